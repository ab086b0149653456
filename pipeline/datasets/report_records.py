"""JSON records of frame reports, with stable keys."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.datasets.frame_reports import FrameReport
from pipeline.datasets.odd_frames import OddFrame


def frame_record(report: FrameReport, odd: OddFrame | None = None) -> dict[str, Any]:
    """Record of `frames --json`; "moves" only where the dataset has moves. "dataset_notes" are equal in all.

    With `odd` also "oddness", from 1 on odd, null where nothing was compared, and "odd", the reasons in words.
    """
    oddness = None if odd is None or odd.oddness is None else round(odd.oddness, 4)
    return {
        "index": report.index,
        "frame": report.id,
        "ok": report.ok,
        "problem": report.problem,
        "width": report.width,
        "height": report.height,
        "decoded": report.decoded,
        "annotations": report.annotations if report.decoded else None,
        "labels": list(report.labels),
        "depth_valid": report.depth_valid if report.decoded else None,
        "median_depth": report.median_depth,
        "has_pose": report.has_pose,
        "up_source": report.up_source,
        "up": None if report.up is None else np.round(report.up, 6).tolist(),
        "notes": list(report.notes),
        "dataset_notes": list(report.dataset_notes),
        **({} if odd is None else {"oddness": oddness, "odd": list(odd.reasons)}),
        **({} if report.moves is None else {"moves": dict(report.moves)}),
    }
