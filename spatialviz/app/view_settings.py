"""How a client looks at its dataset: which frame, the paint, the camera, what is shown, dark or light."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

from pipeline.datasets import moves
from spatialviz.app.context import Part, choice, command
from spatialviz.app.picture import frames_html, window
from spatialviz.app.state import CameraMode, ColorMode
from spatialviz.app.toolbar import FLAGS, LARGEST_POINT, LEAST_POINT

POINT_STEP = 1.25


class ViewSettings(Part):
    """Changes how one client looks."""

    @command("color", "next-color=next")
    def paint(self, mode: str) -> None:
        """Paint the cloud in another way, or in the "next"."""
        colors = choice(get_args(ColorMode), self.state.colors, mode)
        if colors is not None:
            self.ctx.show(colors=colors)

    @command("camera")
    def look_from(self, mode: str) -> None:
        """Fly to one of the places to look from."""
        if mode in get_args(CameraMode) and self.state.loaded is not None:
            self.ctx.show(camera=mode)
            self.ctx.scene.viewpoint.fly(mode)

    @command("flag")
    def toggle(self, flag: str) -> None:
        """Show or hide something."""
        flags = self.state.flags
        if flag in FLAGS:
            self.ctx.show(flags=replace(flags, **{flag: not getattr(flags, flag)}))

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
        self.ctx.client.set_dark(not self.state.dark)
        self.ctx.show(dark=not self.state.dark)


BROWSED = 6
"""Small pictures that are made at once: whatever the user does comes between."""


class FrameSteps(Part):
    """Opens frames for one client, and fills its grid of them."""

    @property
    def _ids(self) -> tuple[str, ...]:
        return tuple(self.ctx.source.dataset.frame_ids)

    @command("open")
    def open(self, frame_id: str) -> None:
        """Show the frame of a name."""
        self.ctx.open_frame(frame_id)

    @command("frame")
    def open_number(self, number: str) -> None:
        """Show the frame of a number."""
        if number.isdecimal() and int(number) < len(self._ids):
            self.ctx.open_frame(self._ids[int(number)])

    @command("next-frame")
    def step(self, by: str) -> None:
        """Show the next frame, or the one before."""
        if by.lstrip("-").isdecimal():
            self.open_number(str(self._ids.index(self.state.frame_id) + int(by)))

    @command("move")
    def move(self, move: str) -> None:
        """Go where a move of the dataset's robot leads; one that is not possible does nothing."""
        to = moves(self.ctx.source.dataset, self.state.frame_id).get(move)
        if to is not None:
            self.ctx.open_frame(to)

    def browse(self) -> None:
        """Fill the grid of small pictures bit by bit, behind whatever the user does."""
        ids, source, frame = self._ids, self.state.source, self.state.frame_id
        at = ids.index(frame)
        total = len(window(ids, at))

        def fill(ready: int) -> None:
            if (self.state.source, self.state.frame_id) != (source, frame) or self.ctx.closed.is_set():
                return
            self.ctx.page.show("frames", frames_html(self.state, ids, self.ctx.shared.store, ready))
            if ready < total:
                self.ctx.post(lambda: fill(min(ready + BROWSED, total)))
            else:
                self.ctx.shared.store.prepare(source, (*ids[at + 1 : at + 2], *ids[max(0, at - 1) : at]))

        self.ctx.post(lambda: fill(min(BROWSED, total)))
