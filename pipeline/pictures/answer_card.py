"""Picture of an answer to show to others: the question, right or wrong, why, the answer beside the truth, the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.cards import Card, cards_of
from pipeline.diagnosis.story_words import Story, Tone, capital
from pipeline.diagnosis.verdict import NOT_SEEN, shown_verdict
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import ON_DARK, RGB, Role
from pipeline.pictures.looks import INK, Look, draw_names, frame_shown, free_corner, scene_shown
from pipeline.pictures.marks import draw_outline, window
from pipeline.pictures.shapes import CHECK, CROSS, LEVEL, POINT, Box, panel, paste, strokes
from pipeline.pictures.text import (
    ELLIPSIS,
    Text,
    draw_text,
    fitted,
    font,
    on_one_line,
    plain,
    shortened,
    width_of,
    wrapped,
)

SIZE = 1200, 630
"""Width and height, pixels: what is shown of a linked page."""
BACK: RGB = (14, 16, 20)
PANEL: RGB = (22, 26, 32)
LINE: RGB = (42, 48, 58)
WORDS: RGB = (232, 235, 240)
DIM: RGB = (163, 173, 186)
WHITE: RGB = (255, 255, 255)
AMBER: RGB = (224, 152, 46)
MARKS: dict[Tone, tuple[RGB, RGB, Sequence[Sequence[tuple[float, float]]]]] = {
    "right": ((29, 131, 80), WHITE, CHECK),
    "also right": (AMBER, (18, 20, 24), POINT),
    "wrong": ((209, 50, 57), WHITE, CROSS),
    "none": ((84, 92, 104), WHITE, LEVEL),
}
EDGE, LEFT = 32, 408
"""Margin, and width of the left column, pixels."""
STAGE: Box = (464, 92, 704, 474)
"""Where the scene is."""
INSET = 264, 212
"""Width and height of the picture over the scene at most."""
LEGEND: dict[Role, str] = {"target": "target", "reference": "reference", "truth": "correct by the labels"}
SPAN_COLORS = {"target": ON_DARK["target"], "reference": ON_DARK["reference"]}


def answer_picture(
    answer: Answer,
    frame: Frame | None = None,
    dataset: str = "",
    caption: str = "",
    beside: Answer | None = None,
) -> np.ndarray:
    """Picture of an answer, (630, 1200, 3) uint8 RGB.

    Parameters
    ----------
    frame : Frame, optional
        The one that was asked of; needed where the question could not be asked.
    dataset : str
        Its name, told below.
    caption : str
        Words in the scene.
    beside : Answer, optional
        Another answer to the same question, whose objects are in view, too, so that both are seen from one place.
    """
    if frame is None:
        judged = answer.diagnosis
        frame = judged.evidence.answers.context.frame if judged is not None else None
        frame = frame if answer.trace is None else answer.trace.frame
    look = Look(answer, frame, None if beside is None else Look(beside, None))
    image = np.full((SIZE[1], SIZE[0], 3), BACK, np.uint8)
    _draw_question(image, answer)
    y = _draw_story(image, told := _told(answer))
    _draw_cards(image, look, told.mend, y)
    _draw_stage(image, look, caption)
    _draw_foot(image, look, dataset)
    return image


def _draw_question(image: np.ndarray, answer: Answer) -> None:
    """Question on top, its target and reference in their colours."""
    width = SIZE[0] - 2 * EDGE
    face, lines = fitted(_question(answer), (28, 24, 20), True, width, 1)
    if lines and str(lines[-1]).endswith(ELLIPSIS):
        face, lines = fitted(_question(answer), (18, 16), True, width, 2)
    top = 66 - 12 * (len(lines) - 1)
    for number, line in enumerate(lines):
        draw_text(image, line, (EDGE, top + 24 * number), face)


def _question(answer: Answer) -> Text:
    spans = () if answer.trace is None else answer.trace.query.spans
    ends = 2 if answer.pairs and answer.pairs[0].second_reference is not None else 1
    colors = [WORDS] * len(answer.text)
    for span in spans:
        if span.role in SPAN_COLORS and (span.role == "target" or span.index <= ends):
            colors[span.start : span.end] = [SPAN_COLORS[span.role]] * (span.end - span.start)
    parts = tuple((letter if letter.isprintable() else " ", c) for letter, c in zip(answer.text, colors, strict=False))
    clean = on_one_line(answer.text)
    return Text(parts) if "".join(t for t, _ in parts) == clean else plain(answer.text, WORDS)


def _told(answer: Answer) -> Story:
    """Story of an answer; without a verdict it is the answer itself."""
    told = answer.story
    if answer.diagnosis is not None or answer.unseen is not None or not answer.pairs:
        return told
    return replace(told, sentence=f"{capital(answer.sentence.replace('·', ' '))}.", mend=told.sentence)


def _draw_story(image: np.ndarray, told: Story) -> int:
    """Mark, head, sentence; returns where they end."""
    fill, ink, lines = MARKS[told.tone]
    y = STAGE[1]
    face, head = fitted(plain(told.head or "Answered", WORDS), (34, 30, 26), True, LEFT - 60, 2)
    tall = 40 if len(head) == 1 else 72
    paste(image, fill, (EDGE, y + (tall - 44) // 2, 44, 44), 22)
    strokes(image, lines, (EDGE, y + (tall - 44) // 2, 44, 44), ink, 4)
    for line in head:
        y += 34
        draw_text(image, line, (EDGE + 58, y - 3), face)
    y = STAGE[1] + tall + 14
    face, said = fitted(plain(told.sentence, WORDS), (24, 22, 20, 18, 16), False, LEFT, 5)
    step = round(face.size * 1.33)
    for line in said:
        y += step
        draw_text(image, line, (EDGE, y - 6), face)
    return y + 18


def _draw_cards(image: np.ndarray, look: Look, mend: str, y: int) -> None:
    """Cards of the answer and of what it should be, and what would mend it."""
    answer, bottom = look.answer, STAGE[1] + STAGE[3]
    cards = cards_of(answer.trace, answer.diagnosis, next(iter(answer.pairs), None), look.name)
    below = wrapped(plain(mend, DIM), font(15), LEFT, 3)
    rows = max((len(card.objects) for card in cards), default=0)
    row = int(np.clip((bottom - y - 46 - 21 * len(below)) / max(rows, 1), 58, 76))
    height = 38 + row * rows
    top = min(y, bottom - height)
    for number, card in enumerate(cards):
        width = (LEFT - 12 * (len(cards) - 1)) // len(cards)
        _draw_card(image, (EDGE + number * (width + 12), top, width, height), row, card, look)
    y = top + height + 10 if cards else y
    for line in below[: max(0, (bottom + 4 - y) // 21)]:
        y += 21
        draw_text(image, line, (EDGE, y - 4), font(15))


def _draw_card(image: np.ndarray, where: Box, row: int, card: Card, look: Look) -> None:
    x, y, width, _ = where
    given = card.kind == "answer"
    panel(image, where, 10, PANEL, LINE)
    draw_text(image, plain(card.title, WORDS if given else ON_DARK["truth"]), (x + 12, y + 24), font(14, True))
    side, bold, small = row - 10, font(14, True), font(13)
    for number, thing in enumerate(card.objects):
        top, at = y + 36 + row * number, x + 12
        if look.frame is not None:
            crop, _, _ = window(look.frame.rgb, thing.bbox[None], (side, side), least=0.04)
            paste(image, crop, (at, top, side, side), 4)
            ends = np.array([at, top, at + side, top + side])
            draw_outline(image, ends, ON_DARK[thing.role], "thin" if given else "dashed")
            at += side + 10
        room = x + width - 8 - at
        name = wrapped(plain(thing.name, WORDS), bold, room, 2)
        note = wrapped(plain(thing.note, DIM), small, room, 3 - len(name))
        base = top + side // 2 + 5 - 9 * (len(name) + len(note) - 1)
        for lines, face in ((name, bold), (note, small)):
            for line in lines:
                draw_text(image, line, (at, base), face)
                base += 18


def _draw_stage(image: np.ndarray, look: Look, caption: str) -> None:
    """The scene with the picture over a corner, or the picture alone."""
    x, y, width, height = STAGE
    if look.frame is None:
        paste(image, PANEL, STAGE, 12)
        return
    shown = scene_shown(look, (width, height))
    taken = [] if not caption else [_caption_box(caption)]
    if shown is None:
        part, placed = frame_shown(look, (width, height))
    else:
        part, placed, boxes = shown
        rgb = look.frame.rgb
        scale = min(INSET[0] / rgb.shape[1], INSET[1] / rgb.shape[0])
        size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
        left, top = free_corner((width, height), size, boxes, 12, above=bool(caption))
        taken.append((left - 1, top - 1, size[0] + 2, size[1] + 2))
        paste(part, LINE, taken[-1], 6)
        paste(part, frame_shown(look, size)[0], (left, top, *size), 6)
    draw_names(part, placed, taken)
    if caption:
        where = _caption_box(caption)
        paste(part, ON_DARK["edited"], where, 6)
        draw_text(part, plain(caption, INK), (where[0] + 14, where[1] + 25), font(18, True))
    paste(image, LINE, (x - 1, y - 1, width + 2, height + 2), 13)
    paste(image, part, STAGE, 12)


def _caption_box(caption: str) -> Box:
    return 12, STAGE[3] - 48, round(width_of(plain(caption, INK), font(18, True))) + 28, 36


def _draw_foot(image: np.ndarray, look: Look, dataset: str) -> None:
    """Legend, and what was asked of."""
    y, x = SIZE[1] - 27, float(EDGE)
    face = font(14)
    for role, name in LEGEND.items():
        if any(n.color == ON_DARK[role] for n in look.all):
            ends = [(x + 9 * k, x + 9 * k + (6 if role == "truth" else 9)) for k in range(3)]
            for start, end in ends:
                paste(image, ON_DARK[role], (round(start), y - 6, round(end - start), 3))
            x = draw_text(image, plain(name, DIM), (x + 36, y), face) + 24
    judged, frame = look.answer.diagnosis, look.frame
    verdict = "" if judged is None else shown_verdict(judged.verdict, judged.detail, judged.lucky)
    if look.answer.unseen is not None:
        verdict = shown_verdict(NOT_SEEN, look.answer.unseen.detail)
    told = " · ".join(filter(None, (dataset, "" if frame is None else f"frame {frame.id}", verdict)))
    mark = plain("spatialviz", WORDS)
    end = SIZE[0] - EDGE - width_of(mark, font(14, True))
    draw_text(image, mark, (end, y), font(14, True))
    line = shortened(plain(told, DIM), face, end - 16 - x)
    draw_text(image, line, (end - 16 - width_of(line, face), y), face)
