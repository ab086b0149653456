"""Tiny SAM and SAM 2 models of the reference libraries, with random weights, exported under the public names."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from reference_code import import_reference

SAM2_SIDE = 512
"""Of the SAM 2 made here; the public ones are 1024. The code is the same, and four times as fast."""


@dataclass(frozen=True)
class Export:
    """A reference model and its files.

    Attributes
    ----------
    model : torch.nn.Module
    encoders, decoders : dict of str to Path
        By flavour.
    """

    model: Any
    encoders: dict[str, Path]
    decoders: dict[str, Path]


def save(
    module: Any, values: dict[str, Any], path: Path, outputs: list[str], axes: dict[str, Any] | None = None
) -> Path:
    """A module as ONNX with the names of its inputs as given."""
    import torch

    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            module.eval(),
            tuple(values.values()),
            str(path),
            input_names=list(values),
            output_names=outputs,
            dynamic_axes=axes or {},
            opset_version=17,
            do_constant_folding=False,
            dynamo=False,
        )
    return path


def renamed(path: Path, names: dict[str, str], to: Path) -> Path:
    """The same graph with other names for its inputs and outputs."""
    import onnx

    model = onnx.load(path)
    for value in (*model.graph.input, *model.graph.output):
        value.name = names.get(value.name, value.name)
    for node in model.graph.node:
        for fields in (node.input, node.output):
            fields[:] = [names.get(name, name) for name in fields]
    onnx.save(model, to)
    return to


def shaken(model: Any, seed: int, gain: float) -> Any:
    """The model with weights large enough for masks that vary over the picture."""
    import torch

    torch.manual_seed(seed)
    with torch.no_grad():
        for name, values in model.named_parameters():
            if values.ndim > 1 and "positional" not in name:
                values.copy_(torch.randn_like(values) * (gain / np.sqrt(values[0].numel())))
    return model.eval().requires_grad_(False)


def export_sam(folder: Path) -> Export:
    """The official SAM code, and its own exporter for the decoder."""
    import_reference("segment_anything")
    import torch
    from segment_anything.modeling import ImageEncoderViT, MaskDecoder, PromptEncoder, Sam, TwoWayTransformer
    from segment_anything.utils.onnx import SamOnnxModel
    from torch.nn.functional import pad

    torch.manual_seed(0)
    sam = Sam(
        ImageEncoderViT(depth=1, embed_dim=32, img_size=1024, num_heads=2, patch_size=16, window_size=14),
        PromptEncoder(256, (64, 64), (1024, 1024), 16),
        MaskDecoder(
            transformer_dim=256,
            transformer=TwoWayTransformer(depth=1, embedding_dim=256, num_heads=8, mlp_dim=64),
        ),
        pixel_mean=[123.675, 116.28, 103.53],
        pixel_std=[58.395, 57.12, 57.375],
    )
    shaken(sam, 1, 1.4)

    mean, std = torch.tensor([123.675, 116.28, 103.53]), torch.tensor([58.395, 57.12, 57.375])

    class Preprocessing(torch.nn.Module):
        """What samexporter puts before the encoder with --use-preprocess."""

        def forward(self, image: Any) -> Any:
            image = ((image - mean) / std).permute(2, 0, 1)
            height, width = image.shape[-2:]
            return sam.image_encoder(pad(image, (0, 1024 - width, 0, 1024 - height))[None])

    square = torch.randn(1, 3, 1024, 1024)
    name = ["image_embeddings"]
    encoders = {
        "inside": save(
            Preprocessing(),
            {"input_image": torch.rand(768, 1024, 3) * 255},
            folder / "inside.onnx",
            name,
            {"input_image": {0: "image_height", 1: "image_width"}},
        ),
        "square": save(sam.image_encoder, {"input_image": square}, folder / "square.onnx", name),
    }
    encoders["x"] = renamed(encoders["square"], {"input_image": "x"}, folder / "x.onnx")
    prompt = {
        "image_embeddings": torch.randn(1, 256, 64, 64),
        "point_coords": torch.rand(1, 5, 2) * 1024,
        "point_labels": torch.randint(0, 4, (1, 5)).float(),
        "mask_input": torch.randn(1, 1, 256, 256),
        "has_mask_input": torch.ones(1),
        "orig_im_size": torch.tensor([1500.0, 2250.0]),
    }
    decoders = {
        kind: save(
            SamOnnxModel(sam, return_single_mask=kind == "single"),
            prompt,
            folder / f"{kind}.onnx",
            ["masks", "iou_predictions", "low_res_masks"],
            {"point_coords": {1: "num_points"}, "point_labels": {1: "num_points"}},
        )
        for kind in ("single", "four")
    }
    return Export(sam, encoders, decoders)


def export_sam2(folder: Path) -> Export:
    """The SAM 2 of transformers, as samexporter and as transformers.js name its parts."""
    import_reference("transformers")
    import torch
    from transformers import Sam2Config, Sam2HieraDetConfig, Sam2Model, Sam2VisionConfig
    from transformers.models.sam2.configuration_sam2 import Sam2MaskDecoderConfig, Sam2PromptEncoderConfig

    torch.manual_seed(0)
    backbone = Sam2HieraDetConfig(
        hidden_size=16,
        image_size=[SAM2_SIDE, SAM2_SIDE],
        blocks_per_stage=[1, 1, 1, 1],
        embed_dim_per_stage=[16, 32, 64, 128],
        num_attention_heads_per_stage=[1, 1, 2, 2],
        global_attention_blocks=[],
    )
    model = Sam2Model(
        Sam2Config(
            vision_config=Sam2VisionConfig(
                backbone_config=backbone,
                backbone_channel_list=[128, 64, 32, 16],
                backbone_feature_sizes=[[SAM2_SIDE // k] * 2 for k in (4, 8, 16)],
            ),
            prompt_encoder_config=Sam2PromptEncoderConfig(image_size=SAM2_SIDE),
            mask_decoder_config=Sam2MaskDecoderConfig(mlp_dim=64, num_hidden_layers=1),
        )
    )
    shaken(model, 2, 1.2)

    class Encoder(torch.nn.Module):
        def forward(self, image: Any) -> Any:
            return tuple(model.get_image_embeddings(image))

    def masks_of(fine: Any, middle: Any, coarse: Any, **prompt: Any) -> Any:
        found = model(image_embeddings=[fine, middle, coarse], multimask_output=True, **prompt)
        return found.iou_scores, found.pred_masks, found.object_score_logits

    class Points(torch.nn.Module):
        """As samexporter: boxes are points with the labels 2 and 3."""

        def forward(self, coarse: Any, fine: Any, middle: Any, points: Any, labels: Any, mask: Any, has: Any) -> Any:
            prompt = {"input_points": points[None], "input_labels": labels.long()[None]}
            scores, masks, _ = masks_of(fine, middle, coarse, **prompt)
            # The file declares an empty mask prompt; using it keeps it an input of the graph.
            return masks[0] + 0 * mask.sum() * has.sum(), scores[0]

    class Boxes(torch.nn.Module):
        """As transformers.js."""

        def forward(self, fine: Any, middle: Any, coarse: Any, points: Any, labels: Any, boxes: Any) -> Any:
            return masks_of(fine, middle, coarse, input_points=points, input_labels=labels, input_boxes=boxes)

    square = torch.randn(1, 3, SAM2_SIDE, SAM2_SIDE)
    sizes = ((32, 4), (64, 8), (256, 16))
    fine, middle, coarse = (torch.randn(1, c, SAM2_SIDE // k, SAM2_SIDE // k) for c, k in sizes)
    encoders = {
        "samexporter": save(
            Encoder(), {"image": square}, folder / "a.onnx", ["high_res_feats_0", "high_res_feats_1", "image_embed"]
        ),
    }
    encoders["transformers"] = renamed(
        encoders["samexporter"],
        {
            "image": "pixel_values",
            "high_res_feats_0": "image_embeddings.0",
            "high_res_feats_1": "image_embeddings.1",
            "image_embed": "image_embeddings.2",
        },
        folder / "b.onnx",
    )
    labels = {0: "num_labels", 1: "num_points"}
    decoders = {
        "samexporter": save(
            Points(),
            {
                "image_embed": coarse,
                "high_res_feats_0": fine,
                "high_res_feats_1": middle,
                "point_coords": torch.rand(1, 5, 2) * 1024,
                "point_labels": torch.randint(0, 4, (1, 5)).float(),
                "mask_input": torch.randn(1, 1, SAM2_SIDE // 4, SAM2_SIDE // 4),
                "has_mask_input": torch.ones(1),
            },
            folder / "c.onnx",
            ["masks", "iou_predictions"],
            {
                "point_coords": labels,
                "point_labels": labels,
                "mask_input": {0: "num_labels"},
                "has_mask_input": {0: "num_labels"},
            },
        ),
        "transformers": save(
            Boxes(),
            {
                "image_embeddings.0": fine,
                "image_embeddings.1": middle,
                "image_embeddings.2": coarse,
                "input_points": torch.rand(1, 2, 3, 2) * 1024,
                "input_labels": torch.ones(1, 2, 3, dtype=torch.int64),
                "input_boxes": torch.rand(1, 2, 4) * 1024,
            },
            folder / "d.onnx",
            ["iou_scores", "pred_masks", "object_score_logits"],
            {
                "input_points": {1: "boxes", 2: "points"},
                "input_labels": {1: "boxes", 2: "points"},
                "input_boxes": {1: "boxes"},
            },
        ),
    }
    return Export(model, encoders, decoders)
