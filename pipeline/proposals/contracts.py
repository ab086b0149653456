"""Contracts of model files: required tensors of each adapter, and their names in a file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class TensorSpec:
    """A declared input or output."""

    name: str
    dtype: str  # As NumPy names it; "float32" stands for float16 too
    shape: tuple[int | str, ...]  # A word where the size is the file's own


@dataclass(frozen=True)
class DetectorContract:
    """A kind of model file."""

    option: str  # How it is asked for, such as "--segmenter sam"
    what: str  # One line of what it is
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]  # Those that tell it from others; a file may declare more outputs


_DTYPES = {
    "tensor(float)": "float32",
    "tensor(float16)": "float16",
    "tensor(double)": "float64",
    "tensor(int64)": "int64",
    "tensor(int32)": "int32",
    "tensor(uint8)": "uint8",
    "tensor(bool)": "bool",
}


def declared(values: Iterable[Any]) -> tuple[TensorSpec, ...]:
    """Inputs or outputs of a session."""

    def shape(value: Any) -> tuple[int | str, ...]:
        return tuple(size if isinstance(size, int) else str(size or "?") for size in value.shape)

    return tuple(TensorSpec(v.name, _DTYPES.get(v.type, str(v.type)), shape(v)) for v in values)


def by_name(values: Iterable[Any]) -> dict[str, TensorSpec]:
    """Declared inputs or outputs by name."""
    return {spec.name: spec for spec in declared(values)}


def follows(session: Any, contract: DetectorContract) -> bool:
    """Test whether a file meets a contract: the same inputs, and at least the outputs."""
    inputs, outputs = by_name(session.get_inputs()), by_name(session.get_outputs())
    if set(inputs) != {s.name for s in contract.inputs}:
        return False
    if not all(_fits(inputs[s.name], s) for s in contract.inputs):
        return False
    if len(contract.outputs) == len(outputs) == 1:
        return len(next(iter(outputs.values())).shape) in (0, len(contract.outputs[0].shape))
    return all(s.name in outputs for s in contract.outputs)


def _fits(found: TensorSpec, wanted: TensorSpec) -> bool:
    if len(found.shape) != len(wanted.shape):
        return False
    if wanted.dtype == "int64" and found.dtype not in ("int64", "int32"):
        return False
    return all(
        a == b or isinstance(a, str) or isinstance(b, str) for a, b in zip(found.shape, wanted.shape, strict=True)
    )


def box_output(session: Any) -> str | None:
    """Name of the output (1, Q, 4), by usual name or by shape."""
    outputs = session.get_outputs()
    named = [o.name for o in outputs if o.name in ("pred_boxes", "boxes")]
    shaped = [o.name for o in outputs if len(o.shape) == 3 and o.shape[2] == 4]
    return next(iter(named + shaped), None)


_OUTPUTS = (TensorSpec("logits", "float32", (1, "Q", "T")), TensorSpec("pred_boxes", "float32", (1, "Q", 4)))
_TEXT = (TensorSpec("input_ids", "int64", (1, "S")), TensorSpec("token_type_ids", "int64", (1, "S")))
GROUNDING_DINO_CONTRACTS = (
    DetectorContract(
        "--detector grounding-dino",
        "GroundingDINO as transformers has it (onnx-community/grounding-dino-tiny-ONNX), with its tokenizer.json",
        (
            TensorSpec("pixel_values", "float32", (1, 3, "H", "W")),
            *_TEXT,
            TensorSpec("attention_mask", "int64", (1, "S")),
            TensorSpec("pixel_mask", "int64", (1, "H", "W")),
        ),
        _OUTPUTS,
    ),
    DetectorContract(
        "--detector grounding-dino",
        "GroundingDINO exported from the original code, with the tokenizer.json or vocab.txt of bert-base-uncased",
        (
            TensorSpec("img", "float32", (1, 3, "H", "W")),
            *_TEXT,
            TensorSpec("attention_mask", "bool", (1, "S")),
            TensorSpec("position_ids", "int64", (1, "S")),
            TensorSpec("text_token_mask", "bool", (1, "S", "S")),
        ),
        _OUTPUTS,
    ),
)
"""Inputs that do not bear on an output may be missing, as exporters drop them."""
PICTURES = ("pixel_values", "img")


def grounding_dino_tensors(session: Any) -> tuple[str, list[str]] | None:
    """Names of the picture's input, logits and boxes; None for another model."""
    inputs = {i.name: i.shape for i in session.get_inputs()}
    picture = next((n for n in PICTURES if n in inputs), None)
    known = {t.name for c in GROUNDING_DINO_CONTRACTS for t in c.inputs}
    boxes = box_output(session)
    outputs = [o for o in session.get_outputs() if o.name != boxes and len(o.shape) == 3]
    # OWLv2 and OWL-ViT have some of the same inputs, and give their embeddings.
    other = any(o.name in ("text_embeds", "image_embeds") for o in session.get_outputs())
    logits = next((o.name for o in outputs if o.name == "logits"), outputs[0].name if outputs else None)
    shape = inputs[picture] if picture else []
    fits = len(shape) == 4 and (shape[1] == 3 or not isinstance(shape[1], int)) and not other
    if picture is None or not fits or "input_ids" not in inputs or set(inputs) - known or not boxes or not logits:
        return None
    return picture, [logits, boxes]


