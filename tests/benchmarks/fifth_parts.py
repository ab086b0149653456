"""The parts of `fifth_pipeline`: three pipelines whose relations do not follow from their 3D boxes alone, or hardly.

Frustum boxes are a 2D box at the depths in its middle half, along the camera's axes. Spheres are a mask's median with
the radius that holds four fifths of its points, written as cubes. A relation is judged in the picture, by 2D boxes and
the depth of the centres, and is unsure of itself, .39 to .61; or by bearings from the viewer and ratios of distance,
with a bias to yes. Scores are calibrated by class, so that one has .9 to .99 and another .2 to .4; or are .35 to .75.

VARIANTS  gate      frustum boxes, the picture; pairs under .5 come below all others, then by the detector's scores
          borda     spheres, bearings; the sum of the ranks that a pair has by each factor, the relation's twice
          bilinear  spheres, bearings; learnt weights on products of two factors
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pipeline.answering.placing import box_2d
from pipeline.answering.predictions import GivenBox, Header, Prediction
from pipeline.datasets.base import Dataset
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases

from . import third_parts
from .fourth_parts import edges, points_of
from .other_pipeline import AXES, Met, OtherPipeline, Pair, Thing
from .planted_parts import share
from .third_parts import Seen

Lift = Callable[[Frame, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Center and size, camera frame and metres, of a frame, a 2D box (x0, y0, x1, y1, pixels) and points (N, 3)."""
BANDS = ((0.9, 0.99), (0.2, 0.4), (0.5, 0.85))
"""What the scores of a class lie between."""


@dataclass(frozen=True)
class Found(Thing):
    """A thing whose 2D `box` is as it is written, and whose 3D box is along the camera's axes."""

    mask: RunLength | None = None


