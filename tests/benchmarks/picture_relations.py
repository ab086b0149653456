"""Three foreign pipelines whose relations do not follow from their 3D boxes alone, or hardly; held out.

Frustum boxes are a 2D box at the depths in its middle half, along the camera's axes. Spheres are a mask's median with
the radius that holds four fifths of its points, written as cubes. A relation is judged in the picture, by 2D boxes and
the depth of the centres, and is unsure of itself, .39 to .61; or by bearings from the viewer and ratios of distance,
with a bias to yes. Scores are calibrated by class, so that one has .9 to .99 and another .2 to .4; or are .35 to .75.

gate      frustum boxes, the picture; pairs under .5 come below all others, then by the detector's scores
borda     spheres, bearings; the sum of the ranks that a pair has by each factor, the relation's twice
bilinear  spheres, bearings; learnt weights on products of two factors

OPM-TARGET, OPM-REF  a class's threshold drops all of it; duplicates of another thing take the places; a box is round
          far more than the thing; or all boxes of the name are in the pixels of a smaller picture, or lag behind
LIFT      boxes of right targets, or of the references that they are right by, stand on the background or have the depth
          of a place beside them; all boxes have depths in reverse, are not levelled, or are of a mirrored depth picture
SRM       sides from half of the references' own view; what is usual for two classes; P in the order of another axis; or
          what is near
OPM-CONF  one name's candidates have the scores of the other name's prompt, or those of their area, or each other's in
          reverse; right ones are put down as by soft suppression
PRM       targets and references exchanged in the relation; the least first; only the surest target goes on; scores made
          to sum to one along the wrong axis; by place in the list

Two ways: some lines broken, each by some kind; and all of them, by the kinds of one module.

    python -m benchmarks.picture_relations --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from benchmarks.fault_figures import FAULTS, PLANTED_SHARE, File, Study, main, random_fault
from benchmarks.fault_purity import box_moved, pure, right_pair
from benchmarks.foreign_pipelines import (
    AXES,
    FEWEST_POINTS,
    Detected,
    ForeignPipeline,
    Pair,
    Placed,
    Question,
    Rng,
    Thing,
    annotated,
    as_written,
    detections,
    judged,
    new_id,
    noise,
    numbered_anew,
    pair_scores,
    points_of,
    ranked,
    right_ids,
    side_of,
    with_things,
)
from benchmarks.planted_parts import share

from pipeline.answering.predictions import Header
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases

KINDS = {
    "OPM-TARGET": ("threshold", "duplicates", "whole", "resized", "lagging"),
    "OPM-REF": ("threshold", "duplicates", "whole", "resized", "lagging"),
    "LIFT": ("background", "unregistered", "reverse", "pitch", "mirrored"),
    "SRM": ("intrinsic", "usual", "transposed", "near"),
    "OPM-CONF": ("prompt", "area", "reverse", "suppressed"),
    "PRM": ("converse", "least", "beam", "axis", "place"),
}
"""A fault is "MODULE kind"."""
TRIES = 6
"""How often a fault is drawn anew that does not count: another direction, strength or role."""
BANDS = ((0.9, 0.99), (0.2, 0.4), (0.5, 0.85))
"""What the scores of a class lie between."""
Lift = Callable[[Frame, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Center and size, camera frame and metres, of a frame, a 2D box (x0, y0, x1, y1, pixels) and points (N, 3)."""


