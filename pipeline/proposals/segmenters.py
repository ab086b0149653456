"""Segmenters by name. Others add theirs through the entry point group `spatialviz.segmenters`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.language.naming import Synonyms
from pipeline.proposals.depth_segmenter import DepthSegmenter
from pipeline.proposals.detector_masks import DetectorSegmenter
from pipeline.proposals.segmenter import Segmenter
from pipeline.system.errors import InputError
from pipeline.system.model_files import resolve_model
from pipeline.system.plugins import load_plugins

if TYPE_CHECKING:
    from pipeline.proposals.prompted import PromptModel


@dataclass(frozen=True)
class SegmenterRequest:
    """What a segmenter may be made from.

    Attributes
    ----------
    model : Path or None
        Model file, or recording; the first of several.
    synonyms : Synonyms or None
    models : tuple of Path
        All that was given.
    """

    model: Path | None
    synonyms: Synonyms | None
    models: tuple[Path, ...] = ()


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

    path = resolve_model(_needed(request, "yolo-seg", "an ONNX file, or its id on the model hub"))
    return DetectorSegmenter(CachedDetector(YoloSegDetector(path, synonyms=request.synonyms)), request.synonyms)


def _sam(request: SegmenterRequest) -> Segmenter:
    from pipeline.proposals.sam import SamModel

    return _prompted(SamModel(_networks(request)))


def _sam2(request: SegmenterRequest) -> Segmenter:
    from pipeline.proposals.sam2 import Sam2Model

    return _prompted(Sam2Model(_networks(request)))


def _efficientsam(request: SegmenterRequest) -> Segmenter:
    from pipeline.proposals.efficientsam import EfficientSamModel

    return _prompted(EfficientSamModel(_networks(request)))


def _networks(request: SegmenterRequest) -> tuple[Path, ...]:
    """The files, fetched where they are named by their ids on the model hub."""
    return tuple(resolve_model(path) for path in request.models)


def _prompted(model: PromptModel) -> Segmenter:
    from pipeline.proposals.mask_cache import CachedSegmenter
    from pipeline.proposals.prompted import PromptedSegmenter

    return CachedSegmenter(PromptedSegmenter(model))


def _needed(request: SegmenterRequest, name: str, what: str) -> Path:
    if request.model is None:
        raise InputError(f"--segmenter {name} needs --segmenter-model", expected=what)
    return request.model


SEGMENTERS: dict[str, Callable[[SegmenterRequest], Segmenter]] = {
    "depth": _depth,
    "recorded": _recorded,
    "yolo-seg": _yolo_seg,
    "sam": _sam,
    "sam2": _sam2,
    "efficientsam": _efficientsam,
}
TWO_FILES = ("sam", "sam2", "efficientsam")
"""Those that are made of an encoder and a decoder."""

SegmenterFiles = Path | tuple[Path, ...] | None
"""What a segmenter is made from: a file, or an encoder and a decoder."""

ENTRY_POINT_GROUP = "spatialviz.segmenters"
"""Entry points of this group name a function of a SegmenterRequest, and so add a segmenter."""


def segmenter_files(given: SegmenterFiles | str | Sequence[str]) -> tuple[Path, ...]:
    """The files in their order; words, as plans and manifests hold them, will do."""
    if given is None:
        return ()
    return (Path(given),) if isinstance(given, str | Path) else tuple(Path(part) for part in given)


def make_segmenter(name: str, *, model: SegmenterFiles = None, synonyms: Synonyms | None = None) -> Segmenter:
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
    files = segmenter_files(model)
    if len(files) > 1 and name in SEGMENTERS and name not in TWO_FILES:
        raise InputError(
            f"--segmenter {name} takes one file at most",
            got=" ".join(map(str, files)),
            cause=f"an encoder and a decoder are for --segmenter {' or '.join(TWO_FILES)}",
        )
    return known[name](SegmenterRequest(files[0] if files else None, synonyms, files))
