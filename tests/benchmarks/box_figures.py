"""Figures of fitted 3D boxes against exact ones, in one run: this tool's fits, criteria of yaw, and Open3D's boxes.

    cd tests && python -m benchmarks.box_figures [WORLDS]

prints a table for each kind of camera in furnished rooms of another maker (three kinds of sensors, half of the masks
rough), and for frames of YCB-Video (SPATIALVIZ_SHARED; its objects' sizes as Calli et al. 2015 publish them). Open3D's
boxes are left out where it is not installed.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarks.house_worlds import SensedView, sensed_view
from other_makers import REGIMES

from pipeline.answering.objects import prepare_frame
from pipeline.answering.whole_boxes import complete
from pipeline.datasets import open_dataset
from pipeline.geometry import Box3D, Camera, LiftConfig, fitting, iou_3d, lift, viewer_axes
from pipeline.geometry.fitting import canonicalised
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language import is_thin
from pipeline.synthetic.raycast import EmbreeScene, pixel_rays, pose_of

WORLDS = 60
FEWEST_POINTS = 16
WHOLE = 0.95
"""Share of a thing's own pixels that is seen of whole ones; they are not cut by the border either."""
TURNED = 10.0
"""Degrees of yaw up to which sizes are compared."""
ROUND = {
    "apple", "ball", "basket", "bin", "bottle", "bowl", "bucket", "can", "candle", "clock", "cup", "glass", "globe",
    "jar", "lamp", "mug", "plant", "plate", "pot", "stool", "teapot", "vase", "wastebasket",
}  # fmt: skip
"""Last words of names of things that are mostly round in plan, or have no sides."""
YCB_MM = {
    1: (102, 102, 140), 2: (72, 164, 213), 3: (45, 93, 176), 4: (68, 68, 102), 5: (58, 96, 191), 6: (86, 86, 34),
    7: (138, 129, 39), 8: (100, 88, 30), 9: (102, 58, 84), 11: (149, 149, 242), 12: (102, 68, 251), 13: (162, 162, 55),
    14: (117, 93, 81), 15: (184, 187, 58), 16: (89, 92, 206), 21: (78, 53, 51),
}  # fmt: skip
"""Width, depth and height by the number of the object."""

Fit = Callable[["View"], list[tuple[Box3D | None, float]]]


@dataclass(frozen=True, eq=False)
class View:
    depth: np.ndarray
    camera: Camera
    viewer: ViewerAxes
    masks: list[np.ndarray]
    names: list[str]
    exact: list[Box3D]
    seen: list[float]
    """Share of each thing's own pixels that is seen."""


def seen_share(view: SensedView, step: int = 4) -> list[float]:
    """What other things leave of each thing's own pixels."""
    v, u = np.mgrid[2 : view.camera.height : step, 2 : view.camera.width : step].reshape(2, -1)
    eye, rays = pose_of(view.camera)[:3, 3], pixel_rays(view.camera, v, u)
    found = []
    for points, placed, mask in zip(view.vertices, view.things, view.masks, strict=True):
        own = EmbreeScene(points, np.asarray(placed.thing.mesh.faces)).first(eye, rays).face >= 0
        found.append(mask[v, u].sum() / max(own.sum(), 1))
    return found


def rooms(regime: str, count: int) -> Iterator[View]:
    for seed in range(1000, 1000 + count):
        view = sensed_view(seed, REGIMES[regime])
        if view is not None and view.camera.up is not None:
            axes = viewer_axes(view.camera.up)
            yield View(view.depth, view.camera, axes, view.masks, view.names, view.boxes(), seen_share(view))


