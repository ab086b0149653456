"""What a click is for: an object or a pair is selected, a level surface named, a length measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import get_args

from pipeline.datasets import write_settings
from pipeline.datasets.demo import demo_path
from pipeline.geometry.camera import depth_at
from pipeline.geometry.level_plane import level_normal_at
from pipeline.system.errors import InputError, require
from spatialviz.app.context import Context, Part, command
from spatialviz.app.frames import LoadedFrame, ToldUp
from spatialviz.app.label_view import paired
from spatialviz.app.picture import object_at, second_at
from spatialviz.app.state import Tool


class Selection(Part):
    """Selects objects of one client."""

    def __init__(self, ctx: Context, taken: Callable[[int, int], bool]) -> None:
        super().__init__(ctx)
        self._taken = taken

    @command("object")
    def select(self, i: int) -> None:
        """Select an object, or nothing where it is selected already."""
        state = self.state
        if 0 <= i < len(state.shown.objects):
            now = None if i == state.selected else i
            pair = state.pair if state.labels is None else paired(state.pair, now, state.selected)
            self.ctx.show(selected=now, pair=pair, second=None)

    def select_on_ray(self, pixel: tuple[int, int] | None, boxes: list[int]) -> None:
        """A click in the scene: the object whose pixel was hit, else the smallest box on the way."""
        loaded = self.state.loaded
        if loaded is None or (pixel is not None and self._taken(*pixel)):
            return
        at = None
        if pixel is not None:
            frame = loaded.context.frame
            at = (pixel[0] + 0.5) / frame.width, (pixel[1] + 0.5) / frame.height
        self._select_first(at, boxes)

    @command("chip")
    def select_role(self, role: str) -> None:
        """A click on a word of the expression: the object that fills it."""
        pair = self.state.pair
        if pair is not None:
            self._select_first(None, [pair[0 if role == "target" else 1]])

    @command("image")
    def select_at(self, fractions: str) -> None:
        """A click in the picture: "0.25,0.5" is a quarter from the left, half way down."""
        try:
            x, y = (float(part) for part in fractions.split(","))
        except ValueError:
            return
        if self.state.loaded is not None:
            height, width = self.state.loaded.context.frame.depth.shape
            if not self._taken(min(int(x * width), width - 1), min(int(y * height), height - 1)):
                self._select_first((x, y), [])

    def _select_first(self, at: tuple[float, float] | None, others: list[int]) -> None:
        """Select what is at a point of the picture, also where only the second detector has it; else of `others`."""
        state = self.state
        found = None if at is None else object_at(state, *at)
        second = None if at is None or found is not None else second_at(state, *at)
        if second is not None:
            self.ctx.show(selected=None, second=second)
            return
        found = next((i for i in (found, *others) if i is not None), None)
        if found is not None and found != state.selected:
            self.select(found)

    @command("pair")
    def choose_pair(self, place: int) -> None:
        """Choose a ranked pair by its place; the target is selected."""
        # A click may be on a row that a newer answer has replaced.
        if 0 <= place < len(self.state.ranked):
            pair = self.state.at(self.state.ranked[place])
            self.ctx.show(pair=pair, selected=pair[0], second=None)

    @command("next-pair")
    def step_pair(self, step: int) -> None:
        """Choose the next ranked pair, or the one before."""
        pairs = [self.state.at(p) for p in self.state.ranked]
        if pairs:
            at = pairs.index(self.state.pair) if self.state.pair in pairs else 0
            self.choose_pair((at + step) % len(pairs))

    @command("focus")
    def focus(self) -> None:
        """Look at the selected object."""
        state = self.state
        chosen = None if state.selected is None else state.shown.objects[state.selected]
        if chosen is None and state.beside is not None and state.second_selected is not None:
            chosen = state.beside.objects[state.second_selected]
        if chosen is not None and chosen.lifted.box is not None:
            self.ctx.scene.viewpoint.focus(chosen.lifted.box)


class Pointing(Part):
    """Gives clicks of one client on pixels, in the picture or in the scene, to the tool that is on."""

    def __init__(self, ctx: Context, tools: Mapping[Tool, Callable[[LoadedFrame, int, int], None]]) -> None:
        super().__init__(ctx)
        self._tools = {**tools, "measure": self._mark}

    @command("pick")
    def turn_to(self, name: str) -> None:
        """Turn a tool on; the one that is on, or "", turns it off, and what was measured goes."""
        state = self.state
        tool = next((t for t in get_args(Tool) if t == name and t != state.picking), "")
        if state.loaded is None or (tool == "level" and state.labels is not None):
            return
        if tool or state.picking or state.marks:
            self.ctx.show(picking=tool, marks=())

    def on_pixel(self, u: int, v: int) -> bool:
        """A click on a pixel; whether a tool has taken it."""
        state = self.state
        if not state.picking or state.loaded is None or (state.picking == "level" and state.labels is not None):
            return False
        self._tools[state.picking](state.loaded, u, v)
        return True

    def _mark(self, loaded: LoadedFrame, u: int, v: int) -> None:
        """One end of a length; a third begins anew."""
        marks = self.state.marks
        try:
            depth_at(loaded.context.frame.depth, u, v)
        except InputError as error:
            self.ctx.page.toast("Not measured", str(error), bad=True)
        else:
            self.ctx.show(marks=(*(marks if len(marks) < 2 else ()), (u, v)))


class LevelSurface(Part):
    """Takes a click of one client as a pixel of a level surface.

    Up is a fact of the data: what one client says holds for all of them, until the program ends or it is saved.
    """

    def on_pixel(self, loaded: LoadedFrame, u: int, v: int) -> None:
        """A click on a pixel of a level surface."""
        frame = loaded.context.frame
        try:
            x, y, z = level_normal_at(frame.depth, frame.camera, u, v).tolist()
        except InputError as error:
            self._tell("Not a level surface", str(error))
            return
        self.ctx.shared.store.tell_up(self.state.source, ToldUp(frame.id, (u, v), (x, y, z)))
        self.ctx.note(f"frame {frame.id}: the surface at {u},{v} is level, up {x:.3f}, {y:.3f}, {z:.3f} in the camera")
        self.state = replace(self.state, picking="")
        self.ctx.reopen()

    @command("level-keep")
    def keep(self) -> None:
        """Write what was said into the settings beside the data."""
        told, root = self.ctx.shared.store.told.get(self.state.source), self.ctx.source.dataset.root
        if told is not None:
            try:
                require(root.resolve() != demo_path().resolve(), "the built-in demo stays as it is", path=root)
                self._tell("Up is kept", str(write_settings(root, None, None, frame_up={told.frame_id: told.up})))
            except InputError as error:
                self._tell("Up is not kept", str(error))

    @command("level-back")
    def take_back(self) -> None:
        """Up as it was before anything was said."""
        if self.state.source in self.ctx.shared.store.told:
            self.ctx.shared.store.tell_up(self.state.source, None)
            self.ctx.reopen()

    def _tell(self, title: str, text: str) -> None:
        self.ctx.note(text)
        self.ctx.page.toast(title, text)
