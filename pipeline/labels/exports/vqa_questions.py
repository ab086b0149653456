"""The questions that can be asked of a frame with a sure answer, and the choice among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from pipeline.labels.exports import vqa_wording as say
from pipeline.labels.exports.base import image_name
from pipeline.labels.exports.frame_rows import FrameRows
from pipeline.labels.exports.vqa_geometry import POINTS, Figures, gap_between
from pipeline.labels.exports.vqa_records import Kind, Question, VqaConfig
from pipeline.labels.labelling import row_hash
from pipeline.language.noun_phrase import alone
from pipeline.relations.relations import F, T
from pipeline.system.errors import InputError

Unit = Callable[[], tuple[Question, ...]]
"""Questions that are asked together or not at all."""
SIZE_AXES = {"height": 1, "width": 0}
"""What sizes are asked for, and along which of (right, up, forward)."""


@dataclass(frozen=True)
class Scene:
    """One frame, made ready for asking.

    Attributes
    ----------
    rows : FrameRows
    number : (N,) int
        The objects' numbers.
    clear : (N,) bool
        Usable objects whose name means no other object of the frame.
    figures : sequence of N Figures
    """

    rows: FrameRows
    config: VqaConfig
    number: np.ndarray
    clear: np.ndarray
    figures: Sequence[Figures]

    def label(self, place: int) -> str:
        return self.rows.objects[place]["label"]

    def key(self, kind: str, *parts: object) -> int:
        return row_hash(self.config.seed, self.rows.frame["frame"], kind, *parts)

    def question(
        self, kind: Kind, key: int, places: Sequence[int], about: str, text: str, answer: str,
        source: str | None = None, rests_on: str | None = None,
    ) -> Question:  # fmt: skip
        frame = self.rows.frame
        return Question(
            f"{frame['frame_index']:06d}-{kind}-{key:016x}",
            image_name(frame["frame_index"]),
            kind,
            frame["frame"],
            frame["frame_index"],
            tuple(int(self.number[p]) for p in places),
            about,
            text,
            answer,
            source,
            rests_on,
        )


def frame_questions(
    rows: FrameRows, relations: Sequence[str], config: VqaConfig, figures: Sequence[Figures]
) -> list[Question]:
    """The chosen questions of a frame: kinds take turns until there are `per_frame`.

    A relation that holds is asked together with one of the same name that does
    not, so that there are as many yes as no, of every relation.
    """
    if not rows.frame["ok"] or not rows.objects:
        return []
    scene = make_scene(rows, config, figures)
    makers: dict[str, Callable[[], Iterator[Unit]]] = {
        "relation": lambda: relation_units(scene, relations),
        "which": lambda: which_units(scene, relations),
        "grounding": lambda: grounding_units(scene),
        "distance": lambda: distance_units(scene),
        "size": lambda: size_units(scene),
    }
    waiting = [makers[kind]() for kind in config.kinds]
    found: list[Question] = []
    while waiting and len(found) < config.per_frame:
        for units in list(waiting):
            asked = _next_asked(units)
            if asked is None:
                waiting.remove(units)
            elif len(found) + len(asked) <= config.per_frame:
                found += asked
            else:
                waiting.remove(units)
    return found


def _next_asked(units: Iterator[Unit]) -> tuple[Question, ...] | None:
    """The next questions that can be put into words; None where there are no more."""
    for unit in units:
        try:
            return unit()
        except InputError:
            # A name that a sentence cannot carry beside the other one.
            continue
    return None


def make_scene(rows: FrameRows, config: VqaConfig, figures: Sequence[Figures]) -> Scene:
    """Which objects may be named; `figures` are theirs, see `vqa_geometry.figures_of`."""
    labels = [row["label"] for row in rows.objects]
    usable = np.array([row["usable"] for row in rows.objects], np.bool_)
    askable = np.array([say.can_be_asked(label) for label in labels], np.bool_)
    clear = usable & askable & alone(labels)
    return Scene(
        rows,
        config,
        np.array([row["object"] for row in rows.objects], np.int64),
        clear,
        figures,
    )


@dataclass(frozen=True)
class _Pairs:
    """Pairs of a frame: places of a and b among the objects, and a relation's state and margin."""

    a: np.ndarray
    b: np.ndarray
    state: np.ndarray
    margin: np.ndarray


def _pairs(scene: Scene, relation: str) -> _Pairs:
    table = scene.rows.relations
    order = np.argsort(scene.number)
    a, b = (order[np.searchsorted(scene.number, table.column(n).to_numpy(), sorter=order)] for n in ("a", "b"))
    # Null, as where a profile does not judge, is as little known as U.
    state = np.nan_to_num(table.column(relation).to_numpy().astype(np.float64)).astype(np.int64)
    margin = np.nan_to_num(table.column(f"{relation}_margin").to_numpy().astype(np.float64))
    return _Pairs(a, b, state, margin)


def relation_units(scene: Scene, relations: Sequence[str]) -> Iterator[Unit]:
    """Pairs of a yes and a no of one relation, the relations in turn."""
    lists: list[list[tuple[int, Unit]]] = []
    for relation in relations:
        pairs = _pairs(scene, relation)
        asked = scene.clear[pairs.a] & scene.clear[pairs.b] & (np.abs(pairs.margin) >= scene.config.min_margin)
        ranked = []
        for wanted in (T, F):
            found = [
                (scene.key("relation", relation, scene.number[a], scene.number[b]), int(a), int(b))
                for a, b in zip(
                    pairs.a[asked & (pairs.state == wanted)], pairs.b[asked & (pairs.state == wanted)], strict=True
                )
            ]
            ranked.append(sorted(found))
        lists.append([(yes[0], _yes_and_no(scene, relation, yes, no)) for yes, no in zip(*ranked, strict=False)])
    for place in range(max(map(len, lists), default=0)):
        turn = sorted((units[place] for units in lists if place < len(units)), key=lambda item: item[0])
        yield from (unit for _, unit in turn)


