"""The 3D scene of one client: the frame's cloud, boxes by role, pair lines. It draws what it is given.

Everything stands in the viewer's level frame with x right, y forward, z up and
the camera at the origin, so that the floor is level whatever the camera's pitch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser.transforms as vtf

from pipeline.geometry.boxes import EDGES, Box3D, ray_entry
from pipeline.geometry.palette import RGB, Role, hex_color, palette
from spatialviz.app.frames import Cloud
from spatialviz.app.scene_client import Node, SceneClient, triple
from spatialviz.app.state import NOTHING, Ghost, Shown, State
from spatialviz.app.viewpoint import Viewpoint

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32)
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
LINE_WIDTH: dict[Role, float] = {"other": 1.3, "reference": 3.2, "target": 3.2, "truth": 1.6, "edited": 2.5}
GHOST_GROWTH = 0.012
"""Ghosts are drawn this much larger, metres, so that they do not lie in the very lines of the answer's boxes."""
FACE_OPACITY: dict[Role, float] = {"other": 0.035, "reference": 0.15, "target": 0.15}


@dataclass(frozen=True)
class Tag:
    """A name that follows a node of the scene, and stands beside what it names.

    Attributes
    ----------
    node : str
        Of the scene.
    text, detail : str
    color : str
        "#rrggbb".
    strong : bool
    center, extent : tuple of float
        Middle and half sizes of what it names, from the node, metres; a point without an extent.
    """

    node: str
    text: str
    detail: str
    color: str
    strong: bool
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    extent: tuple[float, float, float] = (0.0, 0.0, 0.0)


