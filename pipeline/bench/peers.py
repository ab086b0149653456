"""Functions of other projects, run as they are from files that the user has fetched: none of them is part of this one.

What their files import and the timed functions do not use (networks, viewers) is an empty stand-in.
"""

from __future__ import annotations

import importlib
import random
import sys
from itertools import permutations
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np

from pipeline.system.whole_files import scratch_folder

WRAPPERS = "osdsynth.processor.wrappers"
UNUSED = (
    *("torch", "torchvision", "vggt.models.vggt", "vggt.utils.pose_enc", "vggt.utils.geometry", "wis3d", "matplotlib"),
    *(f"{WRAPPERS}.metric3d_v2", f"{WRAPPERS}.perspective_fields"),
)
SIX = ("left", "right", "above", "below", "behind", "front")
JITTER_SEED = 0


def _modules(folder: Path, *names: str) -> list[Any]:
    """Modules of a package in this folder, without its `__init__`, which may ask for networks."""
    packages = {parent for name in names for parent in _parents(name)}
    given: dict[str, Any] = {name: ModuleType(name) for name in packages}
    for name, package in given.items():
        package.__path__ = [str(folder.joinpath(*name.split(".")))]
    unused = {name: MagicMock() for name in UNUSED if name not in sys.modules}
    if "torch" in unused:
        unused["torch"].cuda.is_available.return_value = False
    sys.modules.update(given | unused)
    found = [importlib.import_module(name) for name in names]
    for name in unused:
        # What else asks for torch is not to be given this.
        del sys.modules[name]
    return found


def _parents(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:k]) for k in range(1, len(parts))]


def spatialrgpt(folder: Path) -> Any:
    """Its clouds of objects, their cleaning, both boxes, and six predicates of every ordered pair."""
    names = ("osdsynth.processor.pointcloud", "osdsynth.processor.prompt")
    clouds, words = _modules(folder / "SpatialRGPT" / "dataset_pipeline", *names)
    cfg = SimpleNamespace(dbscan_remove_noise=True, dbscan_eps=0.2, dbscan_min_points=10)
    predicates = [getattr(words, f"{name}_predicate") for name in SIX]

    def run(view: Any) -> None:
        np.random.seed(JITTER_SEED)  # noqa: NPY002 - theirs is drawn from it
        points = clouds.depth_to_points(view.depth[None].astype(np.float64), R=np.eye(3), intrinsic=view.camera.K)
        rgb = np.zeros((*view.depth.shape, 3), np.uint8)
        found = []
        for mask in view.masks:
            cloud = clouds.process_pcd(cfg, clouds.create_object_pcd(points, rgb, mask & (view.depth > 0)))
            clouds.get_bounding_box(cfg, cloud)
            found.append({"caption": "thing", "pcd": cloud})
        for a, b in permutations(found, 2):
            for judge in predicates:
                judge(a, b)

    return run


def vqasynth(folder: Path, canonical: bool = True) -> Any:
    """Its canonicalised scene, its clouds of objects, cut from that as its `run` does, saved and restored, and six
    predicates of every ordered pair.
    """
    scene, words = _modules(folder / "VQASynth", "vqasynth.scene_fusion", "vqasynth.prompts")
    maker = object.__new__(scene.SpatialSceneConstructor)
    generator = words.PromptGenerator()
    predicates = [getattr(generator, f"{name}_predicate") for name in SIX]
    o3d = scene.o3d

    def run(view: Any) -> None:
        random.seed(JITTER_SEED)
        v, u = np.indices(view.depth.shape)
        K, z = view.camera.K, view.depth.astype(np.float64)
        points = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1).reshape(-1, 3)
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        if canonical:
            cloud, _, _ = maker.canonicalize_point_cloud(cloud, canonicalize_threshold=0.3)
        points, paths = np.asarray(cloud.points), []
        with scratch_folder() as out:
            for k, mask in enumerate(view.masks):
                part = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[(mask & (view.depth > 0)).ravel()]))
                paths.append(str(out / f"{k}.pcd"))
                maker.save_pointcloud(part, paths[-1])
            found = [("thing", part) for part in scene.restore_pointclouds(paths)]
        for a, b in permutations(found, 2):
            for judge in predicates:
                judge(a, b)

    return run


def vqasynth_cut(folder: Path) -> Any:
    """The same without its canonicalisation of the scene."""
    return vqasynth(folder, canonical=False)
