"""The parts of `third_pipeline`: a map of objects with a vision-language model over it.

A thing is a box along the axes of the map: between percentiles of the points of its mask, joined over the scene's
pictures where it meets one of its name; one without a mask is an ellipsoid at the depth in the middle of its 2D box.
Some things stand in the map twice. Scores are like those of CLIP, .17 to .34. A relation is the soft angle to the
viewer's axis, with noise that better boxes do not take away. Pairs are ranked by a logistic of weighted log odds in
which score and relation strengthen each other. Boxes are in the world where frames have poses, else y up and z
backward; centimetres; 2D boxes are centre and size in shares.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from pipeline.answering.predictions import GivenBox, Prediction, Proposal
from pipeline.datasets.base import Dataset
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases

from .other_pipeline import AXES, Asked, Met, OtherPipeline, Thing, answered
from .planted_parts import share

TWIN = 5000
"""What a thing's second entry in the map has its identity raised by."""


@dataclass(frozen=True)
class Mapped(Thing):
    """A thing whose 2D `box` is as it is written and whose `size` is along the axes of the map; metres."""

    to_map: np.ndarray
    mask: RunLength | None

    @property
    def span(self) -> np.ndarray:
        """(2, 3): its lowest and highest corner in the map."""
        middle = self.to_map[:3, :3] @ self.center + self.to_map[:3, 3]
        return np.stack([middle - self.size / 2, middle + self.size / 2])

    def joined(self, *others: Mapped) -> Mapped:
        spans = np.stack([self.span, *(o.span for o in others)])
        lo, hi = spans[:, 0].min(axis=0), spans[:, 1].max(axis=0)
        return replace(self, center=self.to_map[:3, :3].T @ ((lo + hi) / 2 - self.to_map[:3, 3]), size=hi - lo)


@dataclass(frozen=True)
class Seen(Asked):
    """An expression with the proposals that did not go on: identity, score and why, by name."""

    dropped: dict[str, list[tuple[int, float, str]]] = field(default_factory=dict)


