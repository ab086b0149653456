"""3D scene of an answer as a page of its own, without server or network."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING

import numpy as np

from pipeline.answering.objects import PreparedFrame
from pipeline.diagnosis.answer import Answer
from pipeline.geometry.boxes import CUBE, CUBE_FACES, Box3D, edge_lines
from pipeline.geometry.cloud import cloud_of, drawn_pixels
from pipeline.geometry.palette import FACE_OPACITY, LINE_WIDTH, RGB, Role, palette
from spatialviz.app.viser_socket import RefuseAll, served_by
from spatialviz.report.picture import AnswerRoles, answer_roles

if TYPE_CHECKING:
    import viser

MOST_POINTS = 40_000
GHOST_OPACITY = 0.10
ASPECT = 1.6
"""Width over height of the part of the page that shows the scene."""


def scene_html(answered: Answer, context: PreparedFrame) -> str:
    """HTML page of the scene, about 1.5 MB, drawn in the viewer's level frame, dark."""
    import viser

    # The server says where it listens; nobody is to go there.
    with served_by(RefuseAll()), redirect_stdout(StringIO()):
        return _with_server(viser.ViserServer(host="127.0.0.1", port=0, verbose=False), answered, context)


def _with_server(server: viser.ViserServer, answered: Answer, context: PreparedFrame) -> str:
    try:
        axes = context.viewer
        to_show = np.stack([axes.right, axes.forward, axes.up])
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        server.scene.configure_environment_map(hdri=None)
        server.scene.configure_default_lights(cast_shadow=False)
        points = _draw_cloud(server.scene, context)
        _draw_boxes(server.scene, answer_roles(answered), to_show)
        _place_camera(server, points, context, to_show)
        return server.scene.as_html(dark_mode=True)
    finally:
        server.stop()


def _draw_cloud(scene: viser.SceneApi, context: PreparedFrame) -> np.ndarray:
    """Draw surfaces in bands of depth, each with its point size; returns the shown points (N, 3)."""
    frame = context.frame
    usable = drawn_pixels(frame)
    stride = max(1, int(np.ceil(np.sqrt(usable.sum() / MOST_POINTS))))
    while usable[::stride, ::stride].sum() > MOST_POINTS:
        stride += 1
    cloud = cloud_of(frame, context.viewer, stride)
    colors = cloud.painted(frame.rgb)
    for part in cloud.parts:
        scene.add_point_cloud(
            f"/cloud/{part.name}",
            cloud.points[part.at],
            colors[part.at],
            point_size=part.size,
            point_shading="flat",
            point_shape="square",
        )
    return cloud.points


def _draw_boxes(scene: viser.SceneApi, cast: AnswerRoles, to_show: np.ndarray) -> None:
    colors = palette(dark=True)
    by_role: dict[Role, list[Box3D]] = {}
    for index, entry in enumerate(cast.objects):
        if entry.lifted.box is not None:
            by_role.setdefault(cast.roles.get(index, "other"), []).append(entry.lifted.box.turned(to_show))
    truth = {k: o.lifted.box.turned(to_show) for k, (_, o) in cast.truth.items() if o.lifted.box is not None}
    by_role["truth"] = list(truth.values())
    opacity: Mapping[Role, float] = {**FACE_OPACITY, "truth": GHOST_OPACITY}
    for role, boxes in by_role.items():
        if boxes:
            _add_boxes(scene, role, boxes, colors[role], LINE_WIDTH[role], opacity[role])
    for index, role in cast.roles.items():
        box = cast.objects[index].lifted.box
        if box is not None:
            _add_label(scene, f"/names/{index}", f"{role}: {cast.objects[index].label}", box.turned(to_show), 0.05)
    for k in truth.keys() - {cast.labelled.get(index) for index in cast.roles}:
        _add_label(scene, f"/names/true/{k}", f"truth: {cast.truth[k][1].label}", truth[k], 0.14)
    pair = [cast.objects[p].lifted.box for p in (cast.target, cast.reference) if p is not None]
    ends = [box.center @ to_show.T for box in pair if box is not None]
    if len(ends) == 2:
        tint = np.array([[colors["target"], colors["reference"]]], np.uint8)
        scene.add_line_segments("/pair", np.array([ends], np.float32), tint, thickness=4.0, thickness_units="screen")


def _add_boxes(scene: viser.SceneApi, role: Role, boxes: list[Box3D], color: RGB, width: float, faces: float) -> None:
    import viser.transforms as vtf

    edges = edge_lines(boxes)
    scene.add_line_segments(f"/boxes/{role}", edges, color, thickness=width, thickness_units="screen")
    scene.add_batched_meshes_simple(
        f"/faces/{role}",
        CUBE,
        CUBE_FACES,
        np.stack([vtf.SO3.from_matrix(b.R).wxyz for b in boxes]).astype(np.float32),
        np.stack([b.center for b in boxes]).astype(np.float32),
        batched_scales=np.stack([np.maximum(b.size, 0.005) for b in boxes]).astype(np.float32),
        batched_colors=np.array([color] * len(boxes), np.uint8),
        batched_opacities=np.full(len(boxes), faces, np.float32),
        lod="off",
        cast_shadow=False,
        receive_shadow=False,
    )


def _add_label(scene: viser.SceneApi, name: str, text: str, box: Box3D, above: float) -> None:
    x, y, _ = (float(v) for v in box.center)
    scene.add_label(
        name,
        text[:60],
        position=(x, y, float(box.corners[:, 2].max()) + above),
        font_size_mode="screen",
        font_screen_scale=0.9,
        anchor="bottom-center",
        depth_test=False,
    )


def _place_camera(server: viser.ViserServer, points: np.ndarray, context: PreparedFrame, to_show: np.ndarray) -> None:
    """Place the camera behind, above and to the left of the sensor, turned to the middle of the seen points."""
    forward = to_show @ np.array([0.0, 0.0, 1.0])
    middle = np.median(points, axis=0) if len(points) else forward * 2
    distance = float(np.linalg.norm(middle))
    eye = middle - forward * distance * 1.12 + np.array([-0.32, 0.0, 0.30]) * distance
    tall = context.frame.height / 2 / context.frame.camera.fy
    wide = context.frame.width / 2 / context.frame.camera.fx / ASPECT
    camera = server.initial_camera
    camera.up = (0.0, 0.0, 1.0)
    camera.position = (float(eye[0]), float(eye[1]), float(eye[2]))
    camera.look_at = (float(middle[0]), float(middle[1]), float(middle[2]))
    camera.fov = float(2 * np.arctan(max(tall, wide) * 0.92))
