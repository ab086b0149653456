"""Planted label errors in rendered rooms: how many the top of the ranking holds, and what mending them is worth.

Confident learning stands alone here: no linter, no rule, no margins, and no
label is compared with its mirror image (see `out_of_fold`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from pipeline.corrections.review.doubts import (
    DoubtConfig,
    Doubts,
    doubt_labels,
    network_probabilities,
    stacked,
    unstacked,
)
from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.intervals import f1_of
from pipeline.metrics.relation_metrics import cell_outcomes
from pipeline.metrics.splits import FrameKey
from pipeline.relations.relations import U
from pipeline.system.errors import require
from pipeline.system.worker_pool import one_thread
from pipeline.training.label_data import LabelData, LabelledFrame, pair_set
from pipeline.training.train import TrainConfig, require_training, train_pairs
from pipeline.training.training_data import FIRST_ROOM, ROOMS_A_SEED, FrameSamples, make_samples

FIRST_BENCH_ROOM = FIRST_ROOM + 400_000
"""Far from the rooms of `train rooms` and `bench srm`."""
TEST_SHARE = 1 / 3
CAVEAT = (
    "the rule makes the labels that networks learn and the ones that F1 is measured by: F1 says how well they imitate "
    "the rule; errors are planted at random, where a labeller's own ones lie together"
)


@dataclass(frozen=True)
class ReviewBenchConfig:
    """What is planted, and how it is looked for.

    Attributes
    ----------
    rooms, views, width, height : int
        One room in three only measures.
    share : float
        Of the cells that are T or F, turned into the opposite.
    top : float
        Share of the cells that is looked at first.
    again : float
        Share that is looked at after those are mended and the queue is made again.
    labels : str
        "exact": by the rule on whole objects; "seen": on what is seen of them, as auto-labels are.
    networks : int
        Trained on each set of labels; their F1 is averaged.
    seeds : int
        Repetitions with other planted errors and other networks, in the same rooms.
    seed : int
    doubts : DoubtConfig
        Its seed is that of each repetition.
    train : TrainConfig
        Of the networks whose F1 is measured.
    """

    rooms: int = 90
    views: int = 2
    width: int = 480
    height: int = 360
    share: float = 0.1
    top: float = 0.1
    again: float = 0.01
    labels: Literal["exact", "seen"] = "seen"
    networks: int = 2
    seeds: int = 3
    seed: int = 0
    doubts: DoubtConfig = field(default_factory=DoubtConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def check(self) -> None:
        """Raise InputError where the numbers make no sense."""
        self.doubts.check()
        self.train.check()
        require(
            self.rooms >= 6 and min(self.views, self.networks, self.seeds) >= 1 and min(self.width, self.height) >= 16,
            "review is measured in 6 rooms, a view, a network, a seed, sides of 16 pixels",
            got=self,
        )
        require(
            0 < self.share < 1 and 0 < self.top < 1 and 0 <= self.again < 1 - self.top,
            "shares must lie between 0 and 1",
            got=f"{self.share}, {self.top}, {self.again}",
        )


@dataclass(frozen=True)
class Recovery:
    """What a review of planted errors found, and what it was worth.

    Attributes
    ----------
    cells, planted : int
        Cells that are T or F, and those of them that were turned.
    found, found_again : float
        Share of the planted ones within the first `top`, and with `again` of the queue that was made anew.
    estimated : float
        How many labels confident learning takes to be wrong, before anything is mended.
    f1 : dict of str to float
        Micro-F1 in other rooms, on true labels, of networks trained on true labels ("clean"), with the errors
        ("planted"), with those mended that `found` ("mended") and `found_again` ("again").
    seconds : float
        Of the first ranking.
    """

    cells: int
    planted: int
    found: float
    found_again: float
    estimated: float
    f1: dict[str, float]
    seconds: float

    def recovered(self, stage: str) -> float:
        """Share of the lost F1 that is back at "mended" or "again"; NaN where none was lost."""
        lost = self.f1["clean"] - self.f1["planted"]
        return (self.f1[stage] - self.f1["planted"]) / lost if lost > 0 else float("nan")

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            **vars(self),
            "recovered": {s: x if np.isfinite(x := self.recovered(s)) else None for s in ("mended", "again")},
        }


def bench_review(
    config: ReviewBenchConfig | None = None,
    *,
    workers: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:
    """Render rooms, plant errors, rank, mend what a reviewer of the top would see, and train again.

    Parameters
    ----------
    config : ReviewBenchConfig, optional
    workers : int
        Processes that render. The figures do not depend on it.
    progress : callable, optional
        Called with (what is done, how much of it, of how much).

    Returns
    -------
    dict
        `caveat`: what the figures cannot show; `runs` (one `Recovery.record()` a seed), and `mean` over them: found,
        found_again, recovered, recovered_again; `recovered_interval` and `recovered_again_interval` hold the mean of
        the seeds' own shares at 95 %, by Student's t: over planted errors and networks, not over rooms. None where
        there are fewer than two seeds.

    Raises
    ------
    InputError
        A number makes no sense.
    MissingExtra
        torch or embreex is not installed.
    """
    config = config or ReviewBenchConfig()
    config.check()
    require_training()
    tell = progress or (lambda what, done, of: None)
    truth, test = review_rooms(config, workers=workers, progress=lambda done: tell("rooms", done, config.rooms))
    runs = []
    for k in range(config.seeds):
        runs.append(measure_recovery(truth, test, config, config.seed + k))
        tell("seeds", k + 1, config.seeds)
    lost = sum(run.f1["clean"] - run.f1["planted"] for run in runs)
    back = {s: sum(run.f1[s] - run.f1["planted"] for run in runs) for s in ("mended", "again")}
    mean = {
        "found": float(np.mean([run.found for run in runs])),
        "found_again": float(np.mean([run.found_again for run in runs])),
        # Of all seeds together: the mean of ratios of small differences would be noise.
        "recovered": back["mended"] / lost if lost > 0 else None,
        "recovered_again": back["again"] / lost if lost > 0 else None,
        "recovered_interval": _interval([run.recovered("mended") for run in runs]),
        "recovered_again_interval": _interval([run.recovered("again") for run in runs]),
    }
    return {
        "labels": config.labels,
        "caveat": CAVEAT,
        "rooms": config.rooms,
        "share": config.share,
        "top": config.top,
        "passes": config.doubts.passes,
        "again": config.again,
        "pairs": sum(len(f.rows) * (len(f.rows) - 1) for f in truth.frames),
        "mean": mean,
        "runs": [run.record() for run in runs],
    }


def _interval(values: Sequence[float]) -> list[float] | None:
    """The mean's 95 % interval by Student's t; None where a value is missing, or there are fewer than two."""
    if len(values) < 2 or not np.isfinite(values).all():
        return None
    from scipy.stats import t

    half = float(t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / len(values) ** 0.5)
    return [float(np.mean(values)) - half, float(np.mean(values)) + half]


def review_rooms(
    config: ReviewBenchConfig, *, workers: int = 1, progress: Callable[[int], None] | None = None
) -> tuple[LabelData, LabelData]:
    """True labels of the rooms that are reviewed, and of those that measure."""
    first = config.seed * ROOMS_A_SEED + FIRST_BENCH_ROOM
    samples = make_samples(
        range(first, first + config.rooms),
        views=config.views,
        width=config.width,
        height=config.height,
        workers=workers,
        progress=progress,
    )
    cut = first + config.rooms - max(1, round(config.rooms * TEST_SHARE))
    train, test = (
        data_of_samples(part, config.labels == "exact")
        for part in ([s for s in samples if s.room < cut], [s for s in samples if s.room >= cut])
    )
    return train, test


@one_thread()
def measure_recovery(truth: LabelData, test: LabelData, config: ReviewBenchConfig, seed: int) -> Recovery:
    """Plant errors by this seed, review, and measure.

    Parameters
    ----------
    truth, test : LabelData
        True labels to review, and of other rooms.
    config : ReviewBenchConfig
    seed : int
        Of the errors and of all networks.
    """
    planted = plant_flips(truth, config.share, seed)
    right = stacked([f.states for f in truth.frames])
    train = replace(config.train, seed=seed)
    doubts = replace(config.doubts, train=replace(config.doubts.train, seed=seed))
    start = time.perf_counter()
    first = doubt_labels(planted.data, doubts)
    seconds = time.perf_counter() - start
    looked = _looked_at(first, np.zeros(right.shape, np.bool_), config.top)
    mended = _mended(planted, looked)
    measured, found = {"clean": truth, "planted": planted.data, "mended": mended}, looked
    if config.again:
        trusted = unstacked(looked, [len(f.rows) for f in truth.frames])
        found = looked | _looked_at(doubt_labels(mended, doubts, trusted=trusted), looked, config.again)
        measured["again"] = _mended(planted, found)
    f1 = {name: _mean_f1(data, test, train, config.networks) for name, data in measured.items()}
    f1.setdefault("again", f1["mended"])
    count = int(planted.flipped.sum())
    return Recovery(
        int((right != U).sum()),
        count,
        float((planted.flipped & looked).sum() / count),
        float((planted.flipped & found).sum() / count),
        sum(n.wrong for n in first.noise.values()),
        f1,
        seconds,
    )


def _looked_at(doubts: Doubts, seen: np.ndarray, share: float) -> np.ndarray:
    """(P, R) bool: the cells most probably wrong that were not seen before, so many of all that are T or F."""
    wrong = stacked(doubts.wrong)
    known = np.isfinite(wrong)
    order = np.argsort(np.where(known & ~seen, -wrong, 1.0).ravel(), kind="stable")
    found = np.zeros(wrong.shape, np.bool_)
    found.ravel()[order[: round(share * known.sum())]] = True
    return found & known & ~seen


def _mended(planted: Planted, looked: np.ndarray) -> LabelData:
    """What a reviewer who is right leaves of the labels: those looked at are true."""
    right, given = (stacked([f.states for f in data.frames]) for data in (planted.truth, planted.data))
    return with_labels(planted.data, np.where(looked, right, given))


def _mean_f1(data: LabelData, test: LabelData, train: TrainConfig, networks: int) -> float:
    """Micro-F1 at 0.5 on other rooms, the mean of several networks."""
    pairs = pair_set(data.frames, data.features, train.output)
    truth = stacked([f.states for f in test.frames])
    found = []
    for k in range(networks):
        model = train_pairs(pairs, replace(train, seed=train.seed + 1000 * k))
        p = stacked([network_probabilities(model, f.rows) for f in test.frames])
        cells = cell_outcomes(p, truth)
        found.append(float(f1_of(cells.tp.sum(), cells.fp.sum(), cells.fn.sum())))
    return float(np.mean(found))


@dataclass(frozen=True, eq=False)
class Planted:
    """Labels with errors.

    Attributes
    ----------
    data : LabelData
        With the errors.
    truth : LabelData
        Without.
    flipped : (P, R) bool
        Which cells were turned from T to F or back, in the order of `stacked`.
    """

    data: LabelData
    truth: LabelData
    flipped: np.ndarray


def plant_flips(truth: LabelData, share: float, seed: int = 0) -> Planted:
    """Turn a share of all cells that are T or F into the opposite, each for itself and not with its mirror image.

    Raises
    ------
    InputError
        The share is not between 0 and 1.
    """
    require(0 < share < 1, "the share of planted errors must lie between 0 and 1", got=share)
    states = stacked([f.states for f in truth.frames])
    known = np.flatnonzero(states.ravel() != U)
    chosen = np.random.default_rng([seed, 41]).choice(known, round(share * len(known)), replace=False)
    flipped = np.zeros(states.shape, np.bool_)
    flipped.ravel()[chosen] = True
    return Planted(with_labels(truth, np.where(flipped, -states, states)), truth, flipped)


def with_labels(data: LabelData, states: np.ndarray) -> LabelData:
    """The data with other states ((P, R) int8, in the order of `stacked`)."""
    matrices = unstacked(states.astype(np.int8), [len(f.rows) for f in data.frames])
    return replace(data, frames=tuple(replace(f, states=s) for f, s in zip(data.frames, matrices, strict=True)))


def data_of_samples(samples: Sequence[FrameSamples], exact: bool, features: str = "rel14") -> LabelData:
    """Rendered views as labels: scenes are rooms, states by exact or by seen extents (see `FrameSamples`)."""
    frames = []
    for index, view in enumerate(samples):
        count = len(view.seen_lo)
        if count < 2:
            continue
        states = (view.truth if exact else view.rule).copy()
        states[np.eye(count, dtype=np.bool_)] = U
        key = FrameKey(f"{view.room}/{index}", str(view.room), index)
        frames.append(LabelledFrame(key, view.rows[features], np.zeros(count, np.int32), states, np.arange(count)))
    require(frames, "these views show no two objects", got=f"{len(samples)} views")
    return LabelData(features, DIRECTIONAL, tuple(frames), ("",))


if __name__ == "__main__":
    # cd tests && python -m benchmarks.planted_labels
    import json

    print(json.dumps(bench_review(ReviewBenchConfig(), workers=2), indent=2))
