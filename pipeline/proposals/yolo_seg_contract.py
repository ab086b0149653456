"""What a YOLO export with masks declares."""

from __future__ import annotations

from typing import Any

from pipeline.proposals.contracts import Contract, TensorSpec

MASK_COEFFICIENTS = 32
OPTION = "--detector yolo-seg"
_PROTOTYPES = TensorSpec("output1", "float32", (1, MASK_COEFFICIENTS, "H/4", "W/4"))
CONTRACTS = (
    Contract(
        OPTION,
        "YOLO export with masks (Ultralytics -seg, YOLOE, YOLO-World with a vocabulary inside)",
        (TensorSpec("images", "float32", (1, 3, "H", "W")),),
        (TensorSpec("output0", "float32", (1, "4+C+32", "N")), _PROTOTYPES),
    ),
    Contract(
        OPTION,
        "YOLO export with masks and the suppression inside",
        (TensorSpec("images", "float32", (1, 3, "H", "W")),),
        (TensorSpec("output0", "float32", (1, "N", 6 + MASK_COEFFICIENTS)), _PROTOTYPES),
    ),
)
"""Tensors are told by their shapes, whatever their names."""


def tensors_of(session: Any) -> tuple[Any, list[str], bool, int | None] | None:
    """The input, the names of rows and prototypes, whether rivals are suppressed inside, and the number of classes.

    None where this is no such model; the number is None where only the class names tell it.
    """
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
