"""What two detectors agree on, as JSON."""

from __future__ import annotations

from typing import Any

from pipeline.answering.agreement.agreement import FrameAgreement
from pipeline.answering.agreement.agreement_figures import figures
from pipeline.language.naming import Synonyms


def agreement_record(frame_id: str, found: FrameAgreement, synonyms: Synonyms | None = None) -> dict[str, Any]:
    """One frame: the figures, and every detection by its place in its detector's list."""
    sums = figures([found], synonyms).record()
    del sums["frames"], sums["classes"]

    def one(label: str, score: Any, nearest: Any = None) -> dict[str, Any]:
        found = {} if nearest is None else {"nearest_iou": round(float(nearest), 6)}
        return {"label": label, "score": round(float(score), 6), **found}

    pairs = [
        {
            "a": {"index": int(i), **one(found.labels_a[i], found.scores_a[i])},
            "b": {"index": int(j), **one(found.labels_b[j], found.scores_b[j])},
            "iou": round(float(iou), 6),
            "same_name": bool(same),
        }
        for (i, j), iou, same in zip(found.pairs, found.iou, found.same, strict=True)
    ]
    return {
        "frame": frame_id,
        **sums,
        "pairs": pairs,
        "alone_a": [
            {"index": int(i), **one(found.labels_a[i], found.scores_a[i], found.nearest_a[i])} for i in found.only_a
        ],
        "alone_b": [
            {"index": int(j), **one(found.labels_b[j], found.scores_b[j], found.nearest_b[j])} for j in found.only_b
        ],
    }
