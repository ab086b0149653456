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

from pipeline.answering.objects import SceneObject
from pipeline.datasets.scene_mesh import ContextMesh
from pipeline.geometry.boxes import EDGES, Box3D, ray_entry
from pipeline.geometry.palette import RGB, Role, hex_color, palette
from spatialviz.app.cloud import Cloud, Part
from spatialviz.app.frames import LoadedFrame
from spatialviz.app.glb import unlit_glb
from spatialviz.app.scene_client import Node, SceneClient
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


@dataclass(frozen=True)
class Ghost:
    """A box beside the answer's: of the label, or of another run's answer.

    Attributes
    ----------
    key, text : str
    box : Box3D
        Camera frame.
    role : str
        "truth" for the label's, "edited" for the other run's.
    """

    key: str
    text: str
    box: Box3D
    role: Role


@dataclass(frozen=True)
class SceneFlags:
    """What is shown."""

    cloud: bool = True
    boxes: bool = False
    labels: bool = False
    pairs: bool = True
    truth: bool = False
    axes: bool = False
    context: bool = False
    camera: bool = False
    ghosts: bool = True
    region: bool = False
    grid: bool = False


class SceneView:
    """Draws into one client's scene."""

    def __init__(
        self,
        client: SceneClient,
        on_ray: Callable[[tuple[int, int] | None, list[int]], None],
    ) -> None:
        self.viewpoint = Viewpoint(client)
        self._client = client
        self._flags = SceneFlags()
        self._boxed: dict[int, Box3D] = {}
        self._cloud: Cloud | None = None
        self._parts: list[Node] = []
        self._point_scale = 1.0
        self._lines: dict[str, Any] = {}
        self._faces: Any = None
        self._anchors: list[Node] = []
        self._ghost_anchors: dict[str, Node] = {}
        self._frustum: Any = None
        self._axes: list[Any] = []
        self._axes_at: tuple[Any, list[Tag]] = (None, [])
        self._context: Any = None
        self.to_show = np.eye(3)

        @client.scene.on_click()
        def _(event: Any) -> None:
            origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
            hit = self._pixel_on_ray(origin, direction) if self._flags.cloud else None
            on_ray(hit, self._boxes_on_ray(origin, direction))

    def set_frame(self, loaded: LoadedFrame, colors: np.ndarray) -> None:
        """Show another frame, of its points the first cloud; `colors` is (H, W, 3) uint8."""
        frame, viewer = loaded.context.frame, loaded.context.viewer
        self.to_show = np.stack([viewer.right, viewer.forward, viewer.up])
        cloud = self._cloud = loaded.cloud
        self.viewpoint.set_frame(cloud.points, self.to_show, frame.camera)
        painted = cloud.painted(colors)
        with self._client.atomic():
            for handle in self._parts:
                handle.remove()
            # Until the rest is there, one point stands for four.
            self._parts = [self._add(p, painted, 2 * p.size) for p in cloud.parts if p.first]
            if self._frustum is not None:
                self._frustum.remove()
            self._frustum = self._client.scene.add_camera_frustum(
                "/camera",
                fov=float(2 * np.arctan(frame.height / 2 / frame.camera.fy)),
                aspect=frame.width / frame.height,
                scale=0.15,
                thickness=1.5,
                thickness_units="screen",
                color=(130, 138, 150),
                wxyz=vtf.SO3.from_matrix(self.to_show).wxyz,
                visible=False,
            )

    def complete(self, colors: np.ndarray) -> None:
        """Add what is not of the first cloud."""
        cloud = self._cloud
        if cloud is None:
            return
        painted = cloud.painted(colors)
        with self._client.atomic():
            rest = [self._add(part, painted, part.size) for part in cloud.parts[len(self._parts) :]]
            self._parts += rest
            self._size_points()

    def _add(self, part: Part, painted: np.ndarray, size: float) -> Node:
        return self._client.scene.add_point_cloud(
            part.name,
            part.offsets,
            painted[part.at],
            point_size=size * self._point_scale,
            precision="float16",
            point_shading="flat",
            point_shape="square",
            position=triple(part.center),
            visible=self._flags.cloud,
        )

    def show_context(self, mesh: ContextMesh | None, dark: bool) -> None:
        """Show the room around the frame, dimmed toward the background; None shows none."""
        if self._context is not None:
            self._context.remove()
            self._context = None
        if mesh is None or not len(mesh.faces):
            return
        background = 20 if dark else 250
        dimmed = (mesh.colors * 0.45 + background * 0.55).astype(np.uint8)
        vertices = mesh.vertices @ self.to_show.T.astype(np.float32)
        data = unlit_glb(vertices, mesh.faces, dimmed)
        self._context = self._client.scene.add_glb("/context", data, cast_shadow=False, receive_shadow=False)

    def clear(self) -> None:
        """Show nothing: the frame is broken."""
        with self._client.atomic():
            handles = [*self._parts, *self._lines.values(), *self._axes, self._faces, self._frustum, self._context]
            for handle in handles:
                if handle is not None:
                    handle.remove()
        self._parts, self._lines, self._axes, self._axes_at = [], {}, [], (None, [])
        self._faces = self._frustum = self._cloud = self._context = None
        self._boxed = {}

    def recolor(self, colors: np.ndarray) -> None:
        """Paint the cloud with (H, W, 3) uint8 colours."""
        if self._cloud is None:
            return
        painted = self._cloud.painted(colors)
        with self._client.atomic():
            for handle, part in zip(self._parts, self._cloud.parts, strict=False):
                handle.colors = painted[part.at]

    def scale_points(self, factor: float) -> None:
        """Draw the points of the cloud larger, or smaller; they are not sent again."""
        if factor != self._point_scale:
            self._point_scale = factor
            with self._client.atomic():
                self._size_points()

    def _size_points(self) -> None:
        parts = () if self._cloud is None else self._cloud.parts
        whole = len(self._parts) == len(parts)
        for handle, part in zip(self._parts, parts, strict=False):
            handle.point_size = part.size * self._point_scale * (1 if whole else 2)

    def draw(
        self,
        objects: Sequence[SceneObject],
        names: Sequence[str],
        roles: Mapping[int, Role],
        selected: int | None,
        pairs: Sequence[tuple[int, int]],
        truth: Sequence[Box3D],
        ghosts: Sequence[Ghost],
        flags: SceneFlags,
        dark: bool,
    ) -> list[Tag]:
        """Draw boxes, the chosen pair first in `pairs`, and return the names to show.

        `truth` are the dataset's exact boxes, `ghosts` those of a label or of another run's answer.
        """
        colors = palette(dark)
        boxed = [i for i, o in enumerate(objects) if o.lifted.box is not None]
        self._flags = flags
        self._boxed = {i: self._box(objects, i) for i in boxed}
        role_of: dict[int, Role] = {i: roles.get(i, "other") for i in boxed}
        with self._client.atomic():
            for handle in self._parts:
                handle.visible = flags.cloud
            if self._frustum is not None:
                self._frustum.visible = flags.camera
            for role in ("other", "reference", "target"):
                shown = flags.boxes or role != "other"
                members = [self._boxed[i] for i in boxed if shown and role_of[i] == role]
                self._set_lines(f"/boxes/{role}", _edges(members), colors[role], LINE_WIDTH[role], True)
            chosen = [self._box(objects, selected)] if selected in role_of else []
            self._set_lines("/boxes/selected", _edges(chosen), (255, 255, 255) if dark else (20, 22, 26), 2.0, True)
            shown_truth = [self.shown_box(b) for b in truth]
            self._set_lines("/boxes/truth", _edges(shown_truth), colors["truth"], LINE_WIDTH["truth"], flags.truth)
            ghost_tags = self._draw_ghosts(ghosts if flags.ghosts else (), colors)
            self._draw_faces(objects, boxed, role_of, colors, flags)
            self._draw_pairs(pairs, colors, flags)
            axes = self._draw_axes(pairs, dark)
            return axes + ghost_tags + self._draw_tags(objects, names, boxed, role_of, selected, flags, colors)

    def _draw_ghosts(self, ghosts: Sequence[Ghost], colors: Mapping[Role, RGB]) -> list[Tag]:
        """Boxes beside the answer's, in lines of their own and a little larger."""
        tags = []
        shown = [(g, self.shown_box(g.box)) for g in ghosts]
        for role in ("truth", "edited"):
            grown = [Box3D(b.center, b.R, b.size + GHOST_GROWTH) for g, b in shown if g.role == role]
            self._set_lines(f"/boxes/ghosts-{role}", _edges(grown), colors[role], 2.4, True)
        for ghost, box in shown:
            if ghost.key not in self._ghost_anchors:
                anchor = self._client.scene.add_frame(f"/tags/ghost-{ghost.key}", show_axes=False)
                self._ghost_anchors[ghost.key] = anchor
            self._ghost_anchors[ghost.key].position = triple(box.center)
            color = hex_color(colors[ghost.role])
            tags.append(Tag(f"/tags/ghost-{ghost.key}", ghost.text, "", color, False, extent=half_size(box)))
        return tags

    def shown_box(self, box: Box3D) -> Box3D:
        """A box of the camera frame as it is shown."""
        return Box3D(self.to_show @ box.center, self.to_show @ box.R, box.size)

    def camera_box(self, box: Box3D) -> Box3D:
        """A shown box in the camera frame."""
        return Box3D(self.to_show.T @ box.center, self.to_show.T @ box.R, box.size)

    def _box(self, objects: Sequence[SceneObject], i: int | None) -> Box3D:
        assert i is not None
        box = objects[i].lifted.box
        assert box is not None
        return self.shown_box(box)

    def _set_lines(self, name: str, points: np.ndarray, color: RGB, width: float, visible: bool) -> None:
        handle = self._lines.get(name)
        if not len(points):
            if handle is not None:
                handle.visible = False
            return
        if handle is None:
            self._lines[name] = self._client.scene.add_line_segments(
                name, points, color, thickness=width, thickness_units="screen", visible=visible
            )
            return
        handle.points = points
        handle.colors = np.array(color, np.uint8)
        handle.visible = visible

    def _draw_faces(
        self,
        objects: Sequence[SceneObject],
        boxed: Sequence[int],
        role_of: Mapping[int, Role],
        colors: Mapping[Role, RGB],
        flags: SceneFlags,
    ) -> None:
        shown = [i for i in boxed if flags.boxes or role_of[i] != "other"]
        if self._faces is not None and (not shown or len(self._faces.batched_positions) != len(shown)):
            self._faces.remove()
            self._faces = None
        if not shown:
            return
        boxes = [self._boxed[i] for i in shown]
        values = {
            "batched_scales": np.stack([np.maximum(b.size, 0.005) for b in boxes]).astype(np.float32),
            "batched_colors": np.array([colors[role_of[i]] for i in shown], np.uint8),
            "batched_opacities": np.array([FACE_OPACITY[role_of[i]] for i in shown], np.float32),
        }
        wxyzs = vtf.SO3.from_matrix(np.stack([b.R for b in boxes])).wxyz.astype(np.float32)
        centers = np.stack([b.center for b in boxes]).astype(np.float32)
        if self._faces is None:
            self._faces = self._client.scene.add_batched_meshes_simple(
                "/boxes/faces", CUBE, CUBE_FACES, wxyzs, centers, lod="off", cast_shadow=False, receive_shadow=False,
                **values,
            )  # fmt: skip
            return
        # A box that is dragged changes a few numbers; only these are sent.
        for name, value in (("batched_wxyzs", wxyzs), ("batched_positions", centers), *values.items()):
            if not np.array_equal(getattr(self._faces, name), value):
                setattr(self._faces, name, value)

    def _draw_pairs(
        self,
        pairs: Sequence[tuple[int, int]],
        colors: Mapping[Role, RGB],
        flags: SceneFlags,
    ) -> None:
        lines = [
            np.array([[self._boxed[a].center, self._boxed[b].center]], np.float32)
            if a in self._boxed and b in self._boxed
            else np.zeros((0, 2, 3), np.float32)
            for a, b in pairs
        ]
        none = np.zeros((0, 2, 3), np.float32)
        chosen, others = (lines or [none])[0], np.concatenate([none, *lines[1:]])
        blend = np.array([[colors["target"], colors["reference"]]], np.uint8)
        for name, segment, width in (("/pairs/chosen", chosen, 5.0), ("/pairs/others", others, 1.6)):
            handle, shown = self._lines.get(name), len(segment) > 0 and flags.pairs
            tint = np.repeat(blend, len(segment), axis=0)
            if name == "/pairs/others":
                tint = (tint * 0.6).astype(np.uint8)
            if handle is not None and len(handle.points) == len(segment):
                handle.points, handle.colors, handle.visible = segment, tint, shown
                continue
            if handle is not None:
                self._lines.pop(name).remove()
            if shown:
                self._lines[name] = self._client.scene.add_line_segments(
                    name, segment, tint, thickness=width, thickness_units="screen"
                )

    def _draw_axes(self, pairs: Sequence[tuple[int, int]], dark: bool) -> list[Tag]:
        """The viewer's right, forward and up at the reference: the frame in which the relation is judged."""
        reference = self._boxed.get(pairs[0][1]) if pairs else None
        shown = reference is not None and (self._flags.axes or self._flags.region)
        marks = None if reference is None or not shown else (reference.center.tobytes(), reference.size.tobytes(), dark)
        if marks == self._axes_at[0]:
            return self._axes_at[1]
        for handle in self._axes:
            handle.remove()
        self._axes, self._axes_at = [], (marks, [])
        if reference is None or not shown:
            return []
        length = float(np.clip(np.linalg.norm(reference.size), 0.25, 0.8))
        center, scene = reference.center, self._client.scene
        tags = []
        for name, direction in (("right", np.eye(3)[0]), ("forward", np.eye(3)[1]), ("up", np.eye(3)[2])):
            tip = center + direction * length
            color = (245, 247, 250) if dark else (24, 26, 30)
            self._axes.append(
                scene.add_arrows(
                    f"/axes/{name}",
                    np.array([[center, tip]], np.float32),
                    color,
                    shaft_radius=0.006,
                    head_radius=0.016,
                    head_length=0.05,
                )
            )
            x, y, z = (float(v) for v in tip)
            self._axes.append(scene.add_frame(f"/axes/tip-{name}", show_axes=False, position=(x, y, z)))
            tags.append(Tag(f"/axes/tip-{name}", name, "", "#5b6472", False))
        self._axes_at = marks, tags
        return tags

    def _draw_tags(
        self,
        objects: Sequence[SceneObject],
        names: Sequence[str],
        boxed: Sequence[int],
        role_of: Mapping[int, Role],
        selected: int | None,
        flags: SceneFlags,
        colors: Mapping[Role, RGB],
    ) -> list[Tag]:
        while len(self._anchors) < len(objects):
            self._anchors.append(self._client.scene.add_frame(f"/tags/{len(self._anchors)}", show_axes=False))
        tags = []
        for i in boxed:
            if not (role_of[i] != "other" or i == selected or flags.labels):
                continue
            box = self._box(objects, i)
            self._anchors[i].position = triple(box.center)
            strong = role_of[i] != "other" or i == selected
            score = objects[i].score
            detail = "" if score >= 0.9995 else f"{score:.2f}"
            color = hex_color(colors[role_of[i]])
            tags.append(Tag(f"/tags/{i}", names[i], detail, color, strong, extent=half_size(box)))
        # Names of the answer are put last so that they lie on top of the others.
        return sorted(tags, key=lambda t: t.strong)

    def _boxes_on_ray(self, origin: np.ndarray, direction: np.ndarray) -> list[int]:
        """The boxes a ray passes, the smallest first: a mug is meant rather than the table around it."""
        hit = [i for i, b in self._boxed.items() if ray_entry(b, origin, direction) is not None]
        return sorted(hit, key=lambda i: self._boxed[i].volume)

    def _pixel_on_ray(self, origin: np.ndarray, direction: np.ndarray) -> tuple[int, int] | None:
        """(u, v) of the nearest surface point close to a ray; exact, because points are pixels."""
        if self._cloud is None or not len(self._cloud.points):
            return None
        offset = self._cloud.points - origin
        along = offset @ direction
        aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
        close = (along > 0.05) & (aside < 0.012 * np.maximum(along, 0.3))
        if not close.any():
            return None
        index = np.flatnonzero(close)
        best = index[np.argmin(along[index] + 3 * aside[index])]
        return int(self._cloud.u[best]), int(self._cloud.v[best])


def triple(v: np.ndarray) -> tuple[float, float, float]:
    """A vector as viser and JSON take it."""
    return float(v[0]), float(v[1]), float(v[2])


def half_size(box: Box3D) -> tuple[float, float, float]:
    """Half of what a box takes along the axes of the scene, metres."""
    return triple((box.corners.max(axis=0) - box.corners.min(axis=0)) / 2)


def _edges(boxes: Sequence[Box3D]) -> np.ndarray:
    if not boxes:
        return np.zeros((0, 2, 3), np.float32)
    return np.concatenate([b.corners[EDGES] for b in boxes]).astype(np.float32)
