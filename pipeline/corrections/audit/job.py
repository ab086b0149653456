"""An audit of whatever it is given: a labels folder, sentences with their truth, or a benchmark of questions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pipeline.answering.opening import open_pipeline
from pipeline.corrections.audit.labels import audit_labels
from pipeline.corrections.audit.report import AuditReport
from pipeline.corrections.audit.sentences import audit_sentences
from pipeline.corrections.audit.systems import read_answers
from pipeline.corrections.review.queue import QueueConfig
from pipeline.evaluation.sentences import read_sentence_file
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
    target : Path
        A labels folder; or, about the frames of `dataset`, a file of sentences as `eval --sentences` takes it.
    dataset : str, optional
    runs : sequence of Path
        Run folders of systems that answered the same items.
    options : dict, optional
        Arguments of `open_pipeline`.
    queue : QueueConfig, optional
        Of the review queue of labels.
    progress : callable, optional
        Told (done, in all).

    Raises
    ------
    InputError
        Something cannot be read, or --dataset is missing.
    """
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
