"""`relation_records.parquet`: a row for each labelled pair, with its states and what every scorer says of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.evaluation.relation_cases import (
    FramePairs,
    RelationSpec,
    RelationSystem,
    geometry_of_labels,
    open_systems,
    read_pairs,
    score_lifted,
    score_stored,
)
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import PAIRWISE
from pipeline.metrics.splits import DROPPED, PARTS
from pipeline.relations.model import OnnxScorer
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError
from pipeline.system.safe_files import open_parquet, parse_json, read_parquet
from pipeline.training.label_data import parts_seen

FILE = "relation_records.parquet"
SYSTEMS_KEY = b"spatialviz.relation_systems"


@dataclass(frozen=True, eq=False)
class SystemRecords:
    """What one scorer says of P pairs.

    Attributes
    ----------
    name, title : str
    relations : tuple of str
    p : (P, R_k) float32
    part : (P,) int8
        TRAIN or VALIDATION for pairs of frames that it learnt from, else DROPPED.
    prior : tuple of float
        Of a softmax network all of whose relations were labelled, in the order of `relations`; else empty.
    """

    name: str
    title: str
    relations: tuple[str, ...]
    p: np.ndarray
    part: np.ndarray
    prior: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class RelationRecords:
    """All pairs.

    Attributes
    ----------
    relations : tuple of str
        Those that were labelled.
    states : (P, R) int8
    frame_index : (P,) int32
    scenes : tuple of str
        Names, in the order of the frames.
    scene : (P,) int32
        Indices in `scenes`.
    systems : tuple of SystemRecords
    """

    relations: tuple[str, ...]
    states: np.ndarray
    frame_index: np.ndarray
    scenes: tuple[str, ...]
    scene: np.ndarray
    systems: tuple[SystemRecords, ...]

    def __len__(self) -> int:
        return len(self.states)

    def truth(self, relations: Sequence[str]) -> np.ndarray:
        """(P, K) int8: the states of these relations."""
        return self.states[:, [self.relations.index(r) for r in relations]]

    def clusters(self, counted: np.ndarray) -> tuple[np.ndarray, str]:
        """What resembles each other: the scene of each pair; its frame where the (P,) counted ones are of one scene."""
        return (self.scene, "scene") if len(np.unique(self.scene[counted])) > 1 else (self.frame_index, "frame")


class RelationPass:
    """What a process opens once to score the labelled pairs of frames.

    Parameters
    ----------
    spec : RelationSpec
    options : dict
        Arguments of `open_pipeline`.
    labels : Labels
    chosen : collection of int
        Indices of the frames that are scored.
    """

    def __init__(self, spec: RelationSpec, options: dict[str, Any], labels: Labels, chosen: Sequence[int]) -> None:
        self.spec, self.labels = spec, labels
        self.systems = open_systems(options, spec, labels)
        self.needs_frames = geometry_of_labels(spec, labels) == "lifted"
        self._chosen = frozenset(int(index) for index in chosen)
        self._schema = relation_schema(self.systems, labels)

    def cases(self, first: int, stop: int) -> dict[int, FramePairs]:
        """The labelled pairs of the chosen frames in this range, by index."""
        return {f.key.index: f for f in read_pairs(self.labels, first, stop, self._chosen)}

    def table(self, source: Pipeline, pairs: FramePairs, context: PreparedFrame | None) -> pa.Table:
        """The rows of one frame; `context` is needed where `needs_frames`."""
        if self.needs_frames:
            assert context is not None
            found = score_lifted(source, self.systems, pairs, context)
        else:
            found = score_stored(self.systems, pairs)
        return _rows(self._schema, self.systems, pairs, found, self.labels)


def relation_schema(systems: Sequence[RelationSystem], labels: Labels) -> pa.Schema:
    """`state` holds a state for each relation; `p` for each scorer a probability for each of its relations, and
    `learnt_from` the part of its training ("train", "validation") that the frame belongs to, else null."""
    relations = [r for r in PAIRWISE if r in labels.relation_names]
    text = [pa.field(s.name, pa.struct([pa.field(r, pa.float32()) for r in s.relations])) for s in systems]
    about = [{"name": s.name, "title": s.title, "relations": s.relations, "prior": _prior_of(s)} for s in systems]
    return pa.schema(
        [
            pa.field("frame", pa.string()),
            pa.field("frame_index", pa.int32()),
            pa.field("scene", pa.string()),
            pa.field("a", pa.int32()),
            pa.field("b", pa.int32()),
            pa.field("label_a", pa.string()),
            pa.field("label_b", pa.string()),
            pa.field("state", pa.struct([pa.field(r, pa.int8()) for r in relations])),
            pa.field("p", pa.struct(text)),
            pa.field("learnt_from", pa.struct([pa.field(s.name, pa.string()) for s in systems])),
        ],
        metadata={SYSTEMS_KEY: json.dumps(about).encode()},
    )


def _prior_of(system: RelationSystem) -> list[float]:
    """Of a network that says which one relation fits best, where all it can say was labelled; else empty."""
    if not system.prior or system.unlabelled or not isinstance(system.scorer, OnnxScorer):
        return []
    shares = dict(zip(system.scorer.contract.vocabulary, system.prior, strict=True))
    return [shares[r] for r in system.relations]


def _rows(
    schema: pa.Schema,
    systems: Sequence[RelationSystem],
    pairs: FramePairs,
    found: Sequence[np.ndarray],
    labels: Labels,
) -> pa.Table:
    count = len(pairs.a)

    def struct(values: list[Any], names: Sequence[str]) -> Any:
        return pa.StructArray.from_arrays(values, names=list(names))

    names = [np.array(pairs.labels, object)[end].tolist() for end in (pairs.a, pairs.b)]
    text = [
        struct([pa.array(p[:, k], pa.float32()) for k in range(len(s.relations))], s.relations)
        for s, p in zip(systems, found, strict=True)
    ]
    learnt = [_part_of(s, pairs, labels) for s in systems]
    columns = [
        pa.array([pairs.key.frame] * count, pa.string()),
        pa.array(np.full(count, pairs.key.index, np.int32)),
        pa.array([pairs.key.scene] * count, pa.string()),
        pa.array(pairs.numbers[pairs.a].astype(np.int32)),
        pa.array(pairs.numbers[pairs.b].astype(np.int32)),
        *(pa.array(n, pa.string()) for n in names),
        struct([pa.array(pairs.states[:, k]) for k in range(len(pairs.relations))], pairs.relations),
        struct(text, [s.name for s in systems]),
        struct([pa.array([part] * count, pa.string()) for part in learnt], [s.name for s in systems]),
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def _part_of(system: RelationSystem, pairs: FramePairs, labels: Labels) -> str | None:
    if system.trained_on is None:
        return None
    part = int(parts_seen(system.trained_on, labels, [pairs.key])[0])
    return None if part == DROPPED else PARTS[part]


def read_pair_names(path: Path) -> list[tuple[str, str, str]]:
    """Frame and class names (of a, of b) of each pair, in the order of `read_relation_records`."""
    table = read_parquet(path, ["frame", "label_a", "label_b"])
    return list(zip(*(column.to_pylist() for column in table.columns), strict=True))


def read_relation_records(path: Path) -> RelationRecords:
    """Relation records as arrays, read piece by piece.

    Raises
    ------
    InputError
        The file is missing, or is something else.
    """
    try:
        file = open_parquet(path)
        schema = file.schema_arrow
        about = parse_json(schema.metadata[SYSTEMS_KEY], path)
    except FileNotFoundError as error:
        cause = "was eval run with --tables grounding?"
        raise InputError("no relation records here", cause=cause, path=path) from error
    except InputError:
        raise
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError("not a file of relation records", got=str(error).split("\n")[0], path=path) from error
    with file:
        count = file.metadata.num_rows
        relations = tuple(field.name for field in schema.field("state").type)
        states, frames = np.empty((count, len(relations)), np.int8), np.empty(count, np.int32)
        scene, scenes = np.empty(count, np.int32), dict[str, int]()
        p = [np.empty((count, len(s["relations"])), np.float32) for s in about]
        parts = [np.empty(count, np.int8) for _ in about]
        numbers = {None: DROPPED, **{name: k for k, name in enumerate(PARTS)}}
        start = 0
        for batch in file.iter_batches(columns=["frame_index", "scene", "state", "p", "learnt_from"]):
            part = slice(start, start + batch.num_rows)
            frames[part] = batch.column("frame_index").to_numpy()
            scene[part] = [scenes.setdefault(s, len(scenes)) for s in batch.column("scene").to_pylist()]
            for k, relation in enumerate(relations):
                states[part, k] = batch.column("state").field(relation).to_numpy()
            for s, system in enumerate(about):
                text = batch.column("p").field(system["name"])
                for k, relation in enumerate(system["relations"]):
                    p[s][part, k] = text.field(relation).to_numpy()
                learnt = batch.column("learnt_from").field(system["name"]).to_pylist()
                parts[s][part] = [numbers[name] for name in learnt]
            start = part.stop
    systems = tuple(
        SystemRecords(s["name"], s["title"], tuple(s["relations"]), p[k], parts[k], tuple(s["prior"]))
        for k, s in enumerate(about)
    )
    return RelationRecords(relations, states, frames, tuple(scenes), scene, systems)
