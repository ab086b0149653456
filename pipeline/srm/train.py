"""Training the relation network in torch as the paper says, and writing it as ONNX.

Three layers, Adam at 1e-3 halved every 3 epochs, 10 epochs, binary cross
entropy over all relations at once with the doubtful cells (U) masked. What the
paper leaves open (width, batch, initial weights) is that of the method notes:
128, 256, He. One thread and torch's deterministic algorithms: equal samples and
seeds give equal bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.errors import InputError, MissingExtra
from pipeline.relations import DIRECTIONAL
from pipeline.srm.calibration import IDENTITY, Platt
from pipeline.srm.features import feature_set
from pipeline.srm.model import Contract
from pipeline.srm.training_data import FrameSamples, iterate_pairs

OPSET = 13
IR_VERSION = 8
"""Old enough for every ONNX Runtime this program accepts."""


@dataclass(frozen=True)
class TrainConfig:
    """How the network is trained; the defaults are the paper's, or the measured choice where it gives none."""

    features: str = "rel14"
    hidden: int = 128
    batch: int = 256
    epochs: int = 10
    learning_rate: float = 1e-3
    halve_every: int = 3
    seed: int = 0


@dataclass(frozen=True)
class TrainedModel:
    """A network before calibration.

    Attributes
    ----------
    config : TrainConfig
    layers : tuple of (W, b)
        float32, W is (inputs, outputs).
    mean, std : (D,) float64
        Of the training features.
    losses : tuple of float
        Mean loss of each epoch.
    pairs : int
        Training pairs.
    data : str
        Hash of features and labels.
    """

    config: TrainConfig
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    mean: np.ndarray
    std: np.ndarray
    losses: tuple[float, ...]
    pairs: int
    data: str

    def contract(self, calibration: dict[str, Platt] | None = None) -> Contract:
        """What the ONNX file will say; without a calibration, probabilities are the bare sigmoid."""
        return Contract(
            self.config.features,
            feature_set(self.config.features).columns,
            self.mean,
            self.std,
            DIRECTIONAL,
            calibration or dict.fromkeys(DIRECTIONAL, IDENTITY),
            self.config.seed,
            self.data,
        )


def train_srm(
    samples: Sequence[FrameSamples],
    config: TrainConfig | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> TrainedModel:
    """Train on the pairs of these views.

    Parameters
    ----------
    samples : sequence of FrameSamples
    config : TrainConfig, optional
    progress : callable, optional
        Called after each epoch with (epochs done, mean loss).

    Raises
    ------
    InputError
        There is nothing to learn from, or the configuration makes no sense.
    MissingExtra
        torch is not installed.
    """
    config = config or TrainConfig()
    if min(config.hidden, config.batch, config.epochs, config.halve_every) < 1 or config.learning_rate <= 0:
        raise InputError("width, batch, epochs, halving and learning rate must be positive", got=config)
    torch = _torch()
    dimension = feature_set(config.features).dimension
    views = list(iterate_pairs(samples, config.features))
    features = np.concatenate([f for f, _ in views]) if views else np.zeros((0, dimension))
    states = np.concatenate([s for _, s in views]) if views else np.zeros((0, len(DIRECTIONAL)), np.int8)
    usable = np.isfinite(features).all(axis=1) & (states != 0).any(axis=1)
    features, states = features[usable], states[usable]
    if len(features) < 2:
        raise InputError("there are no pairs of objects to learn from", got=f"{len(features)} pairs")
    mean, std = features.mean(axis=0), features.std(axis=0)
    std = np.where(std > 1e-9, std, 1.0)
    digest = xxhash.xxh3_128(np.ascontiguousarray(features).data)
    digest.update(np.ascontiguousarray(states).data)

    with _deterministic(torch):
        generator = torch.Generator().manual_seed(config.seed)
        sizes = (dimension, config.hidden, config.hidden, len(DIRECTIONAL))
        weights = [
            (torch.randn(i, o, generator=generator) * (2.0 / i) ** 0.5).requires_grad_()
            for i, o in pairwise(sizes)
        ]
        biases = [torch.zeros(o, requires_grad=True) for o in sizes[1:]]
        x = torch.from_numpy(((features - mean) / std).astype(np.float32))
        target = torch.from_numpy((states > 0).astype(np.float32))
        known = torch.from_numpy((states != 0).astype(np.float32))
        optimiser = torch.optim.Adam([*weights, *biases], lr=config.learning_rate)
        schedule = torch.optim.lr_scheduler.StepLR(optimiser, config.halve_every, 0.5)
        losses = []
        for epoch in range(config.epochs):
            order = torch.randperm(len(x), generator=generator)
            total = 0.0
            for start in range(0, len(x), config.batch):
                rows = order[start : start + config.batch]
                logits = _forward(torch, x[rows], weights, biases)
                cells = torch.nn.functional.binary_cross_entropy_with_logits(logits, target[rows], reduction="none")
                loss = (cells * known[rows]).sum() / known[rows].sum()
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                total += float(loss.detach()) * len(rows)
            schedule.step()
            losses.append(total / len(x))
            if progress is not None:
                progress(epoch + 1, losses[-1])
        layers = tuple(
            (w.detach().numpy().copy(), b.detach().numpy().copy()) for w, b in zip(weights, biases, strict=True)
        )
    return TrainedModel(config, layers, mean, std, tuple(losses), len(features), digest.hexdigest())


def _forward(torch: Any, x: Any, weights: Sequence[Any], biases: Sequence[Any]) -> Any:
    for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
        x = torch.addmm(b, x, w)
        if k + 1 < len(weights):
            x = torch.relu(x)
    return x


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise MissingExtra("training", "train") from error
    return torch


def require_training() -> None:
    """Raise MissingExtra now, and not after the rooms are made, where torch or onnx is missing."""
    _torch()
    _onnx()


def _onnx() -> Any:
    try:
        import onnx
    except ImportError as error:
        raise MissingExtra("writing ONNX files", "train") from error
    return onnx


@contextmanager
def _deterministic(torch: Any) -> Iterator[None]:
    """One thread and deterministic algorithms; both as they were afterwards."""
    threads, strict = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(strict)
        torch.set_num_threads(threads)


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
    onnx = _onnx()
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


def save_onnx(path: Path, model: TrainedModel, calibration: dict[str, Platt] | None = None) -> None:
    """The trained network with its contract, as `OnnxScorer` reads it."""
    write_onnx(path, model.layers, model.contract(calibration).metadata())
