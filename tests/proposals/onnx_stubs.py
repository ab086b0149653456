"""Small ONNX files that declare what detectors declare, and answer with what they are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

Shape = Sequence[int | str]
GROUNDING: dict[str, tuple[int, Shape]] = {
    "pixel_values": (TensorProto.FLOAT, (1, 3, "H", "W")),
    "input_ids": (TensorProto.INT64, (1, "S")),
    "token_type_ids": (TensorProto.INT64, (1, "S")),
    "attention_mask": (TensorProto.INT64, (1, "S")),
    "pixel_mask": (TensorProto.INT64, (1, "H", "W")),
}
OWL: dict[str, tuple[int, Shape]] = {
    "input_ids": (TensorProto.INT64, ("L", 16)),
    "pixel_values": (TensorProto.FLOAT, (1, 3, 96, 96)),
    "attention_mask": (TensorProto.INT64, ("L", 16)),
}

WORDS = ("mug", "lap", "##top", "coffee", "of", "the", "left", "dog", "cat", "hot", "tv", "stand", "-", "[", "]", "sep")


def bert_vocabulary() -> dict[str, int]:
    """A vocabulary with BERT's special tokens at BERT's own numbers."""
    words = {n: f"[unused{n}]" for n in range(1100)}
    words |= {0: "[PAD]", 100: "[UNK]", 101: "[CLS]", 102: "[SEP]", 103: "[MASK]", 1012: ".", 1029: "?"}
    words |= {200 + k: w for k, w in enumerate(WORDS)}
    return {w: n for n, w in words.items()}


def write_stub(
    path: Path,
    inputs: Mapping[str, tuple[int, Shape]],
    outputs: Mapping[str, np.ndarray],
    *,
    opset: int = 17,
    external: bool = False,
) -> Path:
    """A model of these inputs whose outputs are constants."""
    weights = [numpy_helper.from_array(value, f"{name}_value") for name, value in outputs.items()]
    nodes = [helper.make_node("Identity", [f"{name}_value"], [name]) for name in outputs]
    graph = helper.make_graph(
        nodes,
        "stub",
        [helper.make_tensor_value_info(n, kind, list(shape)) for n, (kind, shape) in inputs.items()],
        [
            helper.make_tensor_value_info(n, helper.np_dtype_to_tensor_dtype(v.dtype), list(v.shape))
            for n, v in outputs.items()
        ],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    if external:
        onnx.save(model, path, save_as_external_data=True, location=path.name + "_data", size_threshold=0)
    else:
        onnx.save(model, path)
    return path


def grounding_outputs(
    hits: Mapping[tuple[int, int], float], boxes: Mapping[int, Sequence[float]], *, queries: int = 20, dtype: Any = None
) -> dict[str, np.ndarray]:
    """Logits that are -inf but for (query, token), and the queries' boxes."""
    logits = np.full((1, queries, 256), -np.inf, dtype or np.float32)
    relative = np.full((1, queries, 4), 0.5, dtype or np.float32)
    for (query, token), value in hits.items():
        logits[0, query, token] = value
    for query, box in boxes.items():
        relative[0, query] = box
    return {"logits": logits, "pred_boxes": relative}
