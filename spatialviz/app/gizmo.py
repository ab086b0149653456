"""Handles in the scene that move, turn or resize one box.

Everything here is in the shown frame: x right, y forward, z up, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import viser.transforms as vtf

from pipeline.diagnosis.whatif.placement import SMALLEST_SIDE
from pipeline.geometry.boxes import Box3D
from spatialviz.app.scene_client import SceneClient

EditMode = Literal["off", "move", "turn", "resize"]
MODES: tuple[EditMode, ...] = ("off", "move", "turn", "resize")
FACES = tuple((axis, side) for axis in range(3) for side in (-1, 1))


class BoxGizmo:
    """One client's handles: one transform control for move and turn, one for each face for resize.

    Parameters
    ----------
    client : SceneClient
    dragged : callable
        Gets the box as it is now, and whether the handle was let go. It is called on viser's own loop, in order, and
        must return at once.
    root : str
        Scene node under which they stand.
    """

    def __init__(self, client: SceneClient, dragged: Callable[[Box3D, bool], None], root: str = "/edit") -> None:
        self._client, self._dragged, self._root = client, dragged, root
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
        _set(main, visible=mode != "resize")
        if mode != "resize" and main is not self._held:
            turning = mode == "turn"
            _set(
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
            _set(handle, visible=mode == "resize")
            if mode != "resize" or handle is self._held:
                continue
            normal, along = box.R[:, axis] * side, box.R[:, (axis + 1) % 3]
            handle.position = box.center + normal * box.size[axis] / 2
            handle.wxyz = vtf.SO3.from_matrix(np.stack([normal, along, np.cross(normal, along)], axis=1)).wxyz
            _set(handle, scale=float(np.clip(0.5 * span, 0.07, 0.24)))

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
                self._dragged(box, ended)

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


def _set(handle: Any, **values: Any) -> None:
    """Set what differs; viser sends every assignment."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
