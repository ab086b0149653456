"""The parts of `fourth_pipeline`: a scene graph with oriented boxes, and four ways to score and rank it.

A box is the rectangle of least area about the up axis around an eroded mask's depth points, written as eight corners in
millimetres; 2D boxes are y, x, y, x in thousandths, as vision-language models give them. Edges are judged by a soft
margin on what the boxes leave between each other, or by a model that says .1, .3, .5, .7 or .9 and slips at times.

GRAPHS    weakest link       sigmoid scores, coarse edges, the least of the three factors
          power product      softmax over the candidates, coarse edges, a product with exponents, by the header alone
          weighted logs      softmax, soft margins, a sum of logs with weights
          reference first    sigmoid, soft margins, the surest reference, and then the best target for it
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np

from pipeline.answering.placing import box_3d
from pipeline.answering.predictions import GivenBox, Header, Prediction, Weights
from pipeline.datasets.base import Dataset
from pipeline.datasets.up import resolved_camera
from pipeline.geometry.boxes import CORNER_SIGNS, iou_3d
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.cases import Case, FrameCases
from pipeline.relations.relations import F

from . import third_parts
from .other_pipeline import AXES, Met, OtherPipeline, Pair, Thing, right_ids
from .planted_parts import share
from .third_parts import Seen

COARSE = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""What a vision-language model says of an edge."""
ROUND = np.array([0, 1, 3, 2, 4, 5, 7, 6])
"""Corners in another order than ours: round one face, then round the other."""
PairScore = Callable[[float, float, float], float]


@dataclass(frozen=True)
class Oriented(Thing):
    """A thing with a turned box; `box` is y, x, y, x in thousandths, the columns of `R` (3, 3) are the box's axes."""

    R: np.ndarray
    mask: RunLength | None = None

    def reach(self, axis: np.ndarray) -> float:
        """Half of what it takes along an axis, metres."""
        return float(np.abs(self.R.T @ axis) @ self.size / 2)


@dataclass(frozen=True)
class Graph:
    """How one of them scores and ranks.

    Attributes
    ----------
    softmax : bool
        Scores are a softmax over the candidates of a name, else sigmoids.
    coarse : bool
        Edges have one of five probabilities.
    pair_score : callable
        Of P(target), P(reference) and P(relation).
    weights : Weights or None
        The header says that the ranking is the product with these exponents, and pairs have no scores in the file.
    """

    softmax: bool
    coarse: bool
    pair_score: PairScore
    weights: Weights | None = None

    def scores(self, logits: Mapping[int, float]) -> dict[int, float]:
        """P of each candidate."""
        odds = {i: float(np.exp(logit)) for i, logit in logits.items()}
        return {i: o / (sum(odds.values()) if self.softmax else 1 + o) for i, o in odds.items()}

    def logits(self, scores: Mapping[int, float]) -> dict[int, float]:
        """What `scores` gives them for."""
        return {i: float(np.log(p) if self.softmax else np.log(p) - np.log1p(-p)) for i, p in scores.items()}


def weakest_link(p_target: float, p_reference: float, p_relation: float) -> float:
    # What is equal by its least factor is told apart by all three.
    return min(p_target, p_reference, p_relation) + 0.001 * (p_target + p_reference + p_relation)


def power_product(p_target: float, p_reference: float, p_relation: float) -> float:
    return float(p_target * p_reference**0.5 * p_relation**2)


def weighted_logs(p_target: float, p_reference: float, p_relation: float) -> float:
    return float(0.6 * np.log(p_target) + 0.3 * np.log(p_reference) + np.log(p_relation))


def reference_first(p_target: float, p_reference: float, p_relation: float) -> float:
    return 100 * p_reference + p_target * p_relation


GRAPHS = {
    "weakest link": Graph(False, True, weakest_link),
    "power product": Graph(True, True, power_product, Weights(1.0, 0.5, 2.0)),
    "weighted logs": Graph(True, False, weighted_logs),
    "reference first": Graph(False, False, reference_first),
}


def points_of(frame: Frame, index: int) -> np.ndarray:
    """(N, 3): depth points of an annotation's mask without its border, in the camera frame, metres."""
    mask = next((a.mask for a in frame.annotations if a.index == index), None)
    if mask is None:
        return np.zeros((0, 3))
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool) & (frame.depth > 0)
    v, u = np.nonzero(inner if inner.sum() >= 40 else mask & (frame.depth > 0))
    return backproject(frame.depth, frame.camera, v, u).astype(np.float64)


