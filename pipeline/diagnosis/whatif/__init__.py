"""What-if: an answer under edits, fast enough to follow the mouse.

`edits` says what is changed, `rerun` answers again with `pair_tables`, which also names objects so that the name
survives a re-run, `changes` says what came of it, `region` shows
where the asked relation holds, `state` writes a view as one string.
"""

from pipeline.diagnosis.whatif.changes import what_changed
from pipeline.diagnosis.whatif.edits import Edits, PlacedBox, edits_record, load_edits, read_edits
from pipeline.diagnosis.whatif.rerun import Baseline, Outcome, rerun

__all__ = [
    "Baseline",
    "Edits",
    "Outcome",
    "PlacedBox",
    "edits_record",
    "load_edits",
    "read_edits",
    "rerun",
    "what_changed",
]
