"""What a client has selected, an object or a pair: by a row, a word, a pixel of the picture, a click in the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pipeline.geometry.boxes import Box3D
from spatialviz.app.label_view import paired
from spatialviz.app.picture import object_at, second_at
from spatialviz.app.state import State


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
