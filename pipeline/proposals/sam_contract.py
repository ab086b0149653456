"""What the files of SAM and MobileSAM declare."""

from __future__ import annotations

from pipeline.proposals.contracts import Contract, TensorSpec

OPTION = "--segmenter sam"
SIDE = 1024
ALL_MASKS = 4
"""Masks of an export that leaves the choice to its reader: the one for unambiguous prompts, then three others."""
_EMBEDDINGS = TensorSpec("image_embeddings", "float32", (1, 256, 64, 64))
ENCODERS = (
    Contract(
        OPTION,
        "SAM or MobileSAM encoder with the preprocessing inside",
        (TensorSpec("input_image", "float32", ("height", "width", 3)),),
        (_EMBEDDINGS,),
    ),
    Contract(
        OPTION,
        "SAM or MobileSAM encoder of the normalised square (samexporter)",
        (TensorSpec("input_image", "float32", (1, 3, SIDE, SIDE)),),
        (_EMBEDDINGS,),
    ),
    Contract(
        OPTION,
        "SAM or MobileSAM encoder of the normalised square (osam)",
        (TensorSpec("x", "float32", (1, 3, SIDE, SIDE)),),
        (_EMBEDDINGS,),
    ),
)
DECODERS = (
    Contract(
        OPTION,
        "SAM or MobileSAM prompt decoder (official exporter)",
        (
            _EMBEDDINGS,
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
CONTRACTS = ENCODERS + DECODERS
