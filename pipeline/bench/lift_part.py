"""Lifting and relations, beside what others compute them with, on the same masks and depth in one process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.bench.clock import Figure, Setup, least, side_by_side
from pipeline.geometry import Camera, ViewerAxes, backproject, depth_edges, extents_of, lift, viewer_axes
from pipeline.labels.profiles import judge_viewer_cone
from pipeline.language import DIRECTIONAL
from pipeline.synthetic import choose_views, exact_view, make_room, sense
from pipeline.system.worker_pool import one_thread
from pipeline.training.training_data import MIN_PIXELS, degraded

WIDTH, HEIGHT, VIEWS_A_ROOM = 640, 480, 3
FIRST_ROOM = 7_000_000
"""Rooms of these seeds are in no dataset and in no training set."""
PAIRED = 60
"""Objects whose pairs are counted."""


@dataclass(frozen=True)
class BenchView:
    """A sensed view with the truth of its visible surfaces.

    Attributes
    ----------
    depth : (H, W) float32
        As the sensor reports it, metres.
    masks : list of (H, W) bool
        A little wrong, as a segmenter's.
    lo, hi : (N, 3) float64
        1st and 99th percentile of the exact visible surface along (right, up, forward), metres.
    """

    depth: np.ndarray
    camera: Camera
    viewer: ViewerAxes
    masks: list[np.ndarray]
    lo: np.ndarray
    hi: np.ndarray


Extents = tuple[np.ndarray, np.ndarray]
Lifting = Callable[[BenchView], "Extents | None"]


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure lifting with relations, in frames a second; face errors; pairs a second."""
    views = [v for k in range(setup.times(4, 1)) for v in bench_views(FIRST_ROOM + k)]
    with one_thread():
        for name, make in (
            ("open3d", lambda: open3d_recipe),
            ("spatialrgpt", partial(_foreign, setup.peers, "spatialrgpt")),
            ("vqasynth", partial(_foreign, setup.peers, "vqasynth")),
            ("vqasynth_cut", partial(_foreign, setup.peers, "vqasynth_cut")),
            ("trimesh", lambda: trimesh_bounds),
        ):
            try:
                theirs = make()
                theirs(views[0])  # The first call pays for imports.
            except Exception as error:  # Files of others fail in their own ways.
                yield f"lift.{name}", str(error).partition("\n")[0] or type(error).__name__, None
                continue
            ours, floor = _rates(views, theirs, setup.times(5))
            yield f"lift.{name}", ours, floor
            if name == "open3d":
                yield "lift.faces", _mean_error(views, our_lifting), _mean_error(views, theirs)
        yield "lift.pairs", *pairs_per_second(setup.times(9))


def bench_views(seed: int) -> list[BenchView]:
    """Views of one rendered room, with the extents of what is truly visible."""
    rng = np.random.default_rng([seed, 31])
    room = make_room(seed)
    found = []
    for camera in choose_views(room, VIEWS_A_ROOM, np.random.default_rng([seed, 11]), WIDTH, HEIGHT):
        assert camera.up is not None
        exact, instances = exact_view(room, camera)
        viewer = viewer_axes(camera.up)
        masks, lo, hi = [], [], []
        for number in np.flatnonzero(np.bincount(instances[instances >= 0], minlength=1) >= MIN_PIXELS):
            seen = instances == number
            v, u = np.nonzero(seen & (exact > 0) & (exact < 8))
            if len(v) < MIN_PIXELS:
                continue
            low, high = extents_of(backproject(exact, camera, v, u).astype(np.float64) @ viewer.matrix.T)
            masks.append(degraded(seen, rng))
            lo.append(low)
            hi.append(high)
        faces = (np.array(e, np.float64).reshape(-1, 3) for e in (lo, hi))
        found.append(BenchView(sense(exact, rng), camera, viewer, masks, *faces))
    return found


def our_lifting(view: BenchView) -> Extents:
    """Depth edges, lifting with boxes, and all relations of a view; the extents of its objects."""
    lifted = lift(view.depth, view.camera, view.masks, view.viewer, edges=depth_edges(view.depth))
    lo = np.array([item.lo for item in lifted]).reshape(-1, 3)
    hi = np.array([item.hi for item in lifted]).reshape(-1, 3)
    judge_viewer_cone(lo, hi, (lo + hi) / 2, None, DIRECTIONAL)
    return lo, hi


