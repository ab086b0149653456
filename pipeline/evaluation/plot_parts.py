"""What the still and the moving plots of a diagnosis share: colours, bars and shares."""

from __future__ import annotations

import numpy as np

from pipeline.evaluation.confusion import Confusion
from pipeline.evaluation.summary import RunSummary
from pipeline.metrics.intervals import Estimate

VERDICT_COLORS = {
    "CORRECT": "#009988", "PARSE": "#aa3377", "LABEL": "#b4bdca", "OPM-TARGET": "#cc3311", "OPM-REF": "#ee7733",
    "LIFT": "#0077bb", "SRM": "#33bbee", "OPM-CONF": "#ddaa33", "PRM": "#ee3377", "COMPOUND": "#46536a",
}  # fmt: skip
LOSS_COLORS = {
    "accuracy": VERDICT_COLORS["CORRECT"], "PARSE": VERDICT_COLORS["PARSE"], "RECALL": VERDICT_COLORS["OPM-TARGET"],
    "LIFT": VERDICT_COLORS["LIFT"], "SRM": VERDICT_COLORS["SRM"], "CONF": VERDICT_COLORS["OPM-CONF"],
    "residual": VERDICT_COLORS["COMPOUND"],
}  # fmt: skip
ADDS_UP = (
    "Full bars add up from the accuracy to 100: what the gold parse gains (PARSE), the Shapley value of each oracle, "
    "its fair share over all orders of replacing, and the residual. Hollow bars are one oracle alone: they do not add "
    "up, and one below 0 says that the module made up for an error of another."
)


def waterfall(summary: RunSummary) -> list[tuple[str, float, Estimate]]:
    """(name, where its bar begins, estimate) of what adds up to one."""
    found, at = [], 0.0
    for name, estimate in summary.loss.items():
        found.append((name, at, estimate))
        at += estimate.value
    return found


def interval(e: Estimate) -> tuple[float, float]:
    """How far an interval reaches below and above its value, in points; 0 without one."""
    if not (np.isfinite(e.low) and np.isfinite(e.high)):
        return 0.0, 0.0
    return max(0.0, 100 * (e.value - e.low)), max(0.0, 100 * (e.high - e.value))


def shares_of_rows(found: Confusion) -> np.ndarray:
    """(R, C) counts as shares of their row; 0 in an empty row."""
    total = found.counts.sum(axis=1, keepdims=True)
    return np.divide(found.counts, total, out=np.zeros(found.counts.shape), where=total > 0)
