"""What helps to judge an answer, without a browser: grid, tools for clicks, colours, all pairs, what is kept."""

from __future__ import annotations

import io
import re
import time
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh

from pipeline.answering.frame_store import FrameStore
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.datasets.demo import DEMO_EXPRESSION
from pipeline.datasets.scene_mesh import ContextMesh
from pipeline.diagnosis.whatif.answer_view import shown_objects
from pipeline.geometry.cloud import floor_height
from pipeline.geometry.palette import depth_ends
from pipeline.system.errors import FrameUnusable, needed
from spatialviz.app.channel import Call
from spatialviz.app.context import Context, Shared
from spatialviz.app.frame_cloud import FrameCloud, SceneAids
from spatialviz.app.layout import BrowserPage
from spatialviz.app.markup import h
from spatialviz.app.picture import depth_bar
from spatialviz.app.scene import Tag
from spatialviz.app.selection import Selection
from spatialviz.app.stages import pairs_evidence
from spatialviz.app.state import State
from spatialviz.app.view_strings import view_of, with_settings


@cache
def opened() -> tuple[Pipeline, State]:
    """The demo's first frame with its question answered."""
    source = open_pipeline("demo")
    store = FrameStore({"demo": source})
    loaded = store.load("demo", source.dataset.frame_ids[0])
    trace = source.ask(loaded.context, DEMO_EXPRESSION)
    state = State("demo", loaded.context.frame.id, loaded=loaded, text=DEMO_EXPRESSION, trace=trace)
    state = replace(state, found=shown_objects(loaded, trace, trace.exact))
    return source, replace(state, pair=state.at(state.ranked[0]))


NOTHING_DONE: Any = dict.fromkeys(("receive", "clicked", "draw", "handle", "open_frame"), lambda *_, **__: None)


class Desk(Context):
    """A page without a browser: its state, the calls that it was sent, and its tools."""

    def __init__(self) -> None:
        source, state = opened()
        super().__init__("0" * 32, Shared(FrameStore({"demo": source}), {}, {}, {}, {}), **NOTHING_DONE)
        self.state = state
        self.calls: list[Call] = []
        self.reopened = 0
        self.page = BrowserPage(lambda message: self.calls.append(message) if isinstance(message, Call) else None)
        self.aids = SceneAids(self)
        self.pointing = Selection(self, self.reopen)

    def reopen(self) -> None:
        self.reopened += 1

    def aided(self, state: State) -> list[Tag]:
        """The tags of a state."""
        self.state = state
        return self.aids.follow()

    def called(self, name: str) -> Any:
        return next(c.data for c in reversed(self.calls) if c.name == name)


def test_two_clicks_measure_a_third_begins_anew_and_escape_ends() -> None:
    desk = Desk()
    assert not desk.pointing.on_pixel(120, 200), "without a tool a click selects"
    desk.pointing.turn_to("measure")
    for pixel in ((120, 200), (420, 330)):
        assert desk.pointing.on_pixel(*pixel)
    assert desk.state.measured is not None
    assert desk.state.measured.distance == pytest.approx(1.5161, abs=1e-4)
    (tag,) = desk.aided(desk.state)
    assert tag.text == "1.516 m"
    assert len(desk.called("measure")["points"]) == 2
    desk.pointing.on_pixel(300, 300)
    assert desk.state.marks == ((300, 300),)
    assert desk.state.measured is None
    desk.pointing.turn_to("")
    assert (desk.state.picking, desk.state.marks) == ("", ())


def test_a_pixel_without_depth_is_told_and_not_marked() -> None:
    desk = Desk()
    loaded = desk.state.loaded
    assert loaded is not None
    v, u = (int(k[0]) for k in np.nonzero(loaded.context.frame.depth == 0))
    desk.pointing.turn_to("measure")
    assert desk.pointing.on_pixel(u, v)
    assert desk.state.marks == ()
    assert "no depth" in desk.called("toast")["text"]


def test_one_tool_is_on_at_a_time() -> None:
    desk = Desk()
    desk.pointing.turn_to("measure")
    desk.pointing.turn_to("level")
    assert desk.pointing.on_pixel(320, 400)
    assert (desk.reopened, desk.state.picking) == (1, "")
    assert not desk.pointing.on_pixel(320, 400)


