"""Asking a vision-language model behind a server for the boxes of expressions: pictures, questions, answers."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.datasets import Dataset
from pipeline.evaluation.model_answers import box_numbers, spoken_part
from pipeline.evaluation.place_reading import PlacedLine, PlaceReading, read_places
from pipeline.evaluation.run import chosen_ids
from pipeline.evaluation.written_places import WrittenPlace, written_place
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import read_cases
from pipeline.labels.exports.vqa_questions import ask_grounding
from pipeline.labels.reading import Labels
from pipeline.system.chat import ChatAnswer, ChatClient, ChatPicture, ChatQuestion
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

PADDING = (122, 116, 104)
"""CLIP's mean colour, with which LLaVA-1.5 makes pictures square (llava/mm_utils.py, expand2square)."""
_BOX_TOKENS = 64
SAMPLED = 48
"""So many answers, spread over the run, say what a model's numbers mean; they are kept, and not asked for again."""
OVERSHOOT = 1.0
"""Picture widths beyond the edge at which a number is no overshoot but another scale."""


@dataclass(frozen=True)
class Pointed:
    """A box for an expression's target."""

    box: np.ndarray | None  # (4,) float: x0, y0, x1, y1, pixels
    score: float | None = None
    problem: str | None = None  # why there is no box


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

    def of_frame(self, boxes: np.ndarray) -> np.ndarray:
        """Boxes (N, 4) in the frame's pixels as shares of the picture."""
        return (boxes + np.tile(self.offset, 2)) / np.tile(self.size, 2)


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


def decided_readings(
    client: ChatClient,
    model: str,
    dataset: Dataset,
    labels: Labels,
    limit: int | None = None,
    told: Sequence[PlaceReading] = (),
) -> tuple[tuple[PlaceReading, ...], tuple[str, ...]]:
    """Decide what the numbers of a model mean, over its answers to a sample of the expressions, and say so in words.

    `limit`: expressions of the run. `told`: as far as it is known.

    Raises InputError: two readings fit alike; it names the option that tells.
    Raises ServerError: no answer from the server to any question.
    """
    asked = sorted(chosen_ids(labels, limit or labels.manifest.counts["expressions"]) or ())
    chosen = {asked[k] for k in np.unique(np.linspace(0, len(asked) - 1, min(SAMPLED, len(asked))).astype(int))}
    lines: list[PlacedLine] = []
    for index in sorted({frame for frame, _ in chosen}):
        for truth in read_cases(labels, index, index + 1):
            try:
                view = view_of(dataset.load(truth.frame).rgb)
            except InputError:
                continue
            cases = [case for case in truth.cases if (index, case.id) in chosen]
            answers = client.ask_many([_question(case.text, view) for case in cases])
            for case, answer in zip(cases, answers, strict=True):
                place = _written(answer)
                if isinstance(place, WrittenPlace):
                    things = view.of_frame(truth.boxes[truth.alike[case.target_object]])
                    lines.append(PlacedLine(f"frame {truth.frame}", place, view.size, things, model))
    if not lines:
        return tuple(told), ()
    places, notes = read_places(lines, told)
    return tuple(dict.fromkeys(place.reading for place in places)), tuple(notes)


def point_by_model(
    client: ChatClient, frame: Frame, texts: Sequence[str], model: str = "", readings: Sequence[PlaceReading] = ()
) -> list[Pointed]:
    """Ask for the boxes of expressions about one frame, such as "the mug left of the laptop"; in the same order.

    `model`: its name, which says how a known one counts. `readings`: what its numbers may mean.

    Raises InputError: an expression that cannot be asked.
    Raises ServerError: no answer from the server to any question.
    """
    require(all(text.strip() for text in texts), "an expression is empty")
    view = view_of(frame.rgb)
    answers = client.ask_many([_question(text, view) for text in texts])
    return [_pointed(answer, view, model, readings) for answer in answers]


def _question(text: str, view: View) -> ChatQuestion:
    return ChatQuestion(ask_grounding(text, 0), view.picture, _BOX_TOKENS)


def _written(answer: ChatAnswer) -> WrittenPlace | str:
    """The place as it is written, or why there is none."""
    if answer.failure is not None:
        return answer.failure
    spoken, reason = spoken_part(answer.text)
    place = None if reason else written_place(spoken)
    if place is not None:
        return place
    found = reason or box_numbers(spoken)
    return f"{found if isinstance(found, str) else 'no box'}{cut_words(answer)}"


def _pointed(answer: ChatAnswer, view: View, model: str, readings: Sequence[PlaceReading]) -> Pointed:
    place = _written(answer)
    if isinstance(place, str):
        return Pointed(None, problem=place)
    try:
        (found,), _ = read_places([PlacedLine("the answer", place, view.size, np.zeros((0, 4)), model)], readings)
    except InputError as error:
        return Pointed(None, problem=error.what)
    if found.point:
        return Pointed(None, problem="a point, no box")
    x0, y0, x1, y1 = found.box
    if min(found.box) < -OVERSHOOT or max(found.box) > 1 + OVERSHOOT:
        return Pointed(None, problem=f"numbers far outside the picture: {found.written}")
    box = view.to_frame((min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)))
    return Pointed(box, problem="an empty box, or one in the padding" if box is None else None)


def cut_words(answer: ChatAnswer) -> str:
    """Words of an answer that the server cut off; empty for a whole one."""
    return ", cut off by max_tokens" if answer.finish == "length" else ""
