"""What a file of Detic declares."""

from __future__ import annotations

from typing import Any

from pipeline.proposals.contracts import Contract, TensorSpec

OPTION = "--detector detic"
CONTRACTS = (
    Contract(
        OPTION,
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


def tensors_of(session: Any) -> tuple[Any, list[str]] | None:
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
