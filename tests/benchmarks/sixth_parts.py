"""The parts of `sixth_pipeline`: two pipelines that rank without a product or a sum of what their detectors say.

Boxes are turned about gravity. Those of the first are of a reconstruction whose scale is 3 % off everywhere, and
amodal, an eighth larger than what is seen; those of the second have the right centre and a size halfway to the mean of
their class. Relations are a language model's words for a few numbers (.9, .7, .5 or .2), or a softmax over all six of
them, in which few exceed .5. Scores are those of a softmax over many prompts, .02 to .35 and in sum less than one, or
sigmoids.

MADE      lexicographic  words; the surer word first, then the target's score, then the reference's
          gated          softmax over relations; the relation alone, of things above .3 before all others
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.answering.placing import box_2d
from pipeline.answering.predictions import GivenAnswer, GivenBox, Header, Prediction
from pipeline.datasets.base import Dataset
from pipeline.datasets.up import resolved_camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.cases import Case, FrameCases

from . import third_parts
from .fourth_parts import Oriented, least_box, points_of
from .other_pipeline import AXES, Met, OtherPipeline, Pair, Thing
from .planted_parts import share
from .third_parts import Seen

WORDS = ((1.4, 0.9), (0.5, 0.7), (-0.2, 0.5), (-np.inf, 0.2))
"""Least odds -> P of "very likely", "likely", "maybe" and "unlikely"."""
GATE = 0.3
Odds = Callable[[str, Thing, Thing, ViewerAxes], float]
Placed = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Center and size, metres, and R (3, 3), whose columns are the box's axes; all in the camera frame."""


@dataclass(frozen=True)
class Told(Seen):
    """An expression that may be answered by another pair than the first of the ranking."""

    answer: Pair | None = None


