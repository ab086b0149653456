"""Systems that are given the whole expression and give one box: a detector as referring baseline, or a VLM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.diagnosis.frame_evidence import matched
from pipeline.evaluation.records import asked_columns, overlaps
from pipeline.evaluation.vlm.client import ChatClient
from pipeline.evaluation.vlm.questions import GroundingConfig, ground_many
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import HIT, Case, FrameCases
from pipeline.proposals.base import Detector, detect_expression
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class Pointed:
    """Where a system says that an expression's target is.

    Attributes
    ----------
    box : (4,) float or None
        x0, y0, x1, y1, pixels.
    score : float or None
    problem : str or None
        Why there is no box.
    """

    box: np.ndarray | None
    score: float | None = None
    problem: str | None = None


@dataclass(frozen=True)
class Referring:
    """The detector fed the whole expression, as a sentence or as a class name: its best box is the answer."""

    detector: Detector

    def point(self, frame: Frame, texts: Sequence[str]) -> list[Pointed]:
        """One answer for each expression, in order."""
        found = []
        for text in texts:
            try:
                proposals = detect_expression(self.detector, frame, text)
            except InputError as error:
                found.append(Pointed(None, problem=str(error)))
                continue
            if not len(proposals):
                found.append(Pointed(None, problem="nothing detected"))
                continue
            best = int(np.argmax(proposals.scores))
            found.append(Pointed(proposals.boxes[best].astype(np.float64), float(proposals.scores[best])))
        return found


@dataclass(frozen=True)
class VlmOptions:
    """A vision-language model behind an OpenAI-compatible server.

    Attributes
    ----------
    url, model : str
    requests_per_minute : float or None
    timeout_s : float
    workers : int
        Questions in flight at once.
    box_scale : str or float
        See `pipeline.evaluation.vlm.answers.parse_box`.
    """

    url: str
    model: str
    requests_per_minute: float | None = None
    timeout_s: float = 120.0
    workers: int = 4
    box_scale: Any = "auto"


class Vlm:
    """A vision-language model, asked LLaVA's question for the box of a sentence.

    Parameters
    ----------
    options : VlmOptions

    Attributes
    ----------
    client : ChatClient
        Its `usage` counts requests and tokens.
    """

    def __init__(self, options: VlmOptions) -> None:
        self.client = ChatClient(
            options.url,
            options.model,
            timeout_s=options.timeout_s,
            requests_per_minute=options.requests_per_minute,
        )
        self._config = GroundingConfig(box_scale=options.box_scale, workers=options.workers, keep_going=True)

    def point(self, frame: Frame, texts: Sequence[str]) -> list[Pointed]:
        """One answer for each expression, in order."""
        found = ground_many(self.client, frame, texts, config=self._config)
        return [Pointed(g.box, problem=g.reason if g.box is None else None) for g in found]


WholeExpression = Referring | Vlm
"""Points at what expressions say, without taking them apart."""


def record_whole(case: Case, truth: FrameCases, pointed: Pointed) -> dict[str, Any]:
    """The row of one expression: only what a system that gives one box can be measured by."""
    box = pointed.box
    overlap = iou_2d(np.zeros((0, 4)) if box is None else box[None], truth.boxes)
    iou, strict, lenient = overlaps(None if box is None else 0, case, overlap)
    row = asked_columns(case, truth) | {
        "parse_ok": True, "problem": pointed.problem, "iou": iou, "strict_iou": strict, "set_iou": lenient,
        "correct": iou >= HIT, "strict_correct": strict >= HIT, "set_correct": lenient >= HIT,
    }  # fmt: skip
    if box is not None:
        index = int(matched(overlap, truth.alike[[case.target_object]])[0])
        row |= {"box": box.tolist(), "p_target": pointed.score, "matched_target": None if index < 0 else index}
    return row
