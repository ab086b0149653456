"""What a click is for: an object or a pair is selected, a level surface named, a length measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import get_args

from pipeline.datasets import write_settings
from pipeline.datasets.demo import demo_path
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import depth_at
from pipeline.geometry.level_plane import level_normal_at
from pipeline.system.errors import InputError
from spatialviz.app.frames import FrameStore, LoadedFrame, ToldUp
from spatialviz.app.label_view import paired
from spatialviz.app.layout import Page
from spatialviz.app.picture import object_at, second_at
from spatialviz.app.state import State, Tool


class Selection:
    """Selects objects of one client.

    Parameters
    ----------
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    draw : callable
    look_at : callable
        Turns the view around a box.
    taken : callable
        Whether a click on a pixel (u, v) was meant for something else.
    """

    def __init__(
        self,
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[], None],
        look_at: Callable[[Box3D], None],
        taken: Callable[[int, int], bool],
    ) -> None:
        self._state, self._take, self._draw, self._look_at, self._taken = state, take, draw, look_at, taken

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "object": lambda place: self.select(int(place)),
            "chip": self.select_role,
            "image": self.select_at,
            "focus": lambda _: self.focus(),
            "pair": lambda place: self.choose_pair(int(place)),
            "next-pair": lambda step: self.step_pair(int(step)),
        }

    def select(self, i: int) -> None:
        """Select an object, or nothing where it is selected already."""
        state = self._state()
        if 0 <= i < len(state.shown.objects):
            now = None if i == state.selected else i
            pair = state.pair if state.labels is None else paired(state.pair, now, state.selected)
            self._take(replace(state, selected=now, pair=pair, second=None))
            self._draw()

    def select_on_ray(self, pixel: tuple[int, int] | None, boxes: list[int]) -> None:
        """A click in the scene: the object whose pixel was hit, else the smallest box on the way."""
        state = self._state()
        if state.loaded is None:
            return
        found = None
        if pixel is not None and self._taken(*pixel):
            return
        if pixel is not None:
            frame = state.loaded.context.frame
            at = (pixel[0] + 0.5) / frame.width, (pixel[1] + 0.5) / frame.height
            found = object_at(state, *at)
            if found is None and self._select_second(*at):
                return
        if found is None and boxes:
            found = boxes[0]
        self._select_other(found)

    def select_role(self, role: str) -> None:
        """A click on a word of the expression: the object that fills it."""
        pair = self._state().pair
        if pair is not None:
            self._select_other(pair[0 if role == "target" else 1])

    def select_at(self, fractions: str) -> None:
        """A click in the picture: "0.25,0.5" is a quarter from the left, half way down."""
        try:
            x, y = (float(part) for part in fractions.split(","))
        except ValueError:
            return
        state = self._state()
        if state.loaded is not None:
            height, width = state.loaded.context.frame.depth.shape
            if self._taken(min(int(x * width), width - 1), min(int(y * height), height - 1)):
                return
        found = object_at(state, x, y)
        if found is None and self._select_second(x, y):
            return
        self._select_other(found)

    def _select_second(self, x: float, y: float) -> bool:
        """Select what only the second detector has at a point of the picture."""
        state = self._state()
        found = second_at(state, x, y)
        if found is not None:
            self._take(replace(state, selected=None, second=found))
            self._draw()
        return found is not None

    def _select_other(self, found: int | None) -> None:
        if found is not None and found != self._state().selected:
            self.select(found)

    def choose_pair(self, place: int) -> None:
        """Choose a ranked pair by its place; the target is selected."""
        state = self._state()
        if not 0 <= place < len(state.ranked):
            return  # A click on a row that a newer answer has replaced.
        pair = state.at(state.ranked[place])
        self._take(replace(state, pair=pair, selected=pair[0], second=None))
        self._draw()

    def step_pair(self, step: int) -> None:
        """Choose the next ranked pair, or the one before."""
        state = self._state()
        if state.ranked:
            pairs = [state.at(p) for p in state.ranked]
            at = pairs.index(state.pair) if state.pair in pairs else 0
            self.choose_pair((at + step) % len(pairs))

    def focus(self) -> None:
        """Look at the selected object."""
        state = self._state()
        chosen = None if state.selected is None else state.shown.objects[state.selected]
        if chosen is None and state.beside is not None and state.second_selected is not None:
            chosen = state.beside.objects[state.second_selected]
        box = None if chosen is None else chosen.lifted.box
        if box is not None:
            self._look_at(box)


class Pointing:
    """Gives clicks of one client on pixels, in the picture or in the scene, to the tool that is on.

    Parameters
    ----------
    page : Page
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    draw : callable
    tools : mapping of str to callable
        What takes the pixel, beside measuring: given the frame, column and row.
    """

    def __init__(
        self,
        page: Page,
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[], None],
        tools: Mapping[Tool, Callable[[LoadedFrame, int, int], None]],
    ) -> None:
        self._page, self._state, self._take, self._draw = page, state, take, draw
        self._tools = {**tools, "measure": self._mark}

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {"pick": self.turn_to}

    def turn_to(self, name: str) -> None:
        """Turn a tool on; the one that is on, or "", turns it off, and what was measured goes."""
        state = self._state()
        tool = next((t for t in get_args(Tool) if t == name and t != state.picking), "")
        if state.loaded is None or (tool == "level" and state.labels is not None):
            return
        if tool or state.picking or state.marks:
            self._take(replace(state, picking=tool, marks=()))
            self._draw()

    def on_pixel(self, u: int, v: int) -> bool:
        """A click on a pixel; whether a tool has taken it."""
        state = self._state()
        if not state.picking or state.loaded is None or (state.picking == "level" and state.labels is not None):
            return False
        self._tools[state.picking](state.loaded, u, v)
        return True

    def _mark(self, loaded: LoadedFrame, u: int, v: int) -> None:
        """One end of a length; a third begins anew."""
        state = self._state()
        try:
            depth_at(loaded.context.frame.depth, u, v)
        except InputError as error:
            self._page.toast("Not measured", str(error), bad=True)
            return
        self._take(replace(state, marks=(*(state.marks if len(state.marks) < 2 else ()), (u, v))))
        self._draw()


class LevelSurface:
    """Takes a click of one client as a pixel of a level surface.

    Up is a fact of the data: what one client says holds for all of them, until the program ends or it is saved.

    Parameters
    ----------
    page : Page
    store : FrameStore
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    reopen : callable
        Opens the frame anew, with its question.
    note : callable
        Writes a line of the log.
    """

    def __init__(
        self,
        page: Page,
        store: FrameStore,
        *,
        state: Callable[[], State],
        take: Callable[[State], None],
        reopen: Callable[[], None],
        note: Callable[[str], None],
    ) -> None:
        self._page, self._store = page, store
        self._state, self._take, self._reopen, self._note = state, take, reopen, note

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "level-keep": lambda _: self.keep(),
            "level-back": lambda _: self.take_back(),
        }

    def on_pixel(self, loaded: LoadedFrame, u: int, v: int) -> None:
        """A click on a pixel of a level surface."""
        state, frame = self._state(), loaded.context.frame
        try:
            x, y, z = level_normal_at(frame.depth, frame.camera, u, v).tolist()
        except InputError as error:
            self._tell("Not a level surface", str(error))
            return
        self._store.tell_up(state.source, ToldUp(frame.id, (u, v), (x, y, z)))
        self._note(f"frame {frame.id}: the surface at {u},{v} is level, up {x:.3f}, {y:.3f}, {z:.3f} in the camera")
        self._take(replace(state, picking=""))
        self._reopen()

    def keep(self) -> None:
        """Write what was said into the settings beside the data."""
        source = self._state().source
        told = self._store.told.get(source)
        if told is not None:
            root = self._store.sources[source].dataset.root
            try:
                if root.resolve() == demo_path().resolve():
                    raise InputError("the built-in demo stays as it is", path=root)
                self._tell("Up is kept", str(write_settings(root, None, None, frame_up={told.frame_id: told.up})))
            except InputError as error:
                self._tell("Up is not kept", str(error))

    def take_back(self) -> None:
        """Up as it was before anything was said."""
        state = self._state()
        if state.source in self._store.told:
            self._store.tell_up(state.source, None)
            self._reopen()

    def _tell(self, title: str, text: str) -> None:
        self._note(text)
        self._page.toast(title, text)
