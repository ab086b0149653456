"""Recomputing every answer of a question file from the tables, by other ways than those that made it."""

from __future__ import annotations

import ast
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import InputError
from pipeline.labels.exports.frame_rows import FrameRows, iterate_frames
from pipeline.labels.exports.vqa_questions import measured_extents
from pipeline.labels.exports.vqa_records import Question, VqaConfig, read_questions
from pipeline.labels.noun_phrase import readable
from pipeline.labels.reading import Labels
from pipeline.naming import same_class


def verify_vqa(path: str | Path, labels: Labels, config: VqaConfig | None = None) -> list[str]:
    """What is wrong in an export of questions: one line a question, none where all is well.

    Parameters
    ----------
    path : str or Path
        The exported folder.
    labels : Labels
        Those that were exported.
    config : VqaConfig, optional
        The options of the export.
    """
    config = config or VqaConfig()
    by_frame = groupby(read_questions(Path(path)), key=lambda q: q.frame_index)
    frames = iterate_frames(labels)
    wrong: list[str] = []
    for index, questions in by_frame:
        rows = next((r for r in frames if r.index == index), None)
        if rows is None:
            raise InputError(f"questions of frame_index {index}, which the labels lack or have earlier", path=path)
        asked = list(questions)
        wrong += [f"{q.id}: {problem}" for q in asked if (problem := _problem(q, rows, config)) is not None]
        if len(asked) > config.per_frame:
            wrong.append(f"frame_index {index}: {len(asked)} questions")
    return wrong


def _problem(question: Question, rows: FrameRows, config: VqaConfig) -> str | None:
    objects = {row["object"]: row for row in rows.objects}
    if question.frame != rows.frame["frame"] or any(n not in objects for n in question.objects):
        return "about objects that the frame lacks"
    own = [objects[n] for n in question.objects]
    if question.kind == "relation":
        return _relation(question, own, rows, config)
    if question.kind == "which":
        return _which(question, own, rows)
    if question.kind == "grounding":
        return _grounding(question, own, rows, config)
    return _measure(question, own, rows)


def _named_once(rows: FrameRows, *named: dict[str, Any]) -> bool:
    return all(sum(same_class(row["label"], other["label"]) for other in rows.objects) == 1 for row in named)


def _states(rows: FrameRows, relation: str, **pair: int) -> list[tuple[int, int, int | None, float | None]]:
    """(a, b, state, margin) of the pairs with those numbers."""
    table = rows.relations.select(["a", "b", relation, f"{relation}_margin"]).to_pylist()
    found = [row for row in table if all(row[key] == number for key, number in pair.items())]
    return [(row["a"], row["b"], row[relation], row[f"{relation}_margin"]) for row in found]


def _relation(question: Question, own: list[dict[str, Any]], rows: FrameRows, config: VqaConfig) -> str | None:
    ((_, _, state, margin),) = _states(rows, question.about, a=question.objects[0], b=question.objects[1])
    if state not in (1, -1) or margin is None or abs(margin) < config.min_margin:
        return f"a relation of state {state} with margin {margin}"
    if not _named_once(rows, *own):
        return "a name that several objects have"
    expected = "Yes" if state == 1 else "No"
    return None if question.answer == expected else f"answered {question.answer}, is {expected}"


def _which(question: Question, own: list[dict[str, Any]], rows: FrameRows) -> str | None:
    states = _states(rows, question.about, b=question.objects[1])
    holding = [a for a, _, state, _ in states if state == 1]
    if holding != [question.objects[0]] or any(state not in (1, -1) for _, _, state, _ in states):
        return f"true of the objects {holding}, or doubtful"
    if not _named_once(rows, own[1]):
        return "a reference whose name several objects have"
    return None if question.answer == readable(own[0]["label"]) else "another name"


def _grounding(question: Question, own: list[dict[str, Any]], rows: FrameRows, config: VqaConfig) -> str | None:
    row = next((row for row in rows.expressions if row["id"] == question.source), None)
    if row is None or not question.question.endswith(row["text"]):
        return "another sentence than the expression's"
    if row["acceptable"] != [question.objects[0]]:
        return f"true of the objects {row['acceptable']}"
    said = np.array(ast.literal_eval(question.answer), np.float64)
    size = np.array([rows.frame["width"], rows.frame["height"]] * 2, np.float64)
    if said.shape != (4,) or (said < 0).any() or (said > 1).any():
        return "not a normalised box"
    # Half a unit of the last digit, in shares of the picture.
    return (
        None
        if (np.abs(said - np.clip(np.array(own[0]["bbox"]) / size, 0, 1)) <= 0.5001 * 10.0**-config.box_decimals).all()
        else "another box"
    )


def _measure(question: Question, own: list[dict[str, Any]], rows: FrameRows) -> str | None:
    if not _named_once(rows, *own):
        return "a name that several objects have"
    if any(row["touches_border"] or row["fallback"] for row in own):
        return "an object that is not seen whole"
    if question.about == "center":
        value = float(np.sqrt(sum((p - q) ** 2 for p, q in zip(own[0]["center"], own[1]["center"], strict=True))))
    elif question.about == "gap":
        a, b = question.objects
        pairs = rows.relations.select(["a", "b", "distance"]).to_pylist()
        value = next(row["distance"] for row in pairs if (row["a"], row["b"]) == (a, b))
    else:
        axis = {"height": 1, "width": 0}[question.about]
        value = float(measured_extents(own[0], rows.frame["up"])[axis])
    number, unit = question.answer.split(" ")
    return None if unit == "m" and abs(float(number) - value) <= 0.00501 else f"answered {number}, is {value:.3f}"