TOKENS = 16
"""Tokens of a name where the file does not say."""
SIDES = {"owlv2": 960, "owlvit": 768}
"""The side of the input where the file leaves it open: that of the base models."""
Kind = Literal["owlv2", "owlvit"]


def _contract(kind: Kind, what: str) -> DetectorContract:
    return DetectorContract(
        f"--detector {kind}",
        f"{what} as transformers.js and optimum export it, with its tokenizer.json",
        (
            TensorSpec("input_ids", "int64", ("L", TOKENS)),
            TensorSpec("pixel_values", "float32", (1, 3, SIDES[kind], SIDES[kind])),
            TensorSpec("attention_mask", "int64", ("L", TOKENS)),
        ),
        (TensorSpec("logits", "float32", (1, "Q", "L")), TensorSpec("pred_boxes", "float32", (1, "Q", 4))),
    )


OWL_CONTRACTS = (_contract("owlv2", "OWLv2"), _contract("owlvit", "OWL-ViT"))
"""Their files declare the same tensors, but for the size: which of the two it is must be said."""


def owl_tensors(session: Any) -> list[str] | None:
    """Names of logits, boxes and, if present, objectness; None for another model."""
    inputs = {i.name: i.shape for i in session.get_inputs()}
    names = [o.name for o in session.get_outputs()]
    picture = inputs.get("pixel_values", [])
    wanted = {t.name for t in OWL_CONTRACTS[0].inputs}
    square = len(picture) == 4 and len({n for n in picture[2:] if isinstance(n, int)}) < 2
    boxes = box_output(session)
    fits = len(inputs.get("input_ids", [])) == 2 and square and not set(inputs) - wanted
    if not fits or boxes is None or "logits" not in names:
        return None
    return ["logits", boxes, *(["objectness_logits"] if "objectness_logits" in names else [])]


MASK_COEFFICIENTS = 32
YOLO_SEG_OPTION = "--detector yolo-seg"
_PROTOTYPES = TensorSpec("output1", "float32", (1, MASK_COEFFICIENTS, "H/4", "W/4"))
YOLO_SEG_CONTRACTS = (
    DetectorContract(
        YOLO_SEG_OPTION,
        "YOLO export with masks (Ultralytics -seg, YOLOE, YOLO-World with a vocabulary inside)",
        (TensorSpec("images", "float32", (1, 3, "H", "W")),),
        (TensorSpec("output0", "float32", (1, "4+C+32", "N")), _PROTOTYPES),
    ),
    DetectorContract(
        YOLO_SEG_OPTION,
        "YOLO export with masks and the suppression inside",
        (TensorSpec("images", "float32", (1, 3, "H", "W")),),
        (TensorSpec("output0", "float32", (1, "N", 6 + MASK_COEFFICIENTS)), _PROTOTYPES),
    ),
)
"""Tensors are told by their shapes, whatever their names."""


