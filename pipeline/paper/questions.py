"""Questions to a vision-language model: for the box of a sentence, and whether the relations of a pair hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from pipeline.evaluation.model_answers import BoxScale, parse_box, parse_yes_no
from pipeline.geometry.frame import Frame
from pipeline.labels.exports.vqa_questions import ask_grounding, ask_relation, can_be_asked
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.chat import ChatAnswer, ChatClient, ChatPicture, ChatQuestion
from pipeline.system.errors import InputError, require

PADDING = (122, 116, 104)
"""CLIP's mean colour, with which LLaVA-1.5 makes pictures square (llava/mm_utils.py, expand2square)."""


@dataclass(frozen=True)
class View:
    """Picture of a frame as it is sent."""

    picture: ChatPicture
    offset: tuple[int, int]
    """x and y of the frame's upper left corner, pixels of the picture."""
    frame_size: tuple[int, int]
    """Width and height of the frame."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture."""
        height, width = self.picture.rgb.shape[:2]
        return width, height

    def to_frame(self, box: Sequence[float]) -> np.ndarray | None:
        """A box as shares of the picture, in the frame's pixels.

        Returns (4,) float32: x0, y0, x1, y1, cut at the frame's edges; None where it lies in the padding.
        """
        corners = np.array(box, np.float64).reshape(2, 2) * self.size
        corners = np.clip(corners - self.offset, 0, self.frame_size)
        return corners.reshape(4).astype(np.float32) if (corners[1] > corners[0]).all() else None


def view_of(rgb: np.ndarray) -> View:
    """Picture of a frame ((H, W, 3) uint8) padded to a square, the frame in the middle.

    LLaVA-1.5 was trained on pictures padded to a square, and its boxes are shares of that square; some servers pad
    themselves, others cut the middle out. A picture that is square already is treated alike by all.
    """
    height, width = ChatPicture(rgb).rgb.shape[:2]
    wide, high = (max(height, width) - inner for inner in (width, height))
    x, y = wide // 2, high // 2
    image = cv2.copyMakeBorder(rgb, y, high - y, x, wide - x, cv2.BORDER_CONSTANT, value=PADDING)
    return View(ChatPicture(image), (x, y), (width, height))


UNKNOWN = 0.5
_YES_NO_TOKENS, _BOX_TOKENS = 32, 64


class Named(Protocol):
    """A thing of a frame: an `Annotation`, a `SceneObject`."""

    @property
    def label(self) -> str: ...

    @property
    def bbox(self) -> np.ndarray: ...


@dataclass(frozen=True)
class PairScores:
    """Answers of the model about N ordered pairs and R relations."""

    relations: tuple[str, ...]
    probabilities: np.ndarray
    """(N, R) float64: 1 for yes, 0 for no, 0.5 for an answer that is not known."""
    known: np.ndarray
    """(N, R) bool."""
    ambiguous: np.ndarray
    """(N,) bool: pairs with a name that another thing of the frame has too."""
    texts: tuple[tuple[str, ...], ...]
    """N by R."""
    reasons: dict[str, int]
    """Counts of why answers are not known."""


def score_pairs(
    client: ChatClient,
    frame: Frame,
    objects: Sequence[Named],
    pairs: np.ndarray | Sequence[tuple[int, int]],
    relations: Sequence[str],
    *,
    workers: int = 4,
) -> PairScores:
    """Ask of each pair whether each relation holds, in LLaVA's words; things are told apart by their names only.

    `objects`: things with a label and a bbox, such as the frame's annotations. `pairs` (N, 2) int: indices of a and b
    in `objects`. `relations`: out of `PAIRWISE`.

    Raises InputError: arguments out of range.
    Raises ServerError: no answer from the server to any question.
    """
    indices = _checked(pairs, len(objects), relations)
    asked = [_question(relation, objects[a].label, objects[b].label) for a, b in indices for relation in relations]
    # Things of one name ask the same, and are asked about once.
    prompts = [text for text in dict.fromkeys(asked) if text is not None]
    picture = view_of(frame.rgb).picture
    questions = [ChatQuestion(text, picture, _YES_NO_TOKENS) for text in prompts]
    answers = dict(zip(prompts, client.ask_many(questions, workers=workers), strict=True))
    shape = (len(indices), len(relations))
    probabilities, reasons = np.full(shape, UNKNOWN), Counter[str]()
    for cell, text in enumerate(asked):
        value, reason = (None, "a name that cannot stand in a question") if text is None else _judged(answers[text])
        if value is None:
            reasons[reason] += 1
        else:
            probabilities.flat[cell] = float(value)
    said = iter("" if text is None else answers[text].text for text in asked)
    return PairScores(
        tuple(relations),
        probabilities,
        probabilities != UNKNOWN,
        np.asarray(_shared_names(objects)[indices].reshape(-1, 2).any(axis=1)),
        tuple(tuple(next(said) for _ in relations) for _ in indices),
        dict(reasons),
    )


