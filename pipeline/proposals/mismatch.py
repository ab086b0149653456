"""Adapter of an ONNX file by declared tensors, and explanation of mismatches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pipeline.proposals.contracts import (
    _EMBEDDINGS,
    EFFICIENTSAM_CONTRACTS,
    EFFICIENTSAM_OPTION,
    SAM2_CONTRACTS,
    SAM_CONTRACTS,
    SAM_OPTION,
    SIDES,
    DetectorContract,
    TensorSpec,
    declared,
    detic_tensors,
    follows,
    grounding_dino_tensors,
    owl_tensors,
    yolo_seg_tensors,
)
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import metadata

BOXES = "--detector boxes"
Found = TypeVar("Found")


@dataclass(frozen=True)
class FileKind:
    """Kind of a model file."""

    what: str  # In a few words
    options: tuple[str, ...]  # Those that read it, such as "--detector yolo-seg"; empty where none does
    advice: str = ""  # What to do with it where no option simply reads it; "" where one does

    @property
    def sentence(self) -> str:
        """A clause for messages."""
        if self.advice:
            return f"this looks like {self.what}; {self.advice}"
        return f"this looks like {self.what}: use {' or '.join(self.options)}"


def recognise(session: Any) -> FileKind | None:
    """Recognise an open file; None if unknown."""
    refused = next((c for c in REFUSED if follows(session, c)), None)
    if refused is not None:
        return FileKind(refused.what, (), INSTEAD[refused.option])
    segmenter = next((c for c in SEGMENTERS if follows(session, c)), None)
    if segmenter is not None:
        return FileKind(f"the {segmenter.what}", (segmenter.option,))
    return _detector(session) or _relatives(session)


_KINDS = (
    (grounding_dino_tensors, FileKind("GroundingDINO", ("--detector grounding-dino",))),
    (yolo_seg_tensors, FileKind("a YOLO export with masks", ("--detector yolo-seg", "--segmenter yolo-seg"))),
    (detic_tensors, FileKind("Detic", ("--detector detic",))),
)


def _detector(session: Any) -> FileKind | None:
    if owl_tensors(session) is None or grounding_dino_tensors(session) is not None:
        return next((kind for tensors, kind in _KINDS if tensors(session) is not None), None)
    sides = next(i.shape[2:] for i in session.get_inputs() if i.name == "pixel_values")
    names = tuple(n for n, side in SIDES.items() if side == sides[0]) or ("owlv2", "owlvit")
    what = {"owlv2": "OWLv2", "owlvit": "OWL-ViT"}
    return FileKind(" or ".join(what[n] for n in names), tuple(f"--detector {n}" for n in names))


def _relatives(session: Any) -> FileKind | None:
    """Similar kinds of files, and files for a TOML description."""
    inputs, outputs = declared(session.get_inputs()), declared(session.get_outputs())
    names = {s.name for s in inputs}
    if any(key.startswith("srm.") for key in metadata(session)):
        return FileKind("a relation network", ("--srm FILE",))
    if "text_features" in names:
        return FileKind("YOLO-World with its text from outside", (), "export it with its vocabulary set inside")
    if "input_ids" in names and not any(len(s.shape) == 4 for s in inputs):
        return FileKind("the text part of a model", (), "an export of the whole is needed")
    pictures = [s for s in inputs if len(s.shape) == 4 and 3 in (s.shape[1], s.shape[3])]
    if len(pictures) != 1 or "input_ids" in names:
        return None
    advice = f"describe its tensors in a TOML file and use {BOXES}"
    if _yolo_rows(outputs):
        return FileKind("a YOLO export without masks", (BOXES,), f"{advice}, or export a -seg model")
    if _boxes_among(outputs):
        return FileKind("a detector of boxes", (BOXES,), advice)
    return None


def _yolo_rows(outputs: Sequence[TensorSpec]) -> bool:
    shapes = [s.shape for s in outputs]
    return (
        len(shapes) == 1
        and len(shapes[0]) == 3
        and (6 in shapes[0][1:] or any(isinstance(n, int) and n > 1000 for n in shapes[0][1:]))
    )


def _boxes_among(outputs: Sequence[TensorSpec]) -> bool:
    last = [s.shape[-1] for s in outputs if len(s.shape) in (2, 3)]
    several = [n for n in last if isinstance(n, int) and n % 4 == 0]
    return 4 in last or (len(last) >= 4 and len(several) * 2 >= len(last))


def explain_mismatch(session: Any, option: str) -> str:
    """Explanation of a mismatch with an option, as a clause for a message."""
    face = option.split()[0]
    kind = recognise(session)
    if kind is None:
        return f"is it a file for another {face}?"
    if option in kind.options:
        return f"this is {kind.what}"
    # A segmenter's user is told of segmenters, where there is one.
    own = tuple(o for o in kind.options if o.startswith(face))
    if own or not kind.options or face == "--detector":
        return FileKind(kind.what, own or kind.options, kind.advice).sentence
    return f"this looks like {kind.what}, no {face.lstrip('-')}: it is for {' or '.join(kind.options)}"


def shapes(specs: Sequence[TensorSpec]) -> str:
    """ "pixel_values [1, 3, 800, 800], input_ids [1, S]"."""
    return ", ".join(f"{s.name} [{', '.join(str(d) for d in s.shape)}]" for s in specs)


def fitting(found: Found | None, what: str, session: Any, path: Path, contracts: Sequence[DetectorContract]) -> Found:
    """Tensors found by an adapter; InputError with an explanation otherwise."""
    if found is not None:
        return found
    wanted, given = [c.inputs for c in contracts], declared(session.get_inputs())
    if any(_alike(inputs, given) for inputs in wanted):
        # The inputs say nothing: it is the outputs that are others.
        wanted, given = [c.outputs for c in contracts], declared(session.get_outputs())
    raise InputError(
        f"the ONNX file is not {what}",
        got=shapes(given)[:300],
        expected=" or ".join(dict.fromkeys(shapes(w) for w in wanted)),
        cause=explain_mismatch(session, contracts[0].option),
        path=path,
    )


def _alike(wanted: Sequence[TensorSpec], given: Sequence[TensorSpec]) -> bool:
    return len(wanted) == len(given) and all(len(a.shape) == len(b.shape) for a, b in zip(wanted, given, strict=True))


SEGMENTERS: tuple[DetectorContract, ...] = SAM_CONTRACTS + SAM2_CONTRACTS + EFFICIENTSAM_CONTRACTS
"""Of every segmenter that takes an encoder and a decoder."""
_NO_BOX = "the export of SAM 1 for transformers.js, whose decoder takes no box"
_POSITIONS = TensorSpec("image_positional_embeddings", "float32", ("batch", 256, 64, 64))
REFUSED: tuple[DetectorContract, ...] = (
    DetectorContract(
        SAM_OPTION,
        _NO_BOX,
        (TensorSpec("pixel_values", "float32", ("batch", 3, "side", "side")),),
        (_EMBEDDINGS, _POSITIONS),
    ),
    DetectorContract(
        SAM_OPTION,
        _NO_BOX,
        (
            _EMBEDDINGS,
            _POSITIONS,
            TensorSpec("input_points", "float32", ("batch", "prompts", "points", 2)),
            TensorSpec("input_labels", "int64", ("batch", "prompts", "points")),
        ),
        (
            TensorSpec("iou_scores", "float32", ("batch", "prompts", "masks")),
            TensorSpec("pred_masks", "float32", ("batch", "prompts", "masks", 256, 256)),
        ),
    ),
    DetectorContract(
        EFFICIENTSAM_OPTION,
        "an EfficientSAM in one file, which would be run whole for each box",
        (
            TensorSpec("batched_images", "float32", ("batch", 3, "height", "width")),
            TensorSpec("batched_point_coords", "float32", ("batch", "boxes", "points", 2)),
            TensorSpec("batched_point_labels", "float32", ("batch", "boxes", "points")),
        ),
        (),
    ),
)
"""Files that look right and cannot be used; `what` says why."""
INSTEAD = {
    SAM_OPTION: "MobileSAM's or the official exporter's files do",
    EFFICIENTSAM_OPTION: "take the split export",
}
"""What to do in place of those."""
