"""`relation_records.parquet`: a row for each labelled pair, with its states and what every scorer says of it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
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
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import as_input_error, first_line, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import parse_json, read_parquet
from pipeline.training.label_data import parts_seen

FILE = "relation_records.parquet"
SYSTEMS_KEY = b"spatialviz.relation_systems"


@dataclass(frozen=True, eq=False)
class SystemRecords:
    """What one scorer says of P pairs."""

    name: str
    title: str
    relations: tuple[str, ...]
    p: np.ndarray  # (P, R_k) float32
    part: np.ndarray  # (P,) int8: TRAIN or VALIDATION for pairs of frames that it learnt from, else DROPPED
    # prior: of a softmax network all of whose relations were labelled, in the order of `relations`; else empty
    prior: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class RelationRecords:
    """All pairs."""

    relations: tuple[str, ...]  # those that were labelled
    states: np.ndarray  # (P, R) int8
    frame_index: np.ndarray  # (P,) int32
    scenes: tuple[str, ...]  # names, in the order of the frames
    scene: np.ndarray  # (P,) int32: indices in `scenes`
    systems: tuple[SystemRecords, ...]

    def __len__(self) -> int:
        return len(self.states)

    def truth(self, relations: Sequence[str]) -> np.ndarray:
        """(P, K) int8: the states of these relations."""
        return self.states[:, [self.relations.index(r) for r in relations]]

    def clusters(self, counted: np.ndarray) -> tuple[np.ndarray, str]:
        """Clusters for intervals: the scene of each pair; the frame if all (P,) counted pairs are of one scene."""
        return (self.scene, "scene") if len(np.unique(self.scene[counted])) > 1 else (self.frame_index, "frame")


class RelationPass:
    """What a process opens once to score the labelled pairs of frames.

    `options`: arguments of `open_pipeline`. `chosen`: indices of the frames that are scored.
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
        """Rows of a frame; `context` is needed where `needs_frames`."""
        if self.needs_frames:
            assert context is not None
            found = score_lifted(source, self.systems, pairs, context)
        else:
            found = score_stored(self.systems, pairs)
        names, called = np.array(pairs.labels, object), [s.name for s in self.systems]
        seen = [_part_of(s, pairs, self.labels) for s in self.systems]
        columns = {
            "frame": [pairs.key.frame] * len(pairs.a),
            "frame_index": [pairs.key.index] * len(pairs.a),
            "scene": [pairs.key.scene] * len(pairs.a),
            "a": pairs.numbers[pairs.a],
            "b": pairs.numbers[pairs.b],
            "label_a": names[pairs.a],
            "label_b": names[pairs.b],
            "state": struct_of(pairs.relations, pairs.states.T),
            "p": struct_of(called, [struct_of(s.relations, p.T) for s, p in zip(self.systems, found, strict=True)]),
            "learnt_from": struct_of(called, [[part] * len(pairs.a) for part in seen]),
        }
        schema = self._schema
        return pa.Table.from_arrays([pa.array(c, schema.field(n).type) for n, c in columns.items()], schema=schema)


def relation_schema(systems: Sequence[RelationSystem], labels: Labels) -> pa.Schema:
    """Arrow schema: `state` by relation; `p`, a probability by scorer and relation; `learnt_from`, the part of the
    scorer's training data ("train", "validation") with the frame, else null."""
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
    """Prior of a softmax network with labels of all relations; else empty."""
    if not system.prior or system.unlabelled or not isinstance(system.scorer, OnnxScorer):
        return []
    shares = dict(zip(system.scorer.contract.vocabulary, system.prior, strict=True))
    return [shares[r] for r in system.relations]


def struct_of(names: Sequence[str], columns: Iterable[Any]) -> pa.StructArray:
    """Join columns under their names."""
    return pa.StructArray.from_arrays([pa.array(c) for c in columns], names=list(names))


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
    """Relation records as arrays.

    Raises InputError: the file is missing, or is something else.
    """
    wrong = "not a file of relation records"
    with as_input_error(wrong, OSError, KeyError, TypeError, ValueError, got=first_line, path=path):
        require(path.is_file(), "no relation records here", cause="was eval run with --tables grounding?", path=path)
        rows = read_parquet(path, ["frame_index", "scene", "state", "p", "learnt_from"])
        about = parse_json(rows.schema.metadata[SYSTEMS_KEY], path)
    frames, scenes, states, p, learnt = (column.combine_chunks() for column in rows.columns)
    relations = tuple(field.name for field in states.type)
    coded = scenes.dictionary_encode()
    places = pa.array(PARTS)
    systems = tuple(
        SystemRecords(
            s["name"],
            s["title"],
            tuple(s["relations"]),
            _matrix(p.field(s["name"]), s["relations"], np.float32),
            pc.index_in(learnt.field(s["name"]), places).fill_null(DROPPED).to_numpy().astype(np.int8),  # pyright: ignore[reportAttributeAccessIssue]
            tuple(s["prior"]),
        )
        for s in about
    )
    held = _matrix(states, relations, np.int8)
    sound = all(((s.p >= 0) & (s.p <= 1)).all() for s in systems) and np.isin(held, (-1, 0, 1)).all()
    require(sound, "relation records hold a probability outside 0..1, or a state that is none", path=path)
    scene = coded.indices.to_numpy().astype(np.int32)
    names = tuple(coded.dictionary.to_pylist())
    return RelationRecords(relations, held, frames.to_numpy(), names, scene, systems)


def _matrix(rows: pa.StructArray, names: Sequence[str], kind: Any) -> np.ndarray:
    """(P, K): the fields of a struct side by side."""
    # 2 is neither a probability nor a state.
    columns = [rows.field(name).fill_null(2).to_numpy() for name in names]
    return np.stack(columns, axis=1).astype(kind) if columns else np.zeros((len(rows), 0), kind)