def ycb_frames() -> Iterator[View]:
    root = Path(os.environ.get("SPATIALVIZ_SHARED", "../../shared")) / "data" / "real" / "ycbv-bop"
    if not root.exists():
        return
    dataset = open_dataset(root)
    for frame_id in dataset.frame_ids:
        context = prepare_frame(dataset, dataset.load(frame_id), boxes=False)
        scene, image = frame_id.split("/")
        poses = json.loads((root / scene / "scene_gt.json").read_text())[str(int(image))]
        kept = [k for k, pose in enumerate(poses) if pose["obj_id"] in YCB_MM]
        names = {a.index: a.label for a in context.frame.annotations}
        masks = {a.index: a.mask for a in context.frame.annotations}
        exact = [
            Box3D(
                np.array(poses[k]["cam_t_m2c"]) / 1000,
                np.array(poses[k]["cam_R_m2c"]).reshape(3, 3),
                np.array(YCB_MM[poses[k]["obj_id"]]) / 1000,
            )
            for k in kept
        ]
        found = [masks[k] for k in kept]
        assert all(mask is not None for mask in found)
        yield View(
            context.frame.depth,
            context.frame.camera,
            context.viewer,
            [mask for mask in found if mask is not None],
            [names[k] for k in kept],
            exact,
            [1.0] * len(kept),
        )


def fitted(view: View, mode: str) -> list[tuple[Box3D | None, float]]:
    """By this tool."""
    thin = [is_thin(name) for name in view.names]
    config = LiftConfig(box=mode)  # type: ignore[arg-type]
    lifted = lift(view.depth, view.camera, view.masks, view.viewer, config=config, thin=thin)
    return [(o.box, o.yaw_confidence) if len(o.points) >= FEWEST_POINTS else (None, 0.0) for o in lifted]


def completed(view: View) -> list[tuple[Box3D | None, float]]:
    """By this tool, completed by the network of `--boxes completed`."""
    thin = [is_thin(name) for name in view.names]
    lifted = lift(view.depth, view.camera, view.masks, view.viewer, thin=thin)
    wholes = complete(lifted, view.names, view.depth, view.camera)
    return [
        (None if whole is None or len(o.points) < FEWEST_POINTS else whole.box, o.yaw_confidence)
        for o, whole in zip(lifted, wholes, strict=True)
    ]


@contextmanager
def yaw_by(criterion: Callable[[np.ndarray], float]) -> Iterator[None]:
    """Upright boxes whose yaw another criterion chooses, (2, N) points along candidate axes -> one value, in steps of 1
    degree; what claims a direction stays the same.
    """
    before, angles = fitting.plan_yaws, np.deg2rad(np.arange(90))

    def chosen(plans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turns = [np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in angles]
        best = [int(np.argmax([criterion(turn @ plan) for turn in turns])) for plan in plans]
        return angles[best], before(plans)[1]

    fitting.plan_yaws = chosen
    try:
        yield
    finally:
        fitting.plan_yaws = before


def least_area(along: np.ndarray) -> float:
    return -float(np.ptp(along, axis=1).prod())


def least_variance(along: np.ndarray) -> float:
    """Zhang, Xu, Dong and Dolan 2017: each point belongs to the nearer of two sides, whose distances vary little."""
    side = np.minimum(along - along.min(axis=1, keepdims=True), along.max(axis=1, keepdims=True) - along)
    nearer = side.argmin(axis=0)
    return -float(sum(side[k][nearer == k].var() if (nearer == k).any() else 0.0 for k in (0, 1)))


def principal(along: np.ndarray) -> float:
    """PCA: the spread along one axis is greatest."""
    return float(along[0].var())


def by_criterion(criterion: Callable[[np.ndarray], float]) -> Fit:
    def fit(view: View) -> list[tuple[Box3D | None, float]]:
        with yaw_by(criterion):
            return fitted(view, "upright")

    return fit


def open3d_boxes(minimal: bool) -> Fit:
    """As recipes do it: points of the mask, statistical outliers removed, an oriented (or minimal oriented) box."""
    import open3d as o3d  # pyright: ignore[reportMissingImports]

    def fit(view: View) -> list[tuple[Box3D | None, float]]:
        found: list[tuple[Box3D | None, float]] = []
        for mask in view.masks:
            v, u = np.nonzero(mask & (view.depth > 0))
            if len(v) < FEWEST_POINTS:
                found.append((None, 0.0))
                continue
            z = view.depth[v, u].astype(np.float64)
            x, y = (u - view.camera.cx) / view.camera.fx * z, (v - view.camera.cy) / view.camera.fy * z
            cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.stack([x, y, z], axis=1)))
            cloud, _ = cloud.remove_statistical_outlier(20, 2.0)
            box = cloud.get_minimal_oriented_bounding_box() if minimal else cloud.get_oriented_bounding_box()
            R = np.array(box.R)
            R[:, 2] *= np.sign(np.linalg.det(R))
            found.append((Box3D(np.array(box.center), R, np.array(box.extent)), 1.0))
        return found

    return fit


