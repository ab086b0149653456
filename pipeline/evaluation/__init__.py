"""Evaluation: the systems that are measured, the run folder, and its tables and plots.

A figure without support is NaN and never 0: precision where nothing was said
to hold, recall, average precision and F1 where nothing holds; means go over
what is defined.
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.evaluation.adapters import import_published
    from pipeline.evaluation.browsing import RunRows, complete, with_value
    from pipeline.evaluation.comparing import CHANGES, answer_differences, compare
    from pipeline.evaluation.exporting import export_run
    from pipeline.evaluation.importing import import_run, judge_again
    from pipeline.evaluation.job import RunReport, evaluate_dataset
    from pipeline.evaluation.leakage import AGREEMENT, PERFECT, scorer_share, shares_of_run, title_of
    from pipeline.evaluation.records import read_records
    from pipeline.evaluation.relation_cases import RelationSpec
    from pipeline.evaluation.robospatial import Question, published_right, read_question_answers, read_questions
    from pipeline.evaluation.run import evaluate_labels
    from pipeline.evaluation.run_figures import (
        STANDS_IN,
        Listing,
        Recorded,
        RunFigures,
        doubts_of,
        figures_of,
        judged_by,
        recorded_verdict,
    )
    from pipeline.evaluation.run_folder import Run, open_database, open_run, spec_record
    from pipeline.evaluation.search import find_failures, find_rows, quote
    from pipeline.evaluation.sentence_files import Sentence, SentenceFile, read_sentence_file
    from pipeline.evaluation.sentences import SentenceReport, evaluate_sentences
    from pipeline.evaluation.slices import Slices, slice_by, slice_table
    from pipeline.evaluation.summary import RunSummary, cost_words, oracle_deltas, summarise_run
    from pipeline.evaluation.systems import EvalSpec

__getattr__ = lazy_exports(__name__, __file__)