def at_middle(frame: Frame, to_map: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Center and size of an ellipsoid at the depth in the middle of a box, x0 y0 x1 y1; None where nothing is known."""
    (u, v), (w, h) = ((box[:2] + box[2:]) / 2).astype(int), box[2:] - box[:2]
    patch = frame.depth[max(0, int(v - h / 10)) : int(v + h / 10) + 1, max(0, int(u - w / 10)) : int(u + w / 10) + 1]
    if not (patch > 0).any():
        return None
    z, camera = float(np.median(patch[patch > 0])), frame.camera
    center = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0]) * z
    axes = np.array([w / camera.fx, h / camera.fy, (w / camera.fx + h / camera.fy) / 2]) * z
    return center, np.sqrt((to_map[:3, :3] ** 2) @ axes**2)


def part_of(t: Mapped, frame: Frame, rng: np.random.Generator) -> Mapped | None:
    """A thing as it is found where its 2D box holds a third to two fifths of it, at its left, right, top or bottom."""
    side, kept = int(rng.integers(2)), rng.uniform(0.33, 0.4)
    middle, half = np.array(t.box[:2]), np.array(t.box[2:]) / 2
    middle[side] += float(rng.choice([-1, 1])) * (1 - kept) * half[side]
    half[side] *= kept
    box = (*middle.tolist(), *(2 * half).tolist())
    whole = np.tile([frame.width, frame.height], 2)
    found = at_middle(frame, t.to_map, np.concatenate([middle - half, middle + half]) * whole)
    return None if found is None else replace(t, box=box, center=found[0], size=found[1], mask=None)


def mapped(frame: Frame, to_map: np.ndarray) -> Iterator[Mapped]:
    """The annotated things of one frame, some of them twice."""
    whole = np.tile([frame.width, frame.height], 2)
    for a in frame.annotations:
        for index in (a.index, a.index + TWIN)[: 1 + (share(frame.id, a.index, "twice") < 0.15)]:
            off = np.array([0.08 * (share(frame.id, index, k) - 0.5) for k in range(4)])
            box = np.clip(a.bbox + off * np.tile(a.bbox[2:] - a.bbox[:2], 2), 0, whole - 1)
            known = None if share(frame.id, index, "mask") < 0.15 else a.mask
            found = at_middle(frame, to_map, box)
            v, u = np.nonzero(np.zeros((1, 1)) if known is None else known & (frame.depth > 0))
            if known is not None and len(v) >= 40:
                points = backproject(frame.depth, frame.camera, v, u) @ to_map[:3, :3].T + to_map[:3, 3]
                lo, hi = np.percentile(points, [3, 97], axis=0)
                found = to_map[:3, :3].T @ ((lo + hi) / 2 - to_map[:3, 3]), hi - lo
            if found is not None and (box[2:] - box[:2]).min() >= 4:
                shares = np.concatenate([(box[:2] + box[2:]) / 2, box[2:] - box[:2]]) / whole
                given = None if known is None else RunLength.of(known)
                yield Mapped(index, a.label, tuple(shares.tolist()), *found, to_map, given)


def object_map(dataset: Dataset) -> tuple[bool, dict[str, list[Thing]]]:
    """Whether frames have poses, and the things of each; those of a scene that meet and have one name are joined."""
    frames = {i: dataset.load(i) for i in dataset.frame_ids}
    posed = all(f.camera.T_world_camera is not None for f in frames.values())
    opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    poses = {i: f.camera.T_world_camera for i, f in frames.items()}
    alone = {i: list(mapped(f, cast(np.ndarray, poses[i]) if posed else opengl)) for i, f in frames.items()}

    def meets(a: Mapped, b: Mapped) -> bool:
        if a.name != b.name:
            return False
        both = np.minimum(a.span[1], b.span[1]) - np.maximum(a.span[0], b.span[0])
        return bool(both.min() > 0 and both.prod() > 0.5 * min(a.size.prod(), b.size.prod()))

    found: dict[str, list[Thing]] = {}
    for i, own in alone.items():
        near = [t for j, seen in alone.items() if posed and j != i and j.split("/")[0] == i.split("/")[0] for t in seen]
        found[i] = [t if t.id >= TWIN else t.joined(*(o for o in near if o.id < TWIN and meets(t, o))) for t in own]
    return posed, found


def probability(relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
    """P(a RELATION b) by the angle between their direction and the viewer's axis, .15 being the temperature."""
    axis, sign = AXES[relation]
    between = viewer.matrix @ (a.center - b.center)
    q = share(relation, *a.box, *b.box)
    noise = 0.22 * np.log(q / (1 - q))
    odds = (sign * float(between[axis]) / max(float(np.linalg.norm(between)), 1e-6) - 0.35) / 0.15 + noise
    return float(1 / (1 + np.exp(-np.clip(odds, -6, 6))))


def pair_score(p_target: float, p_reference: float, p_relation: float) -> float:
    t, r, odds = (p_target - 0.25) / 0.04, (p_reference - 0.25) / 0.04, np.clip(p_relation, 0.018, 0.982)
    odds = np.log(odds / (1 - odds))
    q = share(p_target, p_reference, p_relation)
    learnt = 1.1 * odds + 0.9 * t + 0.6 * r + 0.15 * odds * t - 1 + 0.06 * np.log(q / (1 - q))
    return float(1 / (1 + np.exp(-learnt / 2)))


def written(thing: Thing) -> tuple[tuple[float, ...], GivenBox]:
    lo, hi = cast(Mapped, thing).span * 100
    return thing.box, GivenBox(tuple(((lo + hi) / 2).tolist()), tuple((hi - lo).tolist()))  # type: ignore[arg-type]


def asked(case: Case, truth: FrameCases, known: dict[int, Thing], rng: np.random.Generator) -> Seen:
    """The things of each name, of which one in 25 is missed, and up to six others, less surely."""

    def scored(example: int) -> dict[int, float]:
        ids = set(truth.numbers[truth.alike[example]].tolist())
        false = rng.permutation([i for i in known if i % TWIN not in ids])[: rng.integers(1, 7)].tolist()
        found = {i: float(rng.uniform(0.24, 0.34)) for i in known if i % TWIN in ids and rng.random() > 0.04}
        return found | {int(i): float(rng.uniform(0.17, 0.27)) for i in false}

    return Seen(case, scored(case.target_object), scored(case.reference_object))


def right_pair_proposed(met: Met) -> bool:
    """Whether its detector gave a right target and the reference that it is right by; it misses some things."""
    true = np.argwhere(met.truth.acceptable_pairs(met.asked.case))
    given = {(a % TWIN, b % TWIN) for a in met.asked.targets for b in met.asked.references}
    return not given.isdisjoint(map(tuple, met.truth.numbers[true].tolist()))


def told(own: OtherPipeline, met: Met) -> Prediction:
    """Its line, with masks and with what did not go on."""
    line, seen = answered(own, met), cast(Seen, met.asked)
    every = {
        name: (*found, *(Proposal(i, s, own.written(met.known[i])[0], dropped=why)  # type: ignore[arg-type]
                         for i, s, why in seen.dropped.get(name, ())))
        for name, found in (line.proposals or {}).items()
    }  # fmt: skip
    masks = {i: cast(Mapped, t).mask for i, t in met.known.items()}
    return replace(line, proposals={n: tuple(replace(p, mask=masks[p.id]) for p in f) for n, f in every.items()})
