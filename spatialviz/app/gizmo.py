"""Handles in the scene that move, turn or resize one box.

Everything here is in the shown frame: x right, y forward, z up, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np
import viser.transforms as vtf

from pipeline.diagnosis.whatif.placement import SMALLEST_SIDE
from pipeline.geometry.boxes import Box3D
from spatialviz.app.context import Context
from spatialviz.app.frame_cloud import set_changed
from spatialviz.app.state import EditMode

MODES: tuple[EditMode, ...] = ("off", "move", "turn", "resize")
FACES = tuple((axis, side) for axis in range(3) for side in (-1, 1))


class BoxGizmo:
    """One client's handles: one transform control for move and turn, one for each face for resize.

    Parameters
    ----------
    ctx : Context
    dragged : callable
        Gets the box as it is now (camera frame), and whether the handle was let go, on the page's own thread. Only the
        latest box counts where the page is still busy with one before.
    root : str
        Scene node under which they stand.
    """

    def __init__(self, ctx: Context, dragged: Callable[[Box3D, bool], None], root: str = "/edit") -> None:
        self._ctx, self._client, self._dragged, self._root = ctx, ctx.client, dragged, root
        self._latest: tuple[Box3D, bool] | None = None
        self._lock = Lock()
        self._main: Any = None
        self._faces: list[Any] = []
        self._box: Box3D | None = None
        self._start: tuple[Box3D, np.ndarray] | None = None
        self._held: Any = None
        self._pulled = False
        self._mode: EditMode = "off"

    @property
    def held(self) -> bool:
        """Whether a handle is being dragged."""
        return self._held is not None

    def show(self, box: Box3D | None, mode: EditMode) -> None:
        """Show the handles of a mode around a box; none where there is no box. One that is held stays where it is."""
        if box is None or mode == "off":
            self._box, self._mode = None, "off"
            for handle in [self._main, *self._faces]:
                if handle is not None and handle.visible:
                    handle.visible = False
            return
        if self._main is None:
            self._make()
        self._box, self._mode = box, mode
        with self._client.atomic():
            self._place(box, mode)

    def _place(self, box: Box3D, mode: EditMode) -> None:
        main, span = self._main, float(box.size.max())
        set_changed(main, visible=mode != "resize")
        if mode != "resize" and main is not self._held:
            turning = mode == "turn"
            set_changed(
                main,
                disable_axes=turning,
                disable_sliders=turning,
                disable_rotations=not turning,
                active_axes=(True, True, not turning),
                scale=float(np.clip(span, 0.18, 0.6)),
            )
            main.position = box.center
            main.wxyz = vtf.SO3.from_z_radians(_yaw(box)).wxyz if turning else np.array([1.0, 0.0, 0.0, 0.0])
        for handle, (axis, side) in zip(self._faces, FACES, strict=True):
            set_changed(handle, visible=mode == "resize")
            if mode != "resize" or handle is self._held:
                continue
            normal, along = box.R[:, axis] * side, box.R[:, (axis + 1) % 3]
            handle.position = box.center + normal * box.size[axis] / 2
            handle.wxyz = vtf.SO3.from_matrix(np.stack([normal, along, np.cross(normal, along)], axis=1)).wxyz
            set_changed(handle, scale=float(np.clip(0.5 * span, 0.07, 0.24)))

    def _make(self) -> None:
        scene = self._client.scene
        self._main = scene.add_transform_controls(
            f"{self._root}/gizmo", line_width=3.0, depth_test=False, visible=False
        )
        self._faces = [
            scene.add_transform_controls(
                f"{self._root}/face-{'xyz'[axis]}{'-' if side < 0 else '+'}",
                line_width=4.0,
                active_axes=(True, False, False),
                disable_sliders=True,
                disable_rotations=True,
                depth_test=False,
                visible=False,
            )
            for axis, side in FACES
        ]
        self._listen(self._main, self._moved)
        for handle, (axis, side) in zip(self._faces, FACES, strict=True):
            self._listen(handle, lambda start, h, axis=axis, side=side: _resized(start[0], axis, side, h.position))

    def _listen(self, handle: Any, changed: Callable[[tuple[Box3D, np.ndarray], Any], Box3D]) -> None:
        @handle.on_update
        async def _(event: Any) -> None:
            if event.phase == "start" and self._box is not None:
                self._start, self._held = (self._box, _matrix(handle)), handle
            if self._start is None or self._held is not handle:
                return
            if event.phase == "update":
                self._pulled = True
            box, ended, pulled = changed(self._start, handle), event.phase == "end", self._pulled
            if ended:
                self._start, self._held, self._pulled = None, None, False
            if pulled:
                with self._lock:
                    before, self._latest = self._latest, (box, ended or (self._latest or (box, False))[1])
                if before is None:
                    self._ctx.post(self._follow)

    def _follow(self) -> None:
        with self._lock:
            latest, self._latest = self._latest, None
        if latest is not None:
            self._dragged(self._ctx.scene.camera_box(latest[0]), latest[1])

    def _moved(self, start: tuple[Box3D, np.ndarray], handle: Any) -> Box3D:
        box, was = start
        if self._mode != "turn":
            return replace(box, center=np.array(handle.position, np.float64))
        turn = vtf.SO3.from_matrix(_matrix(handle) @ was.T).as_matrix()
        return replace(box, R=turn @ box.R)


def _resized(box: Box3D, axis: int, side: int, position: Any) -> Box3D:
    """The box with one face pulled to a place; the opposite face stays."""
    normal = box.R[:, axis] * side
    face = box.center + normal * box.size[axis] / 2
    pull = max(float((np.array(position) - face) @ normal), SMALLEST_SIDE - float(box.size[axis]))
    size = box.size.copy()
    size[axis] += pull
    return Box3D(box.center + normal * pull / 2, box.R, size)


def _matrix(handle: Any) -> np.ndarray:
    return vtf.SO3(np.array(handle.wxyz)).as_matrix()


def _yaw(box: Box3D) -> float:
    return float(np.arctan2(box.R[1, 0], box.R[0, 0]))