@dataclass(frozen=True)
class PictureRelations(ForeignPipeline):
    """One of the three.

    Attributes
    ----------
    masked : bool
        It lifts by masks, else by the middle of 2D boxes.
    lift, judge : callable
    sure : callable
        Score by a class name and a certainty, 0 to 1.
    rank : callable
        Scores (P,) of a question's pairs by their factors (P, 3).
    """

    masked: bool
    lift: Lift
    judge: Callable[[str, Thing, Thing, ViewerAxes], float]
    sure: Callable[[str, float], float]
    rank: Callable[[np.ndarray], np.ndarray]
    decimals: ClassVar[int | None] = 3

    def things(self, frame: Frame, viewer: ViewerAxes) -> list[Thing]:
        def box_of(index: int, pixels: np.ndarray) -> Placed | None:
            points = points_of(frame, index) if self.masked else points_in(frame, pixels)
            return (*self.lift(frame, pixels, points), None) if len(points) >= FEWEST_POINTS else None

        return annotated(self.header, frame, self.masked, box_of)

    def lifted(self, t: Thing, frame: Frame, pixels: np.ndarray) -> Thing | None:
        """Find a thing in another 2D box, and lift it from there; None where nothing is known there."""
        points = points_in(frame, pixels)
        if len(points) < 10:
            return None
        center, size = self.lift(frame, pixels, points)
        return Thing(t.id, t.name, as_written(self.header, frame, pixels), center, size)

    def detected(self, case: Case, truth: FrameCases, known: Mapping[int, Thing], rng: Rng) -> Detected:
        return detections(
            case, truth, known, rng, self.sure, missed=1 / 30, others=(1, 6), right=(0.35, 1.0), false=(0.0, 0.5)
        )

    def probability(self, relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
        return self.judge(relation, a, b, viewer)

    def ranks(self, factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
        return self.rank(factors)

    def planted(self, fault: str, q: Question, rng: Rng, whole: bool) -> Question | None:
        """Question with a fault that is drawn anew until it counts; None where no draw does."""
        module, kind = fault.split()
        for _ in range(TRIES if right_pair(self, q) else 0):
            broken = planted_once(self, module, kind, q, rng)
            if broken is not None and pure(self, module, q, broken):
                return broken
        return None

    def counts(self, module: str, q: Question, broken: Question) -> bool:
        return True


def points_in(frame: Frame, pixels: np.ndarray) -> np.ndarray:
    """Depth points (N, 3) in the middle half of a 2D box."""
    middle, half = (pixels[:2] + pixels[2:]) / 2, (pixels[2:] - pixels[:2]) / 4
    (x0, y0), (x1, y1) = np.maximum(0, middle - half).astype(int), np.maximum(0, middle + half).astype(int) + 1
    v, u = np.nonzero(frame.depth[y0:y1, x0:x1] > 0)
    return backproject(frame.depth, frame.camera, v + y0, u + x0).astype(np.float64)


def frustum(frame: Frame, pixels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    near, far = np.percentile(points[:, 2], [8, 92])
    z, camera = (near + far) / 2, frame.camera
    (u, v), (w, h) = (pixels[:2] + pixels[2:]) / 2, pixels[2:] - pixels[:2]
    center = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0]) * z
    return center, np.maximum([w / camera.fx * z, h / camera.fy * z, far - near], 0.02)


def sphere(frame: Frame, pixels: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    middle = np.median(points, axis=0)
    radius = max(0.02, float(np.percentile(np.linalg.norm(points - middle, axis=1), 80)))
    # What is seen of a thing is its near side.
    return middle * (1 + 0.3 * radius / np.linalg.norm(middle)), np.full(3, 2 * radius)


def by_picture(relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
    """P(a RELATION b) by corner-and-size boxes in the picture and the depth of the centres."""
    axis, sign = AXES[relation]
    a2, b2 = (np.array(t.box).reshape(2, 2) for t in (a, b))
    flat = ((a2[0] + a2[1] / 2) - (b2[0] + b2[1] / 2)) / ((a2[1] + b2[1]) / 2)
    deep = (a.center[2] - b.center[2]) / (0.1 + (a.size[2] + b.size[2]) / 2)
    offsets = np.array([flat[0], -flat[1], deep])
    aside = np.abs(np.delete(offsets, axis)).clip(0, 2).mean()
    return float(0.5 + 0.11 * np.tanh(0.9 * (sign * offsets[axis] - 0.2 * aside - 0.3) + 0.12 * noise(relation, a, b)))


def by_bearing(relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
    """P(a RELATION b) by azimuth, elevation and the logarithm of the distance; it would rather say yes."""

    def seen(t: Thing) -> np.ndarray:
        right, up, forward = viewer.matrix @ t.center
        far = float(np.hypot(right, forward)) + 1e-6
        return np.array([np.arctan2(right, forward) / 0.10, np.arctan2(up, far) / 0.08, np.log(far) / 0.10])

    axis, sign = AXES[relation]
    odds = sign * (seen(a) - seen(b))[axis] + 0.6 + 0.3 * noise(relation, a, b)
    return float(1 / (1 + np.exp(-np.clip(odds, -4, 4))))


def by_class(name: str, sure: float) -> float:
    low, high = BANDS[int(3 * share("band", name))]
    return low + (high - low) * sure


def by_hundredths(name: str, sure: float) -> float:
    return round(0.35 + 0.4 * sure, 2)


def gate(factors: np.ndarray) -> np.ndarray:
    t, r, p = factors.T
    return np.where(p >= 0.5, 1.0, 0.0) + 0.7 * t + 0.3 * r


def borda(factors: np.ndarray) -> np.ndarray:
    """Number of pairs that a pair is above, by each factor; equal ones are told apart by the product."""
    above = (factors[:, None] > factors[None]).sum(axis=1)
    return above @ [1.0, 1.0, 2.0] + 0.5 * factors.prod(axis=1)


def bilinear(factors: np.ndarray) -> np.ndarray:
    t, r, p = factors.T
    return 1.3 * t * p + 0.6 * r * p + 0.2 * t * r + 0.3 * p + 0.1 * t


NAMES = ("gate", "borda", "bilinear")


def make(name: str) -> PictureRelations:
    if name == "gate":
        header = Header(1, "frustums, gate", "xywh", "pixels", "camera_opencv", "cm", "pair_scores")
        return PictureRelations(header, False, frustum, by_picture, by_class, gate)
    header = Header(1, f"spheres, {name}", "cxcywh", "thousandths", "camera_opengl", "mm", "pair_scores")
    return PictureRelations(header, True, sphere, by_bearing, by_hundredths, borda if name == "borda" else bilinear)


def planted_once(own: PictureRelations, module: str, kind: str, q: Question, rng: Rng) -> Question | None:
    good, ends = right_ids(q)
    if module == "SRM":
        said = judged_wrong(own, kind, q)
        return None if said is None else replace(q, relations=said)
    if module == "PRM":
        return replace(q, scores=ranked_wrong(own, kind, q))
    of_target = module == "OPM-TARGET" or (module != "OPM-REF" and rng.random() < 0.5)
    ids = good if of_target else ends
    if not ids:
        return None
    if module == "LIFT":
        return lifted_wrong(own, kind, q, ids, rng)
    change = scored_wrong if module == "OPM-CONF" else proposed_wrong
    return change(own, kind, q, of_target, ids, rng)


def proposed_wrong(
    own: PictureRelations, kind: str, q: Question, of_target: bool, ids: Sequence[int], rng: Rng
) -> Question | None:
    """Question without the right candidates of one name."""
    side, name, scores, named = side_of(q, of_target)
    frame, known = q.frame, q.known
    gone: list[tuple[int, float, str]] = []
    kept = dict(scores)
    fresh: dict[int, Thing] = {}
    if kind == "threshold":
        gone = [(i, s, "threshold") for i, s in scores.items() if i in named]
        kept = {i: s for i, s in scores.items() if i not in named}
    elif kind == "duplicates":
        # What is cut off by K has less than what takes its place.
        surer = [i for i, s in scores.items() if i not in ids and s > max(scores[j] for j in ids)]
        if not surer:
            return None
        one = surer[int(rng.integers(len(surer)))]
        pixels = own.pixels(known[one], frame)
        gone = [(i, scores[i], "rank") for i in ids]
        kept = {i: s for i, s in scores.items() if i not in ids}
        for _ in range(1 + int(rng.integers(3))):
            off = rng.uniform(-0.06, 0.06, 4) * np.tile(pixels[2:] - pixels[:2], 2)
            twin = own.lifted(known[one], frame, np.clip(pixels + off, 0, [frame.width, frame.height] * 2))
            if twin is not None:
                new = new_id(rng)
                fresh[new] = replace(twin, id=new)
                kept[new] = float(rng.uniform(max(scores[j] for j in ids), scores[one]))
    else:
        moving = ids if kind == "whole" else list(scores)
        new_things = {i: t for i in moving if (t := _elsewhere(own, kind, known[i], q, ids, rng)) is not None}
        if not set(ids) <= set(new_things):
            return None
        # What has no depth there has no box either.
        lost = set(moving) - set(new_things)
        fields: dict[str, Any] = {side: {i: s for i, s in scores.items() if i not in lost}}
        left = replace(q, **fields)
        broken = with_things(left, numbered_anew(new_things, rng))
        # Things that are asked for by both names keep their boxes in the other role.
        return replace(broken, references=q.references) if of_target else replace(broken, targets=q.targets)
    fields: dict[str, Any] = {side: kept}
    return replace(q, **fields, dropped={name: gone}, known={**known, **fresh})


def _elsewhere(own: PictureRelations, kind: str, t: Thing, q: Question, ids: Sequence[int], rng: Rng) -> Thing | None:
    """Find a thing in a wrong 2D box."""
    frame, pixels = q.frame, own.pixels(t, q.frame)
    whole = np.array([frame.width, frame.height] * 2, np.float64)
    if kind == "whole":
        middle, half = (pixels[:2] + pixels[2:]) / 2, (pixels[2:] - pixels[:2]) / 2 * rng.uniform(1.9, 2.6)
        middle = middle + half * rng.uniform(-0.3, 0.3, 2)
        pixels = np.concatenate([middle - half, middle + half])
    elif kind == "resized":
        # One size for all boxes of the name.
        pixels = pixels * float((0.4, 0.5, 0.625)[int(3 * share(frame.id, q.case.text, "size"))])
    else:
        first = own.pixels(q.known[ids[0]], frame)
        angle = 2 * np.pi * share(frame.id, q.case.text, "lag")
        pixels = pixels + np.tile(np.array([np.cos(angle), 0.5 * np.sin(angle)]) * (first[2:] - first[:2]), 2)
    pixels = np.clip(pixels, 0, whole)
    return own.lifted(t, frame, pixels) if (pixels[2:] - pixels[:2]).min() >= 4 else None


def lifted_wrong(own: PictureRelations, kind: str, q: Question, ids: Sequence[int], rng: Rng) -> Question | None:
    """Question with wrong 3D boxes of these things, or of all candidates that are off by it."""
    frame, known = q.frame, q.known
    every = list({**q.targets, **q.references})
    depths = np.array([known[i].center[2] for i in every])
    turn = float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.2))
    away = float(rng.choice([-1, 1]) * rng.uniform(0.7, 1.6))
    new: dict[int, Thing] = {}
    for i in ids if kind in ("background", "unregistered") else every:
        t = known[i]
        pixels = own.pixels(t, frame)
        center, size, z = t.center, t.size, t.center[2]
        if kind == "pitch":
            c, s = np.cos(turn), np.sin(turn)
            center = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ center
        else:
            if kind == "reverse":
                there: float | None = float(depths.min() + depths.max() - z)
            elif kind == "background":
                there = _behind(frame, pixels, z)
            elif kind == "unregistered":
                shift = away * (pixels[2] - pixels[0])
                there = _depth(frame, pixels + np.array([shift, 0, shift, 0]))
            else:
                x0, y0, x1, y1 = pixels
                there = _depth(frame, np.array([frame.width - x1, y0, frame.width - x0, y1]))
            if there is None:
                continue
            center, size = center * there / z, size * there / z
        moved = replace(t, center=center, size=size)
        if box_moved(own, t, moved):
            new[i] = moved
    if not new or (kind in ("background", "unregistered") and len(new) < len(ids)):
        return None
    return with_things(q, numbered_anew(new, rng))


def _depth(frame: Frame, pixels: np.ndarray) -> float | None:
    points = points_in(frame, np.clip(pixels, 0, [frame.width, frame.height] * 2))
    return float(np.median(points[:, 2])) if len(points) >= 10 else None


def _behind(frame: Frame, pixels: np.ndarray, z: float) -> float | None:
    """Median depth of what lies behind, in and round a box."""
    middle, whole = (pixels[:2] + pixels[2:]) / 2, pixels[2:] - pixels[:2]
    points = points_in(frame, np.clip(np.concatenate([middle - 1.5 * whole, middle + 1.5 * whole]), 0, None))
    far = points[points[:, 2] > z + 0.25, 2]
    return float(np.median(far)) if len(far) >= 20 else None


def judged_wrong(own: PictureRelations, kind: str, q: Question) -> dict[Pair, float] | None:
    """Wrong probabilities of all pairs."""
    case, known, p = q.case, q.known, judged(own, q)
    low, high = min(p.values(), default=0.0), max(p.values(), default=1.0)
    if kind == "intrinsic":
        facing = {b for _, b in p if share(q.frame.id, b, "faces the viewer") < 0.5}
        return {(a, b): 1 - x if b in facing else x for (a, b), x in p.items()}
    if kind == "usual":
        habit = {(a, b): share(case.relation, known[a].name, known[b].name, "usual") for a, b in p}
        return {pair: low + (high - low) * x for pair, x in habit.items()}
    if kind == "near":
        away = {(a, b): float(np.linalg.norm(known[a].center - known[b].center)) for a, b in p}
        return {pair: low + (high - low) * float(np.exp(-d)) for pair, d in away.items()}
    rows, columns = list(q.targets), list(q.references)
    if min(len(rows), len(columns)) < 2:
        return None
    table = np.array([[p.get((a, b), (low + high) / 2) for b in columns] for a in rows])
    read = table.T.reshape(len(rows), len(columns))
    return {(a, b): float(read[k, j]) for k, a in enumerate(rows) for j, b in enumerate(columns) if a != b}


def ranked_wrong(own: PictureRelations, kind: str, q: Question) -> dict[Pair, float]:
    """Wrong scores of all pairs."""
    scores = ranked(own, q)
    if kind == "converse":
        known = q.known
        back = {(a, b): own.probability(q.case.relation, known[b], known[a], q.viewer) for a, b in q.pairs}
        return pair_scores(own, q, back)
    if kind == "least":
        return {pair: -s for pair, s in scores.items()}
    if kind == "beam":
        first = max(q.targets, key=q.targets.__getitem__)
        below = 2 * max(abs(s) for s in scores.values()) + 1
        return {pair: s if pair[0] == first else s - below for pair, s in scores.items()}
    if kind == "axis":
        sums = {a: sum(s for (x, _), s in scores.items() if x == a) for a in q.targets}
        return {pair: s / max(sums[pair[0]], 1e-6) for pair, s in scores.items()}
    return {pair: float(-k) for k, pair in enumerate(scores)}


def scored_wrong(
    own: PictureRelations, kind: str, q: Question, of_target: bool, ids: Sequence[int], rng: Rng
) -> Question | None:
    """Question with wrong scores of one name's candidates."""
    side, name, scores, _ = side_of(q, of_target)
    _, other, _, others = side_of(q, not of_target)
    if kind == "prompt":
        found = [i for i in q.known if i in others and i not in scores]
        sure = {i: (0.35, 1.0) if i in others else (0.0, 0.3) for i in [*scores, *found]}
        new = {i: own.sure(other, float(rng.uniform(*u))) for i, u in sorted(sure.items())}
    elif kind == "area":
        boxes = {i: own.pixels(q.known[i], q.frame) for i in scores}
        area = {i: float(np.prod(b[2:] - b[:2])) / (q.frame.width * q.frame.height) for i, b in boxes.items()}
        new = {i: own.sure(name, min(1.0, 2 * a**0.5)) for i, a in area.items()}
    elif kind == "reverse":
        new = dict(zip(scores, list(scores.values())[::-1], strict=True))
    else:
        new = scores | {i: scores[i] * float(rng.uniform(0.3, 0.65)) for i in ids}
    fields: dict[str, Any] = {side: new}
    return replace(q, **fields) if new != scores else None


def ways(seeds: range, every: int, apart: int) -> dict[str, list[File]]:
    kinds = {m: [f"{m} {k}" for k in KINDS[m]] for m in FAULTS}
    # Each module as often as any other.
    even = [fault for m in FAULTS for fault in kinds[m] for _ in range(60 // len(kinds[m]))]
    return {
        "mixed": [File(seed, every, random_fault(even, PLANTED_SHARE)) for seed in seeds],
        "one module": [File(seeds.stop, apart, random_fault(kinds[m], 1.0)) for m in FAULTS],
    }


if __name__ == "__main__":
    main(Study(NAMES, make, KINDS, ways, seeds=2, every=6, apart=16, rooms=31415, also=(1, 2)))
