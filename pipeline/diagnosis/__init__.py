"""Diagnosis of answers: the module that failed, the reason, and the smallest change to mend it.

`frame_evidence` joins what was detected in a frame with what is true of it,
`substitution` ranks again with parts of the pipeline replaced by the truth,
`decision` names the module, `story` says it in words, `asking` answers and
judges, `cases` keeps answers, `whatif` edits them.
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.diagnosis.answer import (
        Answer,
        answer_record,
        diagnosis_record,
        failed_stages,
        stages_of,
        unasked_stages,
    )
    from pipeline.diagnosis.asking import (
        annotated_truth,
        ask_and_judge,
        frame_truth,
        judge_sentence,
        judge_trace,
        labelled_truth,
    )
    from pipeline.diagnosis.cases.replay import ReplayResult, find_cases, replay_all
    from pipeline.diagnosis.cases.saving import open_case, save_case
    from pipeline.diagnosis.decision import diagnose
    from pipeline.diagnosis.frame_evidence import FrameEvidence
    from pipeline.diagnosis.marks import MARKS, read_marks
    from pipeline.diagnosis.oracles import ALL_ORACLES, CONF, LIFT, ORACLES, SRM, SUBSETS, names_of
    from pipeline.diagnosis.sentence_truth import sentence_case
    from pipeline.diagnosis.story_words import Story
    from pipeline.diagnosis.substitution import substitute
    from pipeline.diagnosis.suggestions import (
        SuggestedQuestions,
        completions,
        first_answered,
        missed_names,
        suggest_expressions,
        suggest_questions,
    )
    from pipeline.diagnosis.verdict import MODULE_OF, VERDICTS, Diagnosis, Missed, shown_verdicts
    from pipeline.diagnosis.whatif import Baseline, Edits, edits_record, load_edits, what_changed
    from pipeline.diagnosis.whatif.answer_view import AnswerView, BothAnswers, OtherAnswer, shown_objects
    from pipeline.diagnosis.whatif.changes import each_edit, without_edit
    from pipeline.diagnosis.whatif.edit_words import edit_from_words, edits_from_words
    from pipeline.diagnosis.whatif.placement import SMALLEST_SIDE, box_numbers
    from pipeline.diagnosis.whatif.region import AskedPair, asked_pair
    from pipeline.diagnosis.whatif.rerun import foreign_keys
    from pipeline.diagnosis.whatif.state import CameraView, ViewState, decode, encode

__getattr__ = lazy_exports(__name__, __file__)