def least_box(points: np.ndarray, viewer: ViewerAxes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Center (3,), size (3,) and R (3, 3) of the upright box of least floor area around points."""
    level = points @ viewer.matrix.T
    lo, hi = np.percentile(level, [1, 99], axis=0)
    kept = level[((level >= lo) & (level <= hi)).all(axis=1)]
    kept = level if len(kept) < 10 else kept
    (right, forward), (w, d), turned = cv2.minAreaRect(np.ascontiguousarray(kept[:, [0, 2]], np.float32))
    bottom, top = kept[:, 1].min(), kept[:, 1].max()
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    axes = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    center = viewer.matrix.T @ np.array([right, (bottom + top) / 2, forward])
    return center, np.maximum([w, top - bottom, d], 0.01), viewer.matrix.T @ axes


def things(frame: Frame, viewer: ViewerAxes) -> list[Thing]:
    """The annotated things of a frame."""
    found = []
    whole = np.array([frame.width, frame.height, frame.width, frame.height])
    for a in frame.annotations:
        points = points_of(frame, a.index)
        if len(points) >= 25:
            x0, y0, x1, y1 = np.round(a.bbox / whole * 1000).tolist()
            found.append(Oriented(a.index, a.label, (y0, x0, y1, x1), *least_box(points, viewer)))
    return found


def probability(coarse: bool, relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
    """P(a RELATION b): how far a lies to that side, less half of how far aside, against what the boxes take of it."""
    assert isinstance(a, Oriented)
    assert isinstance(b, Oriented)
    axis, sign = AXES[relation]
    way = sign * viewer.matrix[axis]
    between, both = a.center - b.center, a.reach(way) + b.reach(way)
    along = float(way @ between)
    aside = float(np.linalg.norm(between - along * way))
    q = share(relation, *a.box, *b.box)
    odds = (along - 0.5 * aside - 0.25 * both) / (0.05 + 0.2 * both) + 0.3 * np.log(q / (1 - q))
    p = float(1 / (1 + np.exp(-np.clip(odds, -3.5, 3.5))))
    if not coarse:
        return p
    said = int(np.abs(COARSE - p).argmin())
    slips = share("slip", relation, *a.box, *b.box) < 0.1
    return float(COARSE[said + (np.sign(2 - said) if slips else 0)])


def written(thing: Thing) -> tuple[tuple[float, ...], GivenBox]:
    assert isinstance(thing, Oriented)
    corners = thing.center + (CORNER_SIGNS[ROUND] * thing.size / 2) @ thing.R.T
    return thing.box, GivenBox(corners=tuple(tuple(c) for c in np.round(1000 * corners, 2).tolist()))  # type: ignore[arg-type]


def asked(graph: Graph, case: Case, truth: FrameCases, known: dict[int, Thing], rng: np.random.Generator) -> Seen:
    """The things of each name, of which one in 30 is missed, and up to four others, less surely; by their numbers."""

    def scored(example: int) -> dict[int, float]:
        ids = set(truth.numbers[truth.alike[example]].tolist())
        logits = {i: float(rng.uniform(0.6, 3.0)) for i in known if i in ids and rng.random() > 1 / 30}
        false = rng.permutation([i for i in known if i not in ids])[: rng.integers(1, 5)].tolist()
        logits |= {int(i): float(rng.uniform(-0.9, 1.0)) for i in false}
        return graph.scores(dict(sorted(logits.items())))

    return Seen(case, scored(case.target_object), scored(case.reference_object))


def told(own: OtherPipeline, met: Met) -> Prediction:
    """Its line; where the header says how it ranks, without scores of pairs."""
    line = third_parts.told(own, met)
    return replace(line, pairs=None) if own.header.ranking == "product" else line


def graph_pipeline(name: str, dataset: Dataset, planted: Callable[..., Met | None]) -> OtherPipeline:
    """One of GRAPHS over a dataset, with what can be broken in it."""
    graph = GRAPHS[name]
    header = Header(
        1, f"scene graph, {name}", "yxyx", "thousandths", "camera_opencv", "mm",
        "pair_scores" if graph.weights is None else "product", graph.weights or Weights(),
    )  # fmt: skip

    def seen(frame: Frame) -> list[Thing]:
        camera = resolved_camera(dataset, frame)
        assert camera.up is not None
        return things(frame, viewer_axes(camera.up))

    return OtherPipeline(
        header,
        seen,
        lambda *pair: probability(graph.coarse, *pair),
        graph.pair_score,
        written,
        lambda *given: planted(graph, *given),
        lambda *given: asked(graph, *given),
        told,
    )


def right_pair(line: Prediction, met: Met) -> bool:
    given = line.answer and (line.answer.object, line.answer.reference)
    return given in true_pairs(met)


def true_pairs(met: Met) -> set[Pair]:
    rows = met.truth.numbers[np.argwhere(met.truth.acceptable_pairs(met.asked.case))]
    return {(int(a), int(b)) for a, b in rows}


def false_pairs(met: Met) -> set[Pair]:
    """Of all things, whatever their class: what the labels say the relation does not hold of."""
    states = met.truth.states[met.asked.case.relation]
    rows = met.truth.numbers[np.argwhere(met.truth.judged & (states == F))]
    return {(int(a), int(b)) for a, b in rows}


def edges(own: OtherPipeline, met: Met, relation: str) -> dict[Pair, float]:
    """P of every pair of candidates, as the pipeline has it."""
    known = met.known
    every = [(a, b) for a in met.asked.targets for b in met.asked.references if a != b]
    return {(a, b): own.probability(relation, known[a], known[b], met.viewer) for a, b in every}


def truly_wrong(own: OtherPipeline, module: str, met: Met, broken: Met) -> bool:
    """Whether boxes are more than a little off; whether right edges are less likely, or the answer's false one more."""
    if module == "LIFT":
        new = [t for i, t in broken.known.items() if i not in met.known]
        was = {t.box: t for t in met.known.values()}
        pairs = [[box_3d(own.written(t)[1], own.header, None) for t in (t, was[t.box])] for t in new]
        return all(iou_3d(a, b) < 0.5 for a, b in pairs)
    if module != "SRM" or own.told is None:
        return True
    before, after = edges(own, met, met.asked.case.relation), broken.asked.relations
    rise = {pair: after.get(pair, p) - p for pair, p in before.items()}
    answer = own.told(own, broken).answer
    assert answer is not None
    given = cast(Pair, (answer.object, answer.reference))
    lowered = all(d < -0.05 for pair, d in rise.items() if pair in true_pairs(met))
    return lowered or (rise[given] > 0.05 and given in false_pairs(met))


def alone(own: OtherPipeline, module: str, met: Met, broken: Met) -> bool:
    """Whether nothing but the module is wrong in what decides: no other module had the answer's pair above the true
    ones, or a box far off, before the fault; and the answer is more than one of equal pairs."""
    assert own.told is not None
    answer = own.told(own, broken).answer
    true = true_pairs(met)
    if answer is None:
        return True
    given = cast(Pair, (answer.object, answer.reference))
    if _ties(own, broken, given):
        return False
    new = {t.box: t.id for t in met.known.values()}
    a, b = (new.get(broken.known[i].box, -1) for i in given)
    seen, case = met.asked, met.asked.case
    good, ends = right_ids(met)
    for one, example, scores, ids in (
        (a, case.target_object, seen.targets, good),
        (b, case.reference_object, seen.references, ends),
    ):
        named = met.truth.numbers[met.truth.alike[example]]
        surer = ids and scores.get(one, 0.0) > max(scores[i] for i in ids)
        if module != "OPM-CONF" and one not in named and surer:
            return False
    p = edges(own, met, case.relation)
    most = max((q for pair, q in p.items() if pair in true), default=0.0)
    if module != "SRM" and (a, b) in false_pairs(met) and p.get((a, b), 0.0) > most:
        return False
    used = {a, b, *(i for pair in p if pair in true for i in pair)} - {-1}
    return module == "LIFT" or not any(_off(met, i) for i in used)


def _ties(own: OtherPipeline, met: Met, given: Pair) -> bool:
    """Whether a true pair scores as the answer's does."""
    scores = {pair: score for pair, (_, score) in scored(own, met).items()}
    return any(abs(scores[pair] - scores[given]) < 1e-6 for pair in scores if pair in true_pairs(met))


def scored(own: OtherPipeline, met: Met) -> dict[Pair, tuple[float, float]]:
    """P and score of every pair of candidates, as the line has them."""
    seen, every = met.asked, edges(own, met, met.asked.case.relation) | met.asked.relations
    return {
        (a, b): (p, seen.scores.get((a, b), own.pair_score(seen.targets[a], seen.references[b], p)))
        for (a, b), p in every.items()
    }


def _off(met: Met, i: int) -> bool:
    """Whether the box of a thing is off by .15 m and by a quarter of its extent."""
    place = np.flatnonzero(met.truth.numbers == i)
    if not len(place):
        return False
    center, size = (met.truth.geometry[n][place[0]] for n in ("center", "size"))
    away = float(np.linalg.norm(met.known[i].center - center))
    return away > 0.15 and away > 0.25 * float(np.max(size))
