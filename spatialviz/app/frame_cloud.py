"""Frame in a client's scene: point cloud, surrounding room, and aids for judging lengths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import is_
from typing import Any

import numpy as np
import viser.transforms as vtf

from pipeline.answering.frame_store import LoadedFrame, frame_colors
from pipeline.answering.objects import SceneObject
from pipeline.datasets.scene_mesh import fuse_context
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.cloud import NEAREST_BY_HAND, CloudPart, metre_grid, spacing_at, stride_of
from pipeline.geometry.masks import encode_run_length
from pipeline.geometry.palette import dimming, hex_color
from pipeline.geometry.viewer import surface_point
from pipeline.system.errors import FrameUnusable, MissingExtra
from pipeline.system.recent import Recent
from spatialviz.app.context import Context, Part
from spatialviz.app.picture import index_map
from spatialviz.app.scene import Tag, plain_color
from spatialviz.app.scene_client import triple
from spatialviz.app.state import State

CLOUD = "/cloud/"
"""Prefix of the cloud's nodes."""


class FrameCloud(Part):
    """Keeps a client's cloud and surrounding room up to the state."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._loaded: LoadedFrame | None = None
        self._painted: tuple[Any, ...] = ()
        self._points = np.zeros((0, 3), np.uint8)
        self._lit: tuple[tuple[object, ...], dict[str, object] | None] = ((), None)
        self.place_anew = False

    def follow(self) -> None:
        """Draw everything for the state; the view is reset on demand, or until a person turns it."""
        state, scene = self.state, self.ctx.scene
        loaded, viewpoint = state.loaded, scene.viewpoint
        anew, self.place_anew = self.place_anew or viewpoint.untouched, False
        was, self._loaded = self._loaded, loaded
        other = viewpoint.look_about(state.about)
        if loaded is None:
            scene.cloud = None
            self.ctx.client.clear(CLOUD)
            self.ctx.client.clear("/camera")
        elif self._painted != state.paint_key or loaded is not was:
            self._painted = state.paint_key
            look = state.colors, loaded.context.frame, loaded.objects, state.roles, state.dark
            self._points = loaded.painted(state.paint_key, lambda: frame_colors(*look))
            with self.ctx.client.atomic():
                if loaded is not was:
                    self._show(loaded)
                for part in loaded.cloud.parts:
                    self.ctx.client.change(CLOUD + part.name, colors=self._points[part.at])
            if loaded is not was:
                if anew:
                    viewpoint.place(state.camera)
                self.ctx.post(lambda: self._complete(loaded))
        # A refused question has no pair to look at.
        if other and not state.error and state.camera == "pair" and viewpoint.untouched and loaded is not None:
            viewpoint.place("pair")
        self.dress()
        self.ctx.page.call("lit", self._spotlight(state))
        self._show_room(state)

    def _spotlight(self, state: State) -> dict[str, object] | None:
        """Pixels that the browser dims the cloud around, and how it finds those of points; None dims nothing."""
        loaded, masks = state.loaded, state.spotlit
        if loaded is None or masks is None:
            return None
        drawn = (loaded, state.dark, self.ctx.scene.to_show, *masks)
        if len(drawn) != len(self._lit[0]) or not all(map(is_, drawn, self._lit[0])):
            camera = loaded.context.frame.camera
            step = stride_of(camera)
            lit = np.logical_or.reduce([mask[::step, ::step] for mask in masks]) if masks else None
            to_pixel = (
                intrinsics(camera.fx, camera.fy, camera.cx, camera.cy)
                @ self.ctx.scene.to_show.T
                / [[step], [step], [1]]
            )
            self._lit = (
                drawn,
                {
                    "size": [-(-side // step) for side in (camera.height, camera.width)],
                    "counts": "" if lit is None else encode_run_length(lit),
                    "toPixel": to_pixel.ravel().tolist(),
                    "dim": dimming(state.dark).ravel().tolist(),
                },
            )
        return self._lit[1]

    def dress(self) -> None:
        """Show the points at the chosen size, and the camera."""
        parts, state, client = () if self._loaded is None else self._loaded.cloud.parts, self.state, self.ctx.client
        # Until the rest arrives, a point stands for four.
        factor = state.point_size * (1 if all(CLOUD + part.name in client.nodes for part in parts) else 2)
        with client.atomic():
            for part in parts:
                client.change(CLOUD + part.name, visible=state.flags.cloud, point_size=part.size * factor)
            client.change("/camera", visible=state.flags.camera)
        self.ctx.page.call("cloud", {CLOUD + part.name: len(part.offsets) for part in parts if state.flags.cloud})

    def _show(self, loaded: LoadedFrame) -> None:
        """Show another frame, with the first cloud of points."""
        frame, viewer, scene = loaded.context.frame, loaded.context.viewer, self.ctx.scene
        scene.to_show, scene.cloud = np.stack([viewer.right, viewer.forward, viewer.up]), loaded.cloud
        scene.viewpoint.set_frame(loaded.cloud.points, scene.to_show, frame.camera)
        self.ctx.client.clear(CLOUD)
        # Old tags would pile up over frames.
        self.ctx.client.clear("/tags/")
        self._add(part for part in loaded.cloud.parts if part.first)
        self.ctx.client.put(
            "camera_frustum",
            "/camera",
            fov=float(2 * np.arctan(frame.height / 2 / frame.camera.fy)),
            aspect=frame.width / frame.height,
            scale=0.15,
            thickness=1.5,
            thickness_units="screen",
            color=(130, 138, 150),
            wxyz=vtf.SO3.from_matrix(scene.to_show).wxyz,
            visible=self.state.flags.camera,
        )

    def _complete(self, loaded: LoadedFrame) -> None:
        """Send the rest of a frame's cloud, unless another frame is shown."""
        if loaded is self._loaded:
            with self.ctx.client.atomic():
                self._add(part for part in loaded.cloud.parts if not part.first)
                self.dress()

    def _add(self, parts: Iterable[CloudPart]) -> None:
        for part in parts:
            self.ctx.client.put(
                "point_cloud",
                CLOUD + part.name,
                points=part.offsets,
                colors=self._points[part.at],
                point_size=part.size * self.state.point_size * (2 if part.first else 1),
                precision="float16",
                point_shading="flat",
                point_shape="square",
                position=triple(part.center),
                visible=self.state.flags.cloud,
            )

    def _show_room(self, state: State) -> None:
        """Neighbouring frames fused, where wanted and possible, dimmed toward the background."""
        room = state.loaded if state.flags.context else None
        key = None if room is None else (room.cloud, state.dark)
        if not self.ctx.client.outdated("/context", key) or room is None:
            return
        try:
            mesh = fuse_context(self.ctx.source.dataset, room.context.frame)
        except (FrameUnusable, MissingExtra) as error:
            self.ctx.toast("No room to show", str(error), bad=True)
            self.ctx.show(flags=replace(state.flags, context=False))
            return
        if len(mesh.faces):
            dimmed = (mesh.colors * 0.45 + (20 if state.dark else 190) * 0.55).astype(np.uint8)
            data = unlit_glb(mesh.vertices @ self.ctx.scene.to_show.T.astype(np.float32), mesh.faces, dimmed)
            self.ctx.client.put("glb", "/context", glb_data=data, cast_shadow=False, receive_shadow=False)


