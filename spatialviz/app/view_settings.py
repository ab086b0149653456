"""How a client looks at a frame: the paint, the camera, what is shown, dark or light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pipeline.answering.opening import Pipeline
from pipeline.datasets.scene_mesh import fuse_context
from pipeline.system.errors import FrameUnusable, MissingExtra
from spatialviz.app.layout import Page
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
