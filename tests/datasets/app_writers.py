"""Writes recordings as apps and published sets lay them out, after their makers' documents and code."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from dataset_writers import HEIGHT, OPENGL, WIDTH, K, Truth, quaternion_line, random_truth, write_png


def truths(count: int, seed: int = 11) -> list[Truth]:
    """Frames of noise in smooth colour, which a video keeps."""
    rng = np.random.default_rng(seed)
    made = [random_truth(rng) for _ in range(count)]
    for number, truth in enumerate(made):
        truth.rgb[:] = (40 + 60 * number, 200 - 50 * number, 90)
    return made


def write_video(path: Path, pictures: Sequence[np.ndarray]) -> None:
    """Pictures (H, W, 3) RGB as a video without loss where the name ends in .mkv."""
    code = "FFV1" if path.suffix == ".mkv" else "mp4v"
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 30.0, (width, height))
    assert writer.isOpened()
    for picture in pictures:
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
    writer.release()


def write_stray(root: Path, made: list[Truth], packed: bool, first: int = 0) -> None:
    """https://github.com/strayrobots/scanner/blob/main/docs/format.md, colour twice as large as depth; unpacked with
    numbers from `first` on, as ffmpeg does from 1."""
    big = [cv2.resize(truth.rgb, (2 * WIDTH, 2 * HEIGHT), interpolation=cv2.INTER_NEAREST) for truth in made]
    for number, truth in enumerate(made):
        write_png(root / f"depth/{number:06d}.png", truth.millimetres)
        write_png(root / f"confidence/{number:06d}.png", np.full((HEIGHT, WIDTH), 2, np.uint8))
        if not packed:
            write_png(root / f"rgb/{number + first:06d}.png", big[number])
    if packed:
        write_video(root / "rgb.mp4", big)
    # A pixel of depth is two of colour; pixels count from their centres.
    rows = [[2 * K[0, 0], 0.0, 2 * (K[0, 2] + 0.5) - 0.5], [0.0, 2 * K[1, 1], 2 * (K[1, 2] + 0.5) - 0.5], [0, 0, 1]]
    (root / "camera_matrix.csv").write_text("\n".join(", ".join(map(str, row)) for row in rows))
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for number, truth in enumerate(made):
        values = ", ".join(f"{v:.9f}" for v in quaternion_line(truth.T_world_camera))
        lines.append(f"{100 + number / 30:.6f}, {number:06d}, {values}")
    (root / "odometry.csv").write_text("\n".join(lines))
    (root / "imu.csv").write_text("timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n100, 0, 0, 9.8, 0, 0, 0\n")


def write_polycam(root: Path, made: list[Truth], corrected: bool) -> None:
    """https://github.com/PolyCam/polyform, "Polycam's data format": t_ij is camera-to-world of ARKit's cameras."""
    kinds = [("", False), ("corrected_", True)] if corrected else [("", False)]
    for number, truth in enumerate(made):
        stamp = str(1_700_000_000_000_000 + 500_000 * number)
        write_png(root / f"keyframes/depth/{stamp}.png", truth.millimetres)
        write_png(root / f"keyframes/confidence/{stamp}.png", np.full((HEIGHT, WIDTH), 255, np.uint8))
        for prefix, right in kinds:
            write_png(
                root / f"keyframes/{prefix}images/{stamp}.png", truth.rgb if right or not corrected else truth.rgb // 2
            )
            T = truth.T_world_camera @ OPENGL
            T[:3, 3] += 0 if right or not corrected else 1.0
            table = {f"t_{i}{j}": float(T[i, j]) for i in range(3) for j in range(4)}
            table |= {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "width": WIDTH, "height": HEIGHT}
            path = root / f"keyframes/{prefix}cameras/{stamp}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({**table, "blur_score": 50.0, "timestamp": int(stamp)}))
    (root / "mesh_info.json").write_text('{"faceCount": 1}')