def object_points(view: BenchView) -> Iterator[np.ndarray]:
    """(P, 3) float64 points in the camera's axes of each object, metres."""
    for mask in view.masks:
        v, u = np.nonzero(mask & (view.depth > 0))
        yield backproject(view.depth, view.camera, v, u).astype(np.float64)


def open3d_recipe(view: BenchView) -> Extents:
    """SpatialRGPT's published steps and parameters by Open3D, without its random jitter: statistical outliers (10,
    1.2), voxels of 1 cm or spread/40, the largest of DBSCAN (.2, 10), oriented box, centres in a double loop.
    """
    o3d: Any = import_module("open3d")
    lo, hi, centers = [], [], []
    for points in object_points(view):
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud, _ = cloud.remove_statistical_outlier(nb_neighbors=10, std_ratio=1.2)
        points = np.asarray(cloud.points)
        if not len(points):
            for part in (lo, hi, centers):
                part.append(np.full(3, np.nan))
            continue
        spread = float(np.linalg.norm(points.std(axis=0))) * 3.0
        cloud = cloud.voxel_down_sample(voxel_size=max(0.01, spread / 40))
        label = np.asarray(cloud.cluster_dbscan(eps=0.2, min_points=10))
        if (label >= 0).any():
            largest = int(np.bincount(label[label >= 0]).argmax())
            cloud = cloud.select_by_index(np.flatnonzero(label == largest).tolist())
        points = np.asarray(cloud.points)
        if len(points) >= 4:
            cloud.get_oriented_bounding_box(robust=True)
        level = points @ view.viewer.matrix.T
        lo.append(level.min(axis=0))
        hi.append(level.max(axis=0))
        centers.append(level.mean(axis=0))
    compare_centres(centers)
    return np.array(lo).reshape(-1, 3), np.array(hi).reshape(-1, 3)


def compare_centres(centers: list[np.ndarray]) -> None:
    """Judge six relations of every ordered pair in a double loop."""
    for i, a in enumerate(centers):
        for j, b in enumerate(centers):
            if i != j:
                _ = (a[0] < b[0], a[0] > b[0], a[1] > b[1], a[1] < b[1], a[2] < b[2], a[2] > b[2])


def trimesh_bounds(view: BenchView) -> None:
    """Oriented bounds of each object's points, as they are, and centres in a double loop."""
    bounds: Any = import_module("trimesh.bounds")
    compare_centres([bounds.oriented_bounds(points)[0][:3, 3] for points in object_points(view)])


def _foreign(folder: str | None, name: str) -> Lifting:
    if folder is None:
        raise FileNotFoundError("no --peers FOLDER (docs/examples/bench_peers.sh fetches it)")
    return getattr(import_module("pipeline.bench.peers"), name)(Path(folder))


def face_errors(found: Extents, view: BenchView) -> np.ndarray:
    """(N, 6) metres between the faces of the boxes and those of the exact visible surface."""
    return np.abs(np.concatenate([found[0] - view.lo, found[1] - view.hi], axis=1))


def _mean_error(views: list[BenchView], lifting: Lifting) -> float:
    """Mean of all faces, centimetres; objects that were lost are left out."""
    found = [face_errors(extents, view) for view in views if (extents := lifting(view)) is not None]
    return float(np.nanmean(np.concatenate(found))) * 100


def _rates(views: list[BenchView], theirs: Lifting, times: int) -> tuple[float, float]:
    """Frames a second of ours, and of theirs, whose passes are long enough for one to count."""
    ours = sum(least(partial(our_lifting, view), times) for view in views)
    return len(views) / ours, len(views) / sum(least(partial(theirs, view), 1) for view in views)


def pairs_per_second(times: int) -> tuple[float, float]:
    """Ordered pairs judged in a second, six directions with margins: all at once, and two objects at a time."""
    rng = np.random.default_rng(0)
    center = rng.uniform((-2, -1, 1), (2, 1, 5), (PAIRED, 3))
    half = rng.uniform(0.02, 0.5, (PAIRED, 3))

    def judged(chosen: slice | list[int] = slice(None)) -> None:
        c, h = center[chosen], half[chosen]
        judge_viewer_cone(c - h, c + h, c, None, DIRECTIONAL)

    couples = [[i, j] for i in range(PAIRED) for j in range(i)]
    ours, singly = side_by_side([lambda: [judged() for _ in range(20)], lambda: [judged(c) for c in couples]], times)
    pairs = PAIRED * (PAIRED - 1)
    return 20 * pairs / ours, pairs / singly
