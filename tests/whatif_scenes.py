"""Questions for the what-if tests: a row of things with a true detector, and with one that scores and has no ids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scenes import frame_of, upright

from pipeline.answering import AskConfig, Pipeline, PreparedFrame
from pipeline.datasets import Dataset
from pipeline.geometry import Frame
from pipeline.proposals import AnnotationDetector, Proposals
from pipeline.relations import make_scorer

KNOWN = ("mug", "laptop", "book", "lamp", "table", "box")


def row() -> Frame:
    """From left to right on a table: mug 0, book 1, mug 2, laptop 3, mug 4; the table is 5."""
    things = [upright((x, 0.5, 1.5), (0.14, 0.16, 0.14)) for x in (-0.6, -0.3, 0.0, 0.3, 0.6)]
    table = upright((0, 0.63, 1.5), (1.6, 0.1, 0.6))
    return frame_of([*things, table], ["mug", "book", "mug", "laptop", "mug", "table"], pitch=25)


@dataclass(frozen=True)
class ScoringDetector:
    """The annotated objects with scores, each also shifted and less sure, without identities."""

    name = "scoring"
    exact = False
    vocabulary = KNOWN

    def fingerprint(self) -> str:
        return "scoring"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        truth = AnnotationDetector(KNOWN).detect(frame, labels)
        n = len(truth)
        order = np.r_[np.arange(n), np.arange(n)]
        rng = np.random.default_rng(n)
        offset = np.r_[np.zeros(n), np.full(n, 3.0)].astype(np.float32)[:, None]
        return replace(
            truth.take(order),
            boxes=truth.boxes[order] + offset,
            scores=np.round(rng.uniform(0.2, 0.9, 2 * n), 2).astype(np.float32),
            ids=np.full(2 * n, -1),
        )


class RowDataset:
    """Just enough of a dataset for a Source."""

    name, root, class_names, frame_ids = "row", Path("row"), KNOWN, ("scene/0",)


def source(detector: object = None, scorer: str = "trained", **config: object) -> Pipeline:
    dataset: Dataset = RowDataset()  # pyright: ignore
    found = detector or AnnotationDetector(KNOWN)
    return Pipeline(dataset, found, make_scorer(scorer), AskConfig(**config))  # pyright: ignore


def context_of(frame: Frame | None = None) -> PreparedFrame:
    return PreparedFrame(frame or row())