def yolo_seg_tensors(session: Any) -> tuple[Any, list[str], bool, int | None] | None:
    """Input, names of rows and prototypes, suppression inside, and number of classes. None where this is no such model;
    the number is None where only the class names tell it."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    fits = len(inputs) == 1 and len(inputs[0].shape) == 4 and inputs[0].shape[1] == 3
    rows = next((o for o in outputs if len(o.shape) == 3), None)
    prototypes = next((o for o in outputs if len(o.shape) == 4 and o.shape[1] == MASK_COEFFICIENTS), None)
    if not fits or rows is None or prototypes is None:
        return None
    suppressed = rows.shape[2] == 6 + MASK_COEFFICIENTS
    classes = rows.shape[1] - 4 - MASK_COEFFICIENTS if isinstance(rows.shape[1], int) and not suppressed else None
    if classes is not None and classes < 1:
        return None
    return inputs[0], [rows.name, prototypes.name], suppressed, classes


DETIC_OPTION = "--detector detic"
DETIC_CONTRACTS = (
    DetectorContract(
        DETIC_OPTION,
        "Detic with a frozen vocabulary (axinc-ai/ailia-models), with its class names in a file",
        (TensorSpec("img", "float32", (1, 3, "H", "W")),),
        (
            TensorSpec("boxes", "float32", ("n", 4)),
            TensorSpec("scores", "float32", ("n",)),
            TensorSpec("classes", "int64", ("n",)),
            TensorSpec("masks", "float32", ("n", 1, 28, 28)),
        ),
    ),
)
"""The outputs are told by their order, whatever their names."""


def detic_tensors(session: Any) -> tuple[Any, list[str]] | None:
    """The input, and the names of boxes, scores, classes and masks; None where this is no Detic."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1 or len(outputs) != 4 or len(inputs[0].shape) != 4 or inputs[0].shape[1] not in (3, "C"):
        return None
    # A file may leave the shapes of its outputs open: what it says must fit.
    ranks = [len(o.shape) for o in outputs]
    fits = all(r in (0, wanted) for r, wanted in zip(ranks, (2, 1, 1, 4), strict=True))
    boxes = outputs[0].shape
    if not fits or not any(ranks) or (len(boxes) == 2 and isinstance(boxes[1], int) and boxes[1] != 4):
        return None
    return inputs[0], [o.name for o in outputs]


EFFICIENTSAM_OPTION = "--segmenter efficientsam"
_EMBEDDINGS = TensorSpec("image_embeddings", "float32", ("batch", 256, 64, 64))
EFFICIENTSAM_ENCODERS = (
    DetectorContract(
        EFFICIENTSAM_OPTION,
        "EfficientSAM encoder",
        (TensorSpec("batched_images", "float32", ("batch", 3, "height", "width")),),
        (_EMBEDDINGS,),
    ),
)
EFFICIENTSAM_DECODERS = (
    DetectorContract(
        EFFICIENTSAM_OPTION,
        "EfficientSAM prompt decoder",
        (
            _EMBEDDINGS,
            TensorSpec("batched_point_coords", "float32", (1, "boxes", "points", 2)),
            TensorSpec("batched_point_labels", "float32", (1, "boxes", "points")),
            TensorSpec("orig_im_size", "int64", (2,)),
        ),
        (
            TensorSpec("output_masks", "float32", (1, "boxes", "masks", "H", "W")),
            TensorSpec("iou_predictions", "float32", (1, "boxes", "masks")),
        ),
    ),
)
EFFICIENTSAM_CONTRACTS = EFFICIENTSAM_ENCODERS + EFFICIENTSAM_DECODERS


SAM_OPTION = "--segmenter sam"
SAM_SIDE = 1024
ALL_MASKS = 4
"""Masks of an export that leaves the choice to its reader: the one for unambiguous prompts, then three others."""
_SAM_EMBEDDINGS = TensorSpec("image_embeddings", "float32", (1, 256, 64, 64))
SAM_ENCODERS = (
    DetectorContract(
        SAM_OPTION,
        "SAM or MobileSAM encoder with the preprocessing inside",
        (TensorSpec("input_image", "float32", ("height", "width", 3)),),
        (_SAM_EMBEDDINGS,),
    ),
    DetectorContract(
        SAM_OPTION,
        "SAM or MobileSAM encoder of the normalised square (samexporter)",
        (TensorSpec("input_image", "float32", (1, 3, SAM_SIDE, SAM_SIDE)),),
        (_SAM_EMBEDDINGS,),
    ),
    DetectorContract(
        SAM_OPTION,
        "SAM or MobileSAM encoder of the normalised square (osam)",
        (TensorSpec("x", "float32", (1, 3, SAM_SIDE, SAM_SIDE)),),
        (_SAM_EMBEDDINGS,),
    ),
)
SAM_DECODERS = (
    DetectorContract(
        SAM_OPTION,
        "SAM or MobileSAM prompt decoder (official exporter)",
        (
            _SAM_EMBEDDINGS,
            TensorSpec("point_coords", "float32", (1, "points", 2)),
            TensorSpec("point_labels", "float32", (1, "points")),
            TensorSpec("mask_input", "float32", (1, 1, 256, 256)),
            TensorSpec("has_mask_input", "float32", (1,)),
            TensorSpec("orig_im_size", "float32", (2,)),
        ),
        (
            TensorSpec("masks", "float32", (1, "masks", "H", "W")),
            TensorSpec("iou_predictions", "float32", (1, "masks")),
        ),
    ),
)
SAM_CONTRACTS = SAM_ENCODERS + SAM_DECODERS


