"""What a click on a surface is for, where it is not to select: a level surface is named, a length measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import get_args

from pipeline.geometry.camera import depth_at
from pipeline.system.errors import InputError
from spatialviz.app.frames import LoadedFrame
from spatialviz.app.layout import Page
from spatialviz.app.state import State, Tool


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