def write_scannetpp(root: Path, made: list[Truth], how: str) -> None:
    """The `iphone/` folder as `iphone/prepare_iphone_data.py` of https://github.com/scannetpp/scannetpp unpacks it.

    `how` is "lz4" (frames of LZ4), "deflate" (frames of deflate), "stream" (one deflate of all), or "unpacked". Depth
    has the 192 x 256 pixels of the sensor, of which those of `made` are the first.
    """
    folder = root / "iphone"
    folder.mkdir(parents=True)
    table = {}
    depths = [np.zeros((192, 256), np.uint16) for _ in made]
    pictures = [cv2.resize(truth.rgb, (256, 192), interpolation=cv2.INTER_NEAREST) for truth in made]
    for number, (truth, depth) in enumerate(zip(made, depths, strict=True)):
        depth[:HEIGHT, :WIDTH] = truth.millimetres
        matrix = {"intrinsic": K.tolist(), "timestamp": number / 60, "imu": {}}
        raw = (np.eye(4) + 9 * np.eye(4, k=3)).tolist()
        table[f"frame_{number:06d}"] = {**matrix, "pose": raw, "aligned_pose": truth.T_world_camera.tolist()}
    (folder / "pose_intrinsic_imu.json").write_text(json.dumps(table))
    if how == "unpacked":
        for number, (picture, depth) in enumerate(zip(pictures, depths, strict=True)):
            write_png(folder / f"rgb/frame_{number:06d}.png", picture)
            write_png(folder / f"depth/frame_{number:06d}.png", depth)
        return
    write_video(folder / "rgb.mkv", pictures)
    if how == "lz4":
        import lz4.block

        packed = [lz4.block.compress(depth.tobytes(), store_size=False) for depth in depths]
    else:
        metres = [(depth / np.float32(1000)).astype(np.float32) for depth in depths]
        whole = [np.stack(metres)] if how == "stream" else metres
        packed = []
        for part in whole:
            deflate = zlib.compressobj(wbits=-zlib.MAX_WBITS)
            packed.append(deflate.compress(part.tobytes()) + deflate.flush())
    sized = b"".join(struct.pack("<I", len(data)) + data for data in packed)
    (folder / "depth.bin").write_bytes(packed[0] if how == "stream" else sized)


def write_replica(root: Path, made: list[Truth], scale: float) -> Path:
    """https://github.com/cvg/nice-slam: a room's `results/` and `traj.txt`, and `cam_params.json` above the rooms."""
    room = root / "room0"
    for number, truth in enumerate(made):
        write_png(room / f"results/frame{number:06d}.png", truth.rgb)
        units = np.round(truth.millimetres * (scale / 1000)).astype(np.uint16)
        write_png(room / f"results/depth{number:06d}.png", units)
    lines = [" ".join(f"{v:.18e}" for v in truth.T_world_camera.ravel()) for truth in made]
    (room / "traj.txt").write_text("\n".join(lines))
    camera = {"w": WIDTH, "h": HEIGHT, "fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "scale": scale}
    (root / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return room


def write_icl(root: Path, made: list[Truth], reflected: bool) -> None:
    """https://www.doc.ic.ac.uk/~ahanda/VaFRIC/iclnuim.html, its PNG in the layout of TUM. `reflected`: the poses are of
    the renderer, whose y is up in world and camera; pictures are stored from the top down."""
    lines, path = [], []
    S = np.diag([1.0, -1.0, 1.0, 1.0])
    for number, truth in enumerate(made):
        write_png(root / f"rgb/{number}.png", truth.rgb)
        write_png(root / f"depth/{number}.png", truth.millimetres * 5)
        lines.append(f"{number} depth/{number}.png {number} rgb/{number}.png")
        T = S @ truth.T_world_camera @ S if reflected else truth.T_world_camera
        path.append(f"{number} " + " ".join(f"{v:.9f}" for v in quaternion_line(T)))
    (root / "associations.txt").write_text("\n".join(lines))
    (root / "livingRoom2.gt.freiburg").write_text("\n".join(path))


def write_colmap_binary(folder: Path, made: list[Truth], names: Sequence[str]) -> None:
    """`write_model` of COLMAP's `scripts/python/read_write_model.py`: PINHOLE, and two points in each picture."""
    folder.mkdir(parents=True)
    numbers = K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 1, 1, WIDTH, HEIGHT, *numbers))
    data = struct.pack("<Q", len(made))
    for number, (truth, name) in enumerate(zip(made, names, strict=True), start=1):
        x, y, z, qx, qy, qz, qw = quaternion_line(np.linalg.inv(truth.T_world_camera))
        data += struct.pack("<i7di", number, qw, qx, qy, qz, x, y, z, 1) + name.encode() + b"\0"
        data += struct.pack("<Q", 2) + 2 * struct.pack("<ddq", 1.0, 2.0, -1)
    (folder / "images.bin").write_bytes(data)
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))
