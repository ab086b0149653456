"""View of a dataset by a client: frame, display, selection, and the meaning of a click."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from pydantic import FiniteFloat

from pipeline.answering.frame_store import UpHint
from pipeline.corrections.object_card import paired
from pipeline.datasets import write_settings
from pipeline.datasets.demo import demo_path
from pipeline.geometry.camera import depth_at
from pipeline.geometry.frame import Frame
from pipeline.geometry.level_plane import level_normal_at
from pipeline.system.errors import InputError, require
from spatialviz.app.context import Context, Part, choice, command, there
from spatialviz.app.picture import smallest_at
from spatialviz.app.scene import FLIGHT
from spatialviz.app.state import CameraMode, ColorMode, Tool
from spatialviz.app.toolbar import FLAGS, LARGEST_POINT, LEAST_POINT

POINT_STEP = 1.25


class Selection(Part):
    """Selects objects of a client, gives clicks to tools, and changes the display."""

    def __init__(self, ctx: Context, reopen: Callable[[], None]) -> None:
        super().__init__(ctx)
        self._reopen = reopen

    @command("object")
    def select(self, i: int) -> None:
        """Toggle the selection of an object."""
        state = self.state
        if 0 <= i < len(state.shown.objects):
            now = None if i == state.selected else i
            pair = state.pair if state.labels is None else paired(state.pair, now, state.selected)
            self.ctx.show(selected=now, pair=pair)

    def click(self, pixel: tuple[int, int] | None, boxes: list[int]) -> None:
        """Select by a click in the scene or the picture: the object at the pixel, else the smallest box on the ray."""
        state = self.state
        if state.loaded is None or (pixel is not None and self.on_pixel(*pixel)):
            return
        own = smallest_at(state.shown.objects, pixel)
        found = next((i for i in (own, *boxes) if i is not None), None)
        if found is not None and found != state.selected:
            self.select(found)

    @command("chip")
    def select_role(self, role: str) -> None:
        """Select the object of a word of the expression."""
        self.click(None, [there(self.state.pair)[0 if role == "target" else 1]])

    @command("image")
    def select_at(self, x: FiniteFloat, y: FiniteFloat) -> None:
        """Select by a click in the picture, at fractions of width and height."""
        height, width = there(self.state.loaded).context.frame.depth.shape
        self.click((int(np.clip(x * width, 0, width - 1)), int(np.clip(y * height, 0, height - 1))), [])

    @command("pair")
    def choose_pair(self, place: int) -> None:
        """Choose a ranked pair by rank; selects the target."""
        # A click may hit a row of an older answer.
        if 0 <= place < len(self.state.ranked):
            pair = self.state.at(self.state.ranked[place])
            self.ctx.show(pair=pair, selected=pair[0])

    @command("next-pair")
    def step_pair(self, step: int) -> None:
        """Choose the next ranked pair, or the previous."""
        pairs = [self.state.at(p) for p in self.state.ranked]
        if pairs:
            at = pairs.index(self.state.pair) if self.state.pair in pairs else 0
            self.choose_pair((at + step) % len(pairs))

    @command("focus")
    def focus(self) -> None:
        chosen = self.state.shown.objects[there(self.state.selected)]
        self.ctx.scene.viewpoint.focus(there(chosen.lifted.box))

    # ---- tools: a click on a pixel, in the picture or the scene, is theirs ------------

    @command("pick")
    def turn_to(self, name: str) -> None:
        """Toggle a tool; "" turns all off, and removes the measurement."""
        state = self.state
        tool = next((t for t in get_args(Tool) if t == name and t != state.picking), "")
        if state.loaded is None or (tool == "level" and state.labels is not None):
            return
        if tool or state.picking or state.marks:
            self.ctx.show(picking=tool, marks=())

    def on_pixel(self, u: int, v: int) -> bool:
        """Handle a click on a pixel; True if taken by a tool."""
        state = self.state
        if not state.picking or state.loaded is None or (state.picking == "level" and state.labels is not None):
            return False
        try:
            (self._level if state.picking == "level" else self._mark)(state.loaded.context.frame, u, v)
        except InputError as error:
            self.ctx.toast(f"No {state.picking} here", str(error), bad=True)
        return True

    def _mark(self, frame: Frame, u: int, v: int) -> None:
        """Mark an end of a length; a third click begins anew."""
        marks = self.state.marks
        depth_at(frame.depth, u, v)
        self.ctx.show(marks=(*(marks if len(marks) < 2 else ()), (u, v)))

    def _level(self, frame: Frame, u: int, v: int) -> None:
        """Set up from a pixel of a level surface: for all clients, until saved or the end of the program."""
        x, y, z = level_normal_at(frame.depth, frame.camera, u, v).tolist()
        self.ctx.shared.store.set_up_hint(self.state.source, UpHint(frame.id, (u, v), (x, y, z)))
        self.ctx.note(f"frame {frame.id}: the surface at {u},{v} is level, up {x:.3f}, {y:.3f}, {z:.3f} in the camera")
        self.state = replace(self.state, picking="")
        self._reopen()

    @command("level-keep")
    def keep(self) -> None:
        """Save up into the settings beside the data."""
        told, root = there(self.ctx.shared.store.up_hints.get(self.state.source)), self.ctx.source.dataset.root
        require(root.resolve() != demo_path().resolve(), "the built-in demo stays as it is", path=root)
        self.ctx.toast("Up is kept", str(write_settings(root, None, None, frame_up={told.frame_id: told.up})))

    @command("level-back")
    def take_back(self) -> None:
        """Restore the original up."""
        if self.state.source in self.ctx.shared.store.up_hints:
            self.ctx.shared.store.set_up_hint(self.state.source, None)
            self._reopen()

    # ---- display ----------------------------------------------------------------------

    @command("color", "next-color=next")
    def paint(self, mode: str) -> None:
        """Set the colours of the cloud, or the "next"."""
        colors = choice(get_args(ColorMode), self.state.colors, mode)
        if colors is not None:
            self.ctx.show(colors=colors)

    @command("camera")
    def look_from(self, mode: CameraMode) -> None:
        """Fly to a standard viewpoint."""
        if self.state.loaded is not None:
            self.ctx.show(camera=mode)
            self.ctx.scene.viewpoint.place(mode, FLIGHT)

    @command("covered")
    def cover(self, width: FiniteFloat, height: FiniteFloat) -> None:
        """Keep a pair from under the picture or the drawer, by their shares of the scene's width and height."""
        self.ctx.scene.viewpoint.cover(float(np.clip(width, 0, 1)), float(np.clip(height, 0, 1)))

    @command("flag")
    def toggle(self, flag: str) -> None:
        """Toggle a part of the scene."""
        flags = self.state.flags
        if flag in FLAGS:
            self.ctx.show(flags=replace(flags, **{flag: not getattr(flags, flag)}))

    @command("point-size")
    def size_points(self, size: FiniteFloat | Literal["more", "less"]) -> None:
        """Scale the points by a factor; "more" and "less" are steps."""
        step = {"more": POINT_STEP, "less": 1 / POINT_STEP}.get(str(size))
        factor = round(float(size) if step is None else self.state.point_size * step, 2)
        if LEAST_POINT <= factor <= LARGEST_POINT:
            self.state = replace(self.state, point_size=factor)
            # The slider already stands at the value.
            self.ctx.draw(live=step is None)

    @command("theme")
    def switch_theme(self) -> None:
        self.follow_theme("light" if self.state.dark else "dark")

    @command("system-theme")
    def follow_theme(self, theme: Literal["dark", "light"]) -> None:
        self.ctx.client.set_dark(theme == "dark")
        self.ctx.show(dark=theme == "dark")