class SceneView:
    """Draws into one client's scene."""

    def __init__(
        self,
        client: SceneClient,
        on_ray: Callable[[tuple[int, int] | None, list[int]], None],
    ) -> None:
        self.viewpoint = Viewpoint(client)
        self._client = client
        self._boxed: dict[int, Box3D] = {}
        self._faces: Node | None = None
        self._axes_at: tuple[Any, list[Tag]] = (None, [])
        self.cloud: Cloud | None = None
        self.to_show = np.eye(3)

        @client.scene.on_click()
        def _(event: Any) -> None:
            origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
            on_ray(self._pixel_on_ray(origin, direction), self._boxes_on_ray(origin, direction))

    def draw(self, state: State) -> list[Tag]:
        """Draw boxes and pair lines, and return the names to show."""
        colors, flags, lines = palette(state.dark), state.flags, self._client.lines
        shown = state.shown if state.own_layer else NOTHING
        boxes = {i: entry.lifted.box for i, entry in enumerate(shown.objects)}
        self._boxed = {i: self.shown_box(box) for i, box in boxes.items() if box is not None}
        roles = state.roles
        role_of: dict[int, Role] = {i: roles.get(i, "other") for i in self._boxed}
        with self._client.atomic():
            for role in ("other", "reference", "target"):
                members = [box for i, box in self._boxed.items() if role_of[i] == role]
                wanted = state.boxes_shown or role != "other"
                lines(f"/boxes/{role}", edges(members if wanted else ()), colors[role], LINE_WIDTH[role])
            selected = state.selected if state.hovered is None else state.hovered
            chosen = [self._boxed[selected]] if selected in self._boxed else []
            lines("/boxes/selected", edges(chosen), (255, 255, 255) if state.dark else (20, 22, 26), 2.0)
            annotated = () if state.loaded is None or not flags.truth else state.loaded.context.frame.annotations
            truth = [self.shown_box(a.box) for a in annotated if a.box is not None]
            lines("/boxes/truth", edges(truth), colors["truth"], LINE_WIDTH["truth"])
            self._draw_faces([i for i in self._boxed if state.boxes_shown or role_of[i] != "other"], role_of, colors)
            self._draw_pairs(state.pair_lines if flags.pairs else (), colors)
            tags = self._draw_axes(state) + self._draw_ghosts(state.ghosts if flags.ghosts else (), colors)
            return tags + self._draw_tags(shown, role_of, selected, flags.labels, colors)

    def _draw_ghosts(self, ghosts: Sequence[Ghost], colors: Mapping[Role, RGB]) -> list[Tag]:
        """Boxes beside the answer's, in lines of their own and a little larger."""
        tags = []
        shown = [(g, self.shown_box(g.box)) for g in ghosts]
        for role in ("truth", "edited"):
            members = [box for ghost, box in shown if ghost.role == role]
            self._client.lines(f"/boxes/ghosts-{role}", edges(members, GHOST_GROWTH), colors[role], 2.4)
        for ghost, box in shown:
            anchor = self._client.anchor(f"/tags/ghost-{ghost.key}", box.center)
            tags.append(Tag(anchor, ghost.text, "", hex_color(colors[ghost.role]), False, extent=half_size(box)))
        return tags

    def shown_box(self, box: Box3D) -> Box3D:
        """A box of the camera frame as it is shown."""
        return Box3D(self.to_show @ box.center, self.to_show @ box.R, box.size)

    def camera_box(self, box: Box3D) -> Box3D:
        """A shown box in the camera frame."""
        return Box3D(self.to_show.T @ box.center, self.to_show.T @ box.R, box.size)

    def _draw_faces(self, shown: Sequence[int], role_of: Mapping[int, Role], colors: Mapping[Role, RGB]) -> None:
        if self._faces is not None and len(self._faces.batched_positions) != len(shown):
            self._faces.remove()
            self._faces = None
        if not shown:
            return
        boxes = [self._boxed[i] for i in shown]
        values = {
            "batched_wxyzs": vtf.SO3.from_matrix(np.stack([b.R for b in boxes])).wxyz.astype(np.float32),
            "batched_positions": np.stack([b.center for b in boxes]).astype(np.float32),
            "batched_scales": np.stack([np.maximum(b.size, 0.005) for b in boxes]).astype(np.float32),
            "batched_colors": np.array([colors[role_of[i]] for i in shown], np.uint8),
            "batched_opacities": np.array([FACE_OPACITY[role_of[i]] for i in shown], np.float32),
        }
        if self._faces is None:
            self._faces = self._client.scene.add_batched_meshes_simple(
                "/boxes/faces", CUBE, CUBE_FACES, lod="off", cast_shadow=False, receive_shadow=False, **values
            )
            return
        # A box that is dragged changes a few numbers; only these are sent.
        for name, value in values.items():
            if not np.array_equal(getattr(self._faces, name), value):
                setattr(self._faces, name, value)

    def _draw_pairs(self, pairs: Sequence[tuple[int, int]], colors: Mapping[Role, RGB]) -> None:
        """Lines between the boxes of pairs, the chosen one first."""
        known = [pair for pair in pairs if self._boxed.keys() >= set(pair)]
        ends = [[self._boxed[a].center, self._boxed[b].center] for a, b in known]
        segments = np.array(ends, np.float32).reshape(-1, 2, 3)
        tint = np.array([[colors["target"], colors["reference"]]], np.uint8).repeat(len(segments), axis=0)
        first = 1 if known[:1] == list(pairs[:1]) else 0
        self._client.lines("/pairs/chosen", segments[:first], tint[:first], 5.0)
        self._client.lines("/pairs/others", segments[first:], (tint[first:] * 0.6).astype(np.uint8), 1.6)

    def _draw_axes(self, state: State) -> list[Tag]:
        """The viewer's right, forward and up at the reference: the frame in which the relation is judged."""
        pairs = state.pair_lines if state.flags.axes or state.flags.region else ()
        reference = self._boxed.get(pairs[0][1]) if pairs else None
        marks = None if reference is None else (reference.center.tobytes(), reference.size.tobytes(), state.dark)
        if marks == self._axes_at[0]:
            return self._axes_at[1]
        self._client.clear("/axes/")
        tags: list[Tag] = []
        self._axes_at = marks, tags
        if reference is None:
            return tags
        length = float(np.clip(np.linalg.norm(reference.size), 0.25, 0.8))
        for name, direction in zip(("right", "forward", "up"), np.eye(3), strict=True):
            tip = reference.center + direction * length
            self._client.scene.add_arrows(
                f"/axes/{name}",
                np.array([[reference.center, tip]], np.float32),
                (245, 247, 250) if state.dark else (24, 26, 30),
                shaft_radius=0.006,
                head_radius=0.016,
                head_length=0.05,
            )
            tags.append(Tag(self._client.anchor(f"/axes/tip-{name}", tip), name, "", "#5b6472", False))
        return tags

    def _draw_tags(
        self, shown: Shown, role_of: Mapping[int, Role], selected: int | None, every: bool, colors: Mapping[Role, RGB]
    ) -> list[Tag]:
        tags = []
        for i, box in self._boxed.items():
            strong = role_of[i] != "other" or i == selected
            if strong or every:
                score = shown.objects[i].score
                detail = "" if score >= 0.9995 else f"{score:.2f}"
                anchor, color = self._client.anchor(f"/tags/{i}", box.center), hex_color(colors[role_of[i]])
                tags.append(Tag(anchor, shown.names[i], detail, color, strong, extent=half_size(box)))
        # Names of the answer are put last so that they lie on top of the others.
        return sorted(tags, key=lambda t: t.strong)

    def _boxes_on_ray(self, origin: np.ndarray, direction: np.ndarray) -> list[int]:
        """The boxes a ray passes, the smallest first: a mug is meant rather than the table around it."""
        hit = [i for i, b in self._boxed.items() if ray_entry(b, origin, direction) is not None]
        return sorted(hit, key=lambda i: self._boxed[i].volume)

    def _pixel_on_ray(self, origin: np.ndarray, direction: np.ndarray) -> tuple[int, int] | None:
        """(u, v) of the nearest surface point close to a ray; exact, because points are pixels."""
        if self.cloud is None or not len(self.cloud.points):
            return None
        offset = self.cloud.points - origin
        along = offset @ direction
        aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
        close = (along > 0.05) & (aside < 0.012 * np.maximum(along, 0.3))
        if not close.any():
            return None
        index = np.flatnonzero(close)
        best = index[np.argmin(along[index] + 3 * aside[index])]
        return int(self.cloud.u[best]), int(self.cloud.v[best])


def half_size(box: Box3D) -> tuple[float, float, float]:
    """Half of what a box takes along the axes of the scene, metres."""
    return triple((box.corners.max(axis=0) - box.corners.min(axis=0)) / 2)


def edges(boxes: Sequence[Box3D], growth: float = 0.0) -> np.ndarray:
    """(N, 2, 3) float32: the edges of boxes, grown by so many metres."""
    grown = [Box3D(b.center, b.R, b.size + growth).corners[EDGES] for b in boxes]
    return np.concatenate([np.zeros((0, 2, 3)), *grown]).astype(np.float32)
