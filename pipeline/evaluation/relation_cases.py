"""The labelled pairs of a labels folder, frame by frame, and what relation scorers say of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.labels.reading import Labels, read_table
from pipeline.language.relation_names import PAIRWISE
from pipeline.metrics.splits import FrameKey
from pipeline.proposals import make_detector
from pipeline.proposals.base import Detector
from pipeline.relations import RULE, TRAINED, RelationScorer, make_scorer, shipped_network
from pipeline.relations.contract import NetworkContract, TrainedOn
from pipeline.relations.features import geometry_of
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import pairwise_states
from pipeline.relations.scorer import rule_probabilities
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import metadata, open_session
from pipeline.system.safe_files import read_json, read_parquet
from pipeline.training.label_data import GEOMETRY_COLUMNS, column_arrays, known_pairs, object_rows, rows_of_frame

_GEOMETRY = tuple(dict.fromkeys(name for names in GEOMETRY_COLUMNS.values() for name in names))
PAPER_NAMES = {
    "geom2d8": "2D-Geom",
    "paper30": "3D-Geom",
    "canon30": "3D-Geom, canonical",
    "rel14": "relative extents",
    "rel26": "relative extents, places and cuts",
    "rel32": "the same, and how long classes are",
}
Geometry = Literal["lifted", "stored"]


@dataclass(frozen=True, eq=False)
class FramePairs:
    """The labelled pairs of one frame's usable objects."""

    key: FrameKey
    numbers: np.ndarray  # (N,) int: the objects' numbers in the labels, rising
    labels: tuple[str, ...]  # their class names
    # a, b (P,) int64: indices in `numbers`
    a: np.ndarray
    b: np.ndarray
    relations: tuple[str, ...]  # those that were labelled
    states: np.ndarray  # (P, R) int8: 1 T, 0 U or not judged, -1 F
    geometry: dict[str, np.ndarray]  # columns of the objects' table, a row an object
    frame: dict[str, Any]  # width, height, up of the frame


def spread(count: int, limit: int | None) -> np.ndarray:
    """Indices below `count`, rising; at most so many, spread evenly."""
    return np.unique(np.linspace(0, count - 1, count if limit is None else min(limit, count)).astype(int))


def frames_in(labels: Labels, table: str, limit: int | None = None) -> np.ndarray:
    """Indices of frames with rows in a table of the labels, rising; at most so many, spread evenly."""
    found = np.unique(read_table(labels.root / f"{table}.parquet", table, ["frame_index"]).column(0).to_numpy())
    return found[spread(len(found), limit)]


def read_pairs(labels: Labels, first: int, stop: int, chosen: Collection[int] | None = None) -> Iterator[FramePairs]:
    """The labelled pairs of the frames from index `first` up to `stop` (only `chosen` frames), in order.

    Only pairs of usable objects count, as in training.
    """
    relations = tuple(r for r in PAIRWISE if r in labels.relation_names)
    wanted = {
        "frames": ("frame", "frame_index", "scene", "width", "height", "up"),
        "objects": tuple(dict.fromkeys(("frame_index", "object", "label", "usable", *_GEOMETRY))),
        "relations": ("frame_index", "a", "b", *relations),
    }
    frames, objects, rows = (_part(labels, table, names, first, stop) for table, names in wanted.items())
    objects = {name: values[objects["usable"]] for name, values in objects.items()}
    for at in np.argsort(frames["frame_index"], kind="stable"):
        index = int(frames["frame_index"][at])
        if chosen is not None and index not in chosen:
            continue
        mine, pairs = (rows_of_frame(t["frame_index"], index) for t in (objects, rows))
        numbers = objects["object"][mine]
        if len(numbers) < 2:
            continue
        there, i, j = known_pairs(numbers, rows["a"][pairs], rows["b"][pairs])
        if not there.any():
            continue
        yield FramePairs(
            FrameKey(str(frames["frame"][at]), str(frames["scene"][at]), index),
            numbers,
            tuple(str(n) for n in objects["label"][mine]),
            i.astype(np.int64),
            j.astype(np.int64),
            relations,
            np.stack([rows[r][pairs][there] for r in relations], axis=1).astype(np.int8),
            {name: objects[name][mine] for name in _GEOMETRY},
            {name: frames[name][at] for name in ("width", "height", "up")},
        )


