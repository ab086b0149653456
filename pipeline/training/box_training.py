"""Training of the network that completes boxes, on rendered rooms: seen boxes beside the exact ones of whole things."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.whole_boxes import (
    COLUMNS,
    CONTRACT,
    LENGTHS,
    NAMED,
    QUANTILES,
    SHARPNESS,
    BoxNetwork,
    can_complete,
    complete,
    describe,
    measured_sides,
    side_units,
)
from pipeline.geometry.boxes import Box3D, iou_3d
from pipeline.geometry.camera import Camera
from pipeline.geometry.fitting import canonicalised
from pipeline.geometry.lifting import LiftedObject, lift
from pipeline.geometry.viewer import viewer_axes
from pipeline.language.class_sizes import is_thin, size_range
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import file_hash
from pipeline.system.whole_files import file_with_companions
from pipeline.system.worker_pool import one_thread, results_of
from pipeline.training.card import Progress, network_path, rounded, versions, write_onnx
from pipeline.training.train import deterministic, forward, need_torch, require_training
from pipeline.training.training_data import MIN_POINTS, SCALES, Job, Maker, room_seeds, sensed_things, views_of

WRONG_NAMES, NO_NAMES, OTHER_SIZES = 0.1, 0.1, 0.25
"""Shares of things that go by another's name, by none, and that are scaled by SCALES, which leaves them no name."""
NOISE, GUISES = 0.3, 3
"""Deviation of what is added to each standardised input, and how often an epoch shows each thing so: rooms of other
makers are not like these."""
FARTHEST = 6.0
"""Offsets beyond count as this, in a side's units."""
COVERAGE = 0.8
FIT_WEIGHT, INTERVAL_WEIGHT = 0.05, 0.2
"""Weights of the loss of offsets and of the two quantiles beside 1 - IoU."""
SCATTERED_A_ROOM, CALIBRATION_SHARE = 4, 8
"""Scattered rooms for each furnished one; every so manyth is calibrated on."""


@dataclass(frozen=True)
class BoxTraining:
    """How the network is made."""

    rooms: int = 230  # Furnished ones: 7 in 10 to learn from, 2 to measure
    views: int = 4
    width: int = 480
    height: int = 360
    hidden: int = 128
    epochs: int = 10
    batch: int = 512
    learning_rate: float = 2e-3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class BoxSamples:
    """Seen things as the network is told of them, and as they are."""

    rows: np.ndarray  # (N, F) float64: COLUMNS
    size: np.ndarray  # (N, 3): of the seen boxes, metres
    unit: np.ndarray  # (N, 6): metres of an offset of 1
    free: np.ndarray  # (N, 6) bool: sides that are not measured
    offsets: np.ndarray  # (N, 6): of the exact sides, outwards
    figures: np.ndarray  # (N, 3): IoU with the exact box: of the seen box, of the oracle, by the size of names


def exact_in(seen: Box3D, exact: Box3D) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper ends of the exact box, (3,) each, along the seen box's axes, after renaming its own to them."""
    along = canonicalised(Box3D(seen.R.T @ exact.center, seen.R.T @ exact.R, exact.size))
    return along.center - along.size / 2, along.center + along.size / 2


def resized(seen: Box3D, size: np.ndarray) -> Box3D:
    """Box of another size, (3,) metres, whose nearer side along each axis stays."""
    center = seen.center @ seen.R
    near = np.where(center >= 0, center - seen.size / 2, center + seen.size / 2)
    return Box3D(seen.R @ (near + np.where(center >= 0, size, -size) / 2), seen.R, size)


def sized_by_name(seen: Box3D, label: str) -> Box3D:
    """Box as long as things of its class are on the geometric mean, where the seen one is shorter."""
    known = size_range(label)
    factor = 1.0 if known is None else max(1.0, float(np.sqrt(known[0] * known[1])) / max(float(seen.size.max()), 1e-3))
    return resized(seen, seen.size * factor)


def samples_of(
    items: Sequence[LiftedObject], labels: Sequence[str], exact: Sequence[Box3D], depth: np.ndarray, camera: Camera
) -> BoxSamples:
    """Samples of the objects of a view that `can_complete`."""
    rows = describe(items, labels, depth, camera)
    boxes = [o.box for o in items if o.box is not None]
    ends = [(b.center @ b.R, *exact_in(b, e)) for b, e in zip(boxes, exact, strict=True)]
    size = np.array([b.size for b in boxes]).reshape(-1, 3)
    unit = np.array([side_units(b) for b in boxes]).reshape(-1, 6)
    outwards = np.array([np.stack([c - lo, hi - c], axis=1).ravel() for c, lo, hi in ends]).reshape(-1, 6)
    figures = [
        (iou_3d(b, e), iou_3d(resized(b, hi - lo), e), iou_3d(sized_by_name(b, n), e))
        for b, e, n, (_, lo, hi) in zip(boxes, exact, labels, ends, strict=True)
    ]
    free = np.array([~measured_sides(o) for o in items]).reshape(-1, 6)
    offsets = (outwards - np.repeat(size, 2, axis=1) / 2) / unit
    return BoxSamples(rows, size, unit, free, offsets, np.array(figures).reshape(-1, 3))


