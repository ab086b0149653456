"""Functions of other projects, run as they are from files that the user has fetched: none of them is part of this one.

What their files import and the timed functions do not use (networks, viewers) is an empty stand-in.
"""

from __future__ import annotations

import importlib
import random
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from itertools import permutations
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np

from pipeline.system.whole_files import scratch_folder

UNUSED = ("torch", "torchvision", "vggt", "wis3d", "matplotlib", "osdsynth.processor.wrappers")
SIX = ("left", "right", "above", "below", "behind", "front")
JITTER_SEED = 0


class _StandIns(MetaPathFinder, Loader):
    """Makes any module of UNUSED an object that takes every call."""

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        unused = any(name == u or name.startswith(f"{u}.") for u in UNUSED)
        return ModuleSpec(name, self, is_package=True) if unused else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        made = MagicMock(name=spec.name, __path__=[], __spec__=spec)
        made.cuda.is_available.return_value = False
        return made

    def exec_module(self, module: ModuleType) -> None:
        """Leave it empty."""


def _module(folder: Path, name: str) -> Any:
    for path in (folder / "SpatialRGPT" / "dataset_pipeline", folder / "VQASynth"):
        # As their own programs run: beside their packages, whose __init__ may ask for networks.
        package = path / name.partition(".")[0]
        if package.is_dir():
            parts = name.split(".")[:-1]
            for k in range(len(parts)):
                made = sys.modules.setdefault(".".join(parts[: k + 1]), ModuleType(".".join(parts[: k + 1])))
                made.__path__ = [str(path.joinpath(*parts[: k + 1]))]
            if not any(isinstance(f, _StandIns) for f in sys.meta_path):
                sys.meta_path.insert(0, _StandIns())
            return importlib.import_module(name)
    raise FileNotFoundError(f"{name} is not in {folder}")


def spatialrgpt(folder: Path) -> Any:
    """Its clouds of objects, their cleaning, both boxes, and six predicates of every ordered pair."""
    clouds, words = (_module(folder, f"osdsynth.processor.{name}") for name in ("pointcloud", "prompt"))
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
    scene, words = (_module(folder, f"vqasynth.{name}") for name in ("scene_fusion", "prompts"))
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
