"""The hypothesis under which the depth of posed views lands best on each other, and which others do as well."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.datasets.doctor.hypotheses import Hypothesis, by_block, families, score, surely_positive
from pipeline.geometry.landing import Views

COARSE, MIDDLE, FINE = 0.08, 0.03, 0.012
"""Relative depth at which a point counts half: while looking around, while refining, and when deciding."""
SCALES = tuple(float(s) for s in np.geomspace(1 / 32, 32, 27))
FOCALS = (0.4, 0.5, 0.63, 0.8, 1.25, 1.6, 2.0, 2.5)
MOST_PAIRS = 24
LEAST_OVERLAP = 0.15
LEAST_PAIRS = 2
LEAST_SCORE = 0.22
"""Below this, measured at `FINE`, nothing explains the views."""
REFINED = 4


@dataclass(frozen=True)
class Range:
    """What a number of the best hypothesis may be.

    Attributes
    ----------
    value : float
    low, high : float
        Between these the views land as well; 0 or infinity where nothing tells.
    """

    value: float
    low: float
    high: float

    def holds(self, other: float) -> bool:
        return self.low <= other <= self.high

    @property
    def sharp(self) -> float:
        """How far it may be off, as a share."""
        return max(self.high / self.value, self.value / max(self.low, 1e-9)) - 1


class Search:
    """Posed views of one size, and what explains them.

    Parameters
    ----------
    coarse, fine : Views
        The same views with few and with many points.
    """

    def __init__(self, coarse: Views, fine: Views) -> None:
        self.coarse, self._fine = coarse, fine
        self._landings: dict[tuple[Hypothesis, float], np.ndarray] = {}
        self._scores: dict[tuple[Hypothesis, float], float] = {}
        self._refined: dict[tuple[Hypothesis, tuple[str, ...]], Hypothesis] = {}

    @cached_property
    def looked_around(self) -> tuple[Hypothesis, ...]:
        """The best of each family, the best first."""
        found: dict[tuple[str, str], tuple[float, Hypothesis]] = {}
        for start in families():
            tried = [replace(start, scale=s) for s in SCALES]
            if start == Hypothesis():
                tried += [replace(h, focal=f) for h in tried for f in FOCALS]
            found[start.family] = max(
                ((score(h.landing(self.coarse, COARSE)), h) for h in tried), key=lambda scored: scored[0]
            )
        ranked = sorted(found.values(), key=lambda scored: -scored[0])
        return tuple(h for _, h in ranked)

    @cached_property
    def fine(self) -> Views:
        """Pairs that overlap under any of the best explanations, those that overlap most first."""
        best = np.zeros(len(self._fine.pairs))
        for hypothesis in (*self.looked_around[:2], Hypothesis()):
            landing = hypothesis.landing(self.coarse, COARSE)
            share = landing.landed.sum(axis=1) / np.maximum(landing.lifted.sum(axis=1), 1)
            best = np.maximum(best, share)
        order = np.argsort(-best, kind="stable")[:MOST_PAIRS]
        return self._fine.of_pairs(self._fine.pairs[np.sort(order[best[order] > LEAST_OVERLAP * 0.5])])

    @cached_property
    def best(self) -> Hypothesis:
        """The best of all, the simplest of those that are as good."""
        starts = [*self.looked_around[:REFINED], replace(Hypothesis(), scale=self.looked_around[0].scale)]
        refined = [self.refined(h) for h in starts]
        best = max(refined, key=self.at)
        for simpler in self._simpler(best, refined):
            if not self.beats(best, simpler):
                return simpler
        return best

    def _simpler(self, best: Hypothesis, others: Sequence[Hypothesis]) -> list[Hypothesis]:
        """What says less, the least first."""
        plain = Hypothesis()
        told = replace(best, center=plain.center, poses=plain.poses)
        tried = [
            plain,
            *(self.refined(replace(plain, **{name: getattr(best, name)}), (name,)) for name in ("scale", "focal")),
            replace(plain, center=best.center),
            replace(plain, poses=best.poses),
            told,
            replace(best, scale=1.0),
            replace(best, focal=1.0),
            *others,
        ]
        return sorted(tried, key=deviations)

    def refined(self, start: Hypothesis, names: tuple[str, ...] = ("scale", "focal")) -> Hypothesis:
        """The nearest best of its family, changing the numbers of these names alone."""
        if (start, names) not in self._refined:
            self._refined[start, names] = self._climbed(start, names)
        return self._refined[start, names]

    def _climbed(self, start: Hypothesis, names: tuple[str, ...]) -> Hypothesis:
        best = start
        for tolerance, steps in ((MIDDLE, (0.2, 0.1, 0.05)), (FINE, (0.04, 0.02, 0.01, 0.005))):
            value = self.at(best, tolerance)
            for step in steps:
                for _ in range(6):
                    near = [
                        replace(best, **{name: getattr(best, name) * (1 + step) ** way})
                        for name in names
                        for way in (-1, 1)
                    ]
                    found, hypothesis = max(((self.at(h, tolerance), h) for h in near), key=lambda one: one[0])
                    if found <= value:
                        break
                    value, best = found, hypothesis
        return best

    def at(self, hypothesis: Hypothesis, tolerance: float = FINE) -> float:
        """Its score, by default when deciding."""
        self._of_blocks(hypothesis, tolerance)
        return self._scores[hypothesis, tolerance]

    def beats(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether the first is surely better than the other, block by block."""
        return surely_positive(self._of_blocks(one) - self._of_blocks(other))

    def _of_blocks(self, hypothesis: Hypothesis, tolerance: float = FINE) -> np.ndarray:
        key = hypothesis, tolerance
        if key not in self._landings:
            landing = hypothesis.landing(self.fine, tolerance, colour=tolerance == FINE)
            self._landings[key], self._scores[key] = by_block(landing), score(landing)
        return self._landings[key]

    def range_of(self, name: str, other: str) -> Range:
        """How far a number of the best hypothesis can be told, while another one gives way."""
        value = getattr(self.best, name)
        ends = []
        for way in (-1, 1):
            end = 0.0 if way < 0 else float("inf")
            for share in (0.03, 0.06, 0.1, 0.16, 0.25, 0.4, 0.6, 1.0):
                moved = self.refined(replace(self.best, **{name: value * (1 + share) ** way}), (other,))
                if self.beats(self.best, moved):
                    end = getattr(moved, name)
                    break
            ends.append(end)
        return Range(value, ends[0], ends[1])

    def rivals(self, differs: Callable[[Hypothesis], bool]) -> tuple[Hypothesis, ...]:
        """Those of other families that the best does not surely beat."""
        others = [self.refined(h) for h in self.looked_around if differs(h)]
        return tuple(h for h in others if not self.beats(self.best, h))


def deviations(hypothesis: Hypothesis) -> float:
    """How much it claims to be wrong: the number of things, and then by how much."""
    numbers = [abs(np.log(hypothesis.scale)), abs(np.log(hypothesis.focal))]
    plain = Hypothesis()
    words = [hypothesis.center != plain.center, hypothesis.poses != plain.poses]
    return sum(n > 1e-9 for n in numbers) + sum(words) + min(sum(numbers), 9.0) / 10
