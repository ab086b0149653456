"""The whole training job: rooms, network, calibration, figures, and what it leaves: the ONNX file and its card."""

from __future__ import annotations

import json
import platform
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.calibration_metrics import Platt, fit_calibration
from pipeline.relations.class_vectors import vectors_beside
from pipeline.relations.contract import TrainedOn
from pipeline.relations.features import cli_features
from pipeline.relations.model import OnnxScorer
from pipeline.relations.scorer import rule_probabilities
from pipeline.system.errors import require
from pipeline.system.onnx_session import file_hash, require_onnx
from pipeline.system.plugins import versions_of
from pipeline.system.threads import one_thread
from pipeline.training.evaluation import clear_cut_report, evaluate
from pipeline.training.train import TrainConfig, TrainedModel, check_room_config, require_training, train_srm
from pipeline.training.training_data import (
    SCALES,
    SCATTERED_A_ROOM,
    FrameSamples,
    make_split,
    room_seeds,
    with_other_sizes,
)

Progress = Callable[[str, int, int], None]
"""Called with (what is done, how much of it, of how much)."""


@dataclass(frozen=True)
class RoomConfig:
    """The rooms to learn from."""

    rooms: int = 150
    views: int = 4
    width: int = 480
    height: int = 360
    seed: int = 0


@one_thread()
def train_on_rooms(
    out: Path,
    rooms: RoomConfig | None = None,
    config: TrainConfig | None = None,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Render rooms, train on some, calibrate on others, and measure on the rest.

    Writes `out` and, beside it with the suffix .json, the card. Neither
    depends on `workers`, nor on how many threads there are for arithmetic.

    Parameters
    ----------
    out : Path
        The ONNX file to write; its folder is made if it is missing.
    rooms : RoomConfig, optional
    config : TrainConfig, optional
    workers : int
        Processes that make rooms; with more than one the calling script must be importable.
    progress : callable, optional

    Returns
    -------
    dict
        The card.

    Raises
    ------
    InputError
        `out` is not an .onnx file, or an argument makes no sense.
    MissingExtra
        torch, onnx or embreex is not installed.
    """
    rooms, config = rooms or RoomConfig(), config or TrainConfig()
    check_room_config(config)
    out = network_path(out)
    require_training()
    tell = progress or (lambda what, done, of: None)
    train, held_back, test = make_split(
        rooms.seed,
        rooms.rooms,
        views=rooms.views,
        width=rooms.width,
        height=rooms.height,
        workers=workers,
        progress=lambda done, of: tell("rooms", done, of),
    )
    learnt = with_other_sizes(train, rooms.seed)
    model = train_srm(learnt, config, lambda done, loss: tell("epochs", done, config.epochs))
    out.parent.mkdir(parents=True, exist_ok=True)
    name = config.features
    with tempfile.TemporaryDirectory() as folder:
        uncalibrated = Path(folder) / "uncalibrated.onnx"
        save_onnx(uncalibrated, model)
        plain = OnnxScorer(uncalibrated)
    calibration = fit_calibration(
        [plain.logits(frame.rows[name]) for frame in held_back],
        [frame.truth for frame in held_back],
        DIRECTIONAL,
    )
    save_onnx(out, model, calibration)
    card = {
        "name": name,
        "command": _command(out, rooms, config),
        "made_with": versions(),
        "file": {"bytes": out.stat().st_size, "xxh3_128": file_hash(out)},
        "weights_xxh3_128": model.weights_hash,
        "training": {
            **asdict(config),
            "batch": config.batch_of(model.pairs),
            "pairs": model.pairs,
            "loss_by_epoch": [round(loss, 6) for loss in model.losses],
            "data_xxh3_128": model.data,
        },
        "rooms": {**asdict(rooms), **_room_ranges(rooms), "scales": list(SCALES)},
        "calibration": {relation: [round(v, 6) for v in ab] for relation, ab in calibration.items()},
        "held_out": held_out_figures(OnnxScorer(out), plain, test),
    }
    out.with_suffix(".json").write_text(json.dumps(rounded(card), indent=1) + "\n", encoding="utf-8")
    return card


def network_path(out: Path) -> Path:
    """Where a network is written; InputError unless it is an .onnx file."""
    out = Path(out)
    require(out.suffix.lower() == ".onnx" and not out.is_dir(), "the network is written as an .onnx file", path=out)
    return out


def held_out_figures(scorer: OnnxScorer, plain: OnnxScorer, frames: Sequence[FrameSamples]) -> dict[str, Any]:
    """The figures of a network, of the same one without calibration, and of the rule, on views not learnt from."""
    name = scorer.contract.features
    truth, seen = [f.truth for f in frames], [f.rule for f in frames]
    extents = [(f.exact_lo, f.exact_hi) for f in frames]
    found = [scorer.probabilities(f.rows[name]) for f in frames]
    ruled = [rule_probabilities(states) for states in seen]
    bare = evaluate([plain.probabilities(f.rows[name]) for f in frames], truth)
    network, rule = evaluate(found, truth, seen), evaluate(ruled, truth)
    network["uncalibrated"] = {key: bare[key] for key in ("micro_f1", "brier", "ece")}
    for report, p in ((network, found), (rule, ruled)):
        report["clear_cut"] = clear_cut_report(p, extents)
        report["clear_cut_by_centers"] = clear_cut_report(p, extents, by_centers=True)
    return {"views": len(frames), "network": network, "rule": rule}


def _room_ranges(rooms: RoomConfig) -> dict[str, list[int]]:
    """First and last room seed of each part; calibrated on are rooms of solids, measured on furnished ones."""
    train, calibration, test = room_seeds(rooms.seed, rooms.rooms)
    scattered = [train[0], train[0] + SCATTERED_A_ROOM * rooms.rooms - 1]
    parts = {"train": train, "calibration": calibration, "test": test}
    return {**{f"{name}_rooms": [part[0], part[-1]] for name, part in parts.items()}, "scattered_rooms": scattered}


def _command(out: Path, rooms: RoomConfig, config: TrainConfig) -> str:
    return (
        f"spatialviz train rooms --out {out.name} --rooms {rooms.rooms} --views {rooms.views} --seed {rooms.seed} "
        f"--features {cli_features(config.features)} --width {rooms.width} --height {rooms.height} "
        f"--epochs {config.epochs}" + ("" if config.batch is None else f" --batch {config.batch}")
    )


def versions() -> dict[str, str]:
    """Of this program, of Python and of what trains."""
    packages = ("spatialviz", "numpy", "torch", "onnx", "onnxruntime", "embreex", "opencv-python-headless")
    return {"python": platform.python_version(), "machine": platform.machine(), **versions_of(*packages)}


def rounded(value: Any) -> Any:
    """A card with its floats cut to six decimals."""
    if isinstance(value, dict):
        return {key: rounded(inside) for key, inside in value.items()}
    if isinstance(value, (float, np.floating)):
        return round(float(value), 6)
    return value


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