SAM2_OPTION = "--segmenter sam2"


def _features(coarse: str, fine: str, middle: str) -> tuple[TensorSpec, ...]:
    return (
        TensorSpec(coarse, "float32", ("batch", 256, "h", "w")),
        TensorSpec(fine, "float32", ("batch", 32, "4h", "4w")),
        TensorSpec(middle, "float32", ("batch", 64, "2h", "2w")),
    )


_SAMEXPORTER = _features("image_embed", "high_res_feats_0", "high_res_feats_1")
_OSAM = _features("image_embeddings", "high_res_features1", "high_res_features2")
_TRANSFORMERS = _features("image_embeddings.2", "image_embeddings.0", "image_embeddings.1")
_SQUARE = ("batch", 3, "side", "side")
_POINTS = (
    TensorSpec("point_coords", "float32", ("boxes", "points", 2)),
    TensorSpec("point_labels", "float32", ("boxes", "points")),
    TensorSpec("mask_input", "float32", ("boxes", 1, "4h", "4w")),
    TensorSpec("has_mask_input", "float32", ("boxes",)),
)
_MASKS = (
    TensorSpec("masks", "float32", ("boxes", "masks", "4h", "4w")),
    TensorSpec("iou_predictions", "float32", ("boxes", "masks")),
)
SAM2_ENCODERS = (
    DetectorContract(
        SAM2_OPTION, "SAM 2 encoder (samexporter)", (TensorSpec("image", "float32", _SQUARE),), _SAMEXPORTER
    ),
    DetectorContract(SAM2_OPTION, "SAM 2 encoder (osam)", (TensorSpec("input", "float32", _SQUARE),), _OSAM),
    DetectorContract(
        SAM2_OPTION, "SAM 2 encoder (transformers.js)", (TensorSpec("pixel_values", "float32", _SQUARE),), _TRANSFORMERS
    ),
)
SAM2_DECODERS = (
    DetectorContract(SAM2_OPTION, "SAM 2 prompt decoder (samexporter)", (*_SAMEXPORTER, *_POINTS), _MASKS),
    DetectorContract(
        SAM2_OPTION,
        "SAM 2 prompt decoder (osam)",
        (*_OSAM, *_POINTS, TensorSpec("orig_im_size", "int64", (2,))),
        _MASKS,
    ),
    DetectorContract(
        SAM2_OPTION,
        "SAM 2 prompt decoder (transformers.js)",
        (
            *_TRANSFORMERS,
            TensorSpec("input_points", "float32", ("batch", "boxes", "points", 2)),
            TensorSpec("input_labels", "int64", ("batch", "boxes", "points")),
            TensorSpec("input_boxes", "float32", ("batch", "boxes", 4)),
        ),
        (
            TensorSpec("pred_masks", "float32", ("batch", "boxes", "masks", "4h", "4w")),
            TensorSpec("iou_scores", "float32", ("batch", "boxes", "masks")),
        ),
    ),
)
SAM2_CONTRACTS = SAM2_ENCODERS + SAM2_DECODERS


DETECTORS: tuple[DetectorContract, ...] = (
    *GROUNDING_DINO_CONTRACTS,
    *OWL_CONTRACTS,
    *YOLO_SEG_CONTRACTS,
    *DETIC_CONTRACTS,
)
"""Of every detector whose files need no description."""
