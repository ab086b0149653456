"""The labelled pairs of a labels folder, frame by frame, and what relation scorers say of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.evaluation.relation_systems import RelationSystem
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import PAIRWISE
from pipeline.metrics.splits import FrameKey
from pipeline.proposals import make_detector
from pipeline.proposals.base import Detector
from pipeline.relations.features import geometry_of
from pipeline.relations.relations import pairwise_states
from pipeline.relations.scorer import rule_probabilities
from pipeline.system.errors import InputError
from pipeline.training.label_data import GEOMETRY_COLUMNS, column_arrays, object_rows, rows_of_frame


@dataclass(frozen=True, eq=False)
class FramePairs:
    """The labelled pairs of one frame's usable objects.

    Attributes
    ----------
    key : FrameKey
    numbers : (N,) int
        The objects' numbers in the labels, rising.
    labels : tuple of str
        Their class names.
    a, b : (P,) int64
        Places in `numbers`.
    relations : tuple of str
        Those that were labelled.
    states : (P, R) int8
        1 T, 0 U or not judged, -1 F.
    geometry : dict of str to array
        Columns of the objects' table, a row an object.
    frame : dict
        width, height, up of the frame.
    """

    key: FrameKey
    numbers: np.ndarray
    labels: tuple[str, ...]
    a: np.ndarray
    b: np.ndarray
    relations: tuple[str, ...]
    states: np.ndarray
    geometry: dict[str, np.ndarray]
    frame: dict[str, Any]


_GEOMETRY = tuple(dict.fromkeys(name for names in GEOMETRY_COLUMNS.values() for name in names))


def frames_with_pairs(labels: Labels, limit: int | None = None) -> np.ndarray:
    """Indices of the frames that have labelled pairs, rising; at most so many, spread evenly."""
    import pyarrow.parquet as pq

    column = pq.read_table(labels.root / "relations.parquet", columns=["frame_index"]).column("frame_index")
    found = np.unique(column.to_numpy())
    if limit is None or limit >= len(found):
        return found
    return found[np.unique(np.linspace(0, len(found) - 1, limit).astype(int))]


def read_pairs(labels: Labels, first: int, stop: int, chosen: Collection[int] | None = None) -> Iterator[FramePairs]:
    """The labelled pairs of the frames from index `first` up to `stop` (only `chosen` ones), in order.

    Only pairs of usable objects count, as in training.
    """
    relations = tuple(r for r in PAIRWISE if r in labels.relation_names)
    wanted = {
        "frames": ("frame", "frame_index", "scene", "width", "height", "up"),
        "objects": ("frame_index", "object", "label", "usable", *_GEOMETRY),
        "relations": ("frame_index", "a", "b", *relations),
    }
    frames, objects, rows = (_part(labels, table, names, first, stop) for table, names in wanted.items())
    objects = {name: values[objects["usable"]] for name, values in objects.items()}
    for place in np.argsort(frames["frame_index"], kind="stable"):
        index = int(frames["frame_index"][place])
        if chosen is not None and index not in chosen:
            continue
        mine, pairs = (rows_of_frame(t["frame_index"], index) for t in (objects, rows))
        numbers = objects["object"][mine]
        if len(numbers) < 2:
            continue
        a, b = rows["a"][pairs], rows["b"][pairs]
        i, j = (np.minimum(np.searchsorted(numbers, x), len(numbers) - 1) for x in (a, b))
        there = (numbers[i] == a) & (numbers[j] == b) & (i != j)
        if not there.any():
            continue
        yield FramePairs(
            FrameKey(str(frames["frame"][place]), str(frames["scene"][place]), index),
            numbers,
            tuple(str(n) for n in objects["label"][mine]),
            i[there].astype(np.int64),
            j[there].astype(np.int64),
            relations,
            np.stack([rows[r][pairs][there] for r in relations], axis=1).astype(np.int8),
            {name: objects[name][mine] for name in _GEOMETRY},
            {name: frames[name][place] for name in ("width", "height", "up")},
        )


def _part(labels: Labels, table: str, names: Sequence[str], first: int, stop: int) -> dict[str, np.ndarray]:
    import pyarrow.parquet as pq

    chosen = [("frame_index", ">=", first), ("frame_index", "<", stop)]
    found = pq.read_table(labels.root / f"{table}.parquet", columns=list(names), filters=chosen)
    return column_arrays(found.select(list(names)))


def labelled_detector(source: Pipeline) -> Detector:
    """What finds the labelled objects in a frame: the run's own detector where it is exact, else the annotations."""
    if source.detector is not None and source.detector.exact:
        return source.detector
    return make_detector("annotations", class_names=source.dataset.class_names, synonyms=source.synonyms)


def score_lifted(
    source: Pipeline, systems: Sequence[RelationSystem], pairs: FramePairs, context: PreparedFrame
) -> list[np.ndarray]:
    """What each system says of the pairs, on the objects as the dataset's annotations and depth give them.

    Returns
    -------
    list of (P, R_k) float32
        In the order of each system's relations.

    Raises
    ------
    InputError
        The dataset lacks a labelled object, or a network lacks the vector of a class.
    """
    detector = labelled_detector(source)
    proposals = detector.detect(context.frame, None)
    place = {int(number): k for k, number in enumerate(proposals.ids)}
    absent = [int(n) for n in pairs.numbers if int(n) not in place]
    if absent:
        raise InputError(
            f"frame {pairs.key.frame} has no annotation {absent[0]}, which the labels name",
            cause="labels of another dataset, or of another detector? --relation-boxes stored takes their own boxes",
            path=source.dataset.root,
        )
    objects = context.lift(proposals.take(np.array([place[int(n)] for n in pairs.numbers])), detector)
    found = []
    for system in systems:
        scores = replace(source, scorer=system.scorer).score(context, objects, system.relations)
        columns = [scores.relations.index(r) for r in system.relations]
        found.append(scores.probabilities[pairs.a, pairs.b][:, columns].astype(np.float32))
    return found


def score_stored(systems: Sequence[RelationSystem], pairs: FramePairs) -> list[np.ndarray]:
    """The same on boxes and extents as the labels have them; the image is not looked at.

    The rule has no points then: on, in and near are judged by extents.
    """
    from pipeline.relations.model import OnnxScorer

    found = []
    everything = slice(0, len(pairs.numbers))
    for system in systems:
        if isinstance(system.scorer, OnnxScorer):
            contract = system.scorer.contract
            rows = object_rows(geometry_of(contract.features), pairs.geometry, everything, pairs.frame)
            p = system.scorer.probabilities(system.scorer.with_words(rows, pairs.labels))
            order: tuple[str, ...] = contract.vocabulary
        else:
            p = rule_probabilities(pairwise_states(pairs.geometry["lo"], pairs.geometry["hi"]))
            order = PAIRWISE
        columns = [order.index(r) for r in system.relations]
        found.append(p[pairs.a, pairs.b][:, columns].astype(np.float32))
    return found
