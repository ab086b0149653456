"""Saying that a surface is level: by a click, for all frames that follow from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pipeline.datasets import write_settings
from pipeline.datasets.demo import demo_path
from pipeline.geometry.level_plane import level_normal_at
from pipeline.system.errors import InputError
from spatialviz.app.frames import FrameStore, LoadedFrame, ToldUp
from spatialviz.app.layout import Page
from spatialviz.app.state import State


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
