"""Training pairs as arrays, and those of a labels folder: its objects as the network is given them, their relations.

Rows are what the network is fed at run time: the labels keep 2D boxes, extents
and the paper's PCA box of every object. Only usable objects take part.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.fitting import canonicalised
from pipeline.geometry.viewer import viewer_axes
from pipeline.labels.reading import Labels, read_table
from pipeline.metrics.splits import DROPPED, TRAIN, VALIDATION, FrameKey, SplitPlan
from pipeline.relations.contract import TrainedOn
from pipeline.relations.features import feature_set, geometry_of, rows_2d, with_class_lengths
from pipeline.relations.model import ClassVectors
from pipeline.relations.relations import T, U
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

_LENGTHS = {"bbox": 4, "lo": 3, "hi": 3, "pca_center": 3, "pca_R": 9, "pca_size": 3, "center": 3, "R": 9, "size": 3}
GEOMETRY_COLUMNS: dict[str, tuple[str, ...]] = {
    "rel14": ("lo", "hi"),
    "rel26": ("lo", "hi", "touches_border"),
    "rel32": ("lo", "hi", "touches_border", "label"),
    "geom2d8": ("bbox",),
    "paper30": ("pca_center", "pca_R", "pca_size", "center", "R", "size"),
    "canon30": ("pca_center", "pca_R", "pca_size", "center", "R", "size"),
}
"""Columns of the objects from which a contract's rows are made."""


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """The usable objects of one frame."""

    key: FrameKey
    rows: np.ndarray
    """(N, K) float64: geometry of each object by the feature contract; objects of which it is not known are left
    out."""
    classes: np.ndarray
    """(N,) int32: indices of the class names in the data's list."""
    states: np.ndarray
    """(N, N, R) int8: relations in the order of the vocabulary; U for pairs that were not judged, and on the
    diagonal."""
    objects: np.ndarray
    """(N,) int64: their numbers in the labels, rising."""

    def single(self) -> np.ndarray:
        """(N, N) int64: index of a pair's only relation; -1 for none or several."""
        holds = self.states == T
        return np.where(holds.sum(axis=2) == 1, holds.argmax(axis=2), -1)


@dataclass(frozen=True, eq=False)
class LabelData:
    """A labels folder as training data."""

    features: str
    """The feature contract of the rows, without language."""
    vocabulary: tuple[str, ...]
    frames: tuple[LabelledFrame, ...]
    """Those with at least two usable objects, in the order of the dataset."""
    names: tuple[str, ...]
    """Class names of the usable objects, sorted."""


def read_label_data(labels: Labels, features: str, vocabulary: Sequence[str]) -> LabelData:
    """Read training data of these features from labels.

    Parameters
    ----------
    features
        Name of the feature contract, with or without "+lang".
    vocabulary
        Relations in the order of the network's outputs.

    Raises InputError: relations that were not labelled, a damaged table, or nothing usable in it.
    """
    features = geometry_of(features)
    feature_set(features)
    for relation in vocabulary:
        require(
            relation in labels.relation_names,
            f"these labels lack the relation {relation!r} of the vocabulary",
            got=", ".join(labels.relation_names),
            expected="labels made with the vocabulary of the network, or with --vocabulary all",
            path=labels.root,
        )
    frames = _columns(
        labels, "frames", ("frame", "frame_index", "scene", "ok", "width", "height", "up", "T_world_camera")
    )
    wanted = ("frame_index", "object", "label", "usable", *GEOMETRY_COLUMNS[features])
    objects = _columns(labels, "objects", tuple(dict.fromkeys(wanted)))
    objects = {k: v[objects["usable"]] for k, v in objects.items()}
    relations = _columns(labels, "relations", ("frame_index", "a", "b", *vocabulary))
    names, classes = np.unique(objects["label"].astype(np.str_), return_inverse=True)
    order = np.argsort(frames["frame_index"], kind="stable")
    found = []
    for k in order:
        index = int(frames["frame_index"][k])
        mine = rows_of_frame(objects["frame_index"], index)
        if not frames["ok"][k] or mine.stop - mine.start < 2:
            continue
        pose = frames["T_world_camera"][k]
        position = None if pose is None else (float(pose[3]), float(pose[7]), float(pose[11]))
        key = FrameKey(str(frames["frame"][k]), str(frames["scene"][k]), index, position)
        rows = object_rows(features, objects, mine, {name: frames[name][k] for name in ("width", "height", "up")})
        known = np.isfinite(rows).all(axis=1)
        if known.sum() < 2:
            continue
        numbers = objects["object"][mine][known].astype(np.int64)
        states = pair_states(relations, vocabulary, index, numbers)
        found.append(LabelledFrame(key, rows[known], classes[mine][known].astype(np.int32), states, numbers))
    require(found, "these labels hold no frame with two usable objects", path=labels.root)
    return LabelData(features, tuple(vocabulary), tuple(found), tuple(str(n) for n in names))


