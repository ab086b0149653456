"""What the network learns from: rendered rooms, features as a sensor sees them, labels as geometry knows them.

The labels are the rule profile on the exact extents of the whole objects; the
features come from noisy depth through masks that are a little wrong. The
network therefore has to learn more than the rule: what a thing is like behind
the part of it that is seen.

It learns from furnished rooms and from scattered ones, seen by cameras of every kind; its probabilities are fitted
on other scattered rooms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np

from pipeline.geometry.camera import Camera
from pipeline.geometry.lifting import lift
from pipeline.geometry.masks import mask_box
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.relations.features import FEATURES, Appearance, FeatureSet
from pipeline.relations.relations import directional_states
from pipeline.synthetic import Instance, Room, choose_views, make_room, sense_view
from pipeline.synthetic.scattered import make_scattered, roaming_cameras
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.worker_pool import results_of

FIRST_ROOM = 500_000
ROOMS_A_SEED = 1_000_000
"""Room i of training seed s has the room seed s * ROOMS_A_SEED + FIRST_ROOM + i: none is a room of
`spatialviz render`, and so none is in the demo."""

MIN_PIXELS = 200
MIN_POINTS = 16
MASK_ERROR_PIXELS = (-2, 3)
"""Masks are eroded by up to 2 or dilated by up to 3 pixels."""

ROUGH_MASK_PIXELS, ROUGH_SHIFT_PIXELS = (-4, 4), 2
"""Of the rooms that are learnt from: also shifted, each way by up to this."""

STEREO_SHARE = 0.5
"""So many of the views that are learnt from have a stereo camera's steps of disparity added to their noise."""

Maker = Literal["furnished", "varied", "scattered"]
"""furnished: the rooms and cameras of `spatialviz render`. varied: those rooms, cameras, noise and masks of every kind.
scattered: `synthetic.scattered`, likewise."""

Job = tuple[int, int, int, int, Maker]
"""Seed, views, width, height and maker of a room."""

SCATTERED_A_ROOM = 5
"""Scattered rooms for each furnished one, to learn from and to calibrate on: they teach more of other makers' rooms."""

WRONG_NAMES = 0.1
"""So many of the things that are learnt from go by the name of another one: detectors and labels are wrong, too."""

SCALES = (0.2, 2.0)
"""Each training view is used a second time as a scene of another size: table tops are small rooms."""


@dataclass(frozen=True)
class FrameSamples:
    """The objects of one view, as seen and as they are."""

    room: int
    """Seed of the room."""
    rows: dict[str, np.ndarray]
    """dict of str to (N, K) float64: feature contract -> its description of each object, from the noisy view."""
    seen_lo: np.ndarray
    seen_hi: np.ndarray
    """(N, 3) float64: extents of the noisy points along (right, up, forward), metres."""
    exact_lo: np.ndarray
    exact_hi: np.ndarray
    """(N, 3) float64: extents of the whole objects."""

    @property
    def truth(self) -> np.ndarray:
        """(N, N, 6) int8 states of the exact extents, in the order of DIRECTIONAL."""
        return directional_states(self.exact_lo, self.exact_hi)

    @property
    def rule(self) -> np.ndarray:
        """(N, N, 6) int8 states by the rule on the noisy extents."""
        return directional_states(self.seen_lo, self.seen_hi)

    def scaled(self, factor: float) -> FrameSamples:
        """Same view of a scene `factor` times as large, without the sizes of names.

        Its labels are judged anew: the rule knows metres.
        """
        rows = {name: _scaled(FEATURES[name], described, factor) for name, described in self.rows.items()}
        extents = (e * factor for e in (self.seen_lo, self.seen_hi, self.exact_lo, self.exact_hi))
        return FrameSamples(self.room, rows, *extents)


