"""Recomputing every answer of a question file from the tables, by other ways than those that made it."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from export_readers import load_json

from pipeline.datasets import Dataset
from pipeline.labels import Labels, VqaConfig, labelled_dataset
from pipeline.labels.exports.base import ExportFrame, iterate_frames, open_provenance
from pipeline.labels.exports.vqa_geometry import (
    KINDS,
    Depths,
    Figures,
    figures_of,
)
from pipeline.labels.exports.vqa_questions import CONVERSATIONS_FILE, IMAGE_TOKEN, SIZE_AXES, boxed_by_people, distance
from pipeline.language import readable, same_class
from pipeline.system import InputError


@dataclass(frozen=True)
class VqaQuestion:
    """One question about one frame."""

    id: str
    image: str
    """File name of the picture, relative to the export."""
    kind: str
    frame: str
    frame_index: int
    objects: tuple[int, ...]
    """relation: (target, reference). which: (answer, reference). grounding: (target, reference). distance: the two.
    size: the one."""
    about: str
    """The relation; or what is measured: "center", "gap", "height", "width"."""
    question: str
    answer: str
    """What the human says without the image token, and what the model is to say."""
    source: str | None = None
    """Of a grounding question the id of its expression."""
    rests_on: str | None = None
    """Of a distance or a size what its figure was measured on: see `vqa_geometry`."""

    def record(self) -> dict[str, Any]:
        """As LLaVA's training data has it, with `metadata` beside."""
        return {
            "id": self.id,
            "image": self.image,
            "conversations": [
                {"from": "human", "value": f"{IMAGE_TOKEN}\n{self.question}"},
                {"from": "gpt", "value": self.answer},
            ],
            "metadata": {
                "kind": self.kind,
                "frame": self.frame,
                "frame_index": self.frame_index,
                "objects": list(self.objects),
                "about": self.about,
                "source": self.source,
                "rests_on": self.rests_on,
            },
        }


def verify_vqa(
    path: str | Path, labels: Labels, config: VqaConfig | None = None, dataset: Dataset | None = None
) -> list[str]:
    """What is wrong in an export of questions: one line a question, none where all is well.

    Parameters
    ----------
    path : str or Path
        The exported folder.
    labels : Labels
        Those that were exported.
    config : VqaConfig, optional
        The options of the export.
    dataset : Dataset, optional
        Whose depth was measured; the dataset that the labels name by default.
    """
    config = config or VqaConfig()
    depths = Depths(lambda: dataset or labelled_dataset(labels.manifest))
    provenance = open_provenance(labels)
    by_frame = groupby(read_questions(Path(path)), key=lambda q: q.frame_index)
    frames = iterate_frames(labels)
    wrong: list[str] = []
    for index, questions in by_frame:
        rows = next((r for r in frames if r.index == index), None)
        if rows is None:
            raise InputError(f"questions of frame_index {index}, which the labels lack or have earlier", path=path)
        asked = list(questions)
        figures: dict[int, Figures] = {}
        if any(q.kind in ("distance", "size") for q in asked):
            known = figures_of(rows, config, depths, boxed_by_people(provenance, rows))
            figures = {row["object"]: one for row, one in zip(rows.objects, known, strict=True)}
        wrong += [f"{q.id}: {problem}" for q in asked if (problem := _problem(q, rows, config, figures)) is not None]
        if len(asked) > config.per_frame:
            wrong.append(f"frame_index {index}: {len(asked)} questions")
    return wrong


def _problem(question: VqaQuestion, rows: ExportFrame, config: VqaConfig, figures: dict[int, Figures]) -> str | None:
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
    return _measure(question, own, rows, [figures[n] for n in question.objects])


def _named_once(rows: ExportFrame, *named: dict[str, Any]) -> bool:
    return all(sum(same_class(row["label"], other["label"]) for other in rows.objects) == 1 for row in named)


def _states(rows: ExportFrame, relation: str, **pair: int) -> list[tuple[int, int, int | None, float | None]]:
    """(a, b, state, margin) of the pairs with those numbers."""
    table = rows.relations.select(["a", "b", relation, f"{relation}_margin"]).to_pylist()
    found = [row for row in table if all(row[key] == number for key, number in pair.items())]
    return [(row["a"], row["b"], row[relation], row[f"{relation}_margin"]) for row in found]


def _relation(question: VqaQuestion, own: list[dict[str, Any]], rows: ExportFrame, config: VqaConfig) -> str | None:
    ((_, _, state, margin),) = _states(rows, question.about, a=question.objects[0], b=question.objects[1])
    if state not in (1, -1) or margin is None or abs(margin) < config.min_margin:
        return f"a relation of state {state} with margin {margin}"
    if not _named_once(rows, *own):
        return "a name that several objects have"
    expected = "Yes" if state == 1 else "No"
    return None if question.answer == expected else f"answered {question.answer}, is {expected}"


def _which(question: VqaQuestion, own: list[dict[str, Any]], rows: ExportFrame) -> str | None:
    states = _states(rows, question.about, b=question.objects[1])
    holding = [a for a, _, state, _ in states if state == 1]
    if holding != [question.objects[0]] or any(state not in (1, -1) for _, _, state, _ in states):
        return f"true of the objects {holding}, or doubtful"
    if not _named_once(rows, own[1]):
        return "a reference whose name several objects have"
    return None if question.answer == readable(own[0]["label"]) else "another name"


def _grounding(question: VqaQuestion, own: list[dict[str, Any]], rows: ExportFrame, config: VqaConfig) -> str | None:
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


def _measure(question: VqaQuestion, own: list[dict[str, Any]], rows: ExportFrame, figures: list[Figures]) -> str | None:
    if not _named_once(rows, *own):
        return "a name that several objects have"
    if question.kind == "size":
        value, rests_on = float(figures[0].extents[SIZE_AXES[question.about]]), figures[0].rests_on
    else:
        value, rests_on = distance(question.about, *figures)
    if value is None or np.isnan(value):
        return "an object that is not seen whole"
    if question.rests_on != rests_on:
        return f"said to rest on {question.rests_on}, rests on {rests_on}"
    number, unit = question.answer.split(" ")
    return None if unit == "m" and abs(float(number) - value) <= 0.00501 else f"answered {number}, is {value:.3f}"


def question_of(record: Mapping[str, Any]) -> VqaQuestion:
    """The question of a record.

    Raises
    ------
    InputError
        The record is not one of ours.
    """
    try:
        human, model = record["conversations"]
        start = f"{IMAGE_TOKEN}\n"
        if (human["from"], model["from"]) != ("human", "gpt") or not human["value"].startswith(start):
            raise ValueError("another conversation")
        meta = record["metadata"]
        if meta["kind"] not in KINDS:
            raise ValueError(f"kind {meta['kind']!r}")
        return VqaQuestion(
            record["id"],
            record["image"],
            meta["kind"],
            meta["frame"],
            int(meta["frame_index"]),
            tuple(int(n) for n in meta["objects"]),
            meta["about"],
            human["value"][len(start) :],
            model["value"],
            meta["source"],
            meta.get("rests_on"),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError("not a question of an export", got=f"{type(error).__name__}: {error}"[:120]) from error


def read_questions(root: Path) -> Iterator[VqaQuestion]:
    """The questions of an exported folder, in the order in which they were written.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    path = root / CONVERSATIONS_FILE
    records = load_json(path)
    if not isinstance(records, list):
        raise InputError("a file of conversations is a list", got=type(records).__name__, path=path)
    return map(question_of, records)
