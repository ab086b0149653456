"""A draft of pixels in the scene: its points and the box that it would get."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.geometry.boxes import EDGES, Box3D
from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import palette
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_client import SceneClient

POINT = 0.004
MOST_POINTS = 60_000


class PixelScene:
    """Draws into one client's scene, beside what `SceneView` draws."""

    def __init__(self, client: SceneClient, scene: SceneView) -> None:
        self._client, self._scene = client, scene
        self._handles: list[Any] = []

    def clear(self) -> None:
        """Show nothing."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def draw(self, frame: Frame, mask: np.ndarray, box: Box3D | None, dark: bool) -> None:
        """Show a mask's points, towards the viewer of the cloud they lie in, and a box (camera frame)."""
        with self._client.atomic():
            self.clear()
            color = palette(dark)["edited"]
            v, u = np.nonzero(mask & (frame.depth > 0))
            step = max(1, -(-len(v) // MOST_POINTS))
            v, u = v[::step], u[::step]
            if len(v):
                points = lift_pixels(frame.depth[v, u] * np.float32(0.995), frame.camera, v, u)
                shown = (points @ self._scene.to_show.T.astype(np.float32)).astype(np.float32)
                self._handles.append(
                    self._client.scene.add_point_cloud(
                        "/draft/points", shown, color, point_size=POINT, precision="float32", point_shading="flat",
                        point_shape="square",
                    )
                )  # fmt: skip
            if box is not None:
                lines = self._scene.shown_box(box).corners[EDGES].astype(np.float32)
                self._handles.append(
                    self._client.scene.add_line_segments(
                        "/draft/box", lines, color, thickness=2.6, thickness_units="screen"
                    )
                )
