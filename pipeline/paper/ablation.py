"""Feature contracts compared on rendered rooms: how many pairs each needs, and what other cameras cost it.

Rooms to learn from and rooms to measure on are never the same. The rooms that are measured on are seen twice: by a
robot's cameras, as the training rooms are, and from other heights, tilts and rolls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from pathlib import Path

import numpy as np

from pipeline.geometry.camera import Camera
from pipeline.language.relation_names import DIRECTIONAL, HORIZONTAL
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, f1_of
from pipeline.metrics.relation_metrics import cell_outcomes
from pipeline.metrics.tables import Row, Table
from pipeline.relations.features import FEATURES, cli_features
from pipeline.relations.model import OnnxScorer
from pipeline.relations.scorer import rule_probabilities
from pipeline.synthetic import choose_views, make_room
from pipeline.synthetic.render import camera_at
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import scratch_folder
from pipeline.system.worker_pool import results_of
from pipeline.training.card import save_onnx
from pipeline.training.label_data import PairSet
from pipeline.training.train import TrainConfig, require_training, train_pairs
from pipeline.training.training_data import FIRST_ROOM, ROOMS_A_SEED, FrameSamples, view_samples

HEIGHTS_M, PITCHES_DEG, ROLLS_DEG = (0.7, 2.2), (-2.0, 35.0), (-15.0, 15.0)
"""Of the other cameras."""
TEST_SHARE = 1 / 3
FIRST_ABLATION_ROOM = FIRST_ROOM + 300_000
"""Far from the rooms that `train rooms` uses under the same seed."""


@dataclass(frozen=True)
class AblationConfig:
    """What is compared."""

    # rooms, views, width, height: one room in three is measured on
    rooms: int = 120
    views: int = 2
    width: int = 480
    height: int = 360
    pairs: tuple[int, ...] = (1000, 0)  # numbers of training pairs; 0 for all
    features: tuple[str, ...] = ("geom2d8", "paper30", "rel14")  # feature contracts
    networks: int = 3  # of each variant, with seeds and pairs of their own; their answers are counted together
    train: TrainConfig = field(default_factory=TrainConfig)

    def check(self) -> None:
        """Raise InputError where the numbers make no sense."""
        self.train.check()
        require(
            self.rooms >= 3 and min(self.views, self.networks) >= 1 and min(self.width, self.height) >= 16,
            "a comparison needs 3 rooms, a view, a network, and sides of 16 pixels",
            got=self,
        )
        require(
            self.pairs and not any(n != 0 and n < 2 for n in self.pairs),
            "there must be at least two pairs to learn from, or 0 for all",
            got=self.pairs,
        )
        unknown = [name for name in self.features if name not in FEATURES]
        require(
            not unknown and self.features,
            "no such feature contract",
            got=repr(unknown[:1]),
            expected=", ".join(FEATURES),
        )


@dataclass(frozen=True)
class AblationViews:
    """Rooms to learn from, other rooms, and those from other cameras; a tuple of views a room."""

    train: tuple[tuple[FrameSamples, ...], ...]
    test: tuple[tuple[FrameSamples, ...], ...]
    shifted: tuple[tuple[FrameSamples, ...], ...]


def other_camera(camera: Camera, rng: np.random.Generator) -> Camera:
    """A camera at the same place of the floor and in the same direction, from another height, tilted and rolled."""
    assert camera.T_world_camera is not None
    forward, position = camera.T_world_camera[:3, 2], camera.T_world_camera[:3, 3].copy()
    position[2] = rng.uniform(*HEIGHTS_M)
    pitch, roll = (float(np.deg2rad(rng.uniform(*limits))) for limits in (PITCHES_DEG, ROLLS_DEG))
    return camera_at(position, float(np.arctan2(forward[1], forward[0])), pitch, roll, camera.width, camera.height)


def ablation_views(
    config: AblationConfig, *, workers: int = 1, progress: Callable[[int, int], None] | None = None
) -> AblationViews:
    """Render the rooms, whatever the `workers`; `progress` is called with (rooms done, of how many).

    Raises InputError: a number of `config` is out of range.
    Raises MissingExtra: embreex is not installed.
    """
    config.check()
    first = config.train.seed * ROOMS_A_SEED + FIRST_ABLATION_ROOM
    test = max(1, round(config.rooms * TEST_SHARE))
    train = config.rooms - test
    jobs = [(first + k, config.views, config.width, config.height, k >= train) for k in range(config.rooms)]
    found = []
    tell = progress or (lambda done, of: None)
    for samples in results_of(_room, jobs, workers):
        found.append(samples)
        tell(len(found), len(jobs))
    usual = tuple(room for room, _ in found)
    return AblationViews(usual[:train], usual[train:], tuple(room for _, room in found[train:]))


def _room(job: tuple[int, int, int, int, bool]) -> tuple[tuple[FrameSamples, ...], tuple[FrameSamples, ...]]:
    """Views of a room, for a measured room also the views of the other cameras."""
    seed, views, width, height, measured = job
    room = make_room(seed)
    cameras = choose_views(room, views, np.random.default_rng([seed, 11]), width, height)
    rng, again = np.random.default_rng([seed, 17]), np.random.default_rng([seed, 17])
    others = [other_camera(camera, again) for camera in cameras] if measured else []
    return (
        tuple(view_samples(room, camera, rng) for camera in cameras),
        tuple(view_samples(room, camera, again) for camera in others),
    )


@dataclass(frozen=True)
class Variant:
    """A feature contract with a number of training pairs, measured."""

    features: str  # "rule" for the bare rule on what is seen
    pairs: int | None
    # counts (rooms, 2, 6, 3) float64: true positives, false positives and false negatives of each relation of
    # DIRECTIONAL, seen by the usual cameras and by the others, by room
    counts: np.ndarray

    def figures(self, other: Variant | None = None, config: BootstrapConfig | None = None) -> list[Estimate]:
        """Micro-F1 by the usual cameras, by others, the loss; F1 of front and behind by the usual cameras, by others.

        Resampled are rooms. With `other` the figures are paired differences, of `self` less `other`.
        """
        second = None if other is None else other.counts
        return bootstrap(self.counts, np.arange(len(self.counts)), _figures, other=second, config=config)


COLUMNS = ("micro-F1", "other cameras", "loss", "front/behind F1", "front/behind F1, other cameras")


def _figures(sums: np.ndarray) -> np.ndarray:
    """(S, 5) of sums (S, 2, 6, 3)."""
    micro = f1_of(*np.moveaxis(sums.sum(axis=2), -1, 0))
    depth = [DIRECTIONAL.index(name) for name, (axis, _) in HORIZONTAL.items() if axis == 2]
    apart = f1_of(*np.moveaxis(sums[:, :, depth], -1, 0)).mean(axis=2)
    return np.stack([*micro.T, micro[:, 0] - micro[:, 1], *apart.T], axis=1)


def measure_variant(views: AblationViews, features: str, pairs: int, config: AblationConfig) -> Variant:
    """Train `config.networks` networks of these features on so many pairs (0 for all), and measure them.

    Raises InputError: there are fewer pairs.
    Raises MissingExtra: torch or onnx is not installed.
    """
    require_training()
    everything = _pairs(views, features)
    require(
        pairs <= len(everything),
        "there are not so many pairs to learn from",
        got=pairs,
        expected=f"at most {len(everything)}",
    )
    counts = np.zeros((len(views.test), 2, len(DIRECTIONAL), 3))
    for k in range(config.networks):
        seed = config.train.seed + k
        chosen = everything
        if pairs:
            drawn = np.random.default_rng([seed, 29]).choice(len(everything), pairs, replace=False)
            chosen = everything.take(np.sort(drawn))
        model = train_pairs(chosen, replace(config.train, features=features, seed=seed))
        with scratch_folder() as folder:
            save_onnx(Path(folder) / "network.onnx", model)
            scorer = OnnxScorer(Path(folder) / "network.onnx")
        counts += _counts(views, lambda frame, s=scorer: s.probabilities(frame.rows[features]))
    return Variant(features, pairs, counts)


def measure_rule(views: AblationViews) -> Variant:
    """Measure the bare rule on the visible surfaces, the upper bound of a network trained on the rule."""
    return Variant("rule", None, _counts(views, lambda frame: rule_probabilities(frame.rule)))


def ablation_table(variants: Sequence[Variant], test_rooms: int, config: BootstrapConfig | None = None) -> Table:
    """Every variant, and the lead of 3D features over 2D with as many pairs."""
    rows = [Row(_name(v), tuple(v.figures(config=config))) for v in variants]
    flat = {v.pairs: v for v in variants if v.features == "geom2d8"}
    for v in variants:
        other = flat.get(v.pairs)
        if other is not None and v is not other:
            rows.append(Row(f"{_name(v)}, less 2d", tuple(v.figures(other, config))))
    return Table(
        "ablation-exact",
        "Feature contracts on rendered rooms",
        COLUMNS,
        tuple(rows),
        "Percent. Labels: the rule on the exact extents of whole objects. "
        f"Other cameras: {HEIGHTS_M[0]} to {HEIGHTS_M[1]} m high, pitch "
        f"{PITCHES_DEG[0]:.0f} to {PITCHES_DEG[1]:.0f}°, roll up to {ROLLS_DEG[1]:.0f}°. Brackets: 95 % bootstrap "
        f"intervals over {test_rooms} rooms that were not learnt from.",
    )


def compare_features(
    config: AblationConfig | None = None,
    *,
    workers: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> Table:
    """Render, train and measure every variant; `progress` is called with (step, done, of how much).

    Raises InputError: a number of `config` is out of range.
    Raises MissingExtra: torch, onnx or embreex is not installed.
    """
    config = config or AblationConfig()
    config.check()
    require_training()
    tell = progress or (lambda what, done, of: None)
    views = ablation_views(config, workers=workers, progress=lambda done, of: tell("rooms", done, of))
    variants = [measure_rule(views)]
    asked = [(features, pairs) for pairs in config.pairs for features in config.features]
    for k, (features, pairs) in enumerate(asked, start=1):
        variants.append(measure_variant(views, features, pairs, config))
        tell("variants", k, len(asked))
    return ablation_table(variants, len(views.test))


def _name(variant: Variant) -> str:
    if variant.pairs is None:
        return variant.features
    return f"{cli_features(variant.features)}, {f'{variant.pairs:,}' if variant.pairs else 'all'} pairs"


def _pairs(views: AblationViews, features: str) -> PairSet:
    """Join all training pairs with a known state."""
    values, states = [], []
    for frame in (frame for room in views.train for frame in room):
        apart = ~np.eye(len(frame.seen_lo), dtype=np.bool_)
        values.append(FEATURES[features].pair(frame.rows[features])[apart])
        states.append(frame.truth[apart])
    found = PairSet(np.concatenate(values).astype(np.float32), np.concatenate(states))
    return found.take(found.learnable("sigmoid"))


def _counts(views: AblationViews, scored: Callable[[FrameSamples], np.ndarray]) -> np.ndarray:
    """(rooms, 2, 6, 3): see `Variant`."""
    found = np.zeros((len(views.test), 2, len(DIRECTIONAL), 3))
    for side, rooms in enumerate((views.test, views.shifted)):
        for k, room in enumerate(rooms):
            for frame in room:
                apart = ~np.eye(len(frame.seen_lo), dtype=np.bool_)
                cells = cell_outcomes(scored(frame)[apart], frame.truth[apart])
                found[k, side] += np.stack([cells.tp, cells.fp, cells.fn], axis=-1).sum(axis=0)
    return found
