"""Thumbnails of a run's answers, with boxes, made once for all clients, and their addresses."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from pipeline.evaluation.run_figures import Drawn, RunFigures
from pipeline.geometry.palette import ON_DARK, RGB
from pipeline.system.errors import InputError
from spatialviz.app.frames import IMAGES, jpeg_url
from spatialviz.report.picture import Outline, Stroke, answer_crop

STROKES: dict[Drawn, tuple[RGB, Stroke]] = {
    "answered target": (ON_DARK["target"], "thick"),
    "wrong target": ((236, 72, 78), "thick"),
    "answered reference": (ON_DARK["reference"], "thin"),
    "labelled": (ON_DARK["truth"], "dashed"),
    "second run": (ON_DARK["edited"], "dashed"),
}
"""Line of each box, as in the legend."""
PICTURES = 3000
"""Size of the address cache."""


class RunPictures:
    """Thumbnails of a run."""

    def __init__(self, figures: RunFigures) -> None:
        self._figures = figures
        self._kept: dict[int, str] = {}

    def url(self, number: int, row: Mapping[str, Any], make: bool = False) -> str:
        """Address of a row's picture; "" if not made yet, without `make`, or for a broken frame."""
        kept = self._kept.get(number)
        if kept is not None and (not kept or IMAGES.get(kept.rpartition("/")[2]) is not None):
            return kept
        if not make:
            return ""
        self._kept[number] = found = self._made(number, row)
        while len(self._kept) > PICTURES:
            del self._kept[next(iter(self._kept))]
        return found

    def _made(self, number: int, row: Mapping[str, Any]) -> str:
        outlines = [Outline(box, *STROKES[what]) for what, box in self._figures.boxes(number, row)]
        try:
            return jpeg_url(answer_crop(self._figures.colors(row["frame"]), outlines), 80)
        except InputError:
            return ""


@lru_cache(maxsize=8)
def pictures_of(figures: RunFigures) -> RunPictures:
    """Pictures of a run, shared by all clients."""
    return RunPictures(figures)