def fits() -> dict[str, Fit]:
    found: dict[str, Fit] = {
        "upright": lambda view: fitted(view, "upright"),
        "upright, completed": completed,
        "gravity": lambda view: fitted(view, "gravity"),
        "pca": lambda view: fitted(view, "pca"),
        "upright, yaw by least area": by_criterion(least_area),
        "upright, yaw by least variance": by_criterion(least_variance),
        "upright, yaw by PCA": by_criterion(principal),
    }
    try:
        found |= {"Open3D oriented": open3d_boxes(False), "Open3D minimal oriented": open3d_boxes(True)}
    except ImportError:
        print("Open3D is not installed: without its boxes")
    return found


def near_axes(box: Box3D, viewer: ViewerAxes) -> Box3D:
    """The box in the level frame, axes near (right, down, forward)."""
    R = viewer.R_level_camera
    return canonicalised(Box3D(R @ box.center, R @ box.R, box.size))


def turn(box: Box3D, exact: Box3D) -> float:
    """Degrees between the boxes' yaws, 0 to 45."""
    a, b = (np.arctan2(found.R[2, 0], found.R[0, 0]) for found in (box, exact))
    return float(np.rad2deg(abs((a - b + np.pi / 4) % (np.pi / 2) - np.pi / 4)))


def row(views: list[View], fit: Fit) -> str:
    ious, whole_ious, turns, claims, sizes, seconds, count = [], [], [], [], [], 0.0, 0
    for view in views:
        start = time.process_time()
        found = fit(view)
        seconds, count = seconds + time.process_time() - start, count + len(found)
        rows = zip(found, view.exact, view.seen, view.masks, view.names, strict=True)
        for (box, confidence), exact, seen, mask, name in rows:
            if box is None:
                continue
            border = mask[[0, -1]].any() or mask[:, [0, -1]].any()
            whole = seen > WHOLE and not border
            ious.append(iou_3d(box, exact))
            level, true = near_axes(box, view.viewer), near_axes(exact, view.viewer)
            if name.split()[-1] not in ROUND:
                claims.append(confidence > 0.5)
                turns += [turn(level, true)] * claims[-1]
            if whole:
                whole_ious.append(ious[-1])
                sizes += [level.size / true.size] * (turn(level, true) < TURNED)
    right, up, forward = np.median(sizes, axis=0) if sizes else [np.nan] * 3
    return (
        f"{np.mean(ious):.3f} | {np.mean(whole_ious):.3f} | {np.median(turns) if turns else np.nan:.1f} |"
        f" {np.mean(claims):.0%} | {right:.2f} {up:.2f} {forward:.2f} | {1e3 * seconds / count:.2f}"
    )


def main(count: int = WORLDS) -> None:
    worlds = {regime: list(rooms(regime, count)) for regime in ("usual", "high", "table top")}
    for name, views in {**worlds, "YCB-Video": list(ycb_frames())}.items():
        things = sum(len(view.exact) for view in views)
        if not things:
            continue
        print(f"\n{name}: {len(views)} views, {things} things\n")
        print("| fit | IoU | whole things | yaw error | claimed | sizes right, up, forward | ms |")
        print("|---|---|---|---|---|---|---|")
        for fit_name, fit in fits().items():
            print(f"| {fit_name} | {row(views, fit)} |", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