def joined(parts: Sequence[BoxSamples]) -> BoxSamples:
    """Samples of several views as one."""
    names = ("rows", "size", "unit", "free", "offsets", "figures")
    return BoxSamples(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def seen_things(job: Job) -> Iterator[tuple[list[LiftedObject], list[str], list[Box3D], np.ndarray, Camera]]:
    """Things of each view of a room that can be completed, with names, exact boxes, depth and camera."""
    for room, camera, rng, rough in views_of(job):
        assert camera.up is not None
        assert camera.T_world_camera is not None
        depth, things, masks = sensed_things(room, camera, rng, rough)
        labels = [thing.model.label for thing in things]
        items = lift(depth, camera, masks, viewer_axes(camera.up), thin=[is_thin(n) for n in labels])
        kept = [k for k, o in enumerate(items) if can_complete(o) and o.quality.points >= MIN_POINTS]
        T = np.linalg.inv(camera.T_world_camera)
        exact = [things[k].box.transformed(T) for k in kept]
        yield [items[k] for k in kept], [labels[k] for k in kept], exact, depth, camera


def room_samples(job: Job) -> BoxSamples:
    """Samples of all views of a room."""
    return joined([samples_of(*view) for view in seen_things(job)])


def mirrored(samples: BoxSamples) -> BoxSamples:
    """Samples of the views in a mirror."""
    swapped, sign = np.arange(len(COLUMNS)), np.ones(len(COLUMNS))
    pairs = [(name, name.replace("left", "right")) for name in COLUMNS if "left" in name]
    for names in (*pairs, ("points_0.1_right", "points_0.9_right")):
        i, j = map(COLUMNS.index, names)
        swapped[[i, j]] = j, i
    sign[[COLUMNS.index(name) for name in ("towards_right", *(f"points_{q}_right" for q in QUANTILES))]] = -1
    other = [1, 0, 2, 3, 4, 5]
    sides = {"free": samples.free[:, other], "offsets": samples.offsets[:, other]}
    return replace(samples, rows=samples.rows[:, swapped] * sign, **sides)


def with_wrong_names(rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Inputs, (N, F), of which WRONG_NAMES have those of another thing's name."""
    known, *logarithms = map(COLUMNS.index, NAMED)
    wrong = np.flatnonzero(rng.random(len(rows)) < WRONG_NAMES)
    other, longest = rng.integers(len(rows), size=len(wrong)), COLUMNS.index("log_longest")
    found = rows.copy()
    found[wrong, known] = rows[other, known]
    for column in logarithms:
        shift = (rows[other, longest] - rows[wrong, longest]) * rows[other, known]
        found[wrong, column] = rows[other, column] + shift
    return found


@dataclass(frozen=True, eq=False)
class TrainedBoxes:
    """A network of dense layers, and the scale of its inputs."""

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    mean: np.ndarray
    std: np.ndarray
    loss: float

    def write(self, path: Path) -> None:
        """Write the ONNX file that `BoxNetwork` reads."""
        told = {"contract": CONTRACT, "columns": json.dumps(COLUMNS)}
        scale = {"mean": json.dumps(self.mean.tolist()), "std": json.dumps(self.std.tolist())}
        write_onnx(path, self.layers, {f"box.{name}": value for name, value in {**told, **scale}.items()})


def train_boxes(
    samples: BoxSamples, config: BoxTraining, progress: Callable[[int], None] | None = None
) -> TrainedBoxes:
    """Train on samples: 1 - IoU along the seen axes, offsets, and two quantiles of each side.

    Raises InputError: there is nothing to learn from. Raises MissingExtra: torch is not installed.
    """
    torch = need_torch()
    require(len(samples.rows) >= 2, "there are no things to learn from", got=len(samples.rows))
    samples = replace(samples, rows=with_wrong_names(samples.rows, np.random.default_rng([config.seed, 31])))
    samples = joined([samples, mirrored(samples)])
    mean, std = samples.rows.mean(axis=0), samples.rows.std(axis=0) + 1e-3
    named, lengths = ([COLUMNS.index(name) for name in names] for names in (NAMED, LENGTHS))
    arrays = (
        (samples.rows - mean) / std,
        np.clip(samples.offsets, -1, FARTHEST),
        samples.free,
        samples.size,
        samples.unit,
    )
    spans = np.log(SCALES)
    with deterministic(torch):
        x, y, free, size, unit = (torch.from_numpy(np.ascontiguousarray(a, np.float32)) for a in arrays)
        unnamed = torch.from_numpy((-mean[named] / std[named]).astype(np.float32))
        widths = torch.from_numpy(std[lengths].astype(np.float32))
        generator = torch.Generator().manual_seed(config.seed)
        sizes = (x.shape[1], config.hidden, config.hidden, 18)
        weights = [
            (torch.randn(i, o, generator=generator) * (2.0 / i) ** 0.5).requires_grad_() for i, o in pairwise(sizes)
        ]
        # So that at first nothing is completed.
        weights[-1].data *= 0.1
        biases = [torch.zeros(o, requires_grad=True) for o in sizes[1:]]
        optimiser = torch.optim.AdamW([*weights, *biases], lr=config.learning_rate, weight_decay=1e-5)
        steps = config.epochs * GUISES * -(-len(x) // config.batch)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, config.learning_rate, total_steps=steps)
        total = 0.0
        for epoch in range(1, config.epochs + 1):
            total = 0.0
            orders = [torch.randperm(len(x), generator=generator) for _ in range(GUISES)]
            for rows in (part for order in orders for part in order.split(config.batch)):
                given, chance = x[rows], torch.rand(len(rows), generator=generator)
                given[:, named] = torch.where((chance < NO_NAMES + OTHER_SIZES)[:, None], unnamed, given[:, named])
                factor = torch.empty(len(rows)).uniform_(*spans, generator=generator) * (chance < OTHER_SIZES)
                given[:, lengths] += factor[:, None] / widths
                given = given + NOISE * torch.randn(given.shape, generator=generator)
                raw = forward(torch, given, weights, biases).reshape(-1, 3, 6)
                estimate = torch.nn.functional.softplus(raw[:, 0] * SHARPNESS) / SHARPNESS * free[rows]
                loss = 1 - _overlap(torch, size[rows], unit[rows], estimate, y[rows]).mean()
                loss = loss + FIT_WEIGHT * torch.nn.functional.smooth_l1_loss(estimate, y[rows])
                for k, level in ((1, (1 - COVERAGE) / 2), (2, (1 + COVERAGE) / 2)):
                    error = y[rows] - raw[:, k]
                    loss = loss + INTERVAL_WEIGHT * torch.maximum(level * error, (level - 1) * error).mean()
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                schedule.step()
                total += float(loss.detach()) * len(rows) / (GUISES * len(x))
            if progress is not None:
                progress(epoch)
        layers = tuple(
            (w.detach().numpy().copy(), b.detach().numpy().copy()) for w, b in zip(weights, biases, strict=True)
        )
    return TrainedBoxes(layers, mean, std, total)


def _overlap(torch: Any, size: Any, unit: Any, found: Any, true: Any) -> Any:
    """IoU, (N,), of boxes along the same axes, by outward offsets from the seen one."""

    def grown(offsets: Any) -> Any:
        added = (offsets * unit).reshape(-1, 3, 2).sum(dim=2)
        return torch.clamp(size + added, min=1e-4).prod(dim=1)

    shared = grown(torch.minimum(found, true))
    return shared / (grown(found) + grown(true) - shared)


def calibrated(model: TrainedBoxes, offsets: Callable[[TrainedBoxes], np.ndarray], held: BoxSamples) -> TrainedBoxes:
    """Network whose intervals are as many times as wide as makes COVERAGE of the held-back sides lie in them.

    `offsets`: the network's offsets, (N, 3, 6), of the held-back samples.
    """

    def scaled(factor: float) -> TrainedBoxes:
        # The ends are linear in the last layer: drawn to their middle there.
        keep, cross = (1 + factor) / 2, (1 - factor) / 2
        mix = np.array([[1, 0, 0], [0, keep, cross], [0, cross, keep]], np.float32)
        *first, (w, b) = model.layers
        last = np.einsum("hqs,rq->hrs", w.reshape(-1, 3, 6), mix).reshape(w.shape), mix @ b.reshape(3, 6)
        return replace(model, layers=(*first, (last[0], last[1].ravel())))

    low, high = 0.2, 3.0
    for _ in range(12):
        factor = (low + high) / 2
        low, high = (factor, high) if covered(offsets(scaled(factor)), held) < COVERAGE else (low, factor)
    return scaled((low + high) / 2)


def covered(offsets: np.ndarray, samples: BoxSamples) -> float:
    """Share of the sides that are not measured whose exact place lies in its interval."""
    inside = (offsets[:, 1] <= samples.offsets) & (samples.offsets <= offsets[:, 2])
    return float(inside[samples.free].mean()) if samples.free.any() else float("nan")


def figures_of(
    views: Iterable[tuple[list[LiftedObject], list[str], list[Box3D], np.ndarray, Camera]], network: BoxNetwork
) -> dict[str, float]:
    """Figures of completed boxes of views: mean IoU beside those of the seen ones, by the size of names, and of the
    oracle; share of the gap to the oracle that is closed; share of the sides within their intervals.
    """
    ious, parts = [], []
    for items, labels, exact, depth, camera in views:
        found = complete(items, labels, depth, camera, network)
        ious += [iou_3d(c.box, e) for c, e in zip(found, exact, strict=True) if c is not None]
        parts.append(samples_of(items, labels, exact, depth, camera))
    samples = joined(parts)
    seen, oracle, by_name = samples.figures.mean(axis=0).tolist()
    completed = float(np.mean(ious))
    return {
        "things": len(ious),
        "seen": seen,
        "by_name": by_name,
        "completed": completed,
        "oracle": oracle,
        "gap_closed": (completed - seen) / (oracle - seen),
        "coverage": covered(network.offsets(samples.rows), samples),
    }


def train_box_network(
    out: Path, config: BoxTraining | None = None, *, workers: int = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Render rooms, train on some, calibrate on others, measure on the rest; writes `out` and its card (.json) beside.

    Returns the card. Errors as of `train_on_rooms`.
    """
    with one_thread():
        return _train_box_network(network_path(out), config or BoxTraining(), workers, progress or (lambda *_: None))


def _train_box_network(out: Path, config: BoxTraining, workers: int, tell: Progress) -> dict[str, Any]:
    require(
        min(config.views, config.hidden, config.epochs, config.batch, workers) >= 1
        and min(config.width, config.height) >= 16
        and config.learning_rate > 0,
        "views, width, batch, epochs, learning rate and workers must be positive, a side at least 16 pixels",
        got=config,
    )
    require_training()
    train, calibration, test = room_seeds(config.seed, config.rooms)
    scattered = range(train[0], train[0] + SCATTERED_A_ROOM * len(train))
    held = scattered[::CALIBRATION_SHARE]
    made: list[tuple[Maker, Sequence[int]]] = [
        ("varied", train),
        ("scattered", [seed for seed in scattered if seed not in held]),
        ("varied", calibration),
        ("scattered", held),
    ]
    total, done, parts = sum(len(seeds) for _, seeds in made), 0, []
    for maker, seeds in made:
        found = []
        for part in results_of(room_samples, [_job(config, seed, maker) for seed in seeds], workers):
            found.append(part)
            done += 1
            tell("rooms", done, total)
        parts.append(joined(found))
    learnt, held_back = parts[:2], joined(parts[2:])
    model = train_boxes(joined(learnt), config, lambda epoch: tell("epochs", epoch, config.epochs))
    with file_with_companions(out) as path:

        def offsets(network: TrainedBoxes) -> np.ndarray:
            network.write(path)
            return BoxNetwork(path).offsets(held_back.rows)

        model = calibrated(model, offsets, held_back)
        model.write(path)
        network = BoxNetwork(path)
        figures = {
            "furnished rooms of other seeds": figures_of(_views(config, test, "furnished"), network),
            "scattered rooms that intervals are fitted on": figures_of(_views(config, held, "scattered"), network),
        }
        card = {
            "name": out.stem,
            "command": f"spatialviz train boxes --out {out.name} --rooms {config.rooms} --views {config.views} "
            f"--seed {config.seed} --width {config.width} --height {config.height} --epochs {config.epochs}",
            "training": {**asdict(config), "things": sum(len(part.rows) for part in learnt), "loss": model.loss},
            "rooms": {
                "varied": [train[0], train[-1]],
                "scattered": [scattered[0], scattered[-1]],
                "calibration": [calibration[0], calibration[-1], f"and every {CALIBRATION_SHARE}th scattered one"],
                "test": [test[0], test[-1]],
            },
            "held_out": figures,
            "versions": versions(),
            "file_xxh3_128": file_hash(path),
        }
        path.with_suffix(".json").write_text(json.dumps(rounded(card), indent=1) + "\n", encoding="utf-8")
    return rounded(card)


def _job(config: BoxTraining, seed: int, maker: Maker) -> Job:
    return seed, config.views, config.width, config.height, maker


def _views(
    config: BoxTraining, seeds: Sequence[int], maker: Maker
) -> Iterator[tuple[list[LiftedObject], list[str], list[Box3D], np.ndarray, Camera]]:
    return (view for seed in seeds for view in seen_things(_job(config, seed, maker)) if view[0])
