"""A second pipeline that is not ours, with other parts, other faults and other rooms than `other_pipeline`; held out.

Made like a vision-language model with a depth network: a thing lies at the median depth of its pixels, as wide and
high as its 2D box is there and as deep as the lesser of the two. Relations are judged as they are seen, by bearing,
height in the picture and depth, with noise that better boxes do not take away. What scores pairs is a "learnt" curve: a
saturating one of the relation, logs of the two scores, and noise. Boxes are in millimetres, y up and z backward, and 2D
boxes are corner and size, off by a few per cent.

LIFT      right targets or the references that they are right by lie at a wrong depth along their ray, or elsewhere
SRM       right pairs are denied, or a pair that the pipeline holds for wrong is claimed
OPM-CONF  right targets or references score low, and others are proposed in their place
PRM       a wrong pair scores a little more than the best, or right ones less than the worst

    python -m benchmarks.second_pipeline --rooms FOLDER --labels FOLDER        (from tests/; without them it makes some)
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pipeline.answering.predictions import GivenBox, Header
from pipeline.datasets.synthetic import render_dataset
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.job import label

from .other_pipeline import AXES, Met, OtherPipeline, Thing, main, moved, not_proposed, right_ids
from .planted_parts import share

NOISE, SCORE_NOISE = 0.5, 0.02
"""Standard deviations, about, of the log odds of a relation and of a pair's score."""


def things(frame: Frame) -> list[Thing]:
    """The annotated objects at the median depth of their pixels."""
    found = []
    for a in frame.annotations:
        seen = None if a.mask is None else frame.depth[a.mask & (frame.depth > 0)]
        if seen is None or len(seen) < 40:
            continue
        size = np.tile(np.array(a.bbox[2:]) - a.bbox[:2], 2)
        off = [0.1 * (share(frame.id, a.index, k) - 0.5) for k in range(4)]
        x0, y0, x1, y1 = map(float, np.array(a.bbox) + size * off)
        depth, camera = float(np.median(seen)), frame.camera
        assert camera is not None
        there = np.full((camera.height, camera.width), depth, np.float32)
        u, v = (
            int(np.clip((lo + hi) / 2, 0, most - 1))
            for lo, hi, most in ((x0, x1, camera.width), (y0, y1, camera.height))
        )
        center = backproject(there, camera, np.array([v]), np.array([u]))[0].astype(np.float64)
        w, h = (x1 - x0) * depth / camera.fx, (y1 - y0) * depth / camera.fy
        found.append(Thing(a.index, a.label, (x0, y0, x1, y1), center, np.array([w, h, min(w, h)])))
    return found


def probability(relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
    """P(a RELATION b) as a picture shows it."""
    axis, sign = AXES[relation]
    seen = [np.array([t.center[0] / t.center[2], -t.center[1] / t.center[2], t.center[2] / 3]) for t in (a, b)]
    key = (relation, *a.box, *b.box)
    noise = sum(share(*key, k) for k in range(12)) - 6
    odds = sign * float(seen[0][axis] - seen[1][axis]) / 0.06 + NOISE * noise
    return float(1 / (1 + np.exp(-np.clip(odds, -6, 6))))


def pair_score(p_target: float, p_reference: float, p_relation: float) -> float:
    noise = sum(share(p_target, p_reference, p_relation, k) for k in range(12)) - 6
    learnt = np.tanh(3 * (p_relation - 0.5)) + 0.3 * np.log(p_target) + 0.2 * np.log(p_reference)
    return float(learnt + SCORE_NOISE * noise)


def written(thing: Thing) -> tuple[tuple[float, ...], GivenBox]:
    x0, y0, x1, y1 = thing.box
    center, size = thing.center * [1000, -1000, -1000], thing.size * 1000
    return (x0, y0, x1 - x0, y1 - y0), GivenBox(tuple(center.tolist()), tuple(size.tolist()))  # type: ignore[arg-type]


def planted(own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator) -> Met | None:
    asked, known, first = met.asked, met.known, bool(rng.random() < 0.5)
    good, ends = right_ids(met)
    pairs = {
        (a, b): own.probability(asked.case.relation, known[a], known[b], met.viewer)
        for a in asked.targets
        for b in asked.references
        if a != b
    }
    wrong = [pair for pair in pairs if pair[0] not in good]
    if fault in ("OPM-TARGET", "OPM-REF"):
        return not_proposed(fault, met)
    if fault == "LIFT" and rng.random() < 0.5:
        factor = float(rng.choice([rng.uniform(0.4, 0.65), rng.uniform(1.5, 2.2)]))
        return moved(met, {i: known[i].center * factor for i in (good if first else ends)}, rng)
    if fault == "LIFT":
        axis, sign = AXES[asked.case.relation]
        back = (-sign if first else sign) * met.viewer.matrix[axis] * rng.uniform(0.6, 1.5)
        return moved(
            met, {i: known[i].center + back + rng.normal(scale=0.15, size=3) for i in (good if first else ends)}, rng
        )
    if fault == "SRM":
        claimed = [pair for pair in wrong if pairs[pair] < 0.3]
        if not first and not claimed:
            return None
        one = () if first else (claimed[int(rng.integers(len(claimed)))],)
        said = {pair: 1 - p for pair, p in pairs.items() if pair[0] in good} if first else dict.fromkeys(one, 0.98)
        return replace(met, asked=replace(asked, relations=said))
    if fault == "OPM-CONF":
        away = [i for i in known if i not in asked.targets and i not in asked.references]
        false = dict.fromkeys(map(int, rng.permutation(away)[:3]), 0.95)
        low = {i: float(rng.uniform(0.05, 0.15)) for i in (good if first else ends)}
        if first:
            return replace(met, asked=replace(asked, targets={**asked.targets, **low, **false}))
        return replace(met, asked=replace(asked, references={**asked.references, **low, **false}))
    scores = {(a, b): own.pair_score(asked.targets[a], asked.references[b], p) for (a, b), p in pairs.items()}
    if not wrong:
        return None
    raised = {wrong[int(rng.integers(len(wrong)))]: max(scores.values()) + 0.1}
    lowered = {pair: min(scores.values()) - 0.1 for pair in pairs if pair[0] in good}
    return replace(met, asked=replace(asked, scores=raised if first else lowered))


HELD_OUT = OtherPipeline(
    Header(
        system="held out", ranking="pair_scores", boxes="xywh", coordinates="camera_opengl", length="mm"
    ),
    things, probability, pair_score, written, planted,
)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--rooms", type=Path)
    parser.add_argument("--labels", type=Path)
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        rooms, labels = given.rooms or Path(folder, "rooms"), given.labels or Path(folder, "labels")
        if given.rooms is None:
            render_dataset(rooms, rooms=6, views=2, seed=41, width=480, height=360)
        if given.labels is None:
            label(rooms, labels)
        main(HELD_OUT, rooms, labels, given.seeds, given.every)