@dataclass(frozen=True)
class Variant:
    """How one of them lifts, judges, scores and ranks.

    Attributes
    ----------
    header : Header
    masked : bool
        It lifts by masks, else by the middle of 2D boxes.
    lift, probability : callable
    score : callable
        Of a class name and how sure it is of it, 0 to 1.
    ranks : callable
        Scores (P,) of an expression's pairs by their factors (P, 3): target, reference, relation.
    """

    header: Header
    masked: bool
    lift: Lift
    probability: Callable[[str, Thing, Thing, ViewerAxes], float]
    score: Callable[[str, float], float]
    ranks: Callable[[np.ndarray], np.ndarray]

    def pixels(self, t: Thing, frame: Frame) -> np.ndarray:
        """(4,): x0, y0, x1, y1."""
        return box_2d(t.box, self.header, frame.width, frame.height)

    def as_written(self, pixels: np.ndarray, frame: Frame) -> tuple[float, ...]:
        x0, y0, x1, y1 = pixels.tolist()
        if self.header.boxes == "xywh":
            return x0, y0, x1 - x0, y1 - y0
        box = np.array([(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0])
        return tuple(np.round(box / np.tile([frame.width, frame.height], 2) * 1000, 1).tolist())

    def lifted(self, t: Thing, frame: Frame, pixels: np.ndarray) -> Found | None:
        """A thing found in another 2D box, and lifted from there; None where nothing is known there."""
        points = points_in(frame, pixels)
        if len(points) < 10:
            return None
        center, size = self.lift(frame, pixels, points)
        return Found(t.id, t.name, self.as_written(pixels, frame), center, size)


def points_in(frame: Frame, pixels: np.ndarray) -> np.ndarray:
    """(N, 3): depth points in the middle half of a 2D box."""
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


def noise(relation: str, a: Thing, b: Thing) -> float:
    """Logistic, of scale 1; only the boxes in the picture decide it."""
    q = share(relation, *a.box, *b.box)
    return float(np.log(q / (1 - q)))


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
    """How many pairs of the expression a pair is above, by each factor; equal ones are told apart by the product."""
    above = (factors[:, None] > factors[None]).sum(axis=1)
    return above @ [1.0, 1.0, 2.0] + 0.5 * factors.prod(axis=1)


def bilinear(factors: np.ndarray) -> np.ndarray:
    t, r, p = factors.T
    return 1.3 * t * p + 0.6 * r * p + 0.2 * t * r + 0.3 * p + 0.1 * t


VARIANTS = {
    "gate": Variant(
        Header(1, "frustums, gate", "xywh", "pixels", "camera_opencv", "cm", "pair_scores"),
        False, frustum, by_picture, by_class, gate,
    ),
    **{
        name: Variant(
            Header(1, f"spheres, {name}", "cxcywh", "thousandths", "camera_opengl", "mm", "pair_scores"),
            True, sphere, by_bearing, by_hundredths, ranks,
        )
        for name, ranks in (("borda", borda), ("bilinear", bilinear))
    },
}  # fmt: skip


def things(variant: Variant, frame: Frame) -> list[Thing]:
    """The annotated things of a frame."""
    found: list[Thing] = []
    for a in frame.annotations:
        pixels = a.bbox.astype(np.float64)
        points = points_of(frame, a.index) if variant.masked else points_in(frame, pixels)
        if len(points) >= 25 and (pixels[2:] - pixels[:2]).min() >= 4:
            mask = None if a.mask is None or not variant.masked else RunLength.of(a.mask)
            box = variant.as_written(pixels, frame)
            found.append(Found(a.index, a.label, box, *variant.lift(frame, pixels, points), mask))
    return found


def asked(
    variant: Variant, case: Case, truth: FrameCases, known: Mapping[int, Thing], rng: np.random.Generator
) -> Seen:
    """The things of each name, of which one in 30 is missed, and up to five others, less surely; by their numbers."""

    def scored(name: str, example: int) -> dict[int, float]:
        ids = set(truth.numbers[truth.alike[example]].tolist())
        found = {i: variant.score(name, rng.uniform(0.35, 1)) for i in known if i in ids and rng.random() > 1 / 30}
        false = rng.permutation([i for i in known if i not in ids])[: rng.integers(1, 6)].tolist()
        return dict(sorted((found | {int(i): variant.score(name, rng.uniform(0, 0.5)) for i in false}).items()))

    return Seen(case, scored(case.target, case.target_object), scored(case.reference, case.reference_object))


def judged(own: OtherPipeline, met: Met) -> dict[Pair, float]:
    """P of every pair of candidates, as the line has it."""
    p = edges(own, met, met.asked.case.relation)
    return {pair: met.asked.relations.get(pair, q) for pair, q in p.items()}


def factors_of(met: Met, p: Mapping[Pair, float]) -> np.ndarray:
    """(P, 3) of pairs with these probabilities."""
    rows = [(met.asked.targets[a], met.asked.references[b], q) for (a, b), q in p.items()]
    return np.array(rows).reshape(-1, 3)


def ranked(variant: Variant, own: OtherPipeline, met: Met) -> Met:
    """With the score of every pair."""
    p = judged(own, met)
    scores = variant.ranks(factors_of(met, p)).tolist()
    return replace(met, asked=replace(met.asked, scores=dict(zip(p, scores, strict=True))))


def fifth(name: str, dataset: Dataset, planted: Callable[..., Met | None]) -> OtherPipeline:
    """One of VARIANTS, with what can be broken in it."""
    variant = VARIANTS[name]
    scale = {"m": 1, "cm": 100, "mm": 1000}[variant.header.length]
    axes = np.array([1, -1, -1] if variant.header.coordinates == "camera_opengl" else [1, 1, 1])

    def written(t: Thing) -> tuple[tuple[float, ...], GivenBox]:
        center, size = np.round(t.center * axes * scale, 3).tolist(), np.round(t.size * scale, 3).tolist()
        return t.box, GivenBox(tuple(center), tuple(size))

    def told(own: OtherPipeline, met: Met) -> Prediction:
        return third_parts.told(own, met if met.asked.scores else ranked(variant, own, met))

    return OtherPipeline(
        variant.header,
        lambda frame: things(variant, frame),
        variant.probability,
        lambda *factors: float(variant.ranks(np.array([factors]))[0]),
        written,
        lambda own, fault, met, rng: planted(variant, own, fault, ranked(variant, own, met), rng),
        lambda *given: asked(variant, *given),
        told,
    )
