"""How a client looks at its dataset: which frame, the paint, the camera, what is shown, dark or light."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

from pipeline.answering.opening import Pipeline
from pipeline.datasets import moves
from pipeline.datasets.scene_mesh import fuse_context
from pipeline.system.errors import FrameUnusable, MissingExtra
from spatialviz.app.frames import FrameStore
from spatialviz.app.layout import Page
from spatialviz.app.picture import frames_html, window
from spatialviz.app.scene import SceneView
from spatialviz.app.state import CameraMode, ColorMode, State
from spatialviz.app.toolbar import FLAGS, LARGEST_POINT, LEAST_POINT

POINT_STEP = 1.25
MODES: tuple[ColorMode, ...] = ("rgb", "objects", "depth", "evidence")


class ViewSettings:
    """Changes how one client looks.

    Parameters
    ----------
    page : Page
    scene : SceneView
    source : callable
        Gives the source that is looked at.
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    draw : callable
    note : callable
        Writes a line of the log.
    theme : callable
        Makes the page and the scene's frame dark, or light.
    """

    def __init__(
        self,
        page: Page,
        scene: SceneView,
        source: Callable[[], Pipeline],
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[], None],
        note: Callable[[str], None],
        theme: Callable[[bool], None],
    ) -> None:
        self._page, self._scene, self._source = page, scene, source
        self._state, self._take, self._draw, self._note, self._theme = state, take, draw, note, theme

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "color": self.paint,
            "next-color": lambda _: self.paint(MODES[(MODES.index(self._state().colors) + 1) % len(MODES)]),
            "camera": self.look_from,
            "flag": self.toggle,
            "point-size": self.size_points,
            "theme": lambda _: self.switch_theme(),
        }

    def paint(self, mode: str) -> None:
        """Paint the cloud in another way."""
        if mode in MODES:
            self._take(replace(self._state(), colors=mode))
            self._draw()

    def look_from(self, mode: str) -> None:
        """Fly to one of the places to look from."""
        modes: dict[str, CameraMode] = {"pair": "pair", "sensor": "sensor", "orbit": "orbit", "top": "top"}
        state = self._state()
        if mode in modes and state.loaded is not None:
            self._take(replace(state, camera=modes[mode]))
            self._draw()
            self._scene.viewpoint.fly(mode)

    def toggle(self, flag: str) -> None:
        """Show or hide something."""
        state = self._state()
        if flag in FLAGS:
            self._take(replace(state, flags=replace(state.flags, **{flag: not getattr(state.flags, flag)})))
            if flag == "context":
                self.show_context()
            self._draw()

    def size_points(self, text: str) -> None:
        """Draw the points by a factor of their size; "more" and "less" are steps."""
        state, steps = self._state(), {"more": POINT_STEP, "less": 1 / POINT_STEP}
        try:
            factor = state.point_size * steps[text] if text in steps else float(text)
        except ValueError:
            return
        if LEAST_POINT <= (factor := round(factor, 2)) <= LARGEST_POINT:
            self._take(replace(state, point_size=factor))
            # The slider stands where the hand has put it.
            (self._draw if text in steps else lambda: self._scene.scale_points(factor))()

    def show_context(self) -> None:
        """Fuse the frames around this one, where that is wanted and possible."""
        mesh, state = None, self._state()
        if state.flags.context and state.loaded is not None:
            try:
                mesh = fuse_context(self._source().dataset, state.loaded.context.frame)
            except (FrameUnusable, MissingExtra) as error:
                self._take(replace(state, flags=replace(state.flags, context=False)))
                self._note(str(error))
                self._page.toast("No room to show", str(error))
        self._scene.show_context(mesh, state.dark)

    def switch_theme(self) -> None:
        """Dark becomes light, and light dark."""
        state = self._state()
        self._take(replace(state, dark=not state.dark))
        self._theme(not state.dark)
        self.show_context()
        self._draw()


BROWSED = 6
"""Small pictures that are made at once: whatever the user does comes between."""


class FrameSteps:
    """Opens frames for one client, and fills its grid of them.

    Parameters
    ----------
    page : Page
    store : FrameStore
    closed : threading.Event
        Set when the client has gone.
    state : callable
        Gives the client's state.
    open_frame : callable
        Shows a frame.
    post : callable
        Runs something later, on the client's own thread.
    """

    def __init__(
        self,
        page: Page,
        store: FrameStore,
        closed: threading.Event,
        *,
        state: Callable[[], State],
        open_frame: Callable[[str], None],
        post: Callable[[Callable[[], None]], None],
    ) -> None:
        self._page, self._store, self._closed = page, store, closed
        self._state, self._open_frame, self._post = state, open_frame, post

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {"open": self._open_frame, "frame": self.open_number, "next-frame": self.step, "move": self.move}

    @property
    def _ids(self) -> tuple[str, ...]:
        return tuple(self._store.sources[self._state().source].dataset.frame_ids)

    def open_number(self, number: str) -> None:
        """Show the frame of a number."""
        if number.isdecimal() and int(number) < len(self._ids):
            self._open_frame(self._ids[int(number)])

    def step(self, by: str) -> None:
        """Show the next frame, or the one before."""
        if by.lstrip("-").isdecimal():
            self.open_number(str(self._ids.index(self._state().frame_id) + int(by)))

    def move(self, move: str) -> None:
        """Go where a move of the dataset's robot leads; one that is not possible does nothing."""
        state = self._state()
        to = moves(self._store.sources[state.source].dataset, state.frame_id).get(move)
        if to is not None:
            self._open_frame(to)

    def browse(self) -> None:
        """Fill the grid of small pictures bit by bit, behind whatever the user does."""
        ids, state = self._ids, self._state()
        current = (state.source, state.frame_id)
        total = len(window(ids, ids.index(state.frame_id)))

        def fill(ready: int) -> None:
            now = self._state()
            if (now.source, now.frame_id) != current or self._closed.is_set():
                return
            self._page.show("frames", frames_html(now, ids, self._store, ready))
            if ready < total:
                self._post(lambda: fill(min(ready + BROWSED, total)))
            else:
                at = ids.index(now.frame_id)
                self._store.prepare(now.source, (*ids[at + 1 : at + 2], *ids[max(0, at - 1) : at]))

        self._post(lambda: fill(min(BROWSED, total)))
