"""Writes small datasets of known content, for the tests of the readers."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

HEIGHT, WIDTH = 48, 64
K = np.array([[60.0, 0, 31.5], [0, 61.0, 23.5], [0, 0, 1]])


@dataclass
class Truth:
    """What was written of one frame."""

    rgb: np.ndarray
    millimetres: np.ndarray
    T_world_camera: np.ndarray
    masks: list[np.ndarray] = field(default_factory=list)
    T_camera_object: list[np.ndarray] = field(default_factory=list)

    @property
    def depth(self) -> np.ndarray:
        return np.where(self.millimetres == 65535, 0, self.millimetres).astype(np.float32) / np.float32(1000)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def random_truth(rng: np.random.Generator, objects: int = 0) -> Truth:
    """Noise in every pixel, holes in the depth, and disjoint masks."""
    depth = rng.integers(500, 4000, (HEIGHT, WIDTH)).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.1] = 0
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.normal(size=3)
    truth = Truth(rng.integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8), depth, T)
    for k in range(objects):
        mask = np.zeros((HEIGHT, WIDTH), bool)
        mask[5 + k : 20 + 2 * k, 12 * k + 1 : 12 * k + 9] = True
        mask &= rng.random(mask.shape) < 0.7
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = random_rotation(rng), rng.normal(size=3)
        truth.masks.append(mask)
        truth.T_camera_object.append(pose)
    return truth


def write_png(path: Path, pixels: np.ndarray) -> None:
    """RGB or single-channel pixels."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.ascontiguousarray(pixels[..., ::-1]) if pixels.ndim == 3 else pixels
    assert cv2.imwrite(str(path), image)


def write_bop(
    root: Path,
    scenes: dict[str, list[int]],
    objects: tuple[int, ...] = (1, 2, 12),
    models: dict[str, Any] | None = None,
    seed: int = 0,
) -> dict[str, Truth]:
    """A BOP dataset; what was written, by frame id. Rotations are rounded to 5 decimals."""
    rng = np.random.default_rng(seed)
    written: dict[str, Truth] = {}
    for scene, images in scenes.items():
        camera: dict[str, Any] = {}
        gt: dict[str, Any] = {}
        info: dict[str, Any] = {}
        folder = root / scene
        for image in images:
            truth = random_truth(rng, len(objects))
            T = np.linalg.inv(truth.T_world_camera)
            camera[str(image)] = {
                "cam_K": K.ravel().tolist(),
                "depth_scale": 0.5,
                "cam_R_w2c": T[:3, :3].round(5).ravel().tolist(),
                "cam_t_w2c": (T[:3, 3] * 1000).tolist(),
            }
            gt[str(image)] = [
                {
                    "obj_id": number,
                    "cam_R_m2c": pose[:3, :3].round(5).ravel().tolist(),
                    "cam_t_m2c": (pose[:3, 3] * 1000).tolist(),
                }
                for number, pose in zip(objects, truth.T_camera_object, strict=True)
            ]
            info[str(image)] = []
            for k, mask in enumerate(truth.masks):
                rows, columns = np.nonzero(mask)
                x, y = int(columns.min()), int(rows.min())
                w, h = int(columns.max()) - x + 1, int(rows.max()) - y + 1
                info[str(image)].append({"bbox_visib": [x, y, w, h], "visib_fract": 0.25 * (k + 1)})
                write_png(folder / "mask_visib" / f"{image:06d}_{k:06d}.png", mask.astype(np.uint8) * 255)
            write_png(folder / "rgb" / f"{image:06d}.png", truth.rgb)
            write_png(folder / "depth" / f"{image:06d}.png", truth.millimetres * 2)
            written[f"{folder.name}/{image:06d}"] = truth
        for name, table in (("scene_camera", camera), ("scene_gt", gt), ("scene_gt_info", info)):
            (folder / f"{name}.json").write_text(json.dumps(table))
    if models is not None:
        (root / "models").mkdir()
        (root / "models" / "models_info.json").write_text(json.dumps(models))
    return written


def write_seven_scenes(root: Path, count: int, seed: int = 0) -> list[Truth]:
    """`count` 7-Scenes frames numbered from 0, with camera-intrinsics.txt."""
    rng = np.random.default_rng(seed)
    written = [random_truth(rng) for _ in range(count)]
    for k, truth in enumerate(written):
        truth.millimetres[:3, :5] = 65535
        write_png(root / f"frame-{k:06d}.color.png", truth.rgb)
        write_png(root / f"frame-{k:06d}.depth.png", truth.millimetres)
        np.savetxt(root / f"frame-{k:06d}.pose.txt", truth.T_world_camera)
    np.savetxt(root / "camera-intrinsics.txt", K)
    return written