def _part(labels: Labels, table: str, names: Sequence[str], first: int, stop: int) -> dict[str, np.ndarray]:
    chosen = [("frame_index", ">=", first), ("frame_index", "<", stop)]
    found = read_parquet(labels.root / f"{table}.parquet", list(names), chosen)
    return column_arrays(found.select(list(names)))


def labelled_detector(source: Pipeline) -> Detector:
    """Detector of the labelled objects: the run's own where exact, else the annotations."""
    if source.detector is not None and source.detector.exact:
        return source.detector
    return make_detector("annotations", class_names=source.dataset.class_names, synonyms=source.synonyms)


def score_lifted(
    source: Pipeline, systems: Sequence[RelationSystem], pairs: FramePairs, context: PreparedFrame
) -> list[np.ndarray]:
    """Score pairs by each system, on objects lifted from the dataset's annotations and depth.

    Returns a list of (P, R_k) float32, in the order of each system's relations.

    Raises InputError: the dataset lacks a labelled object, or a network lacks the vector of a class.
    """
    detector = labelled_detector(source)
    proposals = detector.detect(context.frame, None)
    index = {int(number): k for k, number in enumerate(proposals.ids)}
    for number in pairs.numbers.tolist():
        require(
            number in index,
            f"frame {pairs.key.frame} has no annotation {number}, which the labels name",
            cause="labels of another dataset, or of another detector? --relation-boxes stored takes their own boxes",
            path=source.dataset.root,
        )
    objects = context.lift(proposals.take(np.array([index[int(n)] for n in pairs.numbers])), detector)
    found = []
    for system in systems:
        scores = replace(source, scorer=system.scorer).score(context, objects, system.relations)
        columns = [scores.relations.index(r) for r in system.relations]
        found.append(scores.probabilities[pairs.a, pairs.b][:, columns].astype(np.float32))
    return found


def score_stored(systems: Sequence[RelationSystem], pairs: FramePairs) -> list[np.ndarray]:
    """Score pairs by each system, on boxes and extents of the labels, without the image.

    The rule has no points then: on, in and near are judged by extents.
    """
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


@dataclass(frozen=True)
class RelationSpec:
    """How relations are measured alone, as plain values that a process can be given."""

    others: tuple[str, ...] = ()  # relation scorers beside the run's own: "trained", "rule", or paths of networks
    vectors: str | None = None  # text vectors for the language networks among all of them
    # geometry: "lifted": the labelled objects as the dataset's annotations and depth give them now. "stored": their
    # boxes and extents as the labels have them. By default lifted, where the labels were made of annotations.
    geometry: Geometry | None = None
    frames: int | None = None  # only so many frames, spread evenly over those with labelled pairs
    # pairs: "all", or "held-out": without the frames that any of the networks was trained or calibrated on
    pairs: Literal["all", "held-out"] = "all"
    vlm_pairs: int = 200  # how many pairs a vision-language model is asked about, drawn at random
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("frames", 1), ("vlm_pairs", 1), ("seed", 0)):
            value = getattr(self, name)
            require(
                value is None or value >= least,
                f"{name.replace('_', ' ')} must be at least {least}",
                got=value,
            )


@dataclass(frozen=True, eq=False)
class RelationSystem:
    """A relation scorer as a row of the tables."""

    name: str  # unlike that of any other in the run; its name in the records
    title: str  # what the tables call it
    scorer: RelationScorer
    relations: tuple[str, ...]  # what it is measured on: the relations it judges itself, as far as they were labelled
    unlabelled: tuple[str, ...] = ()  # those it judges which were not labelled
    prior: tuple[float, ...] = ()  # of a softmax network, in the order of its vocabulary; else empty
    trained_on: TrainedOn | None = None
    recorded: bool = True  # whether it is known what it learnt from: False for networks of labels that do not say so


