"""Which model files the prompted segmenters read, and which they refuse."""

from __future__ import annotations

from pipeline.proposals import efficientsam_contract, sam2_contract, sam_contract
from pipeline.proposals.contracts import Contract, TensorSpec

CONTRACTS: tuple[Contract, ...] = sam_contract.CONTRACTS + sam2_contract.CONTRACTS + efficientsam_contract.CONTRACTS
"""Of every segmenter that takes an encoder and a decoder."""

_NO_BOX = "the export of SAM 1 for transformers.js, whose decoder takes no box"
_EMBEDDINGS = TensorSpec("image_embeddings", "float32", ("batch", 256, 64, 64))
_POSITIONS = TensorSpec("image_positional_embeddings", "float32", ("batch", 256, 64, 64))
REFUSED: tuple[Contract, ...] = (
    Contract(
        sam_contract.OPTION,
        _NO_BOX,
        (TensorSpec("pixel_values", "float32", ("batch", 3, "side", "side")),),
        (_EMBEDDINGS, _POSITIONS),
    ),
    Contract(
        sam_contract.OPTION,
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
        efficientsam_contract.OPTION,
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
    sam_contract.OPTION: "MobileSAM's or the official exporter's files do",
    efficientsam_contract.OPTION: "take the split export",
}
"""What to do in place of those."""