def _yes_and_no(scene: Scene, relation: str, yes: tuple[int, int, int], no: tuple[int, int, int]) -> Unit:
    def ask() -> tuple[Question, ...]:
        return tuple(
            scene.question(
                "relation", key, (a, b), relation,
                say.ask_relation(relation, scene.label(a), scene.label(b), key), say.say_yes(holds),
            )
            for (key, a, b), holds in ((yes, True), (no, False))
        )  # fmt: skip

    return ask


def which_units(scene: Scene, relations: Sequence[str]) -> Iterator[Unit]:
    """Which object has the relation to a reference: where one has, and every other surely has not."""
    found: list[tuple[int, Unit]] = []
    n = len(scene.number)
    for relation in relations:
        pairs = _pairs(scene, relation)
        judged = np.bincount(pairs.b, minlength=n)
        holds = np.bincount(pairs.b[pairs.state == T], minlength=n)
        not_so = np.bincount(pairs.b[pairs.state == F], minlength=n)
        unique = (holds == 1) & (not_so == judged - 1) & scene.clear
        sure = (pairs.state == T) & (pairs.margin >= scene.config.min_margin) & unique[pairs.b]
        for a, b in zip(pairs.a[sure].tolist(), pairs.b[sure].tolist(), strict=True):
            row = scene.rows.objects[a]
            if row["usable"] and say.can_be_asked(row["label"]):
                key = scene.key("which", relation, scene.number[a], scene.number[b])
                found.append((key, _which(scene, relation, a, b, key)))
    yield from (unit for _, unit in sorted(found, key=lambda item: item[0]))


def _which(scene: Scene, relation: str, a: int, b: int, key: int) -> Unit:
    text = say.ask_which
    return lambda: (
        scene.question(
            "which", key, (a, b), relation, text(relation, scene.label(b), key), say.say_name(scene.label(a))
        ),
    )


def grounding_units(scene: Scene) -> Iterator[Unit]:
    """Where the only object is that an expression is true of."""
    frame = scene.rows.frame
    place = {int(number): k for k, number in enumerate(scene.number)}
    found: list[tuple[int, Unit]] = []
    for row in scene.rows.expressions:
        if row["ambiguous"] or row["acceptable"] != [row["target_object"]]:
            continue
        a, b = place[row["target_object"]], place[row["reference_object"]]
        x0, y0, x1, y1 = scene.rows.objects[a]["bbox"]
        if x1 > x0 and y1 > y0:
            key = scene.key("grounding", row["id"])
            box = say.say_box((x0, y0, x1, y1), frame["width"], frame["height"], scene.config.box_decimals)
            found.append((key, _grounding(scene, row, (a, b), box, key)))
    yield from (unit for _, unit in sorted(found, key=lambda item: item[0]))


def _grounding(scene: Scene, row: dict[str, Any], places: tuple[int, int], box: str, key: int) -> Unit:
    return lambda: (
        scene.question("grounding", key, places, row["relation"], say.ask_grounding(row["text"], key), box, row["id"]),
    )


def distance_units(scene: Scene) -> Iterator[Unit]:
    """How far two objects are apart, by their centres or by the gap between them."""
    found: list[tuple[int, str, int, int]] = []
    for places in combinations(np.flatnonzero(scene.clear).tolist(), 2):
        for measure in ("center", "gap"):
            key = scene.key("distance", measure, *scene.number[list(places)])
            # Who is named first is left to the hash, not to the order of the list.
            a, b = places if key & 1 else places[::-1]
            found.append((key, measure, a, b))
    for key, measure, a, b in sorted(found):
        # Measured in the order of asking: few of all pairs are asked for.
        value, rests_on = distance(measure, scene.figures[a], scene.figures[b])
        if value is not None and value >= scene.config.min_distance:
            yield _distance(scene, measure, (a, b), value, rests_on, key)


def distance(measure: str, a: Figures, b: Figures) -> tuple[float | None, str | None]:
    """Metres between two objects, by their centres or at their nearest points, and what the figure rests on."""
    if measure == "gap":
        return gap_between(a, b), POINTS
    value = float(np.linalg.norm(a.center - b.center))
    return (None if np.isnan(value) else value), " and ".join(sorted({str(a.rests_on), str(b.rests_on)}))


def _distance(
    scene: Scene, measure: str, places: tuple[int, int], value: float, rests_on: str | None, key: int
) -> Unit:
    a, b = places
    return lambda: (
        scene.question(
            "distance", key, places, measure,
            say.ask_distance(measure, scene.label(a), scene.label(b), key >> 1), say.say_metres(value),
            rests_on=rests_on,
        ),
    )  # fmt: skip


def size_units(scene: Scene) -> Iterator[Unit]:
    """How tall and how wide an object is, along the viewer's up and right."""
    found: list[tuple[int, Unit]] = []
    for a in np.flatnonzero(scene.clear).tolist():
        for measure, axis in SIZE_AXES.items():
            value = float(scene.figures[a].extents[axis])
            if not np.isnan(value):
                key = scene.key("size", measure, scene.number[a])
                found.append((key, _size(scene, measure, a, value, key)))
    yield from (unit for _, unit in sorted(found, key=lambda item: item[0]))


def _size(scene: Scene, measure: str, a: int, value: float, key: int) -> Unit:
    return lambda: (
        scene.question(
            "size", key, (a,), measure, say.ask_size(measure, scene.label(a), key), say.say_metres(value),
            rests_on=scene.figures[a].rests_on,
        ),
    )  # fmt: skip