def _scaled(contract: FeatureSet, rows: np.ndarray, factor: float) -> np.ndarray:
    column = np.arange(rows.shape[1])
    by = np.where(np.isin(column, contract.lengths), factor, 1.0)
    return rows * np.where(np.isin(column, contract.named), 0.0, by)


def with_wrong_names(samples: Sequence[FrameSamples], seed: int) -> tuple[FrameSamples, ...]:
    """Views with WRONG_NAMES of the things under another thing's name."""
    if not samples:
        return ()
    rng = np.random.default_rng([seed, 31])
    ends = np.cumsum([len(frame.seen_lo) for frame in samples])
    wrong = np.flatnonzero(rng.random(ends[-1]) < WRONG_NAMES)
    other = rng.integers(ends[-1], size=len(wrong))
    found = list(samples)
    for name, contract in ((name, contract) for name, contract in FEATURES.items() if contract.named):
        rows = np.concatenate([frame.rows[name] for frame in samples])
        columns = list(contract.named)
        rows[wrong[:, None], columns] = rows[other[:, None], columns]
        parts = np.split(rows, ends[:-1])
        found = [replace(frame, rows={**frame.rows, name: part}) for frame, part in zip(found, parts, strict=True)]
    return tuple(found)


def with_other_sizes(samples: Sequence[FrameSamples], seed: int) -> tuple[FrameSamples, ...]:
    """The views, and each again at a size drawn evenly in logarithm from SCALES."""
    rng = np.random.default_rng([seed, 23])
    factors = np.exp(rng.uniform(np.log(SCALES[0]), np.log(SCALES[1]), len(samples)))
    return (*samples, *(frame.scaled(float(k)) for frame, k in zip(samples, factors, strict=True)))


def make_samples(
    seeds: Sequence[int],
    *,
    views: int = 3,
    width: int = 480,
    height: int = 360,
    maker: Maker = "furnished",
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
) -> tuple[FrameSamples, ...]:
    """Samples of the rooms of these seeds.

    Parameters
    ----------
    seeds
        Room seeds.
    views
        Views of each room.
    width, height
        Pixels.
    maker
        See `Maker`.
    workers
        Processes; they are spawned. The samples do not depend on their number.
    progress
        Called with the number of rooms done.

    Raises InputError: an argument makes no sense.
    Raises MissingExtra: embreex is not installed.
    """
    require(
        views >= 1 and workers >= 1 and min(width, height) >= 16,
        "views and workers must be at least 1, a side at least 16 pixels",
    )
    jobs: list[Job] = [(seed, views, width, height, maker) for seed in seeds]
    tell = progress or (lambda done: None)
    found: list[FrameSamples] = []
    for k, samples in enumerate(results_of(_room_samples, jobs, workers), start=1):
        found += samples
        tell(k)
    return tuple(found)


def room_seeds(seed: int, rooms: int) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """Room seeds for training (7 in 10), calibration (1 in 10) and test (2 in 10), each at least a room.

    Rooms of different makers have the same seeds and nothing else in common.

    Raises InputError: fewer than three rooms, more than fit under one seed, or a negative seed.
    """
    require(
        3 <= rooms <= ROOMS_A_SEED - FIRST_ROOM,
        "training needs at least 3 rooms: to learn, to calibrate, to test",
        got=rooms,
    )
    require(seed >= 0, "a seed must not be negative", got=seed)
    first = seed * ROOMS_A_SEED + FIRST_ROOM
    seeds = tuple(range(first, first + rooms))
    test = max(1, round(rooms * 0.2))
    calibration = max(1, round(rooms * 0.1))
    train = rooms - test - calibration
    return seeds[:train], seeds[train : train + calibration], seeds[train + calibration :]


def scattered_seeds(seed: int, rooms: int) -> tuple[range, range]:
    """Seeds of the scattered rooms to learn from and to calibrate on."""
    train, calibration, _ = room_seeds(seed, rooms)
    middle = train[0] + SCATTERED_A_ROOM * rooms
    return range(train[0], middle), range(middle, middle + SCATTERED_A_ROOM * len(calibration))


