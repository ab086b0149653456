"""Rules on rows as such: values, keys, references, and the frame's own camera."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline.labels.check.findings import Finding
from pipeline.labels.check.stream import Rows
from pipeline.labels.check.view import FrameView
from pipeline.labels.schema import KEYS
from pipeline.language.relation_names import PAIRWISE

ROTATION_TOLERANCE = 1e-3
"""Greatest entry of R R^T - I: what datasets write with four decimals stays below it."""

NAMED_OBJECTS = {
    "frames": (),
    "objects": ("object",),
    "relations": ("a", "b"),
    "expressions": ("target_object", "reference_object"),
}
"""The columns of a table that name objects."""


def check_rows(view: FrameView) -> Iterator[Finding]:
    """Everything that can be said of rows without knowing what they mean."""
    for table, rows in view.tables.items():
        for violation in rows.violations:
            yield view.finding(
                violation.rule,
                _objects_of(table, rows, violation.row),
                f"{table}: {violation.message}",
                {"table": table, "column": violation.column},
            )
        yield from _keys(view, table, rows)
        yield from _order(view, table, rows)
        yield from _references(view, table, rows)
    yield from _counts(view)
    yield from _camera(view)
    yield from _rotations(view)


def _objects_of(table: str, rows: Rows, row: int) -> tuple[int, ...]:
    return tuple(int(rows[name][row]) for name in NAMED_OBJECTS[table])


def _keys(view: FrameView, table: str, rows: Rows) -> Iterator[Finding]:
    """Rows that share their key with an earlier row."""
    if len(rows) < 2:
        return
    columns = [rows[name] for name in KEYS[table][1:]]
    seen: set[tuple[object, ...]] = set()
    codes = [np.unique(c.astype(str), return_inverse=True)[1] if c.dtype == object else c for c in columns]
    if codes and len(np.unique(np.stack(codes, axis=1), axis=0)) == len(rows):
        return
    for row, key in enumerate(zip(*columns, strict=True) if columns else [()] * len(rows)):
        if key in seen:
            message = f"{table}: a second row has this key"
            yield view.finding("row/duplicate-key", _objects_of(table, rows, row), message, {"table": table})
        seen.add(key)


def _order(view: FrameView, table: str, rows: Rows) -> Iterator[Finding]:
    """Rows of a frame that leave the canonical order, told once."""
    columns = [rows[name] for name in KEYS[table][1:]] if len(rows) > 1 else []
    if not columns:
        return
    rank = {relation: k for k, relation in enumerate(PAIRWISE)}
    keys = [np.array([rank.get(v, -1) for v in c]) if c.dtype == object else c for c in columns]
    if not np.array_equal(np.lexsort(keys[::-1]), np.arange(len(rows))):
        yield view.finding("file/order", (), f"{table}: the rows of the frame are out of order", {"table": table})


def _references(view: FrameView, table: str, rows: Rows) -> Iterator[Finding]:
    """Frames and objects that a row names and that are not there."""
    if table == "frames" or not len(rows):
        return
    frames = view.tables["frames"]
    if not len(frames):
        yield view.finding(
            "row/dangling",
            (),
            f"{table}: {len(rows)} rows are of frame number {view.index}, which does not exist",
            {"table": table, "rows": len(rows), "frame_index": view.index},
        )
    else:
        for row in np.flatnonzero(rows["frame"] != frames["frame"][0]):
            yield view.finding(
                "row/dangling",
                _objects_of(table, rows, int(row)),
                f"{table}: the row names frame {rows['frame'][row]!r}, its number is that of {frames['frame'][0]!r}",
                {"table": table},
            )
    if table == "objects":
        return
    named = np.stack([rows[name] for name in NAMED_OBJECTS[table]], axis=1)
    for row in np.flatnonzero(~np.isin(named, view.ids).all(axis=1)):
        missing = [int(n) for n in named[row] if n not in view.row_of]
        yield view.finding(
            "row/dangling",
            tuple(int(n) for n in named[row]),
            f"{table}: there is no object {' nor '.join(map(str, missing))} in this frame",
            {"table": table},
        )
    if table == "expressions":
        for row in range(len(rows)):
            listed = np.union1d(rows["targets"][row], rows["acceptable"][row])
            absent = listed[~np.isin(listed, view.ids)]
            if len(absent):
                yield view.finding(
                    "row/dangling",
                    _objects_of(table, rows, row),
                    f"expressions: the answers name object {absent[0]}, which is not in this frame",
                    {"table": table, "object": int(absent[0])},
                )


def _counts(view: FrameView) -> Iterator[Finding]:
    frames = view.tables["frames"]
    if len(frames) and int(frames["objects"][0]) != len(view.objects):
        yield view.finding(
            "frame/objects",
            (),
            f"the frame is said to have {frames['objects'][0]} objects, and {len(view.objects)} are listed",
            {"stated": int(frames["objects"][0]), "listed": len(view.objects)},
        )


def _camera(view: FrameView) -> Iterator[Finding]:
    """Intrinsics, pose and up vector of a frame that could be used."""
    if not view.usable:
        return
    frames = view.tables["frames"]
    K = view.K
    if K is None:
        yield view.finding("frame/camera", (), "the frame has no intrinsics")
    elif not (K[0, 0] > 0 and K[1, 1] > 0 and np.array_equal(K[2], [0, 0, 1]) and K[1, 0] == 0):
        yield view.finding("frame/camera", (), "K is not that of a pinhole camera", {"fx": K[0, 0], "fy": K[1, 1]})
    elif not (0 <= K[0, 2] <= view.size[1] and 0 <= K[1, 2] <= view.size[0]):
        yield view.finding(
            "frame/camera", (), "the principal point is outside the picture", {"cx": K[0, 2], "cy": K[1, 2]}, "warning"
        )
    up = frames["up"][0]
    length = float(np.linalg.norm(up))
    if view.viewer is None or abs(length - 1) > ROTATION_TOLERANCE:
        yield view.finding("frame/camera", (), "up is not a unit vector", {"length": length})
    pose = frames["T_world_camera"][0].reshape(4, 4)
    if np.isfinite(pose).all():
        fault = rotation_fault(pose[None, :3, :3])[0]
        if fault > ROTATION_TOLERANCE or not np.array_equal(pose[3], [0, 0, 0, 1]):
            yield view.finding("frame/camera", (), "the pose is not rigid", {"fault": float(fault)})


def _rotations(view: FrameView) -> Iterator[Finding]:
    if not len(view.objects):
        return
    for prefix in ("", "exact_"):
        rotation, size = view.objects[f"{prefix}R"].reshape(-1, 3, 3), view.objects[f"{prefix}size"]
        fault = rotation_fault(rotation)
        for row in np.flatnonzero(fault > ROTATION_TOLERANCE):
            yield view.finding(
                "object/rotation",
                (view.ids[row],),
                f"{prefix}R is not a rotation",
                {"fault": float(fault[row])},
            )
        for row in np.flatnonzero((size < 0).any(axis=1)):
            yield view.finding(
                "object/rotation",
                (view.ids[row],),
                f"{prefix}size has a negative edge",
                {"shortest": float(size[row].min())},
            )


def rotation_fault(rotation: np.ndarray) -> np.ndarray:
    """(N,) how far (N, 3, 3) matrices are from rotations: the greatest entry of R R^T - I, at least 2 for a mirror."""
    fault = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        return np.where(np.linalg.det(np.nan_to_num(rotation)) < 0, np.maximum(fault, 2.0), fault)
