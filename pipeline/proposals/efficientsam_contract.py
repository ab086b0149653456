"""What the files of EfficientSAM declare."""

from __future__ import annotations

from pipeline.proposals.contracts import Contract, TensorSpec

OPTION = "--segmenter efficientsam"
_EMBEDDINGS = TensorSpec("image_embeddings", "float32", ("batch", 256, 64, 64))
ENCODERS = (
    Contract(
        OPTION,
        "EfficientSAM encoder",
        (TensorSpec("batched_images", "float32", ("batch", 3, "height", "width")),),
        (_EMBEDDINGS,),
    ),
)
DECODERS = (
    Contract(
        OPTION,
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
CONTRACTS = ENCODERS + DECODERS