def make_split(
    seed: int,
    rooms: int,
    *,
    views: int = 3,
    width: int = 480,
    height: int = 360,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[tuple[FrameSamples, ...], tuple[FrameSamples, ...], tuple[FrameSamples, ...]]:
    """Samples of rooms, split by room: to train, to calibrate, to test.

    Learnt from are furnished rooms of every kind of view, every second of them also as `spatialviz render` shows it,
    and scattered rooms; calibrated on are other scattered rooms; measured on furnished rooms as rendered.
    `progress` is called with (rooms done, rooms in all).
    """
    train, _, test = room_seeds(seed, rooms)
    scattered, calibration = scattered_seeds(seed, rooms)
    jobs: list[tuple[Sequence[int], Maker]] = [
        (train, "varied"),
        (train[::2], "furnished"),
        (scattered, "scattered"),
        (calibration, "scattered"),
        (test, "furnished"),
    ]
    total, done, parts = sum(len(seeds) for seeds, _ in jobs), 0, []
    tell = progress or (lambda done, of: None)
    for seeds, maker in jobs:
        parts.append(
            make_samples(
                seeds,
                views=views,
                width=width,
                height=height,
                maker=maker,
                workers=workers,
                progress=lambda count, before=done: tell(before + count, total),
            )
        )
        done += len(seeds)
    *learnt, held_back, measured = parts
    return tuple(frame for part in learnt for frame in part), held_back, measured


def _room_samples(job: Job) -> tuple[FrameSamples, ...]:
    return tuple(view_samples(room, camera, rng, rough=rough) for room, camera, rng, rough in views_of(job))


def views_of(job: Job) -> Iterator[tuple[Room, Camera, np.random.Generator, bool]]:
    """Views of a room, each with the generator of its errors, and whether those are rough."""
    seed, views, width, height, maker = job
    rng = np.random.default_rng([seed, 17])
    if maker == "scattered":
        room = make_scattered(seed)
        cameras = roaming_cameras(room, views, rng, width, height)
    else:
        room = make_room(seed)
        usual = 1 if maker == "varied" else views
        cameras = choose_views(room, usual, np.random.default_rng([seed, 11]), width, height)
        if maker == "varied":
            cameras = [varied_camera(camera, rng) for camera in cameras]
            cameras += roaming_cameras(room, views - usual, rng, width, height)
    for camera in cameras:
        yield room, camera, rng, maker != "furnished"


def varied_camera(camera: Camera, rng: np.random.Generator) -> Camera:
    """The camera turned by up to 8 degrees, tilted by up to 6, moved by up to 0.3 m in height, zoomed by 0.8 to 1.3."""
    assert camera.T_world_camera is not None
    T = camera.T_world_camera.copy()
    roll, pitch = np.deg2rad(rng.uniform(-8, 8)), np.deg2rad(rng.uniform(-6, 6))
    about_z = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    T[:3, :3] = T[:3, :3] @ about_x @ about_z
    T[2, 3] += rng.uniform(-0.3, 0.3)
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= rng.uniform(0.8, 1.3)
    return replace(camera, K=K, T_world_camera=T, up=T[:3, :3].T @ np.array([0.0, 0.0, 1.0]))


def view_samples(room: Room, camera: Camera, rng: np.random.Generator, *, rough: bool = False) -> FrameSamples:
    """Simulate one view by sensor and segmenter; the camera needs a pose and an up vector.

    `rough` is for learning: other sensors and worse segmenters now and then.
    """
    assert camera.up is not None
    depth, things, masks = sensed_things(room, camera, rng, rough)
    viewer = viewer_axes(camera.up)
    lifted = lift(depth, camera, masks, viewer, boxes=False)
    kept = [k for k, item in enumerate(lifted) if item.quality.points >= MIN_POINTS]
    shown = [things[k] for k in kept]
    boxes = np.array([mask_box(masks[k]) for k in kept], np.float64).reshape(-1, 4)
    seen = Appearance(boxes, tuple(instance.model.label for instance in shown), camera.width, camera.height)
    rows = {name: contract.describe([lifted[k] for k in kept], viewer, seen) for name, contract in FEATURES.items()}
    whole = np.array([_exact_extents(instance, camera, viewer) for instance in shown]).reshape(-1, 2, 3)
    return FrameSamples(room.seed, rows, rows["rel14"][:, :3], rows["rel14"][:, 3:], whole[:, 0], whole[:, 1])


def sensed_things(
    room: Room, camera: Camera, rng: np.random.Generator, rough: bool
) -> tuple[np.ndarray, list[Instance], list[np.ndarray]]:
    """Noisy depth, (H, W) float32 metres, the things seen, and the mask of each, (H, W) bool, a little wrong."""
    depth, instances = sense_view(room, camera, rng)
    if rough and rng.random() < STEREO_SHARE:
        depth = _in_steps(depth, rng)
    numbers = np.flatnonzero(np.bincount(instances[instances >= 0], minlength=1) >= MIN_PIXELS)
    spoilt = _roughened if rough else degraded
    masks = [spoilt(instances == number, rng) for number in numbers]
    return depth, [room.instances[number] for number in numbers], masks


def _in_steps(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    product, step = rng.uniform(30, 60), float(rng.choice([4, 8, 16]))
    disparity = product / np.maximum(depth, 0.1) + rng.normal(0, rng.uniform(0.02, 0.15), depth.shape)
    stepped = product / np.maximum(np.round(disparity * step) / step, 0.5)
    return np.where(depth > 0, stepped, 0).astype(np.float32)


def degraded(mask: np.ndarray, rng: np.random.Generator, error: tuple[int, int] = MASK_ERROR_PIXELS) -> np.ndarray:
    """Degrade a mask ((H, W) bool) as a segmenter would: a little too small, or a little too large."""
    pixels = int(rng.integers(error[0], error[1] + 1))
    if pixels == 0:
        return mask
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(pixels) + 1,) * 2)
    changed = (cv2.dilate if pixels > 0 else cv2.erode)(mask.view(np.uint8), kernel).view(np.bool_)
    # A thin thing would vanish; a segmenter that finds it finds something.
    return changed if changed.sum() >= MIN_PIXELS // 2 else mask


