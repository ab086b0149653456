"""The cloud of the frame in one client's scene: sent with another frame, painted anew with other colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import viser.transforms as vtf

from pipeline.datasets.scene_mesh import fuse_context
from pipeline.geometry.lifting import Pixel
from pipeline.geometry.palette import DROPPED, Role, depth_colors, instance_colors, palette
from pipeline.system.errors import FrameUnusable, MissingExtra
from spatialviz.app.context import Context, Part
from spatialviz.app.frames import LoadedFrame
from spatialviz.app.frames import Part as CloudPart
from spatialviz.app.scene_client import Node, triple
from spatialviz.app.state import State


class FrameCloud(Part):
    """Keeps a client's cloud, and the room around it, up to its state."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._loaded: LoadedFrame | None = None
        self._painted: tuple[Any, ...] = ()
        self._points = np.zeros((0, 3), np.uint8)
        self._parts: list[Node] = []
        self._room: tuple[LoadedFrame, bool] | None = None
        self.place_anew = False

    def follow(self) -> None:
        """Bring all of it up to the state; the view is placed anew where it is asked for, or nobody has turned it."""
        state, scene = self.state, self.ctx.scene
        loaded, viewpoint = state.loaded, scene.viewpoint
        anew, self.place_anew = self.place_anew or viewpoint.untouched, False
        was, self._loaded = self._loaded, loaded
        if loaded is None:
            scene.cloud, self._parts, self._painted = None, [], ()
            self.ctx.client.clear("/cloud/")
            self.ctx.client.clear("/camera")
        elif self._painted != state.paint_key or loaded is not was:
            self._painted = state.paint_key
            self._points = loaded.cloud.painted(frame_colors(state.colors, loaded, state.roles, state.dark))
            with self.ctx.client.atomic():
                if loaded is not was:
                    self._show(loaded)
                for node, part in zip(self._parts if loaded is was else (), loaded.cloud.parts, strict=False):
                    node.colors = self._points[part.at]
            if loaded is not was:
                if anew:
                    viewpoint.place(state.camera)
                self.ctx.post(lambda: self._complete(loaded))
        self.dress()
        self._show_room(state)

    def dress(self) -> None:
        """Show the points and the camera, as large as they are wanted."""
        parts, state = () if self._loaded is None else self._loaded.cloud.parts, self.state
        # Until the rest is there, one point stands for four.
        factor = state.point_size * (1 if len(self._parts) == len(parts) else 2)
        with self.ctx.client.atomic():
            for node, part in zip(self._parts, parts, strict=False):
                set_changed(node, visible=state.flags.cloud, point_size=part.size * factor)
            if "/camera" in self.ctx.client.scene.nodes:
                set_changed(self.ctx.client.scene.nodes["/camera"], visible=state.flags.camera)

    def _show(self, loaded: LoadedFrame) -> None:
        """Another frame, of its points the first cloud."""
        frame, viewer, scene = loaded.context.frame, loaded.context.viewer, self.ctx.scene
        scene.to_show, scene.cloud = np.stack([viewer.right, viewer.forward, viewer.up]), loaded.cloud
        scene.viewpoint.set_frame(loaded.cloud.points, scene.to_show, frame.camera)
        self.ctx.client.clear("/cloud/")
        self._parts = [self._add(part) for part in loaded.cloud.parts if part.first]
        self.ctx.client.scene.add_camera_frustum(
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
        """Send the rest of a frame's cloud, unless another one is shown already."""
        if loaded is self._loaded:
            with self.ctx.client.atomic():
                self._parts += [self._add(part) for part in loaded.cloud.parts[len(self._parts) :]]
                self.dress()

    def _add(self, part: CloudPart) -> Node:
        return self.ctx.client.scene.add_point_cloud(
            part.name,
            part.offsets,
            self._points[part.at],
            point_size=part.size * self.state.point_size * (2 if part.first else 1),
            precision="float16",
            point_shading="flat",
            point_shape="square",
            position=triple(part.center),
            visible=self.state.flags.cloud,
        )

    def _show_room(self, state: State) -> None:
        """The frames around this one fused, where that is wanted and possible, dimmed toward the background."""
        room = (state.loaded, state.dark) if state.flags.context and state.loaded is not None else None
        if room is not None and self._room is not None and room[0] is self._room[0] and room[1] == self._room[1]:
            return
        self._room = room
        self.ctx.client.clear("/context")
        if room is None:
            return
        try:
            mesh = fuse_context(self.ctx.source.dataset, room[0].context.frame)
        except (FrameUnusable, MissingExtra) as error:
            self.ctx.note(str(error))
            self.ctx.page.toast("No room to show", str(error))
            self.ctx.show(flags=replace(state.flags, context=False))
            return
        if mesh is not None and len(mesh.faces):
            dimmed = (mesh.colors * 0.45 + (20 if state.dark else 250) * 0.55).astype(np.uint8)
            data = unlit_glb(mesh.vertices @ self.ctx.scene.to_show.T.astype(np.float32), mesh.faces, dimmed)
            self.ctx.client.scene.add_glb("/context", data, cast_shadow=False, receive_shadow=False)


def set_changed(node: Node, **values: Any) -> None:
    """Set what differs; viser sends every assignment."""
    for name, value in values.items():
        if getattr(node, name) != value:
            setattr(node, name, value)


def frame_colors(mode: str, loaded: LoadedFrame, roles: Mapping[int, Role], dark: bool) -> np.ndarray:
    """(H, W, 3) uint8 colours of a frame's pixels: "rgb", "objects", "depth" or "evidence"."""
    frame, objects = loaded.context.frame, loaded.objects
    if mode == "depth":
        return depth_colors(frame.depth)
    if mode == "rgb" or not objects:
        return frame.rgb
    grey = np.repeat(frame.rgb.mean(axis=2, keepdims=True), 3, axis=2)
    image = (grey * 0.55 + (20 if dark else 110)).astype(np.uint8)
    order = sorted(range(len(objects)), key=lambda i: -int(objects[i].lifted.quality.mask_pixels))
    if mode == "objects":
        calm, role_colors = instance_colors(len(objects)), palette(dark)
        for i in order:
            color = role_colors[roles[i]] if i in roles else calm[i]
            mask = objects[i].mask
            image[mask] = (image[mask] * 0.35 + np.array(color) * 0.65).astype(np.uint8)
        return image
    for i in order:
        evidence = objects[i].lifted.evidence
        if evidence is None:
            continue
        h, w = evidence.codes.shape
        window = image[evidence.y0 : evidence.y0 + h, evidence.x0 : evidence.x0 + w]
        source = frame.rgb[evidence.y0 : evidence.y0 + h, evidence.x0 : evidence.x0 + w]
        kept = evidence.codes == Pixel.KEPT
        window[kept] = source[kept]
        for reason, color in DROPPED.items():
            window[evidence.codes == reason] = color
    return image


def unlit_glb(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray, opacity: float = 1.0) -> bytes:
    """A binary glTF with one unlit material (KHR_materials_unlit).

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) int
    colors : (V, 3) uint8
        sRGB; glTF wants them linear.
    opacity : float
        0..1, of all of it.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb

    linear = np.round(255 * (colors / 255.0) ** 2.2).astype(np.uint8)
    solid = trimesh.Trimesh(vertices, faces, vertex_colors=linear, process=False)
    return bytes(export_glb(trimesh.Scene(solid), tree_postprocessor=lambda tree: _unlit(tree, opacity)))


def _unlit(tree: dict[str, Any], opacity: float) -> None:
    tree["materials"] = [
        {
            "pbrMetallicRoughness": {
                "metallicFactor": 0.0,
                "roughnessFactor": 1.0,
                "baseColorFactor": [1.0, 1.0, 1.0, opacity],
            },
            "alphaMode": "OPAQUE" if opacity >= 1 else "BLEND",
            "extensions": {"KHR_materials_unlit": {}},
            "doubleSided": True,
        }
    ]
    tree["extensionsUsed"] = sorted({*tree.get("extensionsUsed", []), "KHR_materials_unlit"})
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
