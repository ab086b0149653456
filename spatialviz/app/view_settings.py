"""How a client looks at a frame: the paint, the camera, what is shown, dark or light."""

from __future__ import annotations

from dataclasses import replace

from spatialviz.app.context import Part, command
from spatialviz.app.state import CameraMode, ColorMode
from spatialviz.app.toolbar import FLAGS, LARGEST_POINT, LEAST_POINT

POINT_STEP = 1.25
MODES: tuple[ColorMode, ...] = ("rgb", "objects", "depth", "evidence")


class ViewSettings(Part):
    """Changes how one client looks."""

    @command("color", "next-color=next")
    def paint(self, mode: str) -> None:
        """Paint the cloud in another way, or in the "next"."""
        if mode == "next":
            mode = MODES[(MODES.index(self.state.colors) + 1) % len(MODES)]
        if mode in MODES:
            self.ctx.show(colors=mode)

    @command("camera")
    def look_from(self, mode: str) -> None:
        """Fly to one of the places to look from."""
        modes: dict[str, CameraMode] = {"pair": "pair", "sensor": "sensor", "orbit": "orbit", "top": "top"}
        state = self.state
        if mode in modes and state.loaded is not None:
            self.ctx.show(camera=modes[mode])
            self.ctx.scene.viewpoint.fly(mode)

    @command("flag")
    def toggle(self, flag: str) -> None:
        """Show or hide something."""
        state = self.state
        if flag in FLAGS:
            self.state = replace(state, flags=replace(state.flags, **{flag: not getattr(state.flags, flag)}))
            self.ctx.draw()

    @command("point-size")
    def size_points(self, text: str) -> None:
        """Draw the points by a factor of their size; "more" and "less" are steps."""
        state, steps = self.state, {"more": POINT_STEP, "less": 1 / POINT_STEP}
        try:
            factor = state.point_size * steps[text] if text in steps else float(text)
        except ValueError:
            return
        if LEAST_POINT <= (factor := round(factor, 2)) <= LARGEST_POINT:
            self.state = replace(state, point_size=factor)
            # The slider stands where the hand has put it.
            self.ctx.draw(live=text not in steps)

    @command("theme")
    def switch_theme(self) -> None:
        """Dark becomes light, and light dark."""
        state = self.state
        self.state = replace(state, dark=not state.dark)
        self.ctx.client.set_dark(not state.dark)
        self.ctx.draw()