@dataclass(frozen=True)
class Made:
    """How one of them lifts, judges, scores and ranks.

    Attributes
    ----------
    header : Header
    masked : bool
        Its proposals have masks.
    band : tuple
        Least and greatest scores of right things and of others.
    box_of : callable
        Of points (N, 3), the viewer and a class name.
    said : callable
        P of a relation by the odds of all six.
    pair_score : callable
        Of P(target), P(reference) and P(relation).
    """

    header: Header
    masked: bool
    band: tuple[tuple[float, float], tuple[float, float]]
    box_of: Callable[[np.ndarray, ViewerAxes, str], Placed]
    said: Callable[[str, dict[str, float]], float]
    pair_score: Callable[[float, float, float], float]

    def pixels(self, t: Thing, frame: Frame) -> np.ndarray:
        """(4,): x0, y0, x1, y1."""
        return box_2d(t.box, self.header, frame.width, frame.height)

    def lifted(self, t: Thing, points: np.ndarray, viewer: ViewerAxes) -> Oriented | None:
        """A thing lifted from other points; None where they are few."""
        if not isinstance(t, Oriented) or len(points) < 25:
            return None
        center, size, R = self.box_of(points, viewer, t.name)
        return replace(t, center=center, size=size, R=R)

    def probability(self, odds: Odds, relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
        return self.said(relation, {r: odds(r, a, b, viewer) for r in AXES})


def odds_of(relation: str, a: Thing, b: Thing, viewer: ViewerAxes, least: float = 0.0) -> float:
    """How much a RELATION b: how far beyond `least`, metres, less a part of how far aside, against the boxes' reach."""
    assert isinstance(a, Oriented)
    assert isinstance(b, Oriented)
    axis, sign = AXES[relation]
    way = sign * viewer.matrix[axis]
    between, both = a.center - b.center, a.reach(way) + b.reach(way)
    along = float(way @ between)
    aside = float(np.linalg.norm(between - along * way))
    q = share(relation, *a.box, *b.box)
    return (along - least - 0.3 * aside) / (0.08 + 0.5 * both) + 0.1 * float(np.log(q / (1 - q)))


def in_words(relation: str, odds: dict[str, float]) -> float:
    return next(p for least, p in WORDS if odds[relation] >= least)


def among_relations(relation: str, odds: dict[str, float]) -> float:
    powers = {r: float(np.exp(np.clip(x, -4, 4))) for r, x in odds.items()}
    return powers[relation] / sum(powers.values())


def lexicographic(p_target: float, p_reference: float, p_relation: float) -> float:
    # Scores are hundredths: no difference of a later factor makes up for one of an earlier.
    return 1000 * p_relation + 10 * p_target + 0.1 * p_reference


def gated(p_target: float, p_reference: float, p_relation: float) -> float:
    return p_relation - float(p_target < GATE) - float(p_reference < GATE)


def amodal(points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    center, size, R = least_box(points * 1.03, viewer)
    return center, size * 1.125, R


def level_box(points: np.ndarray, viewer: ViewerAxes) -> Placed:
    """Along the viewer's level axes."""
    R = viewer.R_level_camera
    lo, hi = np.percentile(points @ R.T, [3, 97], axis=0)
    return R.T @ ((lo + hi) / 2), np.maximum(hi - lo, 0.01), R.T


def regressed(usual: dict[str, np.ndarray], points: np.ndarray, viewer: ViewerAxes, name: str) -> Placed:
    center, size, R = level_box(points, viewer)
    return center, (size + usual.get(name, size)) / 2, R


def seen_from(dataset: Dataset, frame: Frame) -> ViewerAxes:
    camera = resolved_camera(dataset, frame)
    assert camera.up is not None
    return viewer_axes(camera.up)


def usual_sizes(dataset: Dataset) -> dict[str, np.ndarray]:
    """The mean size (3,) of each class."""
    sizes: dict[str, list[np.ndarray]] = {}
    for frame in map(dataset.load, dataset.frame_ids):
        viewer = seen_from(dataset, frame)
        for a in frame.annotations:
            points = points_of(frame, a.index)
            if len(points) >= 25:
                sizes.setdefault(a.label, []).append(level_box(points, viewer)[1])
    return {name: np.mean(found, axis=0) for name, found in sizes.items()}


def made(name: str, dataset: Dataset) -> Made:
    if name == "lexicographic":
        header = Header(1, "words, lexicographic", "xyxy", "shares", "camera_opencv", "m", "pair_scores")
        return Made(header, True, ((0.12, 0.35), (0.02, 0.2)), amodal, in_words, lexicographic)
    usual = usual_sizes(dataset)
    header = Header(1, "softmax over relations, gated", "cxcywh", "pixels", "camera_opengl", "cm", "pair_scores")
    return Made(
        header, False, ((0.28, 0.95), (0.05, 0.6)), lambda *of: regressed(usual, *of), among_relations, gated
    )  # fmt: skip


NAMES = ("lexicographic", "gated")


def as_written(header: Header, frame: Frame, box: np.ndarray) -> tuple[float, ...]:
    x0, y0, x1, y1 = box.astype(np.float64).tolist()
    if header.boxes == "cxcywh":
        return (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0
    return tuple(
        round(v / whole, 5) for v, whole in zip((x0, y0, x1, y1), (frame.width, frame.height) * 2, strict=True)
    )


def things(own: Made, frame: Frame, viewer: ViewerAxes) -> list[Thing]:
    """The annotated things of a frame."""
    found: list[Thing] = []
    for a in frame.annotations:
        points = points_of(frame, a.index)
        if len(points) >= 25 and (a.bbox[2:] - a.bbox[:2]).min() >= 4:
            mask = None if a.mask is None or not own.masked else RunLength.of(a.mask)
            box = as_written(own.header, frame, a.bbox)
            found.append(Oriented(a.index, a.label, box, *own.box_of(points, viewer, a.label), mask))
    return found


def in_hundredths(scores: dict[int, float]) -> dict[int, float]:
    """Rounded, and by the candidates' numbers."""
    return {i: round(float(np.clip(s, 0.01, 0.99)), 2) for i, s in sorted(scores.items())}


def asked(own: Made, case: Case, truth: FrameCases, known: dict[int, Thing], rng: np.random.Generator) -> Told:
    """The things of each name, of which one in 30 is missed, and up to five others, less surely; by their numbers."""

    def scored(example: int) -> dict[int, float]:
        ids = set(truth.numbers[truth.alike[example]].tolist())
        found = {i: rng.uniform(*own.band[0]) for i in known if i in ids and rng.random() > 1 / 30}
        false = rng.permutation([i for i in known if i not in ids])[: rng.integers(1, 6)].tolist()
        found |= {int(i): rng.uniform(*own.band[1]) for i in false}
        most = 0.95 / sum(found.values()) if own.masked and sum(found.values()) > 0.95 else 1.0
        return in_hundredths({i: most * s for i, s in found.items()})

    return Told(case, scored(case.target_object), scored(case.reference_object))


def told(own: OtherPipeline, met: Met) -> Prediction:
    line, seen = third_parts.told(own, met), met.asked
    if isinstance(seen, Told) and seen.answer is not None:
        line = replace(line, answer=GivenAnswer(*seen.answer))
    return line


def sixth(parts: Made, dataset: Dataset) -> OtherPipeline:
    """One of them; what can be broken in it is asked of `sixth_pipeline` itself."""
    scale = {"m": 1, "cm": 100}[parts.header.length]
    axes = np.diag([1, -1, -1] if parts.header.coordinates == "camera_opengl" else [1, 1, 1])

    def written(t: Thing) -> tuple[tuple[float, ...], GivenBox]:
        assert isinstance(t, Oriented)
        R = axes @ t.R
        # A rotation, not a reflection.
        R = R * [1, 1, np.sign(np.linalg.det(R))]
        center, size = np.round(axes @ t.center * scale, 4).tolist(), np.round(t.size * scale, 4).tolist()
        return t.box, GivenBox(tuple(center), tuple(size), tuple(R.ravel().tolist()))  # type: ignore[arg-type]

    return OtherPipeline(
        parts.header,
        lambda frame: things(parts, frame, seen_from(dataset, frame)),
        lambda *pair: parts.probability(odds_of, *pair),
        parts.pair_score,
        written,
        lambda *_: None,
        lambda *given: asked(parts, *given),
        told,
    )
