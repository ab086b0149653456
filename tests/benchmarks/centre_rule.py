"""A foreign pipeline that compares the centres of boxes, with faults planted in one module of it at a time.

It is made like SpatialRGPT's: depth points of each mask are cleaned by statistics (what lies far from the median is
dropped), a box along the camera's axes is put around the rest, and relations compare centres. It ranks by no product:
the score of a pair is six tenths of the relation's probability and four tenths of the weaker detection.

OPM-TARGET, OPM-REF  the right targets, or the right references, are not proposed
LIFT      the boxes of the right targets are put .6 to 1.5 m to the other side, and a little elsewhere
SRM       the relation of right pairs is turned round, its probability is one minus itself
OPM-CONF  right targets score .05 to .15, and three things that are none of the class are proposed for it with .97
PRM       the score of a wrong pair, and nothing else, is raised above all others

Three kinds of files: some lines broken, all of them, and all of them in one module.

    python -m benchmarks.centre_rule        (from tests/)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from benchmarks.fault_figures import FAULTS, PLANTED_SHARE, File, Study, main, random_fault
from benchmarks.fault_purity import turned_wrong
from benchmarks.foreign_pipelines import (
    AXES,
    Detected,
    ForeignPipeline,
    Pair,
    Question,
    Rng,
    Thing,
    points_at,
    right_ids,
    with_things,
)

from pipeline.answering.predictions import Header
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import Case, FrameCases


class CentreRule(ForeignPipeline):
    """Boxes along the camera's axes, relations by centres, a weighted minimum."""

    def things(self, frame: Frame, viewer: ViewerAxes) -> list[Thing]:
        found = []
        for a in frame.annotations:
            points = np.zeros((0, 3)) if a.mask is None else points_at(frame, a.mask)
            if len(points) < 40:
                continue
            away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
            kept = points[away <= away.mean() + 2 * away.std()]
            lo, hi = kept.min(axis=0), kept.max(axis=0)
            found.append(Thing(a.index, a.label, tuple(map(float, a.bbox)), (lo + hi) / 2, hi - lo))
        return found

    def detected(self, case: Case, truth: FrameCases, known: Mapping[int, Thing], rng: Rng) -> Detected:
        """Scores of the things of the two names, and of two others that are taken for them, less surely."""

        def scored(example: int) -> dict[int, float]:
            ids = truth.numbers[np.flatnonzero(truth.alike[example])].tolist()
            others = [i for i in known if i not in ids]
            false = rng.permutation(others)[:2].tolist()
            found = {i: float(rng.uniform(0.55, 0.95)) for i in ids if i in known}
            return found | {int(i): float(rng.uniform(0.3, 0.6)) for i in false}

        return scored(case.target_object), scored(case.reference_object)

    def probability(self, relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
        axis, sign = AXES[relation]
        along = float(sign * (viewer.matrix @ (a.center - b.center))[axis])
        return float(1 / (1 + np.exp(-np.clip(along / 0.08, -30, 30))))

    def ranks(self, factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
        return 0.6 * factors[:, 2] + 0.4 * factors[:, :2].min(axis=1)

    def counts(self, module: str, q: Question, broken: Question) -> bool:
        return turned_wrong(self, q, broken)

    def planted(self, fault: str, q: Question, rng: Rng, whole: bool) -> Question | None:
        good, ends = right_ids(q)
        known, relation = q.known, q.case.relation
        if fault == "OPM-TARGET":
            return replace(q, targets={i: s for i, s in q.targets.items() if i not in good})
        if fault == "OPM-REF":
            return replace(q, references={i: s for i, s in q.references.items() if i not in ends})
        if fault == "LIFT":
            axis, sign = AXES[relation]
            back = -sign * q.viewer.matrix[axis]
            at = {i: known[i].center + back * rng.uniform(0.6, 1.5) + rng.normal(scale=0.1, size=3) for i in good}
            first = 10_000 + int(rng.integers(10**9))
            return with_things(q, {i: replace(known[i], id=first + k, center=at[i]) for k, i in enumerate(good)})
        if fault == "SRM":
            p = {(a, b): self.probability(relation, known[a], known[b], q.viewer) for a, b in q.pairs if a in good}
            return replace(q, relations={pair: 1 - x for pair, x in p.items()})
        if fault == "OPM-CONF":
            away = [i for i in known if i not in q.targets and i not in q.references]
            false = rng.permutation(away)[:3].tolist()
            low = {i: float(rng.uniform(0.05, 0.15)) for i in good}
            return replace(q, targets={**q.targets, **low, **dict.fromkeys(map(int, false), 0.97)})
        wrong = [pair for pair in q.pairs if pair[0] not in good]
        return replace(q, scores={wrong[int(rng.integers(len(wrong)))]: 2.0}) if wrong else None


CENTRES = CentreRule(Header(system="centre comparison", ranking="pair_scores"))


def ways(seeds: range, every: int, apart: int) -> dict[str, list[File]]:
    return {
        "some lines": [File(seed, every, random_fault(FAULTS, PLANTED_SHARE)) for seed in seeds],
        "all lines": [File(seed, every, random_fault(FAULTS, 1.0)) for seed in seeds],
        "all lines in one module": [
            File(seed, apart, random_fault((fault,), 1.0)) for seed in seeds for fault in FAULTS
        ],
    }


if __name__ == "__main__":
    main(Study(("centres",), lambda _: CENTRES, dict.fromkeys(FAULTS, ()), ways, seeds=2, every=10, apart=10))
