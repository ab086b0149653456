"""Speed and accuracy of labelling, beside the usual Open3D recipe on the same frames, in one run.

Times are processor seconds of one thread, so that another program on the
machine disturbs them little; ratios hold on any machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from time import process_time
from typing import Any

import numpy as np
from benchmarks.stages import fastest

from pipeline.geometry.camera import Camera, backproject
from pipeline.geometry.fitting import extents_of
from pipeline.geometry.lifting import depth_edges, lift
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.job import label_dataset
from pipeline.labels.plan import LabelConfig, SourceSpec
from pipeline.labels.profiles import judge_viewer_cone
from pipeline.language.relation_names import DIRECTIONAL
from pipeline.relations.relations import directional_states
from pipeline.synthetic import choose_views, exact_view, make_room
from pipeline.synthetic.render import sense
from pipeline.system.errors import MissingExtra, require
from pipeline.system.whole_files import scratch_folder
from pipeline.system.worker_pool import one_thread
from pipeline.training.training_data import MIN_PIXELS, degraded

WIDTH, HEIGHT, VIEWS_A_ROOM = 640, 480, 3
FIRST_ROOM = 7_000_000
"""Rooms of these seeds are in no dataset and in no training set."""

RECIPE = "SOR(10, 1.2), voxel max(1 cm, spread/40), DBSCAN(0.2, 10) largest, OBB, centres in a double loop"
"""SpatialRGPT's published steps and parameters (osdsynth, process_pcd), without its random jitter."""

PAPER_FRAMES = 1500


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


