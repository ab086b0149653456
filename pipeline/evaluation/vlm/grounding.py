"""Referring expressions by a vision-language model: LLaVA's question for the box that a sentence describes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.evaluation.vlm.box_answers import BoxScale, parse_box
from pipeline.evaluation.vlm.client import Answer, ChatClient, Question
from pipeline.evaluation.vlm.view import View, view_of
from pipeline.geometry.frame import Frame
from pipeline.labels.exports.vqa_wording import ask_grounding
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class GroundingConfig:
    """How boxes are asked for.

    Attributes
    ----------
    box_scale : float, "pixels" or "auto"
        See `box_answers.parse_box`; pixels are those of the picture as it is sent. Models that count in thousandths
        (Qwen3-VL, InternVL) need 1000.
    wording : int
        Which of the house's sentences asks; 0 is LLaVA's.
    square, max_side
        See `view.view_of`.
    max_tokens : int
    workers : int
    keep_going : bool
        Go on without an answer where one question fails for itself.
    """

    box_scale: BoxScale = "auto"
    wording: int = 0
    square: bool = True
    max_side: int | None = None
    max_tokens: int = 64
    workers: int = 4
    keep_going: bool = False


@dataclass(frozen=True)
class Grounding:
    """Where the model says that an expression's target is.

    Attributes
    ----------
    box : (4,) float32 or None
        x0, y0, x1, y1, pixels of the frame.
    raw : str
        The answer.
    reason : str or None
        Why there is no box.
    notes : tuple of str
        What had to be mended or assumed to read it.
    """

    box: np.ndarray | None
    raw: str
    reason: str | None = None
    notes: tuple[str, ...] = ()


def ground(client: ChatClient, frame: Frame, text: str, *, config: GroundingConfig | None = None) -> Grounding:
    """Ask for the box of one expression.

    Parameters
    ----------
    text : str
        "the mug left of the laptop".

    Raises
    ------
    InputError
        For an expression that cannot be asked.
    ServerError
        The server gives no answer.
    """
    return ground_many(client, frame, [text], config=config)[0]


def ground_many(
    client: ChatClient,
    frame: Frame,
    texts: Sequence[str],
    *,
    config: GroundingConfig | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Grounding]:
    """Ask for the boxes of many expressions about one frame; in their order. See `ground`."""
    config = config or GroundingConfig()
    # An unusable scale is told before the server is asked.
    parse_box("", (1, 1), config.box_scale)
    if not all(text.strip() for text in texts):
        raise InputError("an expression is empty")
    view = view_of(frame.rgb, square=config.square, max_side=config.max_side)
    questions = [Question(ask_grounding(text, config.wording), view.picture, config.max_tokens) for text in texts]
    answers = client.ask_many(
        questions,
        workers=config.workers,
        progress=lambda done: progress(done, len(questions)),
        keep_going=config.keep_going,
    )
    return [_grounding(answer, view, config.box_scale) for answer in answers]


def _grounding(answer: Answer, view: View, scale: BoxScale) -> Grounding:
    if answer.failure is not None:
        return Grounding(None, "", answer.failure)
    found = parse_box(answer.text, view.size, scale)
    if found.box is None:
        cut = ", cut off by max_tokens" if answer.finish == "length" else ""
        return Grounding(None, answer.text, f"{found.reason}{cut}", found.notes)
    box = view.to_frame(found.box)
    if box is None:
        return Grounding(None, answer.text, "a box outside the frame, in the padding", found.notes)
    return Grounding(box, answer.text, None, found.notes)