def test_the_grid_is_drawn_while_it_is_wanted_and_lies_on_the_floor() -> None:
    desk = Desk()
    plain = desk.state
    desk.aided(replace(plain, flags=replace(plain.flags, grid=True)))
    assert {"/grid/cells", "/grid/fine"} <= desk.client.nodes.keys()
    desk.aided(plain)
    assert not any(name.startswith("/grid") for name in desk.client.nodes)
    loaded = desk.state.loaded
    assert loaded is not None
    heights = loaded.cloud.points[:, 2]
    floor = floor_height(loaded.context.frame, loaded.context.viewer, loaded.cloud.points)
    assert heights.min() - 0.01 <= floor <= np.percentile(heights, 25)


def test_the_scale_is_told_for_the_middle_of_the_pair_else_of_the_cloud() -> None:
    desk = Desk()
    desk.aided(desk.state)
    pair = desk.state.pair
    assert pair is not None
    boxes = [desk.state.shown.objects[i].lifted.box for i in pair[:2]]
    expected = np.mean([box.center for box in boxes if box is not None], axis=0)
    assert desk.called("scale")["name"] == "the pair"
    np.testing.assert_allclose(desk.called("scale")["center"], expected, atol=1e-3)
    desk.aided(replace(desk.state, pair=None))
    assert desk.called("scale")["name"] == "the middle"


def test_the_depth_bar_tells_the_ends_of_the_colours() -> None:
    _, state = opened()
    assert depth_bar(state) is None
    bar = depth_bar(replace(state, colors="depth"))
    assert bar is not None
    assert state.loaded is not None
    low, high = depth_ends(state.loaded.context.frame.depth)
    assert bar.text == f"{low:.2f} m{high:.2f} m"


def test_every_candidate_pair_stands_in_the_heat_map_with_its_probability() -> None:
    _, state = opened()
    assert state.trace is not None
    (table,) = re.findall('<table class="matrix.*?</table>', h.div(pairs_evidence(state, state.trace)).html)
    told = {int(n): float(p) for n, p in re.findall(r"pair:(\d+)[^>]*>([.\d]+)<", table)}
    assert told == {k: pytest.approx(p.p_relation, abs=0.006) for k, p in enumerate(state.ranked)}
    assert len(told) > 1


def test_the_size_of_points_is_in_view_strings_and_older_ones_open() -> None:
    _, state = opened()
    view = view_of(replace(state, point_size=1.75), None, None, None)
    assert with_settings(state, view).point_size == 1.75
    old = view_of(state, None, None, None)
    assert "point size" not in old.toggles
    assert with_settings(state, old).point_size == 1.0
    wild = replace(view, toggles={**view.toggles, "point size": 900.0})
    assert with_settings(state, wild).point_size == 1.0


def test_the_room_the_camera_and_larger_points_are_drawn_while_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    triangle, red = np.eye(3, dtype=np.float32), np.array([[255, 0, 0]] * 3, np.uint8)
    mesh = ContextMesh(triangle, np.array([[0, 1, 2]], np.int32), red, 2)
    monkeypatch.setattr("spatialviz.app.frame_cloud.fuse_context", lambda *_: mesh)
    desk, (_, plain) = Desk(), opened()
    cloud, nodes = FrameCloud(desk), desk.client.nodes
    cloud.follow()
    assert plain.loaded is not None
    parts = [f"/cloud/{part.name}" for part in plain.loaded.cloud.parts]
    while not set(parts) <= nodes.keys():
        time.sleep(0.01)
    cloud.dress()
    usual = [nodes[name].point_size for name in parts]
    assert "/context" not in nodes
    assert not nodes["/camera"].visible
    desk.state = replace(plain, flags=replace(plain.flags, context=True, camera=True), point_size=2.0)
    cloud.follow()
    loaded = trimesh.load_mesh(io.BytesIO(nodes["/context"].glb_data), "glb")
    np.testing.assert_allclose(loaded.vertices, triangle @ desk.scene.to_show.T, atol=1e-6)
    assert b"KHR_materials_unlit" in nodes["/context"].glb_data
    assert nodes["/camera"].visible
    assert [nodes[name].point_size for name in parts] == pytest.approx([2 * size for size in usual])
    desk.state = plain
    cloud.follow()
    assert "/context" not in nodes


def test_a_frame_without_a_room_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "spatialviz.app.frame_cloud.fuse_context", lambda *_: needed(None, "no pose", error=FrameUnusable)
    )
    desk, (_, plain) = Desk(), opened()
    desk.state = replace(plain, flags=replace(plain.flags, context=True))
    FrameCloud(desk).follow()
    assert not desk.state.flags.context
    assert desk.called("toast")["text"] == "no pose"