def write_folder(root: Path, numbers: list[int], seed: int = 0, poses: bool = True) -> list[Truth]:
    """A plain recording: rgb/N.png, depth/N.png in millimetres, pose.txt."""
    rng = np.random.default_rng(seed)
    written = [random_truth(rng) for _ in numbers]
    for number, truth in zip(numbers, written, strict=True):
        write_png(root / "rgb" / f"{number}.png", truth.rgb)
        write_png(root / "depth" / f"{number}.png", truth.millimetres)
    if poses:
        lines = [" ".join(f"{v:.9f}" for v in quaternion_line(truth.T_world_camera)) for truth in written]
        (root / "pose.txt").write_text("\n".join(lines))
    return written


def quaternion_line(T: np.ndarray) -> np.ndarray:
    """tx ty tz qx qy qz qw: the quaternion is the eigenvector of the matrix of Bar-Itzhack (2000)."""
    (a, b, c), (d, e, f), (g, h, i) = T[:3, :3]
    N = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    return np.concatenate([T[:3, 3], np.linalg.eigh(N / 3)[1][:, -1]])


START = 1305031102.175304
"""Time of the first colour image that `write_tum` writes."""


def write_tum(root: Path, count: int, seed: int = 0) -> dict[str, Truth]:
    """A TUM recording at 30 Hz: depth 11 ms after colour, the path 3 ms after it. By frame id."""
    rng = np.random.default_rng(seed)
    header = "# timestamp filename"
    lines: dict[str, list[str]] = {"rgb": [header], "depth": [header], "groundtruth": []}
    written: dict[str, Truth] = {}
    for k in range(count):
        truth, time = random_truth(rng), START + k / 30
        color, depth = f"{time:.6f}", f"{time + 0.011:.6f}"
        write_png(root / "rgb" / f"{color}.png", truth.rgb)
        write_png(root / "depth" / f"{depth}.png", truth.millimetres * 5)
        lines["rgb"].append(f"{color} rgb/{color}.png")
        lines["depth"].append(f"{depth} depth/{depth}.png")
        numbers = " ".join(f"{v:.9f}" for v in quaternion_line(truth.T_world_camera))
        lines["groundtruth"].append(f"{time + 0.003:.4f} {numbers}")
        written[color] = truth
    for name, text in lines.items():
        (root / f"{name}.txt").write_text("\n".join(text) + "\n")
    return written


def write_scannet(root: Path, numbers: list[int], seed: int = 0) -> dict[str, Truth]:
    """A ScanNet export whose colour is lossless and of the depth's size. By frame id."""
    rng = np.random.default_rng(seed)
    written: dict[str, Truth] = {}
    for folder in ("pose", "intrinsic"):
        (root / folder).mkdir(parents=True)
    for number in numbers:
        truth = written[str(number)] = random_truth(rng)
        write_png(root / "color" / f"{number}.png", truth.rgb)
        write_png(root / "depth" / f"{number}.png", truth.millimetres)
        np.savetxt(root / "pose" / f"{number}.txt", truth.T_world_camera)
    M = np.eye(4)
    M[:3, :3] = K
    np.savetxt(root / "intrinsic" / "intrinsic_depth.txt", M)
    M[:2] *= 2
    np.savetxt(root / "intrinsic" / "intrinsic_color.txt", M)
    return written


def write_redwood(root: Path, names: list[str], inside: str = "", seed: int = 0) -> dict[str, Truth]:
    """A Redwood recording, its images and its trajectory in the folder `inside`, the camera file in `root`."""
    rng = np.random.default_rng(seed)
    written: dict[str, Truth] = {}
    log: list[str] = []
    for k, name in enumerate(names):
        truth = written[name] = random_truth(rng)
        write_png(root / inside / "color" / f"{name}.png", truth.rgb)
        write_png(root / inside / "depth" / f"{name}.png", truth.millimetres)
        rows = [" ".join(f"{v:.12g}" for v in row) for row in truth.T_world_camera]
        log += [f"{k} {k} {k + 1}", *rows]
    (root / inside / "trajectory.log").write_text("\n".join(log) + "\n")
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": K.T.ravel().tolist()}
    (root / "camera_primesense.json").write_text(json.dumps(camera))
    return written


