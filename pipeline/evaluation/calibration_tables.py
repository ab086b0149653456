"""What a score calibration changed: accuracy and scores before and after, and whether the figures are held out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.evaluation.grounding_tables import clusters_of, column
from pipeline.evaluation.records import DetectorScores, detector_scores, is_calibrated
from pipeline.labels.reading import Labels
from pipeline.labels.tables import read_table
from pipeline.metrics.calibration_metrics import ECE_BINS
from pipeline.metrics.counts import ratio
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, mean_estimate
from pipeline.metrics.significance import mcnemar
from pipeline.metrics.tables import Cell, Row, Table
from pipeline.proposals.score_calibration import ScoreCalibration

if TYPE_CHECKING:
    import pyarrow as pa

    from pipeline.answering.ask import AskConfig
    from pipeline.answering.opening import Pipeline

ACCURACIES = {
    "Acc@0.5 single truth": "correct", "strict set": "strict_correct", "set-valued": "set_correct",
    "reference": "reference_correct", "pair": "pair_correct",
}  # fmt: skip


def calibration_table(systems: Mapping[str, pa.Table], config: BootstrapConfig | None = None) -> Table | None:
    """Accuracy and detector scores by raw and by calibrated scores; None where no system's are calibrated.

    Differences are paired, with clustered intervals; McNemar's exact test is of the answers.
    """
    calibrated = {name: records for name, records in systems.items() if is_calibrated(records)}
    if not calibrated:
        return None
    rows: list[Row] = []
    for name, records in calibrated.items():
        prefix = f"{name}: " if len(systems) > 1 else ""
        rows += [Row(f"{prefix}{what}", cells) for what, cells in _accuracies(records, config)]
        rows += [Row(f"{prefix}{what}", cells) for what, cells in _score_figures(detector_scores(records), config)]
    return Table(
        "calibration",
        "Score calibration",
        ("raw scores", "calibrated", "difference", "only calibrated right", "only raw right", "McNemar p", "n"),
        tuple(rows),
        "Accuracies in percent of the expressions; Brier score and expected calibration error (15 bins), times 100, of "
        "all detections against an IoU of at least 0.5 with a labelled object of the class asked for. Difference: "
        "calibrated less raw, paired, with 95 % bootstrap intervals over scenes, or frames where there is one scene.",
    )


def _accuracies(records: pa.Table, config: BootstrapConfig | None) -> list[tuple[str, tuple[Cell, ...]]]:
    clusters, _ = clusters_of(records)
    found: list[tuple[str, tuple[Cell, ...]]] = []
    for title, name in ACCURACIES.items():
        raw, own = column(records, f"raw_{name}"), column(records, name)
        test = mcnemar(own > 0, raw > 0)
        estimates = (mean_estimate(values, clusters, config=config) for values in (raw, own))
        difference = mean_estimate(own, clusters, other=raw, config=config)
        found.append((title, (*estimates, difference, test.b, test.c, f"{test.p_value:.2g}", test.n)))
    return found


def _score_figures(scores: DetectorScores, config: BootstrapConfig | None) -> list[tuple[str, tuple[Cell, ...]]]:
    sides = (scores.raw, scores.calibrated)
    squared = [np.square(p - scores.hits) for p in sides]
    brier = [mean_estimate(s, scores.clusters, config=config) for s in squared]
    brier.append(mean_estimate(squared[1], scores.clusters, other=squared[0], config=config))
    ece = [ece_estimate(p, scores.hits, scores.clusters, config=config) for p in sides]
    ece.append(ece_estimate(sides[1], scores.hits, scores.clusters, other=sides[0], config=config))
    blank: tuple[Cell, ...] = (None, None, None, len(scores.hits))
    return [("Brier score of detections", (*brier, *blank)), ("ECE of detections", (*ece, *blank))]


def ece_estimate(
    p: np.ndarray,
    hits: np.ndarray,
    clusters: np.ndarray,
    *,
    other: np.ndarray | None = None,
    config: BootstrapConfig | None = None,
) -> Estimate:
    """Expected calibration error of (N,) probabilities; with `other` (N,), that of `p` less that of `other`."""
    second = None if other is None else _bin_gaps(other, hits)
    return bootstrap(_bin_gaps(p, hits), clusters, _ece, other=second, config=config)[0]


def _bin_gaps(p: np.ndarray, hits: np.ndarray) -> np.ndarray:
    """(N, B + 1): p - [hit] in the column of its bin, and a one to count by."""
    rows = np.zeros((len(p), ECE_BINS + 1))
    rows[np.arange(len(p)), np.minimum((p * ECE_BINS).astype(np.int64), ECE_BINS - 1)] = p - hits
    rows[:, -1] = 1.0
    return rows


def _ece(sums: np.ndarray) -> np.ndarray:
    return ratio(np.abs(sums[:, :-1]).sum(axis=1, keepdims=True), sums[:, -1:])


def calibration_warnings(source: Pipeline, labels: Labels, records: pa.Table) -> tuple[str, ...]:
    """Why the effect of the calibration in these records is not held out, or may not be; nothing where it is."""
    calibration = source.config.score_calibration
    if calibration is None or not is_calibrated(records):
        return ()
    rows = read_table(labels.root / "frames.parquet", "frames", ("frame", "scene", "rgb_hash")).to_pylist()
    evaluated = set(records.column("frame").to_pylist())
    frames = {row["frame"]: (row["scene"], row["rgb_hash"]) for row in rows if row["frame"] in evaluated}
    found = held_out_warning(calibration, frames, source.dataset.root.resolve().name)
    return () if found is None else (found,)


def recorded_config(config: AskConfig) -> dict[str, Any]:
    """The settings as a run's manifest has them: of a calibration how many frames it was fitted on, not which."""
    found = asdict(config)
    if found["score_calibration"] is not None:
        found["score_calibration"]["frames"] = len(found["score_calibration"]["frames"])
    return found


def held_out_warning(
    calibration: ScoreCalibration, frames: Mapping[str, tuple[str, str | None]], dataset: str
) -> str | None:
    """Why the figures of a calibration are not held out; None where they are.

    Parameters
    ----------
    calibration : ScoreCalibration
    frames : mapping of str to (scene, picture's hash or None)
        Those that were evaluated, by id.
    dataset : str
        Its folder's name.
    """
    if not calibration.frames:
        return "the score calibration does not say which frames it was fitted on: its effect may not be held out"
    fitted = {f.rgb_hash for f in calibration.frames}
    same = sum(rgb_hash in fitted for _, rgb_hash in frames.values())
    if same:
        return (
            f"the score calibration was fitted on {same} of the {len(frames)} frames that are evaluated: its effect is "
            "not held out; fit it on others (calibrate --frames FROM:TO)"
        )
    if calibration.dataset == dataset:
        shared = {f.scene for f in calibration.frames} & {scene for scene, _ in frames.values()}
        if shared:
            return (
                f"the score calibration was fitted on other frames of {len(shared)} of the scenes that are evaluated: "
                "the same objects were seen"
            )
    return None
