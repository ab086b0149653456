"""Counts over all frames of a dataset: what can be used, what is annotated, and what is missing."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

from pipeline.datasets.survey import FrameReport

LITTLE_DEPTH = 0.1
"""Share of the pixels with depth below which a frame counts as having little."""


class SurveyCounts:
    """Counts that grow with each frame; memory grows with the number of classes alone."""

    def __init__(self) -> None:
        self._frames = self._usable = self._objects = self._annotated = 0
        self._missing: Counter[str] = Counter()
        self._classes: Counter[str] = Counter()
        self._sizes: Counter[str] = Counter()
        self._ups: Counter[str] = Counter()
        self._problems: Counter[str] = Counter()
        self._notes: tuple[str, ...] = ()
        self._depth = 0.0

    def add(self, report: FrameReport) -> None:
        """Count one frame."""
        self._frames += 1
        self._notes = report.dataset_notes
        if not report.ok:
            self._problems[_reason(report)] += 1
            return
        self._usable += 1
        self._objects += report.annotations
        self._annotated += report.annotations > 0
        self._classes.update(report.labels)
        self._sizes[f"{report.width}x{report.height}"] += 1
        self._ups[report.up_source or "unknown"] += 1
        self._depth += report.depth_valid
        self._missing["with_little_depth"] += report.depth_valid < LITTLE_DEPTH
        self._missing["without_pose"] += not report.has_pose
        self._missing["without_objects"] += not report.annotations
        self._missing["with_notes"] += bool(report.notes)

    def watch(self, reports: Iterable[FrameReport]) -> Iterator[FrameReport]:
        """Pass frames on, and count them."""
        for report in reports:
            self.add(report)
            yield report

    def record(self) -> dict[str, Any]:
        """The counts so far; see `summarise`."""
        missing = ("with_little_depth", "without_pose", "without_objects", "with_notes")
        return {
            "frames": self._frames,
            "frames_usable": self._usable,
            "frames_broken": self._frames - self._usable,
            "notes": list(self._notes),
            "problems": _sorted(self._problems),
            **{f"frames_{name}": self._missing[name] for name in missing},
            "sizes": _sorted(self._sizes),
            "up_source": _sorted(self._ups),
            "depth_valid": round(self._depth / self._usable, 6) if self._usable else None,
            "objects": self._objects,
            "objects_per_frame": round(self._objects / self._usable, 6) if self._usable else None,
            "classes": _sorted(self._classes),
        }


def summarise(reports: Iterable[FrameReport]) -> dict[str, Any]:
    """Counts over the frames of a survey.

    Returns
    -------
    dict
        JSON-able: frames, frames_usable, frames_broken, notes (what no file states,
        see `capabilities.dataset_notes`), problems ({reason: frames}); of the usable
        frames frames_with_little_depth (less than a tenth of the pixels), frames_without_pose, frames_without_objects,
        frames_with_notes, sizes ({"WxH": frames}), up_source ({source: frames}),
        depth_valid (mean share of the pixels, 0..1, or None), objects,
        objects_per_frame (mean or None), and classes ({name: objects}). What is
        counted by name runs from the most frequent on.
    """
    counts = SurveyCounts()
    for report in reports:
        counts.add(report)
    return counts.record()


def _sorted(counter: Counter[str]) -> dict[str, int]:
    return dict(sorted(counter.items(), key=lambda item: (-item[1], item[0])))


def _reason(report: FrameReport) -> str:
    """A problem without what is only of this frame: its name, what was got, and the file."""
    text = (report.problem or "unknown").split("; ")[0].split(" [")[0].split(" (")[0]
    return re.sub(rf"(?<!\w){re.escape(report.id)}(?!\w)", "…", text).removeprefix("frame …: ")
