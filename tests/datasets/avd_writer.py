"""Writes scans in the very format of the Active Vision Dataset, for the tests of its reader."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.geometry import Camera, intrinsics
from pipeline.synthetic import camera_at, make_room
from pipeline.synthetic.render import sense_view

FX, FY, CX, CY = 1049.51, 1092.28, 927.269, 545.76
CAMERA_LINE = f"1 OPENCV 1920 1080 {FX} {FY} {CX} {CY} 0.382444 0.105826 0.000859549 -0.00143275"
CAMERAS = f"# Camera list:\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n# 1\n{CAMERA_LINE}\n"
SCALE = 412.5
"""Millimetres in one unit of the reconstruction that is written."""
NAMES = {0: "background", 1: "advil_liqui_gels", 5: "coca_cola_glass_bottle", 21: "red_bull", 33: "red_cup"}
MOVES = ("rotate_ccw", "rotate_cw", "forward", "backward", "left", "right")
POINTERS = ("rotate_cw", "rotate_ccw", "translate_forward", "translate_backward", "translate_right", "translate_left")

Z_UP_FROM_Y = {
    "y-down": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "y-up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
"""Rotations from the room's world (z up) to one whose height axis is y, that end of it up or down."""


@dataclass(frozen=True)
class ImageTruth:
    """What was written of one image: colour (one for all pixels), depth in millimetres, pose in metres or None."""

    color: np.ndarray
    millimetres: np.ndarray
    T_world_camera: np.ndarray | None


def image_name(scan: str, index: int, kind: int = 1) -> str:
    """15 digits: scene type, scene, scan, image, camera, kind."""
    place, scene, number = scan.split("_")
    return f"{['Home', 'Office', 'Gen'].index(place)}{int(scene):03d}{number}{index:06d}01{kind:02d}"


def write_scan(
    root: Path,
    scan: str = "Home_001_1",
    *,
    size: tuple[int, int] = (192, 108),
    world: str = "y-down",
    steps: int = 4,
    unregistered: tuple[int, ...] = (),
    camera_params: bool = False,
) -> dict[str, ImageTruth]:
    """A robot that turns on the spot by 30 degrees `steps` times and then goes a step forward; by image name.

    Each image annotates red_cup (33) in a box of its own and red_bull (21) in the next.
    """
    folder = root / scan
    for name in ("jpg_rgb", "high_res_depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    width, height = size
    x, y = width / 1920, height / 1080
    room = make_room(0)
    K = intrinsics(FX * x, FY * y, (CX + 0.5) * x - 0.5, (CY + 0.5) * y - 0.5)
    turn = np.eye(4)
    turn[:3, :3] = Z_UP_FROM_Y[world]
    rng = np.random.default_rng(len(scan))
    written: dict[str, ImageTruth] = {}
    structs: list[dict[str, Any]] = []
    annotations: dict[str, Any] = {}
    for k in range(steps + 1):
        name = image_name(scan, k + 1)
        heading = np.deg2rad(30 * min(k, steps - 1))
        place = np.array([room.width / 2, room.depth / 2, 1.2])
        if k == steps:
            place = place + 0.3 * np.array([np.cos(heading), np.sin(heading), 0])
        # The robot's camera looks a little down, as no robot's is quite level.
        T = camera_at(place, heading, np.deg2rad(5), 0.0, width, height).T_world_camera
        assert T is not None
        depth, _ = sense_view(room, Camera(K, width, height, T), rng)
        millimetres = np.rint(depth * 1000).astype(np.uint16)
        millimetres[0, 0], millimetres[0, 1] = 6999, 7001
        color = rng.integers(40, 216, 3).astype(np.uint8)
        picture = np.broadcast_to(color, (height, width, 3))[..., ::-1]
        assert cv2.imwrite(str(folder / "jpg_rgb" / f"{name}.jpg"), np.ascontiguousarray(picture))
        assert cv2.imwrite(str(folder / "high_res_depth" / f"{image_name(scan, k + 1, 3)}.png"), millimetres)
        pose = None if k in unregistered else turn @ T
        structs.append(struct_of(f"{name}.jpg", pose))
        written[name] = ImageTruth(color, millimetres, pose)
        annotations[f"{name}.jpg"] = {
            "bounding_boxes": [[100 + k, 200, 420 + k, 330, 33, 1], [900, 500, 1000, 550, 21, 3]],
            **dict.fromkeys(MOVES, ""),
        }
    names = [f"{name}.jpg" for name in written]
    for k in range(steps - 1):
        annotations[names[k]]["rotate_ccw"] = names[k + 1]
        annotations[names[k + 1]]["rotate_cw"] = names[k]
    annotations[names[-2]]["forward"], annotations[names[-1]]["backward"] = names[-1], names[-2]
    (folder / "annotations.json").write_text(json.dumps(annotations))
    (folder / "present_instance_names.txt").write_text("red_cup\nred_bull\n")
    write_structs(folder, structs)
    (root / "instance_id_map.txt").write_text("".join(f"{name} {number}\n" for number, name in NAMES.items()))
    cameras = root / "camera_params" / scan if camera_params else folder
    cameras.mkdir(parents=True, exist_ok=True)
    (cameras / "cameras.txt").write_text(CAMERAS)
    return written


def struct_of(name: str, T_world_camera: np.ndarray | None) -> dict[str, Any]:
    """One entry of image_structs: R and t world-to-camera in units of `SCALE` millimetres, empty where unknown."""
    empty = np.zeros((0, 0))
    R, t, centre = empty, empty, empty
    if T_world_camera is not None:
        R = T_world_camera[:3, :3].T
        centre = T_world_camera[:3, 3:] * 1000 / SCALE
        t = -R @ centre
    return {
        "image_name": name,
        "t": t,
        "R": R,
        "world_pos": centre,
        "direction": R[2:].T if R.size else empty,
        "quat": empty,
        "scaled_world_pos": centre * SCALE,
        "image_id": "1",
        "camera_id": "1",
        "cluster_id": -1,
        **dict.fromkeys(POINTERS, -1),
    }


def write_structs(folder: Path, structs: list[dict[str, Any]], scale: Any = SCALE) -> None:
    """image_structs.mat with its struct array (1, N)."""
    from scipy.io import savemat

    kinds = [(key, object) for key in structs[0]]
    array = np.empty((1, len(structs)), dtype=kinds)
    for k, struct in enumerate(structs):
        for key, value in struct.items():
            array[key][0, k] = value
    savemat(folder / "image_structs.mat", {"image_structs": array, "scale": scale})


def edit_annotations(folder: Path, change: Any) -> None:
    """Rewrites annotations.json after `change(table)`."""
    table = json.loads((folder / "annotations.json").read_text())
    change(table)
    (folder / "annotations.json").write_text(json.dumps(table))
