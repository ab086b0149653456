"""A trained network as an ONNX file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.metrics.calibration_metrics import Platt
from pipeline.relations.class_vectors import vectors_beside
from pipeline.system.onnx_session import require_onnx

if TYPE_CHECKING:
    from pipeline.relations.contract import TrainedOn
    from pipeline.training.train import TrainedModel

OPSET = 13
IR_VERSION = 8
"""Old enough for every ONNX Runtime this program accepts."""


def write_onnx(
    path: Path, layers: Sequence[tuple[np.ndarray, np.ndarray]], metadata: dict[str, str], producer: str = "spatialviz"
) -> None:
    """Write a network of dense layers with ReLU between them: `features` (pairs, D) -> `logits` (pairs, R).

    Parameters
    ----------
    path : Path
    layers : sequence of (W, b)
        W is (inputs, outputs).
    metadata : dict of str to str

    Raises
    ------
    MissingExtra
        The package onnx is not installed.
    """
    onnx = require_onnx()
    from onnx import TensorProto, helper, numpy_helper

    nodes, constants = [], []
    value = "features"
    for k, (w, b) in enumerate(layers):
        last = k + 1 == len(layers)
        constants += [
            numpy_helper.from_array(np.ascontiguousarray(w, np.float32), f"W{k}"),
            numpy_helper.from_array(np.ascontiguousarray(b, np.float32), f"b{k}"),
        ]
        out = "logits" if last else f"dense{k}"
        nodes.append(helper.make_node("Gemm", [value, f"W{k}", f"b{k}"], [out], name=f"layer{k}"))
        if not last:
            nodes.append(helper.make_node("Relu", [out], [f"relu{k}"], name=f"activation{k}"))
            value = f"relu{k}"
    inputs = helper.make_tensor_value_info("features", TensorProto.FLOAT, ["pairs", layers[0][0].shape[0]])
    outputs = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["pairs", layers[-1][0].shape[1]])
    graph = helper.make_graph(nodes, "srm", [inputs], [outputs], constants)
    model = helper.make_model(
        graph,
        producer_name=producer,
        opset_imports=[helper.make_operatorsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    helper.set_model_props(model, dict(sorted(metadata.items())))
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString(deterministic=True))


def save_onnx(
    path: Path,
    model: TrainedModel,
    calibration: dict[str, Platt] | None = None,
    trained_on: TrainedOn | None = None,
) -> None:
    """The trained network with its contract, as `OnnxScorer` reads it, and its class vectors beside it."""
    write_onnx(path, model.layers, replace(model.contract(calibration), trained_on=trained_on).metadata())
    if model.vectors is not None:
        vectors_beside(path).write_bytes(model.vectors.content())
