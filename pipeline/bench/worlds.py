"""Datasets of the bench: frames of the demo written otherwise, many of them, or with many objects."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from pipeline.datasets import demo_path

TABLES = ("scene_camera", "scene_gt", "scene_gt_info")
SCENE, FRAME = "000001", 1
"""Frame of the demo with 29 objects."""
WIDTH, HEIGHT, CELL = 640, 480, 32
THINGS = tuple(f"thing {chr(97 + k % 26)}{k // 26}" for k in range(40))
ONE_BIT = (cv2.IMWRITE_PNG_BILEVEL, 1)


def demo_frames(root: Path, frames: int, written: bool = False) -> Path:
    """Write a dataset of one frame of the demo, so many times, as links; or with its masks written by OpenCV."""
    source, scene = Path(demo_path()) / SCENE, root / SCENE
    shutil.copytree(source.parent / "models", root / "models")
    shutil.copy(source.parent / "spatialviz.toml", root)
    tables = {name: json.loads((source / f"{name}.json").read_text()) for name in TABLES}
    for folder in ("rgb", "depth", "mask_visib"):
        (scene / folder).mkdir(parents=True, exist_ok=True)
        for path in sorted((source / folder).glob(f"{FRAME:06d}*")):
            first = scene / folder / path.name.replace(f"{FRAME:06d}", "000000", 1)
            if written and folder == "mask_visib":
                mask = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
                cv2.imwrite(str(first), np.asarray(mask))
            else:
                shutil.copy(path, first)
            for n in range(1, frames):
                os.link(first, first.with_name(first.name.replace("000000", f"{n:06d}", 1)))
    for name, table in tables.items():
        (scene / f"{name}.json").write_text(json.dumps({str(n): table[str(FRAME)] for n in range(frames)}))
    return root


def crowded_frame(root: Path, objects: int, names: Sequence[str] = THINGS, cell: int = CELL) -> Path:
    """Write a dataset of a frame with so many things of equal size, each in a cell of its own of the picture."""
    rng, scene = np.random.default_rng(0), root / SCENE
    for folder in ("rgb", "depth", "mask_visib"):
        (scene / folder).mkdir(parents=True)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth, across = 4.0 - 2.0 * v / HEIGHT, WIDTH // cell
    things = []
    for k, at in enumerate(rng.permutation(across * (HEIGHT // cell))[:objects]):
        y, x = (np.array(divmod(int(at), across)) + 0.5) * cell
        mask = (np.abs(u - x) < 0.4 * cell) & (np.abs(v - y) < 0.4 * cell)
        depth[mask] = rng.uniform(1, 3) + 0.002 * (u - x)[mask]
        cv2.imwrite(str(scene / "mask_visib" / f"000000_{k:06d}.png"), mask.astype(np.uint8) * 255, ONE_BIT)
        things.append(
            {"obj_id": k % len(names) + 1, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 1000]}
        )
    millimetres = np.rint(depth * 1000 + rng.normal(0, 2, depth.shape)).astype(np.uint16)
    cv2.imwrite(str(scene / "depth" / "000000.png"), millimetres)
    cv2.imwrite(str(scene / "rgb" / "000000.png"), rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))
    camera = {"cam_K": [525, 0, 319.5, 0, 525, 239.5, 0, 0, 1], "depth_scale": 1.0}
    for name, table in (("scene_camera", camera), ("scene_gt", things)):
        (scene / f"{name}.json").write_text(json.dumps({"0": table}))
    (root / "models").mkdir()
    models = {str(k): {"name": name, "diameter": 1} for k, name in enumerate(names, 1)}
    (root / "models" / "models_info.json").write_text(json.dumps(models))
    return root


def decode(files: Iterable[bytes]) -> None:
    """Floor of reading pictures."""
    for data in files:
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def pictures(root: Path) -> list[bytes]:
    """The picture files of a dataset."""
    return [p.read_bytes() for p in sorted(root.glob("*/*/*")) if p.suffix in (".png", ".jpg")]