def _question(relation: str, a: str, b: str) -> str | None:
    """None where a name cannot be said."""
    if not (can_be_asked(a) and can_be_asked(b)):
        return None
    try:
        return ask_relation(relation, a, b, 0)
    except InputError:
        return None


def _judged(answer: ChatAnswer) -> tuple[bool | None, str]:
    """Yes or no, or None and the reason."""
    if answer.failure is not None:
        return None, "the server failed"
    verdict = parse_yes_no(answer.text)
    cut = ", cut off by max_tokens" if answer.finish == "length" else ""
    return verdict.value, f"{verdict.reason}{cut}"


def _shared_names(objects: Sequence[Named]) -> np.ndarray:
    """(M,) bool: things with a name in common with another thing."""
    forms = [normal_form(thing.label) for thing in objects]
    counts = Counter(forms)
    return np.array([counts[form] > 1 for form in forms], np.bool_)


def _checked(pairs: np.ndarray | Sequence[tuple[int, int]], count: int, relations: Sequence[str]) -> np.ndarray:
    indices = np.asarray(pairs)
    if not indices.size:
        indices = np.zeros((0, 2), np.int64)
    require(
        indices.ndim == 2 and indices.shape[1] == 2 and np.issubdtype(indices.dtype, np.integer),
        "pairs must be int (N, 2)",
        got=f"{indices.dtype} {indices.shape}",
    )
    sound = not indices.size or (indices.min() >= 0 and indices.max() < count)
    require(sound, "a pair names an object that is not there", got=pairs, expected=f"0 to {count - 1}")
    known = " | ".join(PAIRWISE)
    for relation in relations:
        require(relation in PAIRWISE, "no such relation of two things", got=repr(relation), expected=known)
    return indices


@dataclass(frozen=True)
class Grounding:
    """Box of an expression's target, by the model."""

    box: np.ndarray | None
    """(4,) float32: x0, y0, x1, y1, pixels of the frame."""
    raw: str
    """The answer."""
    reason: str | None = None
    """Why there is no box."""
    notes: tuple[str, ...] = ()
    """What had to be mended or assumed to read it."""


def ground_many(
    client: ChatClient, frame: Frame, texts: Sequence[str], *, box_scale: BoxScale = "auto", workers: int = 4
) -> list[Grounding]:
    """Ask for the boxes of expressions about one frame, such as "the mug left of the laptop"; answers in the same
    order.

    `box_scale`: as `parse_box` takes it; pixels are those of the picture as it is sent. Models that count in
    thousandths (Qwen3-VL, InternVL) need 1000.

    Raises InputError: an expression that cannot be asked.
    Raises ServerError: no answer from the server to any question.
    """
    # An unusable scale is told before the server is asked.
    parse_box("", (1, 1), box_scale)
    require(all(text.strip() for text in texts), "an expression is empty")
    view = view_of(frame.rgb)
    questions = [ChatQuestion(ask_grounding(text, 0), view.picture, _BOX_TOKENS) for text in texts]
    return [_grounding(answer, view, box_scale) for answer in client.ask_many(questions, workers=workers)]


def _grounding(answer: ChatAnswer, view: View, scale: BoxScale) -> Grounding:
    if answer.failure is not None:
        return Grounding(None, "", answer.failure)
    found = parse_box(answer.text, view.size, scale)
    if found.box is None:
        cut = ", cut off by max_tokens" if answer.finish == "length" else ""
        return Grounding(None, answer.text, f"{found.reason}{cut}", found.notes)
    box = view.to_frame(found.box)
    reason = "a box outside the frame, in the padding" if box is None else None
    return Grounding(box, answer.text, reason, found.notes)
