"""Cases that are kept: a frame, its detections, an expression and the answer, as a folder that can be run again.

`saving` writes one and reads it back as a source, `replay` runs it again and says what changed,
`manifest` and `kept_proposals` are its two JSON files.
"""

from pipeline.diagnosis.answer import Answer, answer_record
from pipeline.diagnosis.asking import answer
from pipeline.diagnosis.cases.replay import Replay, find_cases, replay_case, update_case
from pipeline.diagnosis.cases.saving import OpenedCase, open_case, save_case

__all__ = [
    "Answer",
    "OpenedCase",
    "Replay",
    "answer",
    "answer_record",
    "find_cases",
    "open_case",
    "replay_case",
    "save_case",
    "update_case",
]
