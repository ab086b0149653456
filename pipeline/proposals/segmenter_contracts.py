"""Which model files the prompted segmenters read, which they refuse, and what a file looks like."""

from __future__ import annotations

from typing import Any

from pipeline.proposals import efficientsam, sam, sam2
from pipeline.proposals.contracts import Contract, TensorSpec
from pipeline.proposals.model_pair import declared, follows

CONTRACTS: tuple[Contract, ...] = sam.CONTRACTS + sam2.CONTRACTS + efficientsam.CONTRACTS
"""Of every segmenter that takes an encoder and a decoder."""

_NO_BOX = "the export of SAM 1 for transformers.js, whose decoder takes no box"
_EMBEDDINGS = TensorSpec("image_embeddings", "float32", ("batch", 256, 64, 64))
_POSITIONS = TensorSpec("image_positional_embeddings", "float32", ("batch", 256, 64, 64))
REFUSED: tuple[Contract, ...] = (
    Contract(
        sam.OPTION,
        _NO_BOX,
        (TensorSpec("pixel_values", "float32", ("batch", 3, "side", "side")),),
        (_EMBEDDINGS, _POSITIONS),
    ),
    Contract(
        sam.OPTION,
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
    Contract(
        efficientsam.OPTION,
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

_INSTEAD = {sam.OPTION: "MobileSAM's or the official exporter's files do", efficientsam.OPTION: "take the split export"}


def explain(session: Any, option: str) -> str:
    """What kind of file this is, and which option reads it, in a clause for a message."""
    refused = next((c for c in REFUSED if follows(session, c)), None)
    if refused is not None:
        return f"this is {refused.what}; {_INSTEAD[refused.option]}"
    known = next((c for c in CONTRACTS if follows(session, c)), None)
    if known is not None and known.option != option:
        return f"this looks like the {known.what}: use {known.option}"
    outputs = [s.shape for s in declared(session.get_outputs())]
    if any(len(s) == 4 and s[1] == 32 for s in outputs) and any(len(s) == 3 for s in outputs):
        return "this looks like a YOLO export with masks: use --segmenter yolo-seg"
    names = {s.name for s in declared(session.get_inputs())}
    if names & {"input_ids", "text_features"}:
        return "this looks like a detector that reads text, no segmenter"
    return "is it a file for another --segmenter?"
