"""Detector options as plain values: the same for the command line, a run, labels, a case and a job.

`pipeline.proposals.registry.open_detector` makes the detector; importing this costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

FILES = ("model", "model_config", "segmenter_model", "srm", "vectors", "synonyms", "predictions")
"""The arguments of `open_pipeline` that name files."""
_WORDS = ("trained", "rule")
Fusion = Literal["wbf", "nms"]


@dataclass(frozen=True)
class DetectorSetup:
    """Detector and its fused companions, picklable."""

    detector: str | None = None
    """annotations | recorded | yolo-seg | grounding-dino | owlv2 | owlvit | detic | boxes | simulated. Default:
    annotations, where the dataset has them."""
    model: Path | None = None
    """Model file, its id on the model hub (OWNER/REPO:FILE@REVISION), a recording, or options of the simulated one."""
    model_config: Path | None = None
    """What the file of --model does not say: the TOML file of boxes (default: beside the model), the class names of
    detic and yolo-seg, the annotation file of COCO results that are recorded."""
    fuse: tuple[str, ...] = ()
    """Further detectors, NAME or NAME=MODEL, whose detections are fused with the detector's. What a MODEL does not say
    stands beside it."""
    fusion: Fusion = "wbf"
    """With --fuse: weighted boxes fusion, or all with non-maximum suppression."""
    min_score: float | None = None
    """Drop detections below this score, of each detector before they are fused. Default: the detector's own."""
    synonyms: Path | None = None
    """A JSON file with more synonyms: {"groups": [["mug", "cup"], …]}."""


def named_model(text: str) -> tuple[str, Path | None]:
    """Split "yolo-seg=FILE.onnx" into detector and model; a bare "simulated" has no model.

    Raises
    ------
    InputError
        No name, or nothing behind the sign.
    """
    name, sign, model = text.partition("=")
    require(
        not (not name.strip() or (sign and not model.strip())),
        "a further detector needs a name",
        got=repr(text),
        expected="NAME or NAME=MODEL",
    )
    return name.strip(), Path(model.strip()) if sign else None


def with_model(text: str, change: Callable[[Path], Any]) -> str:
    """Change the model's path in such a text."""
    name, model = named_model(text)
    return name if model is None else f"{name}={change(model)}"


def with_files(options: Mapping[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    """Change every file in arguments of `open_pipeline`, as runs and labels hold them."""
    found = dict(options)
    for name in FILES:
        value = options.get(name)
        if isinstance(value, list | tuple):
            found[name] = list(map(change, value))
        elif value is not None and str(value) not in _WORDS:
            found[name] = change(value)
    network = options.get("depth_model")
    if network is not None:
        # A bare name is no file; what follows the sign is one.
        name, sign, file = str(network).partition("=")
        is_file = "/" in name or name.endswith(".onnx")
        found["depth_model"] = f"{name}={change(file)}" if sign else str(change(name)) if is_file else name
    if options.get("fuse"):
        found["fuse"] = [with_model(str(text), change) for text in options["fuse"]]
    return found
