"""What a file of OWLv2 or OWL-ViT declares."""

from __future__ import annotations

from typing import Any, Literal

from pipeline.proposals.contracts import Contract, TensorSpec
from pipeline.proposals.relative_boxes import box_output

TOKENS = 16
"""Tokens of a name where the file does not say."""
SIDES = {"owlv2": 960, "owlvit": 768}
"""The side of the input where the file leaves it open: that of the base models."""
Kind = Literal["owlv2", "owlvit"]


def _contract(kind: Kind, what: str) -> Contract:
    return Contract(
        f"--detector {kind}",
        f"{what} as transformers.js and optimum export it, with its tokenizer.json",
        (
            TensorSpec("input_ids", "int64", ("L", TOKENS)),
            TensorSpec("pixel_values", "float32", (1, 3, SIDES[kind], SIDES[kind])),
            TensorSpec("attention_mask", "int64", ("L", TOKENS)),
        ),
        (TensorSpec("logits", "float32", (1, "Q", "L")), TensorSpec("pred_boxes", "float32", (1, "Q", 4))),
    )


CONTRACTS = (_contract("owlv2", "OWLv2"), _contract("owlvit", "OWL-ViT"))
"""Their files declare the same tensors, but for the size: which of the two it is must be said."""


def tensors_of(session: Any) -> list[str] | None:
    """The names of the logits, the boxes and, where it is there, the objectness; None where this is no such model."""
    inputs = {i.name: i.shape for i in session.get_inputs()}
    names = [o.name for o in session.get_outputs()]
    picture = inputs.get("pixel_values", [])
    wanted = {t.name for t in CONTRACTS[0].inputs}
    square = len(picture) == 4 and len({n for n in picture[2:] if isinstance(n, int)}) < 2
    boxes = box_output(session)
    fits = len(inputs.get("input_ids", [])) == 2 and square and not set(inputs) - wanted
    if not fits or boxes is None or "logits" not in names:
        return None
    return ["logits", boxes, *(["objectness_logits"] if "objectness_logits" in names else [])]
