"""What the files of SAM 2 declare."""

from __future__ import annotations

from pipeline.proposals.contracts import Contract, TensorSpec

OPTION = "--segmenter sam2"


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
ENCODERS = (
    Contract(OPTION, "SAM 2 encoder (samexporter)", (TensorSpec("image", "float32", _SQUARE),), _SAMEXPORTER),
    Contract(OPTION, "SAM 2 encoder (osam)", (TensorSpec("input", "float32", _SQUARE),), _OSAM),
    Contract(
        OPTION, "SAM 2 encoder (transformers.js)", (TensorSpec("pixel_values", "float32", _SQUARE),), _TRANSFORMERS
    ),
)
DECODERS = (
    Contract(OPTION, "SAM 2 prompt decoder (samexporter)", (*_SAMEXPORTER, *_POINTS), _MASKS),
    Contract(
        OPTION,
        "SAM 2 prompt decoder (osam)",
        (*_OSAM, *_POINTS, TensorSpec("orig_im_size", "int64", (2,))),
        _MASKS,
    ),
    Contract(
        OPTION,
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
CONTRACTS = ENCODERS + DECODERS