def geometry_of_labels(spec: RelationSpec, labels: Labels) -> Geometry:
    """Geometry as asked for, else as fits the labels.

    Raises InputError: objects are to be lifted from annotations, and the labels are of a detector.
    """
    detector = labels.manifest.models.get("detector", "")
    annotated = detector.startswith("annotations")
    require(
        not (spec.geometry == "lifted" and not annotated),
        "the labelled objects are not the dataset's annotations: they cannot be lifted again",
        got=detector or "no detector in the manifest",
        expected="--relation-boxes stored",
        path=labels.root,
    )
    # Objects that people changed are no longer the dataset's annotations.
    corrected = bool((labels.manifest.corrections or {}).get("objects"))
    return spec.geometry or ("lifted" if annotated and not corrected else "stored")


def open_systems(options: Mapping[str, Any], spec: RelationSpec, labels: Labels) -> tuple[RelationSystem, ...]:
    """The run's own relation scorer, then the others.

    `options`: arguments of `open_pipeline`: srm, vectors.

    Raises InputError: a scorer that cannot be opened, or one that judges nothing of what was labelled.
    """
    vectors = spec.vectors if spec.vectors is not None else options.get("vectors")
    found: dict[str, RelationSystem] = {}
    distinct: dict[str, str] = {}
    for which in (str(options.get("srm", TRAINED)), *spec.others):
        distinct.setdefault(which if which in (RULE, TRAINED) else str(Path(which).resolve()), which)
    worded = {which for which in distinct.values() if vectors is not None and uses_language(which)}
    require(
        vectors is None or worded, "none of the relation scorers uses class names: leave out --vectors", path=vectors
    )
    for which in distinct.values():
        name = which if which in (RULE, TRAINED) else Path(which).stem
        # Networks of one name in several folders are told apart by these.
        if name in found:
            name = "/".join(Path(which).resolve().with_suffix("").parts[-2:])
        while name in found:
            name += "'"
        scorer = make_scorer(which, Path(str(vectors)) if which in worded else None)
        found[name] = _system(name, which, scorer, labels)
    return tuple(found.values())


def _system(name: str, which: str, scorer: RelationScorer, labels: Labels) -> RelationSystem:
    labelled = labels.relation_names
    if not isinstance(scorer, OnnxScorer):
        return RelationSystem(name, name, scorer, tuple(labelled))
    contract = scorer.contract
    kept = tuple(r for r in PAIRWISE if r in contract.vocabulary and r in labelled)
    require(
        kept,
        f"the relation network {name} judges none of the relations that were labelled",
        got=", ".join(contract.vocabulary),
        expected=", ".join(labelled),
        path=labels.root,
    )
    language = "+Lng" if contract.language is not None else ""
    kind = PAPER_NAMES.get(geometry_of(contract.features), contract.features) + language
    missing = tuple(r for r in contract.vocabulary if r not in labelled)
    known = contract.trained_on is not None or which == TRAINED or _of_rooms(Path(which))
    return RelationSystem(
        name, f"{name}, {kind}", scorer, kept, missing, contract.prior, contract.trained_on, recorded=known
    )


def uses_language(which: str) -> bool:
    """Tell whether a relation scorer takes class names; InputError where the file cannot be opened."""
    if which == RULE:
        return False
    path = shipped_network() if which == TRAINED else Path(which)
    if not path.is_file():
        return False  # `make_scorer` says what is wrong.
    return NetworkContract.read(metadata(open_session(path, threads=1)), path).language is not None


def _of_rooms(path: Path) -> bool:
    """Tell whether the card beside a network names rendered rooms as training data."""
    try:
        return "rooms" in read_json(path.with_suffix(".json"))
    except (OSError, ValueError, TypeError):
        return False
