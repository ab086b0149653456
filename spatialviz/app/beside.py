"""The layer of a second detector: whose boxes are shown, its boxes in the scene, and steps through disagreements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.geometry.boxes import EDGES, Box3D
from pipeline.geometry.palette import RGB, hex_color, second_color
from spatialviz.app.beside_html import chosen_row, second_name
from spatialviz.app.scene import GHOST_GROWTH, SceneView, Tag, half_size, triple
from spatialviz.app.scene_client import SceneClient
from spatialviz.app.state import Layers, State
from spatialviz.report.picture import dashed

LAYERS: tuple[Layers, ...] = ("both", "a", "b")
DASH = 0.055
"""Length of a dash with its gap, metres."""
ANCHOR = "/tags/beside"


class BesideLayer:
    """Draws the second detector's boxes, and takes what is asked of it.

    Parameters
    ----------
    client : SceneClient
    scene : SceneView
        Says where a box stands in the scene.
    state : callable
        Gives the client's state.
    take : callable
        Takes a new one.
    draw : callable
    """

    def __init__(
        self,
        client: SceneClient,
        scene: SceneView,
        state: Callable[[], State],
        take: Callable[[State], None],
        draw: Callable[[], None],
    ) -> None:
        self._client, self._scene = client, scene
        self._state, self._take, self._draw = state, take, draw
        self._lines: dict[str, Any] = {}
        self._drawn: tuple[object, ...] = ()
        self._tags: list[Tag] = []
        self._anchor: Any = None

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {
            "layer": self.show,
            "beside": self._select,
            "next-disagreement": lambda step: self._step(int(step)),
        }

    def show(self, which: str) -> None:
        """Show the boxes of "both", "a" or "b"; or the "next" of them."""
        state = self._state()
        if state.beside is None:
            return
        if which == "next":
            which = LAYERS[(LAYERS.index(state.layers) + 1) % len(LAYERS)]
        for layers in LAYERS:
            if layers == which:
                self._take(replace(state, layers=layers))
                self._draw()

    def _select(self, places: str) -> None:
        """Select "3,5": object 3 of the own detector and 5 of the second; -1 for none."""
        beside = self._state().beside
        own, _, other = places.partition(",")
        if beside is None or not all(n.lstrip("-").isdecimal() for n in (own, other)):
            return
        i, j = int(own), int(other)
        state = self._state()
        if i < len(state.shown.objects) and j < len(beside.objects):
            self._choose(None if i < 0 else i, None if j < 0 else j)

    def _step(self, step: int) -> None:
        """Go to the next disagreement, or to one before."""
        state = self._state()
        rows = () if state.beside is None else state.beside.disagreements
        if rows:
            at = chosen_row(state)
            place = rows.index(at) + step if at in rows else 0 if step > 0 else -1
            self._choose(*rows[place % len(rows)])

    def _choose(self, own: int | None, second: int | None) -> None:
        state = self._state()
        layers = state.layers
        # What is chosen must be seen.
        if layers != "both" and (own if layers == "a" else second) is None:
            layers = "both"
        self._take(replace(state, selected=own, second=second, layers=layers))
        self._draw()

    def follow(self, live: bool = False) -> list[Tag]:
        """Bring the scene up to the state, and return the names to show; while a hand is at a box nothing changes."""
        state = self._state()
        objects, chosen = state.second_layer, state.second_selected
        marks = (state.source, state.frame_id, bool(objects), chosen, state.layers, state.boxes_shown, state.dark)
        if live or marks == self._drawn:
            return self._tags
        self._drawn = marks
        color = second_color(state.dark)
        alike: set[int] = set()
        if state.beside is not None and state.layers == "both":
            alike = set(state.beside.found.pairs[state.beside.found.same, 1].tolist())
        boxed = [j for j, entry in enumerate(objects) if entry.lifted.box is not None]
        shown = boxed if state.boxes_shown else []
        with self._client.atomic():
            self._set("alike", self._dashes(objects, [j for j in shown if j in alike]), _faint(color, state.dark), 1.2)
            self._set("apart", self._dashes(objects, [j for j in shown if j not in alike]), color, 2.2)
            self._set("chosen", self._dashes(objects, [j for j in boxed if j == chosen]), color, 4.0)
            self._tags = self._tag(state, chosen if chosen in boxed else None)
        return self._tags

    def clear(self) -> None:
        """Show nothing."""
        for handle in self._lines.values():
            handle.remove()
        self._lines, self._drawn, self._tags = {}, (), []

    def _dashes(self, objects: Sequence[SceneObject], which: Sequence[int]) -> np.ndarray:
        edges = []
        for j in which:
            box = objects[j].lifted.box
            assert box is not None
            at = self._scene.shown_box(box)
            # A little larger, so that they do not lie in the very lines of the own boxes.
            edges.append(Box3D(at.center, at.R, at.size + GHOST_GROWTH).corners[EDGES])
        return dashed(np.concatenate(edges), DASH) if edges else np.zeros((0, 2, 3), np.float32)

    def _set(self, name: str, points: np.ndarray, color: RGB, width: float) -> None:
        handle = self._lines.get(name)
        if handle is None:
            if len(points):
                self._lines[name] = self._client.scene.add_line_segments(
                    f"/beside/{name}", points, color, thickness=width, thickness_units="screen"
                )
            return
        handle.visible = bool(len(points))
        if len(points):
            handle.points, handle.colors = points, np.array(color, np.uint8)

    def _tag(self, state: State, chosen: int | None) -> list[Tag]:
        if chosen is None or state.beside is None:
            return []
        entry = state.beside.objects[chosen]
        assert entry.lifted.box is not None
        box = self._scene.shown_box(entry.lifted.box)
        if self._anchor is None:
            self._anchor = self._client.scene.add_frame(ANCHOR, show_axes=False)
        self._anchor.position = triple(box.center)
        detail = "" if entry.score >= 0.9995 else f"{entry.score:.2f}"
        name, color = second_name(state.beside, chosen), hex_color(second_color(state.dark))
        return [Tag(ANCHOR, f"B {name}", detail, color, True, extent=half_size(box))]


def _faint(color: RGB, dark: bool) -> RGB:
    """Half way to the background."""
    ground = 20 if dark else 250
    r, g, b = ((c + ground) // 2 for c in color)
    return r, g, b
