"""The questions of RoboSpatial-Home, and what answers to them score: by the published metric, and by ours.

Published (evaluation.py of https://github.com/chanhee-luke/RoboSpatial-Eval): a yes/no answer is right that begins with
the right word; of a pointing answer the first pair of numbers in brackets is right inside the polygon of the answer.
Ours: yes or no as the words mean it; of pointing answers the share of all points that fall in the item's mask. Points
are shares of width and height.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.datasets.files import Blob
from pipeline.datasets.images import read_color
from pipeline.datasets.parquet import cell, tables_in
from pipeline.datasets.robospatial import FILE, KEYS, item_name, robospatial_entries
from pipeline.evaluation.model_answers import parse_yes_no
from pipeline.metrics.tables import Row, Table
from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error, first_line, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import parquet_columns, read_parquet

POINTING = "context"
VQA = ("configuration", "compatibility")
COLUMNS = ("answered", *VQA, "VQA", POINTING, "total", "ours", "ours, undoubted")
NOTE = (
    "RoboSpatial-Home's own metric, in percent: configuration and compatibility by the first word, context by the "
    "first point in the answer's polygon; VQA and total are means over categories. Ours: yes or no as the words mean "
    "it, and the share of all points in the mask, as a mean over categories; undoubted: without items whose truth is "
    "more probably wrong than not. Missing answers count as wrong."
)
_NUMBER = r"\s*(\d+\.?\d*)\s*"
_TUPLE, _LIST = re.compile(rf"\({_NUMBER},{_NUMBER}\)"), re.compile(rf"\[{_NUMBER},{_NUMBER}\]")


@dataclass(frozen=True)
class Question:
    """An item."""

    id: str  # "context_0": the category and the row
    frame: str  # of the dataset that its folder is
    category: str
    text: str
    answer: str
    picture: Blob
    mask: Blob | None = None  # nonzero where a point is right

    @property
    def yes(self) -> bool | None:
        """The right answer to a yes/no question; None of the others."""
        return {"yes": True, "no": False}.get(self.answer.strip().lower())

    @cached_property
    def polygon(self) -> np.ndarray:
        """(M, 2) float64 corners x, y of the answer; empty for anything but a list of three points or more."""
        try:
            found = np.array(ast.literal_eval(self.answer.strip()), np.float64)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            return np.zeros((0, 2))
        return found if found.ndim == 2 and found.shape[1] == 2 and len(found) > 2 else np.zeros((0, 2))

    def region(self) -> np.ndarray | None:
        """(H, W) bool: the mask; None without a mask."""
        return None if self.mask is None else read_color(self.mask).max(axis=2) > 0


def is_robospatial(root: Path) -> bool:
    """Recognise the folder of the benchmark, downloaded or as published."""
    return (root / FILE).is_file() or (root.is_dir() and bool(_question_tables(root)))


def read_questions(root: Path) -> list[Question]:
    """The items of a folder.

    Raises InputError: it is not the benchmark, or damaged.
    """
    if (root / FILE).is_file():
        return [
            Question(
                item_name(e["img"]),
                item_name(e["img"]),
                e["category"],
                e["question"],
                e["answer"],
                root / e["img"],
                root / e["mask"] if e.get("mask") else None,
            )
            for e in robospatial_entries(root / FILE)
        ]
    tables = _question_tables(root)
    require(tables, "no RoboSpatial-Home here", expected=f"{FILE}, or tables of {', '.join(KEYS)}", path=root)
    return [question for table in tables for question in _of_table(table, len(tables) > 1)]


def _question_tables(root: Path) -> list[Path]:
    with as_input_error("a table that cannot be read", pa.ArrowException, OSError, got=first_line, path=root):
        return [t for t in tables_in(root) if set(KEYS) <= set(parquet_columns(t))]


def _of_table(table: Path, several: bool) -> Iterator[Question]:
    columns = read_parquet(table, ["category", "question", "answer"]).to_pylist()
    masked = "mask" in parquet_columns(table)
    for row, entry in enumerate(columns):
        frame = f"{table.stem}/{row}" if several else str(row)
        mask = cell(table, row, "mask") if masked and entry["category"] == POINTING else None
        yield Question(
            f"{table.stem.partition('-')[0]}_{row}",
            frame,
            entry["category"],
            entry["question"],
            entry["answer"],
            cell(table, row, "img"),
            mask,
        )


@dataclass(frozen=True)
class QuestionAnswers:
    """A system's answers in its own words, by the item's id."""

    name: str
    texts: dict[str, str]


def read_question_answers(path: Path, questions: Sequence[Question]) -> QuestionAnswers:
    """Answers in the published form: a list of items with the system's `answer`; matched by `img` and `question`.

    Raises InputError: the file is damaged, or answers none of the items.
    """
    by_key = {(q.id, q.text): q.id for q in questions}
    keys = [((item_name(e["img"]), e["question"]), e["answer"]) for e in robospatial_entries(path)]
    texts = {by_key[key]: answer for key, answer in keys if key in by_key}
    require(texts, "it answers none of the items", got=keys[0][0], expected=next(iter(by_key)), path=path)
    return QuestionAnswers(path.stem, texts)


def published_right(question: Question, text: str) -> bool:
    """Judge an answer by the published metric."""
    if question.yes is not None:
        return text.strip().lower().startswith("yes" if question.yes else "no")
    found = _TUPLE.search(text) or _LIST.search(text)
    return found is not None and inside(question.polygon, (float(found[1]), float(found[2])))


def own_right(question: Question, text: str) -> float:
    """Judge by ours: 0 or 1 of a yes/no answer; of points the share in the mask, or without a mask in the polygon."""
    if question.yes is not None:
        return float(parse_yes_no(text).value == question.yes)
    points = points_of(text)
    region = question.region()
    right = [inside(question.polygon, p) if region is None else _in_mask(region, p) for p in points]
    return float(np.mean(right)) if right else 0.0


def points_of(text: str) -> list[tuple[float, float]]:
    """All pairs of numbers in brackets."""
    return [(float(x), float(y)) for pattern in (_TUPLE, _LIST) for x, y in pattern.findall(text)]


def inside(polygon: np.ndarray, point: tuple[float, float]) -> bool:
    """Test a point against a polygon ((M, 2) corners) by the even-odd rule; False without corners."""
    x, y = point
    (x0, y0), (x1, y1) = polygon.T, np.roll(polygon, 1, axis=0).T
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return bool(crossed.sum() % 2)


def _in_mask(region: np.ndarray, point: tuple[float, float]) -> bool:
    size = np.array(region.shape[::-1]) - 1
    column, row = np.clip(np.round(np.array(point) * size), 0, size).astype(int)
    return bool(region[row, column])


def drawn(polygon: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: the pixels inside a polygon of shares."""
    canvas = np.zeros(shape, np.uint8)
    cv2.fillPoly(canvas, [np.round(polygon * (np.array(shape[::-1]) - 1)).astype(np.int32)], 1)
    return canvas > 0


def score_table(questions: Sequence[Question], systems: Sequence[QuestionAnswers], doubted: set[str]) -> Table:
    """A row a system; `doubted` are ids of items with a probably wrong truth."""
    rows = tuple(Row(system.name, _cells(questions, system, doubted)) for system in systems)
    return Table("robospatial", "RoboSpatial-Home", COLUMNS, rows, NOTE)


def _cells(questions: Sequence[Question], system: QuestionAnswers, doubted: set[str]) -> tuple[Any, ...]:
    def mean(of: list[float | None]) -> float | None:
        known = [v for v in of if v is not None]
        return float(np.mean(known)) if known else None

    def by_category(score: Callable[[Question, str], float], counted: Sequence[Question]) -> list[float | None]:
        scores = [(q.category, score(q, system.texts.get(q.id, ""))) for q in counted]
        return [mean([s for category, s in scores if category == name]) for name in (*VQA, POINTING)]

    sound = [q for q in questions if q.id not in doubted]
    *vqa, pointing = published = by_category(published_right, questions)
    ours = (mean(by_category(own_right, counted)) for counted in (questions, sound))
    return len(system.texts), *vqa, mean(vqa), pointing, mean(published), *ours
