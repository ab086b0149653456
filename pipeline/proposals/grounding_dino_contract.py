"""What a file of GroundingDINO declares."""

from __future__ import annotations

from typing import Any

from pipeline.proposals.contracts import Contract, TensorSpec
from pipeline.proposals.relative_boxes import box_output

_OUTPUTS = (TensorSpec("logits", "float32", (1, "Q", "T")), TensorSpec("pred_boxes", "float32", (1, "Q", 4)))
_TEXT = (TensorSpec("input_ids", "int64", (1, "S")), TensorSpec("token_type_ids", "int64", (1, "S")))
CONTRACTS = (
    Contract(
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
    Contract(
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


def tensors_of(session: Any) -> tuple[str, list[str]] | None:
    """The name of the picture's input, and those of the logits and the boxes; None where this is no such model."""
    inputs = {i.name: i.shape for i in session.get_inputs()}
    picture = next((n for n in PICTURES if n in inputs), None)
    known = {t.name for c in CONTRACTS for t in c.inputs}
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
