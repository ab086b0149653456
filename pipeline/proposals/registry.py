"""Detectors and segmenters by name.

Others add theirs through the entry point group `spatialviz.detectors`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from pipeline.language.naming import Synonyms, suggest
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Detector
from pipeline.proposals.cache import CachedDetector, CachedSegmenter
from pipeline.proposals.ensemble import EnsembleDetector
from pipeline.proposals.segmenter import DetectorSegmenter, PngMasks, Segmenter
from pipeline.system.detector_setup import DetectorSetup, named_model
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.model_files import resolve_model
from pipeline.system.plugins import load_plugins


@dataclass(frozen=True)
class DetectorRequest:
    """Ingredients of a detector."""

    model: Path | None  # Model file, recording, or options; of a network also its id on the model hub
    class_names: tuple[str, ...]  # The dataset's class names
    synonyms: Synonyms | None
    min_score: float | None  # None for the detector's own default
    config: Path | None = None
    """What the model file does not say itself: the TOML file of `boxes`, the class names of `detic` and `yolo-seg`,
    what the numbers of a published file of `recorded` mean."""
    frame_ids: tuple[str, ...] = ()  # The dataset's frames, for files that name pictures


def _loaded(home: str) -> Any:
    """Attribute "module.Name" of this package, imported on use."""
    module, _, name = home.partition(".")
    return getattr(import_module(f"pipeline.proposals.{module}"), name)


def _recorded(request: DetectorRequest) -> Detector:
    expected = "a JSON file, a folder of NPZ files, COCO results, or another published file"
    path = needed(request.model, "--detector recorded needs --model", expected=expected)
    return _loaded("recorded.RecordedDetector")(
        path,
        key=request.config,
        frame_ids=request.frame_ids,
        synonyms=request.synonyms,
        min_score=request.min_score or 0.0,
    )


def _network(
    name: str, home: str, what: str, options: Callable[[DetectorRequest], dict[str, Any]]
) -> Callable[[DetectorRequest], Detector]:
    """Factory of a network detector; the model file may be a hub id."""

    def make(request: DetectorRequest) -> Detector:
        expected = f"{what}, or its id on the model hub"
        path = resolve_model(needed(request.model, f"--detector {name} needs --model", expected=expected))
        return CachedDetector(_loaded(home)(path, min_score=request.min_score, **options(request)))

    return make


def _simulated(request: DetectorRequest) -> Detector:
    from pipeline.proposals.simulated import SimulatedDetector, read_options

    require(request.class_names, "--detector simulated needs a dataset with annotations", cause="it is made of them")
    options = None if request.model is None else read_options(request.model)
    return SimulatedDetector(
        options, request.class_names, synonyms=request.synonyms, min_score=request.min_score or 0.0
    )


_OWL = "an ONNX file with its tokenizer.json beside it"
DETECTORS: dict[str, Callable[[DetectorRequest], Detector]] = {
    "annotations": lambda request: AnnotationDetector(request.class_names, request.synonyms),
    "recorded": _recorded,
    "yolo-seg": _network(
        "yolo-seg",
        "yolo_seg.YoloSegDetector",
        "an ONNX file",
        lambda request: {"names": request.config, "synonyms": request.synonyms},
    ),
    "detic": _network(
        "detic",
        "detic.DeticDetector",
        "an ONNX file with its class names beside it",
        lambda request: {"names": request.config, "synonyms": request.synonyms},
    ),
    "boxes": _network(
        "boxes",
        "box_detector.BoxDetector",
        "an ONNX file with a TOML file beside it",
        lambda request: {"config": request.config, "synonyms": request.synonyms},
    ),
    "grounding-dino": _network(
        "grounding-dino",
        "grounding_dino.GroundingDinoDetector",
        "an ONNX file with its tokenizer beside it",
        lambda request: {"default_labels": request.class_names},
    ),
    "owlv2": _network(
        "owlv2", "owl.OwlDetector", _OWL, lambda request: {"kind": "owlv2", "default_labels": request.class_names}
    ),
    "owlvit": _network(
        "owlvit", "owl.OwlDetector", _OWL, lambda request: {"kind": "owlvit", "default_labels": request.class_names}
    ),
    "simulated": _simulated,
}
CONFIGURABLE = ("yolo-seg", "detic", "boxes", "recorded")
"""Those of them that a second file says more about."""

ENTRY_POINT_GROUP = "spatialviz.detectors"
"""Entry points of this group name a function of a DetectorRequest, and so add a detector."""


Make = TypeVar("Make")


def _maker(name: str, what: str, own: dict[str, Make], group: str, near: bool = False) -> Make:
    """Factory of a detector or segmenter by name, built in or a plugin; InputError if unknown."""
    known = own if name in own else {**dict(load_plugins(group, what, Callable)), **own}
    if name not in known:
        alike = ([n for n in known if n.startswith(name)] or suggest(name, known)) if near else ()
        cause = f"did you mean {' or '.join(alike)}?" if alike else None
        raise InputError(f"there is no {what} {name!r}", expected=" or ".join(known), cause=cause)
    return known[name]


def make_detector(
    name: str,
    *,
    model: Path | None = None,
    class_names: tuple[str, ...] = (),
    synonyms: Synonyms | None = None,
    min_score: float | None = None,
    config: Path | None = None,
    frame_ids: tuple[str, ...] = (),
) -> Detector:
    """Make a detector by name; arguments as of `DetectorRequest`.

    Raises
    ------
    InputError
        For an unknown name, a missing model, or a model of another contract.
    """
    require(min_score is None or 0 <= min_score <= 1, "a minimum score must lie in 0..1", got=min_score)
    make = _maker(name, "detector", DETECTORS, ENTRY_POINT_GROUP, near=True)
    require(
        config is None or name not in DETECTORS or name in CONFIGURABLE,
        f"--detector {name} takes no --model-config",
        expected=" or ".join(CONFIGURABLE),
        path=config,
    )
    require(
        config is None or name not in ("yolo-seg", "detic") or config.suffix != ".toml",
        f"--model-config of --detector {name} is a list of class names",
        got="a TOML file",
        expected="for --fuse and --also boxes=MODEL.onnx: that file beside the model, as MODEL.toml",
        path=config,
    )
    return make(DetectorRequest(model, class_names, synonyms, min_score, config, frame_ids))


def open_detector(
    setup: DetectorSetup, class_names: tuple[str, ...], table: Synonyms | None = None, frame_ids: tuple[str, ...] = ()
) -> Detector:
    """Make the detector."""
    table = table or Synonyms.load(setup.synonyms)

    shared = {"class_names": class_names, "synonyms": table, "min_score": setup.min_score, "frame_ids": frame_ids}
    others = [make_detector(name, model=model, **shared) for name, model in map(named_model, setup.fuse)]
    first = make_detector(setup.detector or "annotations", model=setup.model, config=setup.model_config, **shared)
    return EnsembleDetector((first, *others), setup.fusion, table) if others else first


@dataclass(frozen=True)
class SegmenterRequest:
    """Ingredients of a segmenter."""

    model: Path | None  # Model file, or recording; the first of several
    synonyms: Synonyms | None
    models: tuple[Path, ...] = ()  # All that was given


def _depth(request: SegmenterRequest) -> Segmenter:
    require(request.model is None, "--segmenter depth takes no model", path=request.model)
    return _loaded("depth_segmenter.DepthSegmenter")()


def _recorded_masks(request: SegmenterRequest) -> Segmenter:
    what = "a COCO file, a recording of detections, or a folder of PNG masks"
    path = needed(request.model, "--segmenter recorded needs --segmenter-model", expected=what)
    require(path.exists(), "there are no recorded masks", path=path)
    if path.is_dir() and not any(path.glob("*.npz")) and next(path.rglob("*.png"), None) is not None:
        return PngMasks(path)
    return DetectorSegmenter(_loaded("recorded.RecordedDetector")(path, unscored=True), request.synonyms)


def _yolo_seg_masks(request: SegmenterRequest) -> Segmenter:
    what = "an ONNX file, or its id on the model hub"
    path = resolve_model(needed(request.model, "--segmenter yolo-seg needs --segmenter-model", expected=what))
    network = _loaded("yolo_seg.YoloSegDetector")(path, synonyms=request.synonyms)
    return DetectorSegmenter(CachedDetector(network), request.synonyms)


def _prompted(model: str) -> Callable[[SegmenterRequest], Segmenter]:
    def make(request: SegmenterRequest) -> Segmenter:
        files = [resolve_model(path) for path in request.models]
        return CachedSegmenter(_loaded("prompted.PromptedSegmenter")(_loaded(f"prompted.{model}")(files)))

    return make


SEGMENTERS: dict[str, Callable[[SegmenterRequest], Segmenter]] = {
    "depth": _depth,
    "recorded": _recorded_masks,
    "yolo-seg": _yolo_seg_masks,
    "sam": _prompted("SamModel"),
    "sam2": _prompted("Sam2Model"),
    "efficientsam": _prompted("EfficientSamModel"),
}
TWO_FILES = ("sam", "sam2", "efficientsam")
"""Those that are made of an encoder and a decoder."""
SegmenterFiles = Path | tuple[Path, ...] | None
"""What a segmenter is made from: a file, or an encoder and a decoder."""
SEGMENTER_GROUP = "spatialviz.segmenters"
"""Entry points of this group name a function of a SegmenterRequest, and so add a segmenter."""


def segmenter_files(given: SegmenterFiles | str | Sequence[str]) -> tuple[Path, ...]:
    """Files of a segmenter in order, from paths or text."""
    if given is None:
        return ()
    return (Path(given),) if isinstance(given, str | Path) else tuple(Path(part) for part in given)


def make_segmenter(name: str, *, model: SegmenterFiles = None, synonyms: Synonyms | None = None) -> Segmenter:
    """Make a segmenter by name.

    Raises
    ------
    InputError
        For an unknown name, a missing model, or a model of another contract.
    """
    make = _maker(name, "segmenter", SEGMENTERS, SEGMENTER_GROUP)
    files = segmenter_files(model)
    require(
        len(files) <= 1 or name not in SEGMENTERS or name in TWO_FILES,
        f"--segmenter {name} takes one file at most",
        got=" ".join(map(str, files)),
        cause=f"an encoder and a decoder are for --segmenter {' or '.join(TWO_FILES)}",
    )
    return make(SegmenterRequest(files[0] if files else None, synonyms, files))
