"""3D scene of an answer as a page of its own, without server or network."""

from __future__ import annotations

from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import numpy as np
import viser

from pipeline.answering.objects import PreparedFrame
from pipeline.diagnosis.answer import Answer
from pipeline.geometry.cloud import cloud_of, drawn_pixels
from pipeline.geometry.viewpoints import viewpoint
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_client import SceneClient, triple
from spatialviz.app.state import State
from spatialviz.app.viser_socket import served_by
from spatialviz.report.page import shown_state

MOST_POINTS = 40_000
ASPECT = 1.6
"""Width over height of the part of the page that shows the scene."""


def scene_html(answered: Answer, context: PreparedFrame) -> str:
    """HTML page of the scene, about 1.5 MB, drawn in the viewer's level frame, dark."""
    state = shown_state(answered, context)
    # The server says where it listens; nobody is to go there.
    with served_by(None), redirect_stdout(StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            return _drawn(server, replace(state, dark=True, flags=replace(state.flags, boxes=True)), context)
        finally:
            server.stop()


def _drawn(server: viser.ViserServer, state: State, context: PreparedFrame) -> str:
    client, scene, frame = SceneClient(), server.scene, context.frame
    view = SceneView(client, lambda pixel, boxes: None)
    view.to_show = np.stack([context.viewer.right, context.viewer.forward, context.viewer.up])
    tags = view.draw(state)
    scene.set_up_direction("+z")
    scene.world_axes.visible = False
    scene.configure_environment_map(hdri=None)
    scene.configure_default_lights(cast_shadow=False)
    usable = drawn_pixels(frame)
    stride = max(1, int(np.ceil(np.sqrt(usable.sum() / MOST_POINTS))))
    while usable[::stride, ::stride].sum() > MOST_POINTS:
        stride += 1
    cloud = cloud_of(frame, context.viewer, stride)
    colors = cloud.painted(frame.rgb)
    for part in cloud.parts:
        look = {"point_size": part.size, "point_shading": "flat", "point_shape": "square"}
        client.put("point_cloud", f"/cloud/{part.name}", points=cloud.points[part.at], colors=colors[part.at], **look)
    for tag in tags:
        # Labelled ones have their name below, so that neither hides the other's.
        above, anchor = (1, "bottom-center") if tag.strong else (-1, "top-center")
        at = np.array(client.nodes[tag.node].position) + np.array([0.0, 0.0, above * (tag.extent[2] + 0.05)])
        look = {"font_size_mode": "screen", "font_screen_scale": 0.9, "anchor": anchor, "depth_test": False}
        client.put("label", f"/names{tag.node}", text=tag.text[:60], position=triple(at), **look)
    client.copy_to(scene)
    eye, look, fov = viewpoint("orbit", cloud.points, view.to_show, frame.camera, ASPECT)
    camera = server.initial_camera
    camera.up, camera.position, camera.look_at, camera.fov = (0.0, 0.0, 1.0), triple(eye), triple(look), float(fov)
    return scene.as_html(dark_mode=True)
