"""An audit of whatever it is given: a labels folder, sentences with their truth, or a benchmark of questions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pipeline.answering.pipeline import open_pipeline
from pipeline.corrections.audit.labels import audit_labels
from pipeline.corrections.audit.questions import audit_questions
from pipeline.corrections.audit.report import LIKELY, AuditReport
from pipeline.corrections.audit.sentences import audit_sentences
from pipeline.corrections.audit.systems import read_answers
from pipeline.corrections.review.queue import QueueConfig
from pipeline.evaluation.robospatial import is_robospatial, read_question_answers, read_questions, score_table
from pipeline.evaluation.sentence_files import read_sentence_file
from pipeline.labels.reading import MANIFEST_FILE, open_labels
from pipeline.system.errors import needed, require


def audit(
    target: Path,
    dataset: str | None = None,
    runs: Sequence[Path] = (),
    *,
    options: dict[str, Any] | None = None,
    queue: QueueConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> AuditReport:
    """The items of labels or of a benchmark, ranked by how probably their truth is wrong.

    Parameters
    ----------
    target
        A labels folder; RoboSpatial-Home's; or, about the frames of `dataset`, a file of sentences as `eval
        --sentences` takes it.
    runs
        Run folders of systems that answered the same items; of RoboSpatial-Home files of answers in its form.
    options
        Arguments of `open_pipeline`.
    queue
        Of the review queue of labels.
    progress
        Told (done, in all).

    Raises InputError: something cannot be read, or --dataset is missing.
    """
    if is_robospatial(target):
        return _of_questions(target, dataset, runs, options or {}, progress)
    systems = [read_answers(run) for run in runs]
    if (target / MANIFEST_FILE).is_file():
        labels = open_labels(target)
        where = dataset or str(labels.manifest.dataset.get("path") or "DATASET")
        return AuditReport.ranked(where, audit_labels(labels, systems, queue))
    require(target.exists(), "there is nothing to audit", expected="labels, or a benchmark's file", path=target)
    where = needed(dataset, "sentences are audited on their dataset", expected="--dataset DATASET", path=target)
    source = open_pipeline(where, **(options or {}))
    asked = read_sentence_file(target, source, where if where == "demo" else None)
    return AuditReport.ranked(where, audit_sentences(source, asked, systems, progress))


def _of_questions(
    root: Path,
    dataset: str | None,
    runs: Sequence[Path],
    options: dict[str, Any],
    progress: Callable[[int, int], None] | None,
) -> AuditReport:
    where = dataset or str(root)
    questions = read_questions(root)
    systems = [read_question_answers(run, questions) for run in runs]
    source = open_pipeline(where, **options) if options.get("detector") else None
    items = list(audit_questions(questions, systems, source, progress))
    doubted = {item.id for item in items if item.score >= LIKELY}
    table = score_table(questions, systems, doubted) if systems else None
    return AuditReport.ranked(where, items, table)