def pair_set(
    frames: Sequence[LabelledFrame],
    features: str,
    output: str,
    *,
    vectors: ClassVectors | None = None,
    limit: int | None = None,
    seed: int = 0,
) -> PairSet:
    """Learnable pairs of these frames.

    Parameters
    ----------
    features
        The contract of their rows, without language.
    output
        "sigmoid": pairs with any relation that is not U. "softmax": those with exactly one T.
    vectors
        For language networks: of the data's names, in their order.
    limit
        At most so many pairs, drawn at random without replacement.
    seed
        Of that draw.
    """
    contract = feature_set(features)
    # What can be learnt from, (N, N) bool of each frame.
    kept = [f.single() >= 0 if output == "softmax" else (f.states != U).any(axis=2) for f in frames]
    sizes = [int(mask.sum()) for mask in kept]
    total = sum(sizes)
    if limit is not None and limit < total:
        chosen = np.zeros(total, np.bool_)
        chosen[np.random.default_rng([seed, 29]).choice(total, limit, replace=False)] = True
        for mask, part in zip(kept, np.split(chosen, np.cumsum(sizes)[:-1]), strict=True):
            mask[mask] = part
        total = limit
    relations = frames[0].states.shape[2] if frames else 0
    values = np.empty((total, contract.dimension), np.float32)
    states, classes = np.empty((total, relations), np.int8), np.empty((total, 2), np.int32)
    start = 0
    for frame, mask in zip(frames, kept, strict=True):
        a, b = np.nonzero(mask)
        part = slice(start, start + len(a))
        if len(a):
            values[part] = contract.pair(frame.rows)[a, b]
            states[part] = frame.states[a, b]
            classes[part] = np.stack([frame.classes[a], frame.classes[b]], axis=1)
        start = part.stop
    return PairSet(values, states, None if vectors is None else classes, vectors)


def _columns(labels: Labels, table: str, names: Sequence[str]) -> dict[str, np.ndarray]:
    return column_arrays(read_table(labels.root / f"{table}.parquet", table, names))


def column_arrays(table: pa.Table) -> dict[str, np.ndarray]:
    """The columns of a table of labels as arrays; vectors of numbers are (rows, length) float64 with NaN for null."""
    return {name: _array(table.column(name), name) for name in table.column_names}


def _array(column: pa.ChunkedArray, name: str) -> np.ndarray:
    if name in _LENGTHS:
        known = np.asarray(pc.is_valid(column).to_numpy())  # pyright: ignore[reportAttributeAccessIssue]
        values = np.full((len(column), _LENGTHS[name]), np.nan)
        flat = pc.list_flatten(column.drop_null()).to_numpy()  # pyright: ignore[reportAttributeAccessIssue]
        values[known] = np.asarray(flat, np.float64).reshape(-1, _LENGTHS[name])
        return values
    if pa.types.is_list(column.type):
        return np.fromiter(column.to_pylist(), object, len(column))
    if pa.types.is_integer(column.type) and column.null_count:
        # A relation that the profile does not judge of a pair is as unknown as U.
        column = pc.fill_null(column, U)  # pyright: ignore[reportAttributeAccessIssue]
    return np.asarray(column.to_numpy())


