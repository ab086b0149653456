"""What is asked of a frame in an evaluation, and what counts as right: read from labels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.labels.frame_stream import frame_spans
from pipeline.language.chain import Unread, why_unread, why_unused
from pipeline.language.expression import Reader, parse
from pipeline.language.noun_phrase import same_names
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Node, Query
from pipeline.relations.relations import U
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import read_parquet

if TYPE_CHECKING:
    from pipeline.labels.reading import Labels
    from pipeline.system.arrow import pa


@dataclass(frozen=True)
class Meant:
    """A sentence as it was read, where it says more than two names and a relation, with what is true of its parts."""

    root: Node
    """The target with all that is said of it."""
    classes: dict[str, np.ndarray]
    """dict of str to (N,) bool: by name: the labelled objects of that class, whatever they look like."""
    attributes: dict[tuple[str, str], np.ndarray]
    """dict of (str, str) to (N,) float64: by name and attribute: .99, .50, .01 as they have it; NaN where nobody knows.
    Empty without attributes."""

    @property
    def chooses(self) -> bool:
        """Tell sentences with answers by comparison: choices, exclusions, the viewer's sides."""
        return any(n.choices or n.excluded or not all(a.of_pairs for a in n.attachments) for n in self.root.walk())


@dataclass(frozen=True)
class Case:
    """One expression with its truth."""

    id: str
    text: str
    target: str
    relation: str
    reference: str
    """The gold triple; of a sentence the target with its first relation, the last two empty without one."""
    target_object: int
    reference_object: int
    """Indices in the frame's objects; the same without a reference."""
    strict: np.ndarray
    acceptable: np.ndarray
    """(K,) int64: indices of the right targets: beyond doubt, and with the undecided ones."""
    ambiguous: bool
    margin: float
    """Of the labelled pair, metres; NaN where it is not known."""
    meant: Meant | None = None
    """None for a plain triple."""

    @property
    def relations(self) -> set[str]:
        """Relations asked of pairs of things."""
        if self.meant is None:
            return {self.relation}
        return {a.relation for n in self.meant.root.walk() for a in n.attachments if not any(e.viewer for e in a.nodes)}


@dataclass(frozen=True)
class FrameCases:
    """All expressions of a frame, and its objects as labelled."""

    frame: str
    frame_index: int
    scene: str
    labels: tuple[str, ...]
    boxes: np.ndarray
    """(N, 4) float64: x0, y0, x1, y1, pixels."""
    alike: np.ndarray
    """(N, N) bool: objects whose class names mean the same."""
    states: dict[str, np.ndarray]
    """dict of str to (N, N) int8: by relation; -1 where a pair has no label."""
    cases: tuple[Case, ...]
    numbers: np.ndarray
    """(N,) int64: the objects' own numbers in the labels: the dataset's own, where they were made from its
    annotations."""
    judged: np.ndarray
    """(N, N) bool: pairs that have a label."""
    geometry: dict[str, np.ndarray]
    """dict of str to (N, K) float64: "lo", "hi", "center", "R" and "size" as labelled; NaN where there is none."""
    facts: dict[str, np.ndarray]
    """dict of str to (N,) float64: "distance" (metres, NaN for unknown), "occluded" (share of the border),
    "mask_pixels"."""
    masks: tuple[str | None, ...]
    """COCO's compressed run-length codes."""
    rgb_hash: str | None = None
    """Content hash of the picture that was labelled; None where it is the one at hand."""

    def check_picture(self, frame: Frame) -> None:
        """Refuse a frame with another picture than the labelled one.

        Raises InputError: another dataset has a frame of the same name, or the dataset has changed.
        """
        require(
            self.rgb_hash is None or frame.content_hash == self.rgb_hash,
            f"frame {self.frame}: another picture than the one that was labelled",
            cause="has the dataset changed, or are these the labels of another one?",
        )

    def acceptable_pairs(self, case: Case) -> np.ndarray:
        """(N, N) bool: pairs of the asked classes with the relation true or undecided.

        Of a sentence: its right targets with all references that may be meant; where the labels have none for a
        target, with any of the class.
        """
        if case.meant is None:
            ends = self.alike[case.target_object][:, None] & self.alike[case.reference_object][None, :]
            return ends & (self.states[case.relation] >= U)
        ends = np.zeros_like(self.judged)
        top = case.meant.root.pairwise
        if top is None:
            return ends
        name = top.nodes[0].label
        ends[case.acceptable] = case.meant.classes[name]
        for attribute in top.nodes[0].attributes:
            ends &= ~(case.meant.attributes[name, str(attribute)] < HIT)[None]
        if top.relation not in self.states:
            return ends
        states = self.states[top.relation]
        true = ends & ((states.T if top.inverse else states) >= U)
        return np.where(true.any(axis=1, keepdims=True), true, ends)

    def roles(self, case: Case) -> list[tuple[str, np.ndarray]]:
        """Names asked for by an expression, each with the (N,) bool of labelled objects."""
        if case.meant is not None:
            return list(case.meant.classes.items())
        ends = ((case.target, case.target_object), (case.reference, case.reference_object))
        return [(name, self.alike[example]) for name, example in ends]