def tilt_of(rng: np.random.Generator) -> np.ndarray:
    """Rtilt of a camera that is held like a hand holds it: up to 0.3 radians from level."""
    x, y = rng.uniform(-0.3, 0.3, 2)
    return cv2.Rodrigues(np.array([x, y, 0.0]))[0]


def write_sunrgbd(root: Path, frames: list[str], seed: int = 0) -> dict[str, tuple[Truth, np.ndarray]]:
    """SUN RGB-D's own folders; by frame id what was written, and Rtilt."""
    rng = np.random.default_rng(seed)
    written: dict[str, tuple[Truth, np.ndarray]] = {}
    for frame in frames:
        truth, Rtilt = random_truth(rng), tilt_of(rng)
        rotated = (truth.millimetres << 3) | (truth.millimetres >> 13)
        write_png(root / frame / "image" / "0000001.png", truth.rgb)
        write_png(root / frame / "depth" / "0000001.png", rotated)
        write_png(root / frame / "depth_bfx" / "0000001.png", np.full_like(rotated, 2000 << 3))
        np.savetxt(root / frame / "intrinsics.txt", K, fmt="%.6f")
        (root / frame / "extrinsics").mkdir()
        np.savetxt(root / frame / "extrinsics" / "20141221170930.txt", np.c_[Rtilt, np.zeros(3)], fmt="%.6f")
        written[frame] = truth, Rtilt
    return written


def write_votenet(root: Path, frames: list[str], seed: int = 0) -> dict[str, tuple[Truth, np.ndarray]]:
    """VoteNet's export of SUN RGB-D, with one box `chair` a frame; what was written, and Rtilt."""
    from scipy.io import savemat

    rng = np.random.default_rng(seed)
    written: dict[str, tuple[Truth, np.ndarray]] = {}
    for folder in ("depth", "calib", "label"):
        (root / folder).mkdir(parents=True)
    for frame in frames:
        truth, Rtilt = random_truth(rng), tilt_of(rng)
        # A JPEG keeps a picture of one colour to within one step.
        truth.rgb[:] = rng.integers(0, 256, 3)
        write_png(root / "image" / f"{frame}.jpg", truth.rgb)
        v, u = np.nonzero(truth.depth)
        z = truth.depth[v, u].astype(np.float64)
        camera = np.stack([(u - K[0, 2]) / K[0, 0] * z, z, -(v - K[1, 2]) / K[1, 1] * z], axis=1)
        instance = np.concatenate([camera @ Rtilt.T, truth.rgb[v, u] / 255], axis=1).astype(np.float32)
        savemat(root / "depth" / f"{frame}.mat", {"instance": instance}, do_compression=True)
        from_one = np.add(K, [[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        rows = [" ".join(f"{x:.9g}" for x in M.T.ravel()) for M in (Rtilt, from_one)]
        (root / "calib" / f"{frame}.txt").write_text("\n".join(rows) + "\n")
        (root / "label" / f"{frame}.txt").write_text("chair 11 6 20 30 0.1 2.5 -0.4 0.3 0.5 0.4 0.6 -0.8\n")
        written[frame] = truth, Rtilt
    return written


OPENGL = np.diag([1.0, -1, -1, 1])


def write_nerfstudio(root: Path, depth: bool = True) -> list[Truth]:
    """Three posed pictures with `transforms.json`, which names their depth files or leaves that to their names."""
    rng = np.random.default_rng(7)
    made, frames = [random_truth(rng) for _ in range(3)], []
    for number, truth in enumerate(made, start=1):
        write_png(root / f"images/frame_{number:05d}.png", truth.rgb)
        write_png(root / f"depth/frame_{number:05d}.png", truth.millimetres)
        pose = np.asarray(truth.T_world_camera) @ OPENGL
        frame: dict[str, Any] = {"file_path": f"./images/frame_{number:05d}.png", "transform_matrix": pose.tolist()}
        frames.append({**frame, "depth_file_path": f"depth/frame_{number:05d}.png"} if depth else frame)
    table = {"w": WIDTH, "h": HEIGHT, "fl_x": 60.0, "fl_y": 61.0, "cx": 32.0, "cy": 24.0, "camera_model": "OPENCV"}
    (root / "transforms.json").write_text(json.dumps({**table, "frames": frames}))
    return made