def _roughened(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A worse mask: of a larger error, and shifted."""
    changed = degraded(mask, rng, ROUGH_MASK_PIXELS)
    x, y = rng.integers(-ROUGH_SHIFT_PIXELS, ROUGH_SHIFT_PIXELS + 1, 2)
    shift = np.array([[1, 0, x], [0, 1, y]], np.float64)
    # What the border cuts goes on behind it.
    size = (mask.shape[1], mask.shape[0])
    plain, nearest = changed.view(np.uint8), cv2.INTER_NEAREST
    return cv2.warpAffine(plain, shift, size, flags=nearest, borderMode=cv2.BORDER_REPLICATE).view(np.bool_)


def _exact_extents(instance: Instance, camera: Camera, viewer: ViewerAxes) -> tuple[np.ndarray, np.ndarray]:
    assert camera.T_world_camera is not None
    vertices = np.concatenate([part.vertices for part in instance.model.parts]) @ instance.R.T + instance.position
    level = (vertices - camera.T_world_camera[:3, 3]) @ camera.T_world_camera[:3, :3] @ viewer.matrix.T
    return level.min(axis=0), level.max(axis=0)


def iterate_pairs(samples: Sequence[FrameSamples], name: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(P, D) features and (P, 6) true states of the pairs of each view."""
    for frame in samples:
        apart = ~np.eye(len(frame.seen_lo), dtype=np.bool_)
        if apart.any():
            yield FEATURES[name].pair(frame.rows[name])[apart], frame.truth[apart]
