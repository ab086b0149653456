"""KITTI-like object labels: a text file a frame. Not lossless; see below.

`label_2/000000.txt` has a line an object: type, truncated, occluded, alpha,
left, top, right, bottom, h, w, l, x, y, z, rotation_y, score. `calib/000000.txt`
has P0..P3 (all equal), R0_rect, Tr_velo_to_cam, Tr_imu_to_velo.

KITTI describes a box by its size, the middle of its bottom face and one angle
about the vertical, in a camera frame whose y axis points straight down. Our
cameras look down at the scene. So everything is written in the *level* camera
frame: the same centre of projection, turned by `ViewerAxes.R_level_camera` so
that y is along gravity and z is the level viewing direction. It takes the place
of KITTI's rectified frame:

    R0_rect = R_level_camera
    P2      = K · R_level_cameraᵀ          (3x4, last column 0)
    Tr_velo_to_cam = identity              ("velodyne" is our camera frame)

so that `P2 · X` projects a point of a label into the unchanged picture, as the
devkit does it, and `P2 · R0_rect · Tr_velo_to_cam · y` a point of our camera
frame. With a level camera P2 is [K | 0]. With a tilted one P2[0, 0] is not the
focal length: tools that take P2 apart, instead of multiplying by it, must use
K = P2[:, :3] · R0_rect.

Our upright boxes have axes near (right, down, forward) and sizes (width, height,
depth) along them; KITTI's l, h, w are these three. `rotation_y` is KITTI's: the
box's first axis is (cos ry, 0, -sin ry) in the level frame.

* type: the class name with white space as "_"; `classes.json` has the names.
* truncated: 1 where the object touches the picture's border, else 0; how much
  of it lies outside is not known.
* occluded: from the visible share where the dataset gives it, else from what
  stands nearer along the mask's border: 0 below 10 % hidden, 1 below 50 %, 2
  above; 3 where the object has no points.
* right and bottom are exclusive edges in continuous pixels.
* Without an upright box: h w l -1, x y z -1000, alpha and rotation_y -10.

`index.txt` has a line a frame: index, width, height, id. `ImageSets/train.txt`
lists the usable ones, which alone have label and calib files. `object_ids/`
has, line by line as in `label_2/`, the objects' numbers. Pictures, if copied,
are PNG in `image_2/`.

A line of KITTI has no room for where its values come from: `provenance.jsonl` has
a line for every object of `label_2/`, with `index`, `line` (from 1), `frame`,
`object` and the keys of `pipeline.labels.exports.base`.

What comes back: of `frames` frame, frame_index, ok, width, height, K and up
(image-up where it is unknown; K and up null where the frame is not usable); of
`objects` frame, frame_index, object, label, score, bbox, touches_border and,
with nine decimals, center, R, size. Relations and expressions do not.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.geometry.viewer import IMAGE_UP, viewer_axes
from pipeline.labels.exports.base import (
    ExportFormat,
    Job,
    Written,
    iterate_frames,
    json_line,
    label_names,
)
from pipeline.system.whole_files import text_file, write_json

NO_BOX = "-1 -1 -1 -1000 -1000 -1000 -10"
FIELDS = 16
HIDDEN_PARTLY, HIDDEN_LARGELY = 0.1, 0.5


def write_kitti(job: Job) -> Written:
    """Write the label and calibration files of every usable frame, and the lists."""
    tokens = class_tokens(job)
    folders = ("label_2", "calib", "object_ids", "ImageSets")
    for name in folders:
        (job.folder / name).mkdir()
    counts = Counter(frames=0, objects=0, boxes=0)
    left_out = 0
    with (
        text_file(job.folder / "index.txt") as index,
        text_file(job.folder / "ImageSets" / "train.txt") as usable,
        text_file(job.folder / "provenance.jsonl") as provenance,
    ):
        for rows in iterate_frames(job.labels, job.tell):
            frame = rows.frame
            index.write(f"{rows.index:06d} {frame['width']} {frame['height']} {_written_id(frame['frame'])}\n")
            if not frame["ok"]:
                continue
            usable.write(f"{rows.index:06d}\n")
            # From the camera frame into the level one; image-up where up is unknown.
            level = viewer_axes(IMAGE_UP if frame["up"] is None else np.asarray(frame["up"])).R_level_camera
            _write(job.folder / "calib" / f"{rows.index:06d}.txt", _calibration(frame["K"], level))
            lines = [_line(row, tokens, level) for row in rows.objects]
            _write(job.folder / "label_2" / f"{rows.index:06d}.txt", lines)
            _write(job.folder / "object_ids" / f"{rows.index:06d}.txt", [str(row["object"]) for row in rows.objects])
            for k, row in enumerate(rows.objects, start=1):
                named = {"index": rows.index, "line": k, "frame": frame["frame"], "object": row["object"]}
                known = job.provenance.row("objects", frame["frame"], str(row["object"]))
                provenance.write(json_line({**named, **known}) + "\n")
            boxes = sum(NO_BOX not in line for line in lines)
            counts.update(frames=1, objects=len(lines), boxes=boxes)
            left_out += sum(row["center"] is not None for row in rows.objects) - boxes
            job.copy_picture(rows, "image_2", "png")
    write_json(job.folder / "classes.json", {token: name for name, token in tokens.items()})
    files = ("index.txt", "classes.json", "provenance.jsonl", *(f"{name}/" for name in folders))
    turned = (f"{left_out} boxes are not upright, and are written as unknown",) if left_out else ()
    notes = ("relations and expressions have no place in this format", *turned)
    return Written((*files, *(("image_2/",) if job.images is not None else ())), counts, notes)


def class_tokens(job: Job) -> dict[str, str]:
    """Token of each class name, a single word; `DontCare` has another meaning in KITTI and is avoided."""
    tokens: dict[str, str] = {}
    taken = {"DontCare", ""}
    for name in label_names(job.labels):
        # A NUL or another control character would end the line for some readers.
        plain = "_".join("".join(c if c.isprintable() or c.isspace() else " " for c in name).split()) or "_"
        token, number = plain, 2
        while token in taken:
            token, number = f"{plain}~{number}", number + 1
        taken.add(token)
        tokens[name] = token
    return tokens


def _line(row: Mapping[str, Any], tokens: Mapping[str, str], level: np.ndarray) -> str:
    box = None
    if row["center"] is not None and row["R"] is not None and row["size"] is not None:
        R = np.asarray(row["R"], np.float64).reshape(3, 3)
        box = to_kitti(np.asarray(row["center"]), R, np.asarray(row["size"]), level)
    if box is None:
        alpha, geometry = "-10", NO_BOX
    else:
        dimensions, location, rotation_y = box
        alpha = f"{observation_angle(location, rotation_y):.9f}"
        geometry = " ".join(f"{x:.9f}" for x in (*dimensions, *location, rotation_y))
    bbox = " ".join(repr(float(x)) for x in row["bbox"])
    seen = f"{int(row['touches_border'])} {_occluded(row)}"
    return f"{tokens[row['label']]} {seen} {alpha} {bbox} {geometry} {float(row['score'])!r}"


def _occluded(row: Mapping[str, Any]) -> int:
    if not row["points"]:
        return 3
    hidden = row["occluded"] if row["visible"] is None else 1 - row["visible"]
    return 0 if hidden < HIDDEN_PARTLY else 1 if hidden < HIDDEN_LARGELY else 2


def _calibration(K: list[float] | None, level: np.ndarray) -> list[str]:
    P, identity = projection(K, level), np.hstack([np.eye(3), np.zeros((3, 1))])
    entries = {
        **{f"P{k}": P for k in range(4)},
        "R0_rect": level,
        "Tr_velo_to_cam": identity,
        "Tr_imu_to_velo": identity,
    }
    return [f"{name}: " + " ".join(f"{x:.12e}" for x in matrix.ravel()) for name, matrix in entries.items()]


def _write(path: Path, lines: list[str]) -> None:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8", newline="\n")


def _written_id(frame: str) -> str:
    plain = frame and frame.split() == [frame] and frame.isprintable() and not frame.startswith('"')
    return frame if plain else json.dumps(frame)


FORMAT = ExportFormat(
    write_kitti, description="KITTI-like object labels, a text file a frame; boxes only", lossless=False
)


UPRIGHT = 1e-7
"""How far the second axis of a box may stand off the vertical, as a sine."""


def projection(K: list[float] | None, R_level_camera: np.ndarray) -> np.ndarray:
    """P2, (3, 4): pixels from points of the level camera frame. Without intrinsics, those of a unit camera."""
    intrinsic = np.eye(3) if K is None else np.asarray(K, np.float64).reshape(3, 3)
    return np.hstack([intrinsic @ R_level_camera.T, np.zeros((3, 1))])


def to_kitti(
    center: np.ndarray, R: np.ndarray, size: np.ndarray, R_level_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """A box of the camera frame as KITTI has it.

    Returns (h, w, l) metres; middle of the bottom face in the level camera frame, metres; radians in -pi..pi. None
    where the box is not upright.
    """
    own = R_level_camera @ R
    if own[1, 1] <= 0 or max(abs(own[0, 1]), abs(own[2, 1])) > UPRIGHT:
        return None
    return (
        size[[1, 2, 0]],
        R_level_camera @ center + np.array([0.0, size[1] / 2, 0.0]),
        float(np.arctan2(-own[2, 0], own[0, 0])),
    )


def observation_angle(location: np.ndarray, rotation_y: float) -> float:
    """KITTI's alpha, radians in -pi..pi: the angle about the vertical at which the camera sees the box."""
    return float((rotation_y - np.arctan2(location[0], location[2]) + np.pi) % (2 * np.pi) - np.pi)
