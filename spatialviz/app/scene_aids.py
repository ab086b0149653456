"""What helps to judge lengths in the scene: scale, metre grid, a measured length, the size of points."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.measure import surface_point
from spatialviz.app.context import Context, Part
from spatialviz.app.edit_scene import over_floor
from spatialviz.app.frames import Cloud, LoadedFrame
from spatialviz.app.scene import Tag
from spatialviz.app.scene_client import triple
from spatialviz.app.state import State

CELL, FINE = 1.0, 0.25
"""Distance of the grid's lines, metres."""
FLOOR_LOW, FLOOR_HIGH = 0.05, 0.1
"""Points so far below and above the lowest ones are of the floor, metres."""
GRID_LIFT = 0.008
GRID_COLORS = {True: ((118, 126, 140), (70, 76, 86)), False: ((150, 158, 170), (200, 205, 212))}
INK = {True: "#f5f7fa", False: "#181a1e"}
TAG = "/tags/measured"


class SceneAids(Part):
    """Draws them into one client's scene and page."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._gridded: tuple[Cloud, bool] | None = None

    def follow(self) -> list[Tag]:
        """Bring them up to the state; returns the names that are to be shown."""
        state = self.state
        loaded = state.loaded
        self._draw_grid(loaded if state.flags.grid else None, state.dark)
        if loaded is None:
            self.ctx.page.call("scale", None)
            self.ctx.page.call("measure", None)
            return []
        self.ctx.page.call("scale", self._looked_at(state, loaded))
        frame = loaded.context.frame
        ends = [self.ctx.scene.to_show @ surface_point(frame.depth, frame.camera, mark) for mark in state.marks]
        self.ctx.page.call("measure", {"on": state.picking == "measure", "points": [_rounded(end) for end in ends]})
        found = state.measured
        if found is None:
            return []
        half = np.abs(ends[1] - ends[0]) / 2
        parts = ", ".join(word.replace(" m ", " ") for word in found.words)
        return [
            Tag(
                self.ctx.client.anchor(TAG, (ends[0] + ends[1]) / 2),
                f"{found.distance:.3f} m",
                parts,
                INK[state.dark],
                True,
                extent=triple(half),
            )
        ]

    def _looked_at(self, state: State, loaded: LoadedFrame) -> dict[str, object]:
        """The point whose depth the scale is of: the middle of the chosen pair, else of the cloud."""
        ends = [] if state.pair is None else [state.shown.objects[i].lifted.box for i in state.pair[:2]]
        centers = [self.ctx.scene.to_show @ box.center for box in ends if box is not None]
        if centers and state.pair is not None:
            return {"center": _rounded(np.mean(centers, axis=0)), "name": state.shown.names[state.pair[0]]}
        points = loaded.cloud.points
        middle = np.median(points, axis=0) if len(points) else np.array([0.0, 2.0, 0.0])
        return {"center": _rounded(middle), "name": "the middle"}

    def _draw_grid(self, loaded: LoadedFrame | None, dark: bool) -> None:
        wanted = None if loaded is None or not len(loaded.cloud.points) else (loaded.cloud, dark)
        if wanted == self._gridded:
            return
        self.ctx.client.clear("/grid/")
        self._gridded = wanted
        if loaded is None or wanted is None:
            return
        low, high = np.percentile(loaded.cloud.points, [1, 99], axis=0)
        low[2] = high[2] = floor_height(loaded)
        height = over_floor(loaded.cloud.points, low, high) + GRID_LIFT
        for name, color, width, lines in zip(
            ("cells", "fine"), GRID_COLORS[dark], (1.6, 0.8), grid_lines(low[:2], high[:2], height), strict=True
        ):
            self.ctx.client.lines(f"/grid/{name}", lines, color, width)


def floor_height(loaded: LoadedFrame) -> float:
    """How high the floor lies, metres along up from the camera: the annotated one, else that of the lowest points."""
    frame, viewer = loaded.context.frame, loaded.context.viewer
    for annotation in frame.annotations:
        if annotation.label == "floor" and annotation.mask is not None:
            v, u = np.nonzero(annotation.mask & (frame.depth > 0))
            if len(v):
                return float(np.median(lift_pixels(frame.depth[v, u], frame.camera, v, u) @ viewer.up))
    heights = loaded.cloud.points[:, 2]
    lowest = np.percentile(heights, 1)
    near = heights[(heights > lowest - FLOOR_LOW) & (heights < lowest + FLOOR_HIGH)]
    return float(np.median(near))


def grid_lines(low: np.ndarray, high: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2, 3) float32 each: lines at whole metres, and the fine ones between, over the cells from low to high."""
    first, last = np.floor(low / CELL) * CELL, np.ceil(high / CELL) * CELL
    made = []
    for axis in (0, 1):
        steps = np.arange(round((last[axis] - first[axis]) / FINE) + 1)
        lines = np.full((len(steps), 2, 3), height, np.float32)
        lines[..., axis] = (first[axis] + steps * FINE)[:, None]
        lines[:, 0, 1 - axis], lines[:, 1, 1 - axis] = first[1 - axis], last[1 - axis]
        made.append((lines, steps % round(CELL / FINE) == 0))
    cells, fine = (np.concatenate([lines[whole == which] for lines, whole in made]) for which in (True, False))
    return cells, fine


def _rounded(v: np.ndarray) -> list[float]:
    return [round(float(x), 4) for x in v]