def rows_of_frame(sorted_index: np.ndarray, value: int) -> slice:
    """Slice of a value in a sorted column."""
    return slice(int(np.searchsorted(sorted_index, value)), int(np.searchsorted(sorted_index, value, side="right")))


def known_pairs(numbers: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(P,) bool: rows of two different objects of these sorted numbers; and their indices i and j, int64."""
    i, j = (np.minimum(np.searchsorted(numbers, x), len(numbers) - 1) for x in (a, b))
    there = (numbers[i] == a) & (numbers[j] == b) & (i != j)
    return there, i[there], j[there]


def pair_states(
    relations: dict[str, np.ndarray], vocabulary: Sequence[str], index: int, numbers: np.ndarray
) -> np.ndarray:
    """(N, N, R) states of the pairs of these objects (sorted numbers)."""
    mine = rows_of_frame(relations["frame_index"], index)
    states = np.full((len(numbers), len(numbers), len(vocabulary)), U, np.int8)
    there, i, j = known_pairs(numbers, relations["a"][mine], relations["b"][mine])
    for k, relation in enumerate(vocabulary):
        states[i, j, k] = relations[relation][mine][there]
    return states


def object_rows(features: str, objects: dict[str, np.ndarray], mine: slice, frame: dict[str, Any]) -> np.ndarray:
    """(N, K) float64 description of the objects; see `features`."""
    if features == "rel14":
        return np.concatenate([objects["lo"][mine], objects["hi"][mine]], axis=1)
    if features in ("rel26", "rel32"):
        cut = objects["touches_border"][mine].astype(np.float64)[:, None]
        viewed = np.concatenate([objects["lo"][mine], objects["hi"][mine], cut], axis=1)
        return viewed if features == "rel26" else with_class_lengths(viewed, objects["label"][mine])
    if features == "geom2d8":
        return rows_2d(objects["bbox"][mine], frame["width"], frame["height"])
    parts = [objects[f"pca_{name}"][mine] for name in ("center", "R", "size")]
    plain = [objects[name][mine] for name in ("center", "R", "size")]
    # An object without points (an annotated box) is described by its box, as at run time.
    rows = np.concatenate([np.where(np.isfinite(p), p, q) for p, q in zip(parts, plain, strict=True)], axis=1)
    if features == "paper30":
        return rows
    if frame["up"] is None:
        return np.full_like(rows, np.nan)
    level = viewer_axes(np.asarray(frame["up"], np.float64)).R_level_camera
    pca = np.logical_and.reduce(np.isfinite(parts[0]), axis=1)
    for k in np.flatnonzero(np.isfinite(rows).all(axis=1)):
        R = level @ rows[k, 3:12].reshape(3, 3)
        box = Box3D(level @ rows[k, :3], R, rows[k, 12:])
        box = canonicalised(box) if pca[k] else box
        rows[k] = np.concatenate([box.center, box.R.ravel(), box.size])
    return rows


def identity(labels: Labels) -> tuple[str, str, str]:
    """Name of the dataset's folder, hash of files ("" if absent), hash of the frames' table."""
    dataset = labels.manifest.dataset
    return (
        Path(str(dataset.get("path", ""))).name,
        str(dataset.get("input_hash", "")),
        labels.manifest.tables["frames"].content_hash,
    )


def trained_on(labels: Labels, plan: SplitPlan) -> TrainedOn:
    """Training data of a network on these labels and this split."""
    name, input_hash, content = identity(labels)
    inside = {part: [plan.frames[k] for k in plan.indices(part)] for part in (TRAIN, VALIDATION)}
    whole = plan.kind == "scene"
    names = {
        part: tuple(dict.fromkeys(f.scene if whole else f.frame for f in frames)) for part, frames in inside.items()
    }
    scenes = tuple(sorted({f.scene for frames in inside.values() for f in frames}))
    return TrainedOn(name, input_hash, content, plan.kind, names[TRAIN], names[VALIDATION], scenes)


def same_dataset(learnt: TrainedOn, labels: Labels) -> bool:
    """Tell labels of the dataset of training."""
    name, input_hash, content = identity(labels)
    return (
        content == learnt.content_hash
        or (input_hash != "" and input_hash == learnt.input_hash)
        or (name != "" and name == learnt.dataset)
    )


def parts_seen(learnt: TrainedOn, labels: Labels, frames: Sequence[FrameKey]) -> np.ndarray:
    """(F,) int8: TRAIN or VALIDATION of frames known to the network, else DROPPED."""
    known = {**dict.fromkeys(learnt.validation, VALIDATION), **dict.fromkeys(learnt.train, TRAIN)}
    if not same_dataset(learnt, labels):
        known = {}
    names = [frame.scene if learnt.split == "scene" else frame.frame for frame in frames]
    return np.array([known.get(name, DROPPED) for name in names], np.int8)


_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class PairSet:
    """Ordered pairs of objects: what the network is given of each, and what is true of it.

    Class names stand once each, and not in every pair: 75,000 pairs with 300
    numbers for either name would be 180 MB, a million 2.4 GB.
    """

    features: np.ndarray
    """(P, G) float32 or float64: geometry, not standardised."""
    states: np.ndarray
    """(P, R) int8: T, U, F of each relation of the vocabulary."""
    classes: np.ndarray | None = None
    """(P, 2) int32 or None: indices of both class names in `vectors`."""
    vectors: ClassVectors | None = None
    """For "+lang" contracts."""

    def __len__(self) -> int:
        return len(self.features)

    @property
    def language(self) -> int:
        """Dimension of the phrase vectors, 0 without."""
        return 0 if self.vectors is None else self.vectors.vectors.shape[1]

    def take(self, which: np.ndarray) -> PairSet:
        """Select pairs by a mask or indices."""
        classes = None if self.classes is None else self.classes[which]
        return PairSet(self.features[which], self.states[which], classes, self.vectors)

    def learnable(self, output: str) -> np.ndarray:
        """(P,) bool: pairs with finite features and something to learn.

        Where each relation is a question of its own, any state but U; where one
        relation fits best, exactly one T: a pair with two right answers or
        none has no single class.
        """
        finite = np.isfinite(self.features).all(axis=1)
        if output == "softmax":
            return finite & ((self.states == T).sum(axis=1) == 1)
        return finite & (self.states != 0).any(axis=1)

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation of all D inputs, (D,) float64 each; a deviation of nothing is 1."""
        means, deviations = ([of(axis=0, dtype=np.float64)] for of in (self.features.mean, self.features.std))
        if self.vectors is not None and self.classes is not None:
            table = self.vectors.vectors.astype(np.float64)
            for side in range(2):
                share = np.bincount(self.classes[:, side], minlength=len(table)) / len(self)
                means.append(share @ table)
                deviations.append(np.sqrt(share @ np.square(table - means[-1])))
        mean, std = np.concatenate(means), np.concatenate(deviations)
        return mean, np.where(std > 1e-9, std, 1.0)

    def standardised(self, mean: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inputs, standardised, as the geometry of each pair and a table of class vectors for either side.

        Returns
        -------
        geometry : (P, G) float32
        first, second : (C, L) float32
            Empty (0, 0) without language.
        """
        width = self.features.shape[1]
        geometry = np.empty(self.features.shape, np.float32)
        for start in range(0, len(self), _BLOCK):
            block = slice(start, start + _BLOCK)
            geometry[block] = ((self.features[block] - mean[:width]) / std[:width]).astype(np.float32)
        if self.vectors is None:
            return geometry, np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32)
        tables = []
        for side in range(2):
            columns = slice(width + side * self.language, width + (side + 1) * self.language)
            tables.append(((self.vectors.vectors - mean[columns]) / std[columns]).astype(np.float32))
        return geometry, tables[0], tables[1]

    def hash(self) -> str:
        """xxh3-128 of features, states and classes."""
        digest = xxhash.xxh3_128(np.ascontiguousarray(self.features).data)
        digest.update(np.ascontiguousarray(self.states).data)
        if self.classes is not None and self.vectors is not None:
            digest.update(np.ascontiguousarray(self.classes).data)
            digest.update(self.vectors.hash.encode())
        return digest.hexdigest()
