"""Two foreign pipelines that score a pair by the other pairs of its line, with faults that stand in code; held out.

The first runs "filter, relate, filter" as neuro-symbolic programs do. A box is turned about gravity along the principal
axis of the floor plan, around points whose depth is within three deviations of the median. A relation is a fuzzy angle
from the direction, softened near the thing itself. Scores are sigmoids, .05 to .88. Attention on references is their
squared score, in sum one; a target has its score times the relation's expectation under that attention, and a pair has
its target's, times a weak power of what part of the expectation is by its reference.

The second fuses three lists as retrieval does. A box is level, around the largest connected cluster of voxels. A
relation is how many of eight sampled answers say yes. Scores are .3 to .7. Each factor's logarithm, or log odds, is
standardised over the pairs of a line and cut at two and a half deviations; a pair has their weighted sum.

attended      fuzzy angles; expectation under attention
standardised  votes; a weighted sum of z-scores

OPM-TARGET, OPM-REF  a name gets another class's boxes, or none; only the first two from the left are listed; what is
          beyond the sensor's range, is small, or (of targets) touches the border, is dropped
LIFT      boxes of all candidates: another unit in half of the picture; a picture that is turned upright, its points
          not; masks in their crop's pixels; masks that run over; disparity taken for depth; masks of the mirrored
          picture; most depths of dark things filled by a constant
SRM       arguments swapped; sides of the reference's own front; a dead head; near for far; a margin in another unit;
          a relation that is far too flat; P kept by the two names alone; the head of the next relation
OPM-CONF  a class that is sure of any name; all turned round; larger ones surer; divided by area; the other name's
          prompt; surer the earlier in the list
PRM       ranked by the P of the relation before; a factor counted the wrong way; the next target in the list; the
          least; a winner by the place of another line's

Two ways: some lines of a file broken, each by some kind; and a file for each kind, in which the rule is applied to
every line, also where the answer stays as it was. A fault counts as in `pure_by_rule`.

    python -m benchmarks.normalised_scores --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, cast

import cv2
import numpy as np
from benchmarks.fault_figures import FAULTS, File, Study, main
from benchmarks.fault_purity import pure_by_rule
from benchmarks.foreign_pipelines import (
    AXES,
    FEWEST_POINTS,
    TURNED,
    Detected,
    ForeignPipeline,
    Pair,
    Placed,
    Question,
    Rng,
    Thing,
    annotated,
    detections,
    factors_of,
    judged,
    mask_of,
    noise,
    numbered_anew,
    points_at,
    points_of,
    probabilities,
    side_of,
    with_things,
)
from benchmarks.planted_parts import share
from scipy import ndimage

from pipeline.answering.predictions import Header
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases

NAMES = ("attended", "standardised")
VOTES = 8
WEIGHTS = np.array([0.7, 0.5, 1.0])
"""Of target, reference and relation in the weighted sum."""
MISSED = ("class", "synonym", "listed", "far", "small")
KINDS = {
    "OPM-TARGET": (*MISSED, "border"),
    "OPM-REF": MISSED,
    "LIFT": ("region", "rotated", "crop", "bleeding", "disparity", "mirrored", "filled"),
    "SRM": ("swapped", "allocentric", "dead", "depth", "margin", "temperature", "names", "index"),
    "OPM-CONF": ("class", "negated", "larger", "area", "prompt", "position"),
    "PRM": ("former", "sign", "next", "least", "stale"),
}  # fmt: skip
"""A fault is "MODULE kind"."""
SHARE = 0.6
"""Of the lines in which a fault is tried; many of them keep their answer, so that some fifth is broken."""
OFTEN = np.array([1, 3, 5, 3.5, 1.5, 1.5]) / 15.5
"""How often each of FAULTS is tried; boxes seldom change an answer."""
RARE = {
    *(f"{m} {k}" for m in ("OPM-TARGET", "OPM-REF") for k in (*MISSED[2:], "border")),
    *(f"LIFT {k}" for k in ("region", "bleeding", "filled", "disparity")),
    *(f"SRM {k}" for k in ("dead", "depth", "margin", "temperature", "names")),
    "OPM-CONF larger", "OPM-CONF position",
}  # fmt: skip
"""Kinds that seldom change an answer: tried before others of their module where some lines are broken."""
DENSER = {
    **dict.fromkeys(("OPM-TARGET class", "OPM-TARGET synonym", "OPM-CONF class", "OPM-CONF negated"), 0.5),
    **dict.fromkeys(("SRM swapped", "SRM index", "PRM next", "PRM least"), 0.5),
    **dict.fromkeys(("LIFT mirrored", "OPM-CONF prompt", "OPM-CONF position", "PRM stale"), 0.7),
    **dict.fromkeys(("OPM-TARGET listed", "OPM-TARGET small", "OPM-CONF larger", "PRM former"), 1.4),
    **dict.fromkeys(("LIFT crop", "LIFT disparity", "LIFT filled", "OPM-TARGET border"), 2.0),
    **dict.fromkeys((f"OPM-REF {k}" for k in MISSED[:4]), 3.0),
    **dict.fromkeys(("LIFT region", "SRM depth", "SRM margin", "SRM temperature"), 3.0),
    **dict.fromkeys(("OPM-REF small", "SRM dead"), 4.0),
    **dict.fromkeys(("LIFT bleeding", "SRM names"), 5.0),
}
"""How many times as many expressions a whole file has of a kind than one of the others."""
NEXT = dict(zip(AXES, [*AXES][1:] + [*AXES][:1], strict=True))
HALF = ("left", "above", "behind")
"""The relations whose heads are broken in a whole file, where that is of some relations only."""
FAR_M = 2.5
FILLED_M = 4.0


@dataclass(frozen=True)
class NormalisedScores(ForeignPipeline):
    """One of the two.

    Attributes
    ----------
    masked : bool
        Proposals have masks.
    certain : callable
        Score by a certainty, 0 to 1.
    box_of : callable
        Of points (N, 3) and the viewer.
    judge : callable
        P(a RELATION b), of a relation, a, b, the viewer, a least distance (metres) and how sharp it is.
    rank : callable
        Scores (P,) of pairs by their factors (P, 3).
    lifts : dict
        Kind of fault, frame and thing -> 3D box with the fault, None where points are few; over one dataset.
    """

    masked: bool
    certain: Callable[[float], float]
    box_of: Callable[[np.ndarray, ViewerAxes], Placed]
    judge: Callable[[str, Thing, Thing, ViewerAxes, float, float], float]
    rank: Callable[[np.ndarray, Sequence[Pair]], np.ndarray]
    lifts: dict[tuple[str, str, int], Placed | None] = field(default_factory=dict)
    decimals: ClassVar[int | None] = 4

    def things(self, frame: Frame, viewer: ViewerAxes) -> list[Thing]:
        def box_of(index: int, pixels: np.ndarray) -> Placed | None:
            points = points_of(frame, index)
            return self.box_of(points, viewer) if len(points) >= FEWEST_POINTS else None

        return annotated(self.header, frame, self.masked, box_of)

    def detected(self, case: Case, truth: FrameCases, known: Mapping[int, Thing], rng: Rng) -> Detected:
        return detections(
            case, truth, known, rng, lambda _, u: self.certain(u),
            missed=1 / 20, others=(2, 7), right=(0.35, 1.0), false=(0.0, 0.7),
        )  # fmt: skip

    def probability(self, relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
        return self.judge(relation, a, b, viewer, 0.0, 1.0)

    def ranks(self, factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
        return self.rank(factors, pairs)

    def counts(self, module: str, q: Question, broken: Question) -> bool:
        return pure_by_rule(self, module, q, broken, self.certain(0.0))

    def planted(self, fault: str, q: Question, rng: Rng, whole: bool) -> Question | None:
        module, kind = fault.split()
        if module == "LIFT":
            new = lifted_wrong(self, kind, q)
            # In a whole file a thing has the same wrong box in every line.
            return replace(q, known={**q.known, **new}) if whole else with_things(q, numbered_anew(new, rng))
        if module == "SRM":
            return judged_wrong(self, kind, q, whole)
        if module == "PRM":
            return ranked_wrong(self, kind, q, rng, whole)
        if module == "OPM-CONF":
            return scored_wrong(self, kind, q)
        return proposed_wrong(self, kind, q, module == "OPM-TARGET")


def log_odds(p: np.ndarray) -> np.ndarray:
    p = np.clip(p, 1e-4, 1 - 1e-4)
    return np.log(p) - np.log1p(-p)


def offsets(relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> tuple[float, float, float]:
    """Distance of a from b along the relation and aside of it, and what both boxes take along it."""
    axis, sign = AXES[relation]
    between, way = viewer.matrix @ (a.center - b.center), viewer.matrix[axis]
    aside = float(np.linalg.norm(np.delete(between, axis)))
    return float(sign * between[axis]), aside, a.reach(way) + b.reach(way)


def about_gravity(points: np.ndarray, viewer: ViewerAxes) -> Placed:
    """Box along up and the principal axes of the floor plan, between percentiles of what is not far in depth."""
    off = np.abs(points[:, 2] - np.median(points[:, 2]))
    level = points[off <= 3 * 1.4826 * np.median(off) + 0.01] @ viewer.matrix.T
    long = np.linalg.eigh(np.cov(level[:, [0, 2]].T))[1][:, 1]
    axes = np.array([[long[0], 0, -long[1]], [0, 1, 0], [long[1], 0, long[0]]])
    lo, hi = np.percentile(level @ axes, [2, 98], axis=0)
    R = viewer.matrix.T @ axes
    return R @ ((lo + hi) / 2), np.maximum(hi - lo, 0.01), R


def clustered(points: np.ndarray, viewer: ViewerAxes) -> Placed:
    """Level box around the largest cluster of touching voxels, which are larger farther away."""
    edge = 0.02 + 0.015 * float(np.median(points[:, 2]))
    # What is very far from the rest is no cluster, and would make the grid large.
    cells = np.clip(np.floor((points - np.median(points, axis=0)) / edge), -32, 32).astype(int) + 32
    grid = np.zeros((65,) * 3, bool)
    grid[tuple(cells.T)] = True
    numbers, _ = cast("tuple[np.ndarray, int]", ndimage.label(grid, np.ones((3, 3, 3))))
    of = numbers[tuple(cells.T)]
    R = viewer.R_level_camera
    lo, hi = np.percentile(points[of == np.bincount(of).argmax()] @ R.T, [1, 99], axis=0)
    return R.T @ ((lo + hi) / 2), np.maximum(hi - lo, 0.01), R.T


def by_angle(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
    """P by the angle of a - b from the relation's direction, against 55 degrees; unsure within the boxes' reach."""
    along, aside, both = offsets(relation, a, b, viewer)
    along -= least
    angle = float(np.arctan2(aside, along))
    clear = float(np.tanh(np.hypot(along, aside) / (0.03 + 0.5 * both)))
    odds = sharp * (clear * 4.0 * (0.96 - angle) + 0.5 * noise(relation, a, b))
    return round(float(1 / (1 + np.exp(-np.clip(odds, -7, 7)))), 4)


def by_votes(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float, sharp: float) -> float:
    """Share of eight samples that say yes; each has noise of its own."""
    along, aside, both = offsets(relation, a, b, viewer)
    odds = 1.5 * (along - least - 0.4 * aside - 0.1 * both) / (0.04 + 0.3 * both)
    draws = np.array([share(relation, *a.box, *b.box, k) for k in range(VOTES)])
    yes = int((sharp * odds + log_odds(draws) > 0).sum())
    return round((yes + 0.5) / (VOTES + 1), 4)


def attended(factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    t, r, p = factors.T
    refs = {b: x * x for (_, b), x in zip(pairs, r.tolist(), strict=True)}
    by = r * r / sum(refs.values()) * p
    expected: dict[int, float] = {}
    for (a, _), x in zip(pairs, by.tolist(), strict=True):
        expected[a] = expected.get(a, 0.0) + x
    of = np.array([expected[a] for a, _ in pairs])
    return t * of * (by / of) ** 0.25


def standardised(factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    x = np.column_stack([np.log(np.clip(factors[:, :2], 1e-4, 1)), log_odds(factors[:, 2])])
    return np.clip((x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 0.05), -2.5, 2.5) @ WEIGHTS


def make(name: str) -> NormalisedScores:
    if name == NAMES[0]:
        header = Header(1, "soft program, attention", "xyxy", "shares", "camera_opencv", "m", "pair_scores")
        return NormalisedScores(
            header, True, lambda u: round(1 / (1 + np.exp(3 - 5 * u)), 4), about_gravity, by_angle, attended
        )
    header = Header(1, "votes, standardised sum", "cxcywh", "pixels", "camera_opengl", "cm", "pair_scores")
    return NormalisedScores(header, False, lambda u: round(0.3 + 0.4 * u, 4), clustered, by_votes, standardised)


def lifted_wrong(own: NormalisedScores, kind: str, q: Question) -> dict[int, Thing]:
    """Lift all candidates with the fault."""
    new: dict[int, Thing] = {}
    for i in {**q.targets, **q.references}:
        key = kind, q.frame.id, i
        if key not in own.lifts:
            points = wrong_points(own, kind, q.frame, q.known[i])
            points = points[np.isfinite(points).all(axis=1)]
            own.lifts[key] = own.box_of(points, q.viewer) if len(points) >= FEWEST_POINTS else None
        if (box := own.lifts[key]) is not None:
            new[i] = replace(q.known[i], center=box[0], size=box[1], R=box[2])
    return new


def wrong_points(own: NormalisedScores, kind: str, frame: Frame, t: Thing) -> np.ndarray:
    """Depth points (N, 3) that a thing is lifted from with the fault."""
    camera, mask = frame.camera, mask_of(frame, t.id)
    assert mask is not None
    if kind == "bleeding":
        wide = max(3, round(0.05 * frame.width))
        return points_at(frame, cv2.dilate(mask.astype(np.uint8), np.ones((2 * wide + 1,) * 2, np.uint8)).astype(bool))
    if kind == "mirrored":
        return points_at(frame, mask[:, ::-1])
    points = points_of(frame, t.id)
    x, y, z = points.T
    if kind == "region":
        # Half of the picture, by its columns or its rows.
        side = int(4 * share(frame.id, kind))
        uv = (x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy)[side // 2]
        half = uv > (frame.width, frame.height)[side // 2] / 2
        unit = (0.5, 0.7, 1.5)[int(3 * share(frame.id, "unit"))]
        return np.where((half == bool(side % 2))[:, None], unit * points, points)
    if kind == "rotated":
        # The picture was turned by a quarter for the segmenter; the same way over a whole sequence.
        side = 1 if share(frame.id.split("/")[0], kind) < 0.5 else -1
        return np.stack([-side * y, side * x, z], axis=1)
    if kind == "crop":
        x0, y0 = own.pixels(t, frame)[:2]
        return points - z[:, None] * np.array([x0 / camera.fx, y0 / camera.fy, 0])
    if kind == "disparity":
        return points * (float(np.median(frame.depth[frame.depth > 0])) / z)[:, None] ** 2
    # "filled": dark or shining things have no depth in most of them.
    lacks = share(frame.id, t.id, "lacks") < 0.5
    there = (y / z > np.quantile(y / z, 0.25)) & lacks
    return np.where(there[:, None], points * (FILLED_M / z)[:, None], points)


def judged_wrong(own: NormalisedScores, kind: str, q: Question, whole: bool) -> Question | None:
    """Question with wrong P of all pairs; some kinds in a whole file for half of the relations."""
    relation, known, viewer = q.case.relation, q.known, q.viewer
    axis = AXES[relation][0]
    if (kind == "allocentric" and axis == 1) or (kind == "depth" and axis != 2):
        return None
    if whole and kind in ("dead", "temperature") and relation not in HALF:
        return None
    right_ones = probabilities(own, q, relation)
    kept: dict[tuple[str, str], float] = {}

    def p(a: int, b: int) -> float:
        one, other, seen = known[a], known[b], viewer
        if kind == "swapped":
            return own.probability(relation, other, one, seen)
        if kind == "dead":
            # Its bias, and what its weights leave.
            return 0.4 + 0.02 * share(relation, a, b)
        if kind in ("depth", "index"):
            return own.probability((TURNED if kind == "depth" else NEXT)[relation], one, other, seen)
        if kind == "margin":
            return own.judge(relation, one, other, seen, 1.0, 1.0)
        if kind == "temperature":
            return own.judge(relation, one, other, seen, 0.0, 0.06)
        if kind == "names":
            return kept.setdefault((one.name, other.name), right_ones[a, b])
        for _ in range(1 + int(3 * share(q.truth.scene, other.id, "front"))):
            seen = replace(seen, right=seen.forward, forward=-seen.right)
        return own.probability(relation, one, other, seen)

    return replace(q, relations={pair: p(*pair) for pair in right_ones})


def ranked_wrong(own: NormalisedScores, kind: str, q: Question, rng: Rng, whole: bool) -> Question | None:
    """Question with wrong scores of all pairs, or with another pair for an answer than the first."""
    p = judged(own, q)
    if len(p) < 2:
        return None
    factors, pairs = factors_of(q, p), list(p)
    scores = own.ranks(factors, pairs)
    if kind in ("next", "least", "stale"):
        other = int(len(p) * share(q.frame.id, q.case.text, kind))
        (a, b), rows = pairs[int(np.argmax(scores))], list(q.targets)
        after = rows[(rows.index(a) + 1) % len(rows)], b
        following = pairs.index(after) if after in p else other
        k = {"next": following, "least": int(np.argmin(scores)), "stale": other}[kind]
        return replace(q, answer=pairs[k])
    if kind == "former":
        # The relation of the line before.
        others = [r for r in AXES if AXES[r][0] != AXES[q.case.relation][0]]
        before = probabilities(own, q, others[int(len(others) * share(q.frame.id, q.case.text, kind))])
        factors[:, 2] = [before[pair] for pair in pairs]
    else:
        # In a whole file always the same one.
        k = (0 if own.masked else 1) if whole else int(rng.integers(3))
        factors[:, k] = 1 - factors[:, k]
    wrong = own.ranks(factors, pairs)
    return replace(q, scores=dict(zip(pairs, wrong.tolist(), strict=True)))


def scored_wrong(own: NormalisedScores, kind: str, q: Question) -> Question | None:
    """Question with wrong scores of the candidates of both names."""
    new: dict[str, dict[int, float]] = {}
    low, high = own.certain(0.0), own.certain(1.0)
    boxes = {i: own.pixels(t, q.frame) for i, t in q.known.items()}
    area = {i: float(np.prod(b[2:] - b[:2])) for i, b in boxes.items()}
    for of_target in (True, False):
        side, name, scores, named = side_of(q, of_target)
        most, least = (f((area[i] for i in scores), default=1.0) for f in (max, min))
        if kind == "class":
            sure = [i for i, t in q.known.items() if i not in named and share(t.name, "sure of any") < 0.35]
            said = scores | {i: own.certain(0.9 + 0.15 * share(q.frame.id, i, name)) for i in sure}
        elif kind == "negated":
            said = {i: low + high - s for i, s in scores.items()}
        elif kind == "larger":
            said = {i: s * (area[i] / most) ** 0.6 for i, s in scores.items()}
        elif kind == "area":
            said = {i: s * (least / area[i]) ** 0.5 for i, s in scores.items()}
        elif kind == "prompt":
            asked = side_of(q, not of_target)[3]
            said = {i: own.certain(0.5 * (i in asked) + 0.5 * share(q.frame.id, i, name)) for i in scores}
        else:
            said = {i: s * 0.75**k for k, (i, s) in enumerate(scores.items())}
        new[side] = {i: round(min(max(s, 0.0005), 0.9995), 4) for i, s in sorted(said.items())}
    broken = replace(q, targets=new["targets"], references=new["references"])
    return broken if (broken.targets, broken.references) != (q.targets, q.references) else None


def proposed_wrong(own: NormalisedScores, kind: str, q: Question, of_target: bool) -> Question | None:
    """Question without candidates of one name."""
    side, name, scores, named = side_of(q, of_target)
    frame, known = q.frame, q.known
    whole = np.array([frame.width, frame.height] * 2, np.float64)
    boxes = {i: own.pixels(t, frame) / whole for i, t in known.items()}
    area = {i: float(np.prod(b[2:] - b[:2])) for i, b in boxes.items()}
    from_left = sorted(scores, key=lambda i: float(boxes[i][0]))

    drops: dict[str, Callable[[int], bool]] = {
        **dict.fromkeys(("class", "synonym"), lambda i: i in named),
        "listed": lambda i: i in from_left[2:],
        "far": lambda i: bool(known[i].center[2] > FAR_M),
        "border": lambda i: bool(boxes[i][:2].min() < 0.02 or boxes[i][2:].max() > 0.98),
        "small": lambda i: area[i] < 0.012,
    }
    kept = {i: s for i, s in scores.items() if not drops[kind](i)}
    if len(kept) == len(scores):
        return None
    others = sorted({t.name for i, t in known.items() if i not in named}, key=lambda other: share(name, other, kind))
    if kind == "class" and others:
        found = [i for i, t in known.items() if t.name == others[0]]
        kept |= {i: own.certain(0.45 + 0.55 * share(frame.id, i, name)) for i in found}
    fields: dict[str, Any] = {side: dict(sorted(kept.items()))}
    return replace(q, **fields)


def any_fault(rng: Rng, right: bool) -> list[str]:
    """All kinds of faults of a module, rare ones first, in a share of the lines."""
    if rng.random() >= SHARE:
        return []
    module = str(rng.choice(FAULTS, p=OFTEN))
    kinds = [f"{module} {kind}" for kind in rng.permutation(KINDS[module]).tolist()]
    return sorted(kinds, key=lambda fault: fault not in RARE)


def ways(seeds: range, every: int, apart: int) -> dict[str, list[File]]:
    def whole(k: int, fault: str) -> File:
        return File(seeds.start + k, max(1, round(apart / DENSER.get(fault, 1.0))), lambda *_: [fault], whole=True)

    return {
        "mixed": [File(seed, every, any_fault) for seed in seeds],
        "whole files": [whole(k, f"{m} {kind}") for m in FAULTS for k, kind in enumerate(KINDS[m])],
    }


if __name__ == "__main__":
    main(Study(NAMES, make, KINDS, ways, seeds=3, every=6, apart=62, rooms=17320, also=(1, 6)))
