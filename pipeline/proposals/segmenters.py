"""Segmenters by name. Others add theirs through the entry point group `spatialviz.segmenters`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import InputError
from pipeline.naming import Synonyms
from pipeline.plugins import load_plugins
from pipeline.proposals.depth_segmenter import DepthSegmenter
from pipeline.proposals.detector_masks import DetectorSegmenter
from pipeline.proposals.segmenter import Segmenter


@dataclass(frozen=True)
class SegmenterRequest:
    """What a segmenter may be made from.

    Attributes
    ----------
    model : Path or None
        Model file, or recording.
    synonyms : Synonyms or None
    """

    model: Path | None
    synonyms: Synonyms | None


def _depth(request: SegmenterRequest) -> Segmenter:
    if request.model is not None:
        raise InputError("--segmenter depth takes no model", path=request.model)
    return DepthSegmenter()


def _recorded(request: SegmenterRequest) -> Segmenter:
    from pipeline.proposals.recorded_masks import open_recorded_masks

    path = _needed(request, "recorded", "a COCO file, a recording of detections, or a folder of PNG masks")
    return open_recorded_masks(path, request.synonyms)


def _yolo_seg(request: SegmenterRequest) -> Segmenter:
    from pipeline.proposals.cache import CachedDetector
    from pipeline.proposals.yolo_seg import YoloSegDetector

    path = _needed(request, "yolo-seg", "an ONNX file")
    return DetectorSegmenter(CachedDetector(YoloSegDetector(path, synonyms=request.synonyms)), request.synonyms)


def _needed(request: SegmenterRequest, name: str, what: str) -> Path:
    if request.model is None:
        raise InputError(f"--segmenter {name} needs --segmenter-model", expected=what)
    return request.model


SEGMENTERS: dict[str, Callable[[SegmenterRequest], Segmenter]] = {
    "depth": _depth,
    "recorded": _recorded,
    "yolo-seg": _yolo_seg,
}

ENTRY_POINT_GROUP = "spatialviz.segmenters"
"""Entry points of this group name a function of a SegmenterRequest, and so add a segmenter."""


def make_segmenter(name: str, *, model: Path | None = None, synonyms: Synonyms | None = None) -> Segmenter:
    """The segmenter of that name.

    Raises
    ------
    InputError
        For an unknown name, a missing model, or a model of another contract.
    """
    known = SEGMENTERS
    if name not in known:
        known = {**dict(load_plugins(ENTRY_POINT_GROUP, "segmenter", Callable)), **known}
    if name not in known:
        raise InputError(f"there is no segmenter {name!r}", expected=" or ".join(known))
    return known[name](SegmenterRequest(model, synonyms))