def read_cases(labels: Labels, first: int, stop: int, bare: bool = False) -> Iterator[FrameCases]:
    """Read frames with expressions from index `first` up to `stop`, in order; with `bare` those without any, too."""
    names = [r for r in PAIRWISE if r in labels.relation_names]
    rows = {
        table: _part(labels.root, table, chosen, first, stop)
        for table, chosen in {**_COLUMNS, "relations": ["frame_index", "a", "b", *names]}.items()
    }
    frames = {row["frame_index"]: row for row in rows["frames"].to_pylist()}
    expressions = _by_frame(rows["expressions"])
    objects, relations = _by_frame(rows["objects"]), _by_frame(rows["relations"])
    for index in sorted(objects if bare else expressions):
        found = expressions.get(index, {})
        yield frame_cases(
            frames[index]["frame"],
            index,
            frames[index]["scene"],
            objects[index],
            relations.get(index, {}),
            found,
            names,
            frames[index]["rgb_hash"],
        )


def frame_cases(
    frame: str,
    frame_index: int,
    scene: str,
    objects: Mapping[str, Any],
    relations: Mapping[str, Any],
    expressions: Mapping[str, Any],
    names: Sequence[str],
    rgb_hash: str | None = None,
) -> FrameCases:
    """Cases of a frame by rows of the tables as columns; `names` are the judged relations."""
    numbers = list(objects["object"])
    index_of = {number: k for k, number in enumerate(numbers)}
    states = {name: np.full((len(numbers), len(numbers)), -1, np.int8) for name in names}
    judged = np.zeros((len(numbers), len(numbers)), np.bool_)
    if relations:
        a, b = (np.array([index_of[n] for n in relations[end]], np.int64) for end in ("a", "b"))
        judged[a, b] = True
        for name in names:
            states[name][a, b] = relations[name]
    cases = tuple(
        Case(
            id=expressions["id"][k],
            text=expressions["text"][k],
            target=expressions["target"][k],
            relation=expressions["relation"][k],
            reference=expressions["reference"][k],
            target_object=index_of[expressions["target_object"][k]],
            reference_object=index_of[expressions["reference_object"][k]],
            strict=np.array([index_of[n] for n in expressions["targets"][k]], np.int64),
            acceptable=np.array([index_of[n] for n in expressions["acceptable"][k]], np.int64),
            ambiguous=expressions["ambiguous"][k],
            margin=expressions["margin"][k],
        )
        for k in range(len(expressions["id"]) if expressions else 0)
    )
    return FrameCases(
        frame,
        frame_index,
        scene,
        tuple(objects["label"]),
        np.array(objects["bbox"], np.float64).reshape(-1, 4),
        same_names(objects["label"]),
        states,
        cases,
        np.array(numbers, np.int64),
        judged,
        {name: _rows(objects[name], width) for name, width in _GEOMETRY.items()},
        {name: np.array([np.nan if v is None else v for v in objects[name]], np.float64) for name in _FACTS},
        tuple(objects["mask"]),
        rgb_hash,
    )


def _rows(values: list[Any], width: int) -> np.ndarray:
    """(N, width) float64 of lists of numbers, of which some are missing."""
    return np.array([v if v is not None else [np.nan] * width for v in values], np.float64).reshape(-1, width)


_GEOMETRY = {"lo": 3, "hi": 3, "center": 3, "R": 9, "size": 3}
_FACTS = ("distance", "occluded", "mask_pixels")
_COLUMNS = {
    "frames": ["frame", "frame_index", "scene", "rgb_hash"],
    "objects": ["frame_index", "object", "label", "bbox", "mask", *_GEOMETRY, *_FACTS],
    "expressions": [
        "frame",
        "frame_index",
        "id",
        "text",
        "target",
        "relation",
        "reference",
        "target_object",
        "reference_object",
        "targets",
        "acceptable",
        "ambiguous",
        "margin",
    ],
}


def _part(root: Path, name: str, columns: list[str], first: int, stop: int) -> pa.Table:
    return read_parquet(root / f"{name}.parquet", columns, [("frame_index", ">=", first), ("frame_index", "<", stop)])


def _by_frame(table: pa.Table) -> dict[int, dict[str, list[Any]]]:
    """Columns as lists, by frame; rows are in order of frames."""
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    return {
        frame: {name: values[start:stop] for name, values in columns.items()}
        for frame, start, stop in frame_spans(table.column("frame_index").to_numpy())
    }


HIT = 0.5
"""A box is found where its overlap (IoU) is at least this."""


def read_query(
    case: Case, class_names: Sequence[str], reader: Reader = parse
) -> tuple[Query | None, InputError | None]:
    """Parsed expression, or the error."""
    try:
        return reader(case.text, class_names=tuple(class_names)), None
    except InputError as error:
        return None, error


def misread(query: Query | None, case: Case, problem: InputError | None = None) -> Unread:
    """Reason for reading an expression otherwise than meant; `problem` is the error of reading."""
    if problem is not None:
        return why_unread(problem)
    if query is None:
        return "GRAMMAR"
    e, top = query.expression, query.default.root.triple
    if e is not None and top is not None and len(query.readings) == 1 and not e.inverse and not why_unused(query):
        # One relation between two bare names: it is the names, or the relation.
        return "WORDS" if e.relation == case.relation and e.second_reference is None else "GRAMMAR"
    return why_unused(query) or "GRAMMAR"


def is_gold(query: Query, case: Case) -> bool:
    """Tell queries read as the gold triple and nothing else; of a sentence the reading is the meaning."""
    if case.meant is not None:
        return True
    e = query.expression
    return (
        e is not None
        and len(query.readings) == 1
        and query.default.root.triple is not None
        and len(query.labels) == len({case.target, case.reference})
        and (e.target, e.relation, e.reference) == (case.target, case.relation, case.reference)
        and not e.inverse
        and e.second_reference is None
    )
