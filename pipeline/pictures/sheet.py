"""Sheet of a run's failures: the clearest of each verdict, as pictures side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from pipeline.evaluation.run_folder import Failure, Failures, Run
from pipeline.geometry.palette import RGB
from pipeline.language.counted import counted
from pipeline.pictures.answer_card import BACK, DIM, LINE, WORDS, answer_picture
from pipeline.pictures.text import draw_text, font, plain, shortened, width_of
from pipeline.system.errors import require

MOST = 12
"""Pictures of a sheet."""
COLUMNS, TILE = 3, (800, 420)
EDGE, GAP, TOP = 32, 16, 104
"""Margin, what lies between pictures, and the height of the title, pixels."""


def failures_sheet(
    run: Run, search: str = "", progress: Callable[[int, int], None] = lambda done, of: None
) -> np.ndarray:
    """Picture of up to twelve failures of a run, (H, W, 3) uint8 RGB, chosen by `best_failures`.

    `progress`: told of how many are drawn, of how many.

    Raises
    ------
    InputError
        The search cannot be read or finds none, or the dataset or the models are no longer there.
    """
    found = run.failures(search)
    failures = best_failures(found)
    require(failures, "there is no failure to draw", cause="the search finds none" if search else "the run has none")
    rows = -(-len(failures) // COLUMNS)
    wide, tall = TILE
    width = 2 * EDGE + COLUMNS * wide + (COLUMNS - 1) * GAP
    image = np.full((TOP + rows * (tall + GAP) - GAP + EDGE, width, 3), BACK, np.uint8)
    dataset = run.source.dataset.root.name
    of = counted(len(found), "failure") if not search else f"{len(found):,} found by “{search}”"
    shown = f"{len(failures)} of {of} in {counted(run.records.num_rows, 'expression')} on {dataset}"
    _title(image, ((run.name, WORDS, 34, True), (shown, DIM, 24, False)))
    for number, failure in enumerate(failures):
        x, y = EDGE + number % COLUMNS * (wide + GAP), TOP + number // COLUMNS * (tall + GAP)
        picture = answer_picture(failure.answer, dataset=dataset)
        image[y : y + tall, x : x + wide] = cv2.resize(picture, TILE, interpolation=cv2.INTER_AREA)
        cv2.rectangle(image, (x, y), (x + wide - 1, y + tall - 1), LINE, 1)
        progress(number + 1, len(failures))
    return image


def best_failures(found: Failures, most: int = MOST) -> list[Failure]:
    """Failures of a run that show most, in the order of the sheet.

    Verdicts take turns, the most frequent first, and labels that are too narrow last. Of a verdict the next is that of
    the frame and the target that were shown least; then one with a single right answer; then the one whose labelled
    pair is farthest from doubt, at most a metre; then the one with most pixels; then the first of the run.
    """
    rows = found.table.select([c for c in COLUMNS_USED if c in found.table.column_names]).to_pylist()
    waiting: dict[str, list[int]] = {}
    for at, row in enumerate(rows):
        waiting.setdefault(row["verdict"], []).append(at)
    turns = sorted(waiting, key=lambda name: (name in ("LABEL", "CORRECT"), -len(waiting[name]), name))
    chosen, frames, targets = list[int](), Counter[str](), Counter[str]()
    while len(chosen) < most and any(waiting.values()):
        for name in filter(waiting.get, turns):
            at = min(waiting[name], key=lambda at: (*_seen(rows[at], frames, targets), *_doubt(rows[at]), at))
            waiting[name].remove(at)
            frames[rows[at]["frame"]] += 1
            targets[rows[at]["target"]] += 1
            chosen.append(at)
    return [found[at] for at in chosen[:most]]


COLUMNS_USED = ("frame", "target", "verdict", "ambiguous", "answers", "label_margin", "object_pixels")


def _seen(row: dict[str, Any], frames: Counter[str], targets: Counter[str]) -> tuple[int, int]:
    """How often the frame and the target of a row are shown already."""
    return frames[row["frame"]], targets[row["target"]]


def _doubt(row: dict[str, Any]) -> tuple[float, ...]:
    """What speaks against showing a row, the most important first."""
    margin, pixels = (row.get(name) for name in ("label_margin", "object_pixels"))
    several = bool(row.get("ambiguous")) or (row.get("answers") or 1) > 1
    clear = 0.0 if margin is None or not np.isfinite(margin) else min(float(margin), 1.0)
    return float(several), -clear, -float(pixels or 0)


def _title(image: np.ndarray, parts: Sequence[tuple[str, RGB, int, bool]]) -> None:
    mark, x = plain("spatialviz", WORDS), float(EDGE)
    end = image.shape[1] - EDGE - width_of(mark, font(24, True))
    draw_text(image, mark, (end, 66), font(24, True))
    for text, color, size, bold in parts:
        face = font(size, bold)
        x = draw_text(image, shortened(plain(text, color), face, end - 20 - x), (x, 66), face) + 20