def bench_labels(spec: SourceSpec, *, views: int = 12, repeat: int = 3, workers: int = 1) -> dict[str, Any]:
    """Measure lifting, relations and the whole job.

    Parameters
    ----------
    spec : SourceSpec
        What the whole job labels, into a folder that is thrown away.
    views : int
        Rendered views for the comparison (extras: render; open3d for the recipe).
    repeat : int
        Passes; the fastest counts.
    workers : int
        Processes of the whole job.

    Returns
    -------
    dict
        lifting: ms_per_frame, faces (mean and 95th percentile of the error of
        box faces, cm) of ours and of the recipe, ratio; relations: pairs_per_s
        by number of objects; job: frames, workers, seconds, frames_per_s,
        candidates_per_frame, and what 1,500 frames would take.
    """
    require(
        views >= 1 and repeat >= 1, "at least one view and one pass are needed", got=f"{views} views, {repeat} passes"
    )
    found = [v for k in range(-(-views // VIEWS_A_ROOM)) for v in bench_views(FIRST_ROOM + k)][:views]
    with one_thread():
        ours = _timed(found, our_lifting, repeat)
        try:
            open3d_recipe(found[0])  # The first call pays for the import.
            recipe = _timed(found, open3d_recipe, 1)
        except MissingExtra as error:
            recipe = {"skipped": str(error)}
        record: dict[str, Any] = {
            "views": len(found),
            "objects": sum(len(v.masks) for v in found),
            "width": WIDTH,
            "height": HEIGHT,
            "lifting": {"ours": ours, "open3d recipe": recipe, "recipe": RECIPE},
            "relations": {"pairs_per_s": pairs_per_second(repeat)},
        }
    if "ms_per_frame" in recipe:
        record["lifting"]["ratio"] = round(recipe["ms_per_frame"] / ours["ms_per_frame"], 1)
    record["job"] = bench_job(spec, workers)
    return record


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


Extents = tuple[np.ndarray, np.ndarray]


def our_lifting(view: BenchView) -> Extents:
    """Depth edges, lifting with boxes, and all relations of a view; the extents of its objects."""
    lifted = lift(view.depth, view.camera, view.masks, view.viewer, edges=depth_edges(view.depth))
    lo = np.array([item.lo for item in lifted]).reshape(-1, 3)
    hi = np.array([item.hi for item in lifted]).reshape(-1, 3)
    judge_viewer_cone(lo, hi, (lo + hi) / 2, None, DIRECTIONAL)
    return lo, hi


def open3d_recipe(view: BenchView) -> Extents:
    """The same by the usual recipe; see RECIPE. The extents are those of its cleaned points.

    Raises
    ------
    MissingExtra
        Open3D is not installed.
    """
    try:
        o3d: Any = import_module("open3d")
    except (ImportError, OSError) as error:
        raise MissingExtra("the comparison with Open3D", "open3d") from error
    lo, hi, centers = [], [], []
    for mask in view.masks:
        v, u = np.nonzero(mask & (view.depth > 0))
        cloud = o3d.geometry.PointCloud(
            o3d.utility.Vector3dVector(backproject(view.depth, view.camera, v, u).astype(np.float64))
        )
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
    for i, a in enumerate(centers):
        for j, b in enumerate(centers):
            if i != j:
                _ = (a[0] < b[0], a[0] > b[0], a[1] > b[1], a[1] < b[1], a[2] < b[2], a[2] > b[2])
    return np.array(lo).reshape(-1, 3), np.array(hi).reshape(-1, 3)


def face_errors(found: Extents, view: BenchView) -> np.ndarray:
    """(N, 6) metres between the faces of the boxes and those of the exact visible surface."""
    return np.abs(np.concatenate([found[0] - view.lo, found[1] - view.hi], axis=1))


def _timed(views: list[BenchView], job: Callable[[BenchView], Extents], repeat: int) -> dict[str, Any]:
    seconds, errors = [], []
    for view in views:
        passes: list[float] = []
        errors_of_view = np.zeros((0, 6))
        for _ in range(max(repeat, 1)):
            start = process_time()
            errors_of_view = face_errors(job(view), view)
            passes.append(process_time() - start)
        seconds.append(min(passes))
        errors.append(errors_of_view)
    centimetres = np.concatenate(errors) * 100
    return {
        "ms_per_frame": round(float(np.mean(seconds)) * 1000, 2),
        "face_error_cm": round(float(np.nanmean(centimetres)), 2),
        "face_error_p95_cm": round(float(np.nanpercentile(centimetres, 95)), 2),
        "lost": int(np.isnan(centimetres).any(axis=1).sum()),
    }


def pairs_per_second(repeat: int = 3) -> dict[str, int]:
    """Ordered pairs judged in a second, all six directions: states, and states with margins, by number of objects."""
    rng = np.random.default_rng(0)
    found = {}
    for n in (12, 60, 120):
        center = rng.uniform((-2, -1, 1), (2, 1, 5), (n, 3))
        half = rng.uniform(0.02, 0.5, (n, 3))
        lo, hi = center - half, center + half
        jobs: dict[str, Callable[[], Any]] = {
            "states": lambda lo=lo, hi=hi: directional_states(lo, hi),
            "states and margins": lambda lo=lo, hi=hi, c=center: judge_viewer_cone(lo, hi, c, None, DIRECTIONAL),
        }
        for name, job in jobs.items():
            best = fastest(lambda job=job: [job() for _ in range(20)], max(repeat, 3)) / 20
            found[f"{n} objects, {name}"] = int(n * (n - 1) / best)
    return found


def bench_job(spec: SourceSpec, workers: int) -> dict[str, Any]:
    """Label a dataset from its files to merged tables, and scale to the 1,500 frames of the paper."""
    with scratch_folder() as folder:
        report = label_dataset(spec, f"{folder}/labels", LabelConfig(), workers=workers)
    rate = report.frames / report.seconds
    assert report.manifest is not None
    a_frame = report.candidates / max(report.frames, 1)
    return {
        "frames": report.frames,
        "workers": workers,
        "seconds": round(report.seconds, 2),
        "frames_per_s": round(rate, 2),
        "objects_per_frame": round(report.objects / max(report.frames, 1), 1),
        "candidates_per_frame": round(a_frame, 1),
        "kept_per_frame": round(report.manifest.counts["expressions"] / max(report.frames, 1), 1),
        "seconds_for_1500_frames": round(PAPER_FRAMES / rate, 1),
    }


if __name__ == "__main__":
    # cd tests && python -m benchmarks.labelling [DATASET]
    import json
    import sys

    print(json.dumps(bench_labels(SourceSpec((sys.argv[1:] or ["demo"])[0])), indent=2))
