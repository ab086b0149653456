"""One small file of every kind that an adapter reads, and what stands beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, numpy_helper
from onnx_stubs import GROUNDING, OWL, Shape, grounding_outputs, write_stub

FLOAT, INT64 = TensorProto.FLOAT, TensorProto.INT64
EMBEDDINGS = np.zeros((1, 256, 64, 64), np.float32)
BOXES_TOML = 'names = ["mug"]\n[output]\nform = "separate"\nboxes = "b"\nscores = "s"\nunits = "share"\n'
Tensors = dict[str, tuple[int, Shape]]


def _picture(name: str, height: int = 64, width: int = 64) -> Tensors:
    return {name: (FLOAT, (1, 3, height, width))}


def _yolo() -> dict[str, np.ndarray]:
    rows = np.zeros((1, 4 + 1 + 32, 6), np.float32)
    rows[0, :5, 0] = 32, 32, 20, 20, 0.9
    rows[0, 5, 0] = 4.0
    return {"output0": rows, "output1": np.ones((1, 32, 16, 16), np.float32)}


def _yolo_suppressed() -> dict[str, np.ndarray]:
    rows = np.zeros((1, 5, 38), np.float32)
    rows[0, 0, :7] = 22, 22, 42, 42, 0.9, 0, 4.0
    return {"output0": rows, "output1": np.ones((1, 32, 16, 16), np.float32)}


def _detic() -> dict[str, np.ndarray]:
    return {
        "boxes": np.array([[100, 100, 400, 400]], np.float32),
        "scores": np.array([0.9], np.float32),
        "classes": np.zeros(1, np.int64),
        "masks": np.ones((1, 1, 28, 28), np.float32),
    }


def _owl() -> dict[str, np.ndarray]:
    return {
        "logits": np.full((1, 9, 1), 2.0, np.float32),
        "pred_boxes": np.full((1, 9, 4), 0.25, np.float32),
        "text_embeds": np.zeros((1, 1, 8), np.float32),
        "image_embeds": np.zeros((1, 3, 3, 8), np.float32),
    }


SAM_PROMPT: Tensors = {
    "image_embeddings": (FLOAT, (1, 256, 64, 64)),
    "point_coords": (FLOAT, (1, "points", 2)),
    "point_labels": (FLOAT, (1, "points")),
    "mask_input": (FLOAT, (1, 1, 256, 256)),
    "has_mask_input": (FLOAT, (1,)),
    "orig_im_size": (FLOAT, (2,)),
}
EFFICIENT_PROMPT: Tensors = {
    "image_embeddings": (FLOAT, (1, 256, 64, 64)),
    "batched_point_coords": (FLOAT, (1, "boxes", 2, 2)),
    "batched_point_labels": (FLOAT, (1, "boxes", 2)),
    "orig_im_size": (INT64, (2,)),
}
FINE, MIDDLE = np.zeros((1, 32, 64, 64), np.float32), np.zeros((1, 64, 32, 32), np.float32)
COARSE = np.zeros((1, 256, 16, 16), np.float32)
SAM2_PROMPT: Tensors = {
    "image_embed": (FLOAT, COARSE.shape),
    "high_res_feats_0": (FLOAT, FINE.shape),
    "high_res_feats_1": (FLOAT, MIDDLE.shape),
    "point_coords": (FLOAT, ("boxes", "points", 2)),
    "point_labels": (FLOAT, ("boxes", "points")),
    "mask_input": (FLOAT, ("boxes", 1, "mask_height", "mask_width")),
    "has_mask_input": (FLOAT, ("boxes",)),
}


def _masks(side: int) -> dict[str, np.ndarray]:
    return {"masks": np.ones((1, 1, side, side), np.float32), "iou_predictions": np.ones((1, 1), np.float32)}


STUBS: dict[str, Callable[[], tuple[Tensors, dict[str, np.ndarray]]]] = {
    "grounding-dino": lambda: (GROUNDING, grounding_outputs({(0, 1): 2.0}, {0: (0.5, 0.5, 0.4, 0.4)})),
    "owlv2": lambda: (OWL, _owl()),
    "owlvit": lambda: (OWL, _owl()),
    "yolo-seg": lambda: (_picture("images"), _yolo()),
    "yolo-seg suppressed": lambda: (_picture("images"), _yolo_suppressed()),
    "detic": lambda: ({"img": (FLOAT, (1, 3, "h", "w"))}, _detic()),
    "boxes": lambda: (
        _picture("image"),
        {"b": np.array([[[0.2, 0.2, 0.7, 0.7]]], np.float32), "s": np.full((1, 1, 1), 0.9, np.float32)},
    ),
    "sam encoder": lambda: (_picture("x", 1024, 1024), {"image_embeddings": EMBEDDINGS}),
    "sam decoder": lambda: (SAM_PROMPT, _masks(256)),
    "sam2 encoder": lambda: (
        _picture("image", 256, 256),
        {"high_res_feats_0": FINE, "high_res_feats_1": MIDDLE, "image_embed": COARSE},
    ),
    "sam2 decoder": lambda: (SAM2_PROMPT, _masks(64)),
    "efficientsam encoder": lambda: ({"batched_images": (FLOAT, (1, 3, "h", "w"))}, {"image_embeddings": EMBEDDINGS}),
    "efficientsam decoder": lambda: (
        EFFICIENT_PROMPT,
        {"output_masks": np.ones((1, 1, 3, 64, 64), np.float32), "iou_predictions": np.ones((1, 1, 3), np.float32)},
    ),
}


def write_model(kind: str, folder: Path, *, opset: int = 17, external: bool = False) -> Path:
    """A file of that kind in a folder of its own, with its tokenizer, its class names or its TOML file beside it."""
    folder = folder / kind.replace(" ", "-")
    folder.mkdir()
    inputs, outputs = STUBS[kind]()
    path = write_stub(folder / "model.onnx", inputs, outputs, opset=opset, external=external)
    if kind.startswith("yolo-seg"):
        change(path, _name_classes, external=external)
    elif kind == "grounding-dino":
        words = [f"[unused{k}]" for k in range(1100)]
        for place, word in {
            0: "[PAD]",
            100: "[UNK]",
            101: "[CLS]",
            102: "[SEP]",
            103: "[MASK]",
            1012: ".",
            1029: "?",
            200: "mug",
        }.items():
            words[place] = word
        (folder / "vocab.txt").write_text("\n".join(words) + "\n", encoding="utf-8")
    elif kind.startswith("owl"):
        _write_clip(folder / "tokenizer.json")
    elif kind == "detic":
        (folder / "model.names.txt").write_text("mug\n", encoding="utf-8")
    elif kind == "boxes":
        (folder / "model.toml").write_text(BOXES_TOML, encoding="utf-8")
    return path


def _name_classes(model: Any) -> None:
    entry = model.metadata_props.add()
    entry.key, entry.value = "names", "{0: 'mug'}"


def _write_clip(path: Path) -> None:
    from tokenizers import Tokenizer, models, pre_tokenizers

    letters = {chr(c): c - 97 for c in range(97, 123)}
    vocabulary = {**letters, "<|startoftext|>": 26, "<|endoftext|>": 27}
    tokenizer = Tokenizer(models.BPE(vocabulary, [], unk_token="a"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.save(str(path))


def change(path: Path, edit: Callable[[Any], None], *, external: bool = False) -> None:
    """Edit a file in place; its weights are taken in, or put into a file of their own again."""
    model = onnx.load(path)
    edit(model)
    if external:
        weights = path.name + "_data"
        path.with_name(weights).unlink()
        onnx.save(model, path, save_as_external_data=True, location=weights, size_threshold=0)
    else:
        onnx.save(model, path)


def halved(model: Any) -> None:
    """Half precision throughout."""
    for weight in model.graph.initializer:
        value = numpy_helper.to_array(weight)
        if value.dtype == np.float32:
            weight.CopyFrom(numpy_helper.from_array(value.astype(np.float16), weight.name))
    for value in (*model.graph.input, *model.graph.output):
        if value.type.tensor_type.elem_type == FLOAT:
            value.type.tensor_type.elem_type = TensorProto.FLOAT16


def loosened(model: Any) -> None:
    """Every size but that of colours is left open."""
    for value in (*model.graph.input, *model.graph.output):
        for k, size in enumerate(value.type.tensor_type.shape.dim):
            if size.dim_value not in (3, 32):
                size.dim_param = f"{value.name}_{k}"


def grown(model: Any) -> None:
    """Outputs that are of other sizes than declared: each has an axis more, and its last one is longer."""
    for weight in model.graph.initializer:
        value = numpy_helper.to_array(weight)
        weight.CopyFrom(numpy_helper.from_array(np.stack([value, value], axis=-1)[None], weight.name))
    for value in model.graph.output:
        value.type.tensor_type.ClearField("shape")
    del model.graph.value_info[:]


def poisoned(model: Any) -> None:
    """Outputs that are not numbers."""
    for weight in model.graph.initializer:
        value = numpy_helper.to_array(weight)
        if value.dtype == np.float32:
            weight.CopyFrom(numpy_helper.from_array(np.full_like(value, np.nan), weight.name))
