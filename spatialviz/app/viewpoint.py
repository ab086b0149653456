"""Where one client's camera stands: the sensor's own place, an overview, from above, around an object."""

from __future__ import annotations

import time

import numpy as np
import viser

from pipeline.diagnosis.whatif.state import CameraView
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera
from spatialviz.app.scene_client import SceneClient

SAMPLE = 20_000
"""Points of a cloud that say where it lies."""
AROUND, NEAREST = 1.12, 0.9
"""A pair is seen from so much farther than would fill the view, and from no nearer than so many metres."""


class Viewpoint:
    """Moves one client's camera in the level frame of the shown cloud."""

    def __init__(self, client: SceneClient) -> None:
        self._client = client
        self._points: np.ndarray | None = None
        self._to_show = np.eye(3)
        self._camera: Camera | None = None
        self._placed: tuple[str, float, np.ndarray] | None = None
        self._reached = False
        self._moved = False
        self._about: np.ndarray | None = None

        @client.camera.on_update
        async def _(camera: viser.CameraHandle) -> None:
            if self._placed is None or self._points is None:
                return
            kind, aspect, eye = self._placed
            there = np.linalg.norm(np.array(camera.position) - eye) < 0.02
            if self._reached and not there:
                self._placed, self._moved = None, True
                return
            # Until the browser has taken the pose over it reports an older one.
            self._reached = self._reached or bool(there)
            if abs(self._aspect - aspect) > 0.02:
                self.place(kind)

    def set_frame(self, points: np.ndarray, R_show_camera: np.ndarray, camera: Camera) -> None:
        """Take over another cloud ((N, 3), shown frame, metres) and its camera."""
        self._points, self._to_show, self._camera = points[:: len(points) // SAMPLE + 1], R_show_camera, camera

    def look_about(self, corners: np.ndarray | None) -> bool:
        """Have "pair" show these points ((N, 3), shown frame, metres); whether they are others than before."""
        before, self._about = self._about, corners
        if before is None or corners is None:
            return before is not corners
        return not np.array_equal(before, corners)

    def fly(self, kind: str) -> None:
        """Move the camera to "pair", "sensor", "orbit" or "top", smoothly."""
        eye, look, fov = self._pose(kind)
        self._placed = None
        camera = self._client.camera
        camera.up_direction = self._up(kind)
        p0, l0, f0 = np.array(camera.position), np.array(camera.look_at), float(camera.fov)
        for k in range(1, 13):
            t = k / 12
            t = t * t * (3 - 2 * t)
            with self._client.atomic():
                camera.position = p0 * (1 - t) + eye * t
                camera.look_at = l0 * (1 - t) + look * t
                camera.fov = f0 * (1 - t) + fov * t
            self._client.flush()
            time.sleep(1 / 40)
        self._placed, self._reached, self._moved = (kind, self._aspect, eye), False, False

    @property
    def untouched(self) -> bool:
        """Whether the view is as it was placed, nobody having turned it since."""
        return not self._moved

    @property
    def _aspect(self) -> float:
        return float(np.clip(self._client.camera.aspect or 1.3, 0.4, 3.0))

    def place(self, kind: str) -> None:
        """The same at once; repeated when the shape of the page changes before anybody has turned the view."""
        eye, look, fov = self._pose(kind)
        self._placed = (kind, self._aspect, eye)
        self._reached = self._moved = False
        with self._client.atomic():
            self._client.camera.up_direction = self._up(kind)
            self._client.camera.position = eye
            self._client.camera.look_at = look
            self._client.camera.fov = fov

    def turned_to(self) -> tuple[CameraView, float] | None:
        """Where the camera was turned to, in the frame's camera frame, and its field of view; None where it was not."""
        if self.untouched or self._points is None:
            return None
        camera, back = self._client.camera, self._to_show.T
        vectors = (camera.position, camera.look_at, camera.up_direction)
        eye, look, up = ([round(float(x), 4) for x in back @ np.array(v)] for v in vectors)
        view = CameraView((eye[0], eye[1], eye[2]), (look[0], look[1], look[2]), (up[0], up[1], up[2]))
        return view, float(camera.fov)

    def turn_to(self, view: CameraView, fov: float | None) -> None:
        """Turn the camera to where it was turned before."""
        eye, look, up = (self._to_show @ np.array(v) for v in (view.position, view.look_at, view.up))
        if np.linalg.norm(look - eye) < 1e-4 or np.linalg.norm(np.cross(look - eye, up)) < 1e-6:
            return  # No way to look.
        self._placed, self._moved = None, True
        with self._client.atomic():
            self._client.camera.up_direction = up
            self._client.camera.position = eye
            self._client.camera.look_at = look
            if fov is not None and 0.05 < fov < 3.0:
                self._client.camera.fov = fov

    def focus(self, box: Box3D) -> None:
        """Turn around an object: look at it from where the camera stands, nearer."""
        center = self._to_show @ box.center
        # The next frame is shown as a whole again.
        self._placed, self._moved = None, False
        camera = self._client.camera
        away = np.array(camera.position) - center
        distance = max(float(np.linalg.norm(box.size)) * 1.9, 0.5)
        away *= distance / max(float(np.linalg.norm(away)), 1e-6)
        with self._client.atomic():
            camera.position = center + away
            camera.look_at = center

    def _up(self, kind: str) -> tuple[float, float, float]:
        """The sensor's own up in its view, so that the picture stands as it was taken; the world's elsewhere."""
        up = self._to_show @ np.array([0.0, -1.0, 0.0]) if kind == "sensor" else np.array([0.0, 0.0, 1.0])
        return float(up[0]), float(up[1]), float(up[2])

    def _pose(self, kind: str) -> tuple[np.ndarray, np.ndarray, float]:
        assert self._points is not None
        assert self._camera is not None
        points = self._points
        middle = np.median(points, axis=0) if len(points) else np.array([0.0, 2.0, 0.0])
        if not len(points):
            kind = "sensor"
        forward = self._to_show @ np.array([0.0, 0.0, 1.0])
        distance = float(np.linalg.norm(middle))
        if kind == "sensor":
            # The whole picture is in view, with a little air, whatever the shape of the page.
            tall = self._camera.height / 2 / self._camera.fy
            wide = self._camera.width / 2 / self._camera.fx / self._aspect
            return np.zeros(3) - forward * 0.01, forward * distance, float(2 * np.arctan(max(tall, wide) * 1.04))
        if kind == "top":
            low, high = np.percentile(points, [3, 97], axis=0)
            span = float(max(high[0] - low[0], high[1] - low[1]))
            center = (low + high) / 2
            return center + np.array([0.0, -0.02, span * 1.25]), center, float(np.deg2rad(50))
        if kind == "pair" and self._about is not None:
            eye, look, fov = self._fitting_pose(self._about, np.deg2rad(44))
            # What stands around the pair is in view, too.
            return look + (eye - look) * max(AROUND, NEAREST / max(float(np.linalg.norm(eye - look)), 1e-6)), look, fov
        return self._fitting_pose(points, np.deg2rad(44))

    def _fitting_pose(self, points: np.ndarray, fov: float) -> tuple[np.ndarray, np.ndarray, float]:
        """From the right, above and behind the sensor, as near as shows nearly all of the cloud."""
        low, high = np.percentile(points, [2, 98], axis=0)
        center = (low + high) / 2
        toward = np.array([-0.36, 0.84, -0.42])
        toward /= np.linalg.norm(toward)
        across = np.cross(toward, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(across, toward), toward])
        sample = points[:: max(1, len(points) // 4000)]
        tangent = np.tan(fov / 2)
        distance = 1.0
        for _ in range(4):
            x, y, z = ((sample - center) @ axes.T).T
            # A point is in view from as far away as its offset over the tangent, less its own depth.
            needed = np.maximum(np.abs(x) / (tangent * self._aspect), np.abs(y) / tangent) - z
            distance = max(float(np.percentile(needed, 99.3)) * 1.03, 0.2)
            seen = np.stack([x, y]) / np.maximum(distance + z, 0.05)
            shift = np.percentile(seen, [0.7, 99.3], axis=1).mean(axis=0) * distance
            center = center + axes[0] * shift[0] + axes[1] * shift[1]
        return center - toward * distance, center, float(fov)