def unlit_glb(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> bytes:
    """Unlit binary glTF of vertices (V, 3) float32, faces (F, 3) int, colors (V, 3) uint8 sRGB."""
    import trimesh
    from trimesh.exchange.gltf import export_glb

    linear = np.round(255 * (colors / 255.0) ** 2.2).astype(np.uint8)
    solid = trimesh.Trimesh(vertices, faces, vertex_colors=linear, process=False)
    return bytes(export_glb(trimesh.Scene(solid), tree_postprocessor=_unlit))


def _unlit(tree: dict[str, Any]) -> None:
    tree["materials"] = [{"extensions": {"KHR_materials_unlit": {}}, "doubleSided": True}]
    tree["extensionsUsed"] = ["KHR_materials_unlit"]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0


GRID_COLORS = {True: ((118, 126, 140), (70, 76, 86)), False: ((140, 148, 160), (184, 190, 198))}
TAG = "/tags/measured"


class SceneAids(Part):
    """Draws aids into a client's scene and page."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._mapped: tuple[tuple[Any, ...], dict[str, object]] = ((), {})
        self._hovered = Recent[int, tuple[Box3D, dict[str, object]]](1000)

    def follow(self) -> list[Tag]:
        """Draw the aids for the state; returns the name tags to show."""
        state = self.state
        loaded = state.loaded
        self._draw_grid(loaded if state.flags.grid else None, state.dark)
        if loaded is None:
            self.ctx.page.call("scale", None)
            self.ctx.page.call("measure", None)
            return []
        self.ctx.page.call("scale", self._looked_at(state, loaded))
        self.ctx.page.call("objects", self._hoverable(state))
        self.ctx.page.call("names", [name.replace("·", " ") for name in state.shown.names])
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
                hex_color(plain_color(state.dark)),
                True,
                extent=triple(half),
            )
        ]

    def _hoverable(self, state: State) -> dict[str, object] | None:
        """Boxes and places in the picture of all objects, for marking them in the browser."""
        objects, (of, known) = state.found.objects, self._mapped
        if not objects:
            return None
        boxes = [o.lifted.box for o in state.shown.objects]
        drawn = (objects, self.ctx.scene.to_show, *boxes)
        if len(of) != len(drawn) or not all(map(is_, of, drawn)):
            if not of or not _same_places(of[0], objects):
                known = {"map": index_map(objects), "rects": [np.round(o.bbox, 1).tolist() for o in objects]}
            shown = [None if box is None else self._hover_box(box) for box in boxes]
            self._mapped = drawn, {**known, "boxes": shown}
        return self._mapped[1]

    def _hover_box(self, box: Box3D) -> dict[str, object]:
        shown = self.ctx.scene.shown_box(box)
        return self._hovered.get(id(shown), lambda: (shown, _box_record(shown)))[1]

    def _looked_at(self, state: State, loaded: LoadedFrame) -> dict[str, object]:
        """Point of the depth scale: the middle of the chosen pair, else of the cloud."""
        ends = [] if state.pair is None else [state.shown.objects[i].lifted.box for i in state.pair[:2]]
        centers = [self.ctx.scene.to_show @ box.center for box in ends if box is not None]
        if centers:
            center, name = np.mean(centers, axis=0), "the pair"
        else:
            center, name = loaded.cloud.middle, "the middle"
        nearest = NEAREST_BY_HAND * spacing_at(center[None], loaded.context.frame.camera)
        return {"center": _rounded(center), "name": name, "nearest": round(nearest, 3)}

    def _draw_grid(self, loaded: LoadedFrame | None, dark: bool) -> None:
        wanted = None if loaded is None or not len(loaded.cloud.points) else (loaded.cloud, dark)
        if not self.ctx.client.outdated("/grid/", wanted) or loaded is None or wanted is None:
            return
        grid = metre_grid(loaded.context.frame, loaded.context.viewer, loaded.cloud.points)
        for name, color, width, lines in zip(("cells", "fine"), GRID_COLORS[dark], (1.6, 0.8), grid, strict=True):
            self.ctx.client.lines(f"/grid/{name}", lines, color, width)


def _same_places(before: Sequence[SceneObject], objects: Sequence[SceneObject]) -> bool:
    """True for objects of the same pixels and 2D boxes, such as one with another class."""
    return len(before) == len(objects) and all(
        a is b or (np.array_equal(a.bbox, b.bbox) and np.array_equal(a.mask, b.mask))
        for a, b in zip(before, objects, strict=True)
    )


def _box_record(box: Box3D) -> dict[str, object]:
    return {
        "center": _rounded(box.center),
        "R": _rounded(box.R.ravel()),
        "half": _rounded(box.size / 2),
        "volume": round(float(box.volume), 6),
    }


def _rounded(v: np.ndarray) -> list[float]:
    return [round(float(x), 4) for x in v]
