"""The whole training job: rooms, network, calibration, figures, and what it leaves: the ONNX file and its card.

Of the figures only pairs of different objects count, and of their cells only those that are T or F in truth: U is
neither right nor wrong.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.language.relation_names import DIRECTIONAL, RELATIONS
from pipeline.metrics.calibration_metrics import (
    Platt,
    calibration_metrics,
    expected_calibration_error,
    fit_calibration,
    labelled_pairs,
)
from pipeline.metrics.intervals import mean_of_defined, ratio
from pipeline.metrics.relation_metrics import multi_label_metrics, single_label_metrics
from pipeline.relations.contract import TrainedOn
from pipeline.relations.features import cli_features
from pipeline.relations.model import OnnxScorer, vectors_path
from pipeline.relations.relations import measure_pairs
from pipeline.relations.scorer import rule_probabilities
from pipeline.system.errors import extra_module, require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import file_hash
from pipeline.system.plugins import versions_of
from pipeline.system.whole_files import file_with_companions
from pipeline.system.worker_pool import one_thread
from pipeline.training.train import TrainConfig, TrainedModel, check_room_config, require_training, train_srm
from pipeline.training.training_data import (
    SCALES,
    WRONG_NAMES,
    FrameSamples,
    make_split,
    room_seeds,
    scattered_seeds,
    with_other_sizes,
    with_wrong_names,
)

Progress = Callable[[str, int, int], None]
"""Called with (what is done, how much of it, of how much)."""


@dataclass(frozen=True)
class RoomConfig:
    """The rooms to learn from."""

    rooms: int = 400
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
    out
        The ONNX file to write; its folder is made if it is missing.
    workers
        Processes that make rooms; with more than one the calling script must be importable.

    Returns
    -------
    dict
        The card.

    Raises InputError: `out` is not an .onnx file, or an argument makes no sense.
    Raises MissingExtra: torch, onnx or embreex is not installed.
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
    learnt = with_other_sizes(with_wrong_names(train, rooms.seed), rooms.seed)
    model = train_srm(learnt, config, lambda done, loss: tell("epochs", done, config.epochs))
    training = {
        **asdict(config),
        "batch": config.batch_of(model.pairs),
        "pairs": model.pairs,
        "loss_by_epoch": [round(loss, 6) for loss in model.losses],
        "data_xxh3_128": model.data,
    }
    ranges = {**asdict(rooms), **_room_ranges(rooms), "scales": list(SCALES), "wrong_names": WRONG_NAMES}

    def calibrate(plain: OnnxScorer) -> dict[str, Platt]:
        logits = [plain.logits(frame.rows[config.features]) for frame in held_back]
        return fit_calibration(logits, [frame.truth for frame in held_back], DIRECTIONAL)

    return write_network(
        out,
        model,
        _command(out, rooms, config),
        calibrate,
        lambda scorer, plain: {
            "training": training,
            "rooms": ranges,
            "held_out": held_out_figures(scorer, plain, test),
        },
    )


def write_network(
    out: Path,
    model: TrainedModel,
    command: str,
    calibrate: Callable[[OnnxScorer], dict[str, Platt]],
    about: Callable[[OnnxScorer, OnnxScorer], dict[str, Any]],
    trained_on: TrainedOn | None = None,
) -> dict[str, Any]:
    """Write a calibrated network, its class vectors and its card, all of it or nothing; returns the card.

    `calibrate` is called with the bare network, `about` with the calibrated and the bare one: what else the card says.
    """
    with file_with_companions(out) as made:
        save_onnx(made, model)
        plain = OnnxScorer(made)
        calibration = calibrate(plain)
        save_onnx(made, model, calibration, trained_on)
        card = {
            "name": model.config.features,
            "command": command,
            "made_with": versions(),
            "file": {"bytes": made.stat().st_size, "xxh3_128": file_hash(made)},
            "weights_xxh3_128": model.weights_hash,
            "calibration": {relation: [round(v, 6) for v in ab] for relation, ab in calibration.items()},
            **about(OnnxScorer(made), plain),
        }
        made.with_suffix(".json").write_text(json.dumps(rounded(card), indent=1) + "\n", encoding="utf-8")
    return card


def network_path(out: Path) -> Path:
    """Path of a network to write; InputError unless an .onnx file."""
    out = Path(out)
    require(out.suffix.lower() == ".onnx" and not out.is_dir(), "the network is written as an .onnx file", path=out)
    return out


def held_out_figures(scorer: OnnxScorer, plain: OnnxScorer, frames: Sequence[FrameSamples]) -> dict[str, Any]:
    """Figures of a network, of the same without calibration, and of the rule, on unseen views."""
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
    return {"views": len(frames), "network": network, "rule": rule}


def _room_ranges(rooms: RoomConfig) -> dict[str, list[int]]:
    """First and last room seed of each part; calibrated on are scattered rooms, measured on furnished ones."""
    train, _, test = room_seeds(rooms.seed, rooms.rooms)
    scattered, calibration = scattered_seeds(rooms.seed, rooms.rooms)
    parts = {"train": train, "calibration": calibration, "test": test, "scattered": scattered}
    return {f"{name}_rooms": [part[0], part[-1]] for name, part in parts.items()}


def _command(out: Path, rooms: RoomConfig, config: TrainConfig) -> str:
    batch = "" if config.batch is None else f" --batch {config.batch}"
    of_rooms = f"--rooms {rooms.rooms} --views {rooms.views} --seed {rooms.seed}"
    size = f"--width {rooms.width} --height {rooms.height} --epochs {config.epochs} --members {config.members}{batch}"
    return f"spatialviz train rooms --out {out.name} {of_rooms} --features {cli_features(config.features)} {size}"


def versions() -> dict[str, str]:
    """Versions of this program, of Python and of the training packages."""
    packages = ("spatialviz", "numpy", "torch", "onnx", "onnxruntime", "embreex", "opencv-python-headless")
    return {"python": platform.python_version(), "machine": platform.machine(), **versions_of(*packages)}


def rounded(value: Any) -> Any:
    """Card with floats cut to six decimals."""
    if isinstance(value, dict):
        return {key: rounded(inside) for key, inside in value.items()}
    return round(float(value), 6) if isinstance(value, (float, np.floating)) else value


OPSET = 13
IR_VERSION = 8
"""Old enough for every ONNX Runtime this program accepts."""


def write_onnx(
    path: Path, layers: Sequence[tuple[np.ndarray, np.ndarray]], metadata: dict[str, str], producer: str = "spatialviz"
) -> None:
    """Write a network of dense layers with ReLU between: `features` (pairs, D) -> `logits` (pairs, R).

    Parameters
    ----------
    layers : sequence of (W, b)
        W is (inputs, outputs).

    Raises MissingExtra: the package onnx is not installed.
    """
    onnx = extra_module("onnx", "writing ONNX files", "train")
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
    """Save a trained network with the contract for `OnnxScorer`, and class vectors beside."""
    write_onnx(path, model.layers, replace(model.contract(calibration), trained_on=trained_on).metadata())
    if model.vectors is not None:
        vectors_path(path).write_bytes(model.vectors.content())


CLEAR_GAP_M = 0.10


def evaluate(
    probabilities: Sequence[np.ndarray], truth: Sequence[np.ndarray], rule: Sequence[np.ndarray] | None = None
) -> dict[str, Any]:
    """Evaluate a relation scorer.

    Parameters
    ----------
    probabilities : sequence of (N, N, 6) float
        Of each view, in the order of DIRECTIONAL.
    truth : sequence of (N, N, 6) int8
        Exact states.
    rule : sequence of (N, N, 6) int8, optional
        States of the noisy view; adds the cells on which it and the truth differ.

    Returns
    -------
    dict
        Figures by name, of each relation under `relations`; `all_negative_accuracy` is that of always saying no, and
        `differing` stands with `rule` only (see `differing_cells`). None where a figure has no meaning.
    """
    p, t = _cells(probabilities).astype(np.float64), _cells(truth).astype(np.int8)
    metrics, calibration = multi_label_metrics(p, t), calibration_metrics(p, t)
    relations = {
        name: {
            "precision": _defined(metrics.precision[k]),
            "recall": _defined(metrics.recall[k]),
            "f1": _defined(metrics.f1[k]),
            "positives": int(metrics.positives[k]),
        }
        for k, name in enumerate(DIRECTIONAL)
    }
    report: dict[str, Any] = {
        "pairs": metrics.pairs,
        "relations": relations,
        "micro_f1": _defined(metrics.micro_f1),
        "macro_f1": _defined(metrics.macro_f1),
        "element_accuracy": _defined(metrics.element_accuracy),
        "all_negative_accuracy": _defined(metrics.all_negative_accuracy),
        "positives_per_pair": _defined(ratio(metrics.positives.sum(), len(t))),
        "doubtful_share": _defined(ratio(metrics.undecided.sum(), t.size)),
        "brier": _defined(calibration.brier),
        "ece": _defined(calibration.diagram.ece),
    }
    if rule is not None:
        report["differing"] = differing_cells(p, t, _cells(rule))
    return report


def evaluate_classes(
    probabilities: Sequence[np.ndarray], truth: Sequence[np.ndarray], prior: Sequence[float], vocabulary: Sequence[str]
) -> dict[str, Any]:
    """Evaluate a softmax network (a single relation a pair).

    Parameters
    ----------
    probabilities : sequence of (N, N, R) float
        Of each view, softmax over the vocabulary, the prior not divided out.
    truth : sequence of (N, N) int
        Index of the one true relation; -1 for pairs that take no part.
    prior
        Share of each class in training.

    Returns
    -------
    dict
        `pairs`, `top1`, `top2`, `top1_prior_divided` (argmax of p / prior), `mean_recall` over classes that occur,
        `most_frequent` (what always saying the most frequent class gets), `log_loss`, `ece` of the probability of the
        answer, and `relations` (name -> precision, recall, f1, positives). None where a figure has no meaning.
    """
    p, t = labelled_pairs(probabilities, truth, len(vocabulary))
    metrics = single_label_metrics(p, t)
    weighted = p / np.asarray(prior, np.float64)
    divided = single_label_metrics(weighted / weighted.sum(axis=1, keepdims=True), t)
    holds = metrics.confusion.sum(axis=1)
    return {
        "pairs": metrics.pairs,
        "relations": {
            name: {
                "precision": _defined(metrics.precision[k]),
                "recall": _defined(metrics.recall[k]),
                "f1": _defined(metrics.f1[k]),
                "positives": int(holds[k]),
            }
            for k, name in enumerate(vocabulary)
        },
        "top1": _defined(metrics.top1),
        "top2": _defined(metrics.top2),
        "top1_prior_divided": _defined(divided.top1),
        "mean_recall": _defined(mean_of_defined(metrics.recall)),
        "most_frequent": _defined(ratio(holds.max(), metrics.pairs)),
        "log_loss": _defined(ratio(-np.log(np.maximum(p[np.arange(len(t)), t], 1e-12)).sum(), len(t))),
        "ece": _defined(expected_calibration_error(p.max(axis=1), p.argmax(axis=1) == t)),
    }


def _cells(views: Sequence[np.ndarray]) -> np.ndarray:
    """(pairs, 6) of all views, the diagonals left out."""
    rows = [view[~np.eye(len(view), dtype=np.bool_)] for view in views]
    return np.concatenate(rows) if rows else np.zeros((0, len(DIRECTIONAL)))


def _defined(figure: Any) -> float | None:
    return float(figure) if math.isfinite(figure) else None


def differing_cells(p: np.ndarray, truth: np.ndarray, rule: np.ndarray) -> dict[str, int]:
    """Cells, T or F in truth, with another state by the rule on the noisy view.

    Returns
    -------
    dict
        cells; errors (of the probabilities, by 0.5); rule_errors (by 0.5: a U
        counts as "no", which is right where the truth is F); rule_opposite (the
        rule says F for T or T for F).
    """
    cells = (truth != 0) & (rule != truth)
    holds = truth > 0
    return {
        "cells": int(cells.sum()),
        "errors": int((cells & ((p > 0.5) != holds)).sum()),
        "rule_errors": int((cells & ((rule > 0) != holds)).sum()),
        "rule_opposite": int((cells & (rule == -truth)).sum()),
    }


def clear_cut(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """Indisputable relation of each ordered pair.

    Parameters
    ----------
    lo, hi : (N, 3) float
        Exact extents along (right, up, forward), metres.

    Returns
    -------
    (N, N) int64
        Index in DIRECTIONAL of the relation along the axis of the largest gap, where it is over 10 cm; -1 elsewhere.
    """
    measured = measure_pairs(lo, hi)
    axis = np.abs(measured.gap).argmax(axis=2)
    gap = np.take_along_axis(measured.gap, axis[..., None], axis=2)[..., 0]
    of_axis = {RELATIONS[name].axis: k for k, name in enumerate(DIRECTIONAL)}
    negative, positive = (np.array([of_axis[k, side] for k in range(3)])[axis] for side in (-1, 1))
    return np.where(np.abs(gap) <= CLEAR_GAP_M, -1, np.where(gap > 0, positive, negative))


def clear_cut_report(
    probabilities: Sequence[np.ndarray], extents: Sequence[tuple[np.ndarray, np.ndarray]]
) -> dict[str, Any]:
    """Shares of clear-cut relations found likely (p > 0.5), doubted, or opposite.

    Returns
    -------
    dict
        clear_cut (their number), holds, doubted, opposite (shares of it; None where there is none).
    """
    asked, opposed = [], []
    for p, (lo, hi) in zip(probabilities, extents, strict=True):
        which = clear_cut(lo, hi)
        a, b = np.nonzero(which >= 0)
        asked.append(p[a, b, which[a, b]])
        opposed.append(p[b, a, which[a, b]])
    own, other = np.concatenate([*asked, []]), np.concatenate([*opposed, []])
    return {
        "clear_cut": len(own),
        "holds": _defined(ratio((own > 0.5).sum(), len(own))),
        "doubted": _defined(ratio((own == 0.5).sum(), len(own))),
        "opposite": _defined(ratio((other > 0.5).sum(), len(other))),
    }
