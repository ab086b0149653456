"""What is pressed around the scene: how it is painted and looked at, steps between frames, examples, what to keep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from pipeline.geometry.palette import DROPPED
from spatialviz.app.beside_html import layers_html
from spatialviz.app.keys import KEYS, MOVE_KEYS
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State
from spatialviz.app.text import dot, panel, segments, words

COLORS = {"rgb": "Colour", "objects": "Objects", "depth": "Depth", "evidence": "Cleaning"}
CAMERAS = {"pair": "Pair", "sensor": "Sensor", "orbit": "Orbit", "top": "Top"}
MOVE_MARKS = {
    "rotate_ccw": ("↶", "turn left"),
    "forward": ("↑", "forward"),
    "rotate_cw": ("↷", "turn right"),
    "left": ("←", "left"),
    "backward": ("↓", "back"),
    "right": ("→", "right"),
}
FLAGS = {
    "cloud": "cloud",
    "boxes": "boxes",
    "labels": "all names",
    "pairs": "pairs",
    "ghosts": "labelled",
    "truth": "exact boxes",
    "axes": "axes",
    "region": "region",
    "context": "room",
    "camera": "camera",
    "grid": "metre grid",
}
HINTS = {message: f"{label} ({key})" for key, label, message in KEYS["Looking"]}
LEAST_POINT, LARGEST_POINT = 0.4, 4.0
"""How small and how large points are drawn, as a factor."""
PICTURES = tuple(
    h.button(label, cls="toggle", local=local, title=title)
    for label, local, title in (
        ("Save scene", "shot:scene", "the scene as it stands, with its names, as a PNG"),
        ("Save page", "shot:page", "the whole page, as a PNG; the browser asks first"),
    )
)


def scene_tools_html(state: State) -> Element:
    """How the scene is coloured, seen from where, and what is shown in it."""
    flags = asdict(state.flags)
    exact = state.loaded is not None and any(a.box is not None for a in state.loaded.context.frame.annotations)
    toggles = (
        h.button(
            label, cls="toggle", do=f"flag:{key}", aria_pressed=str(flags[key]).lower(), title=HINTS.get(f"flag:{key}")
        )
        for key, label in FLAGS.items()
        if key != "truth" or exact
    )
    legend = (h.span(dot(color), words(reason)) for reason, color in DROPPED.items())
    return h.div(
        segments("color", COLORS, state.colors, "paint"),
        segments("camera", CAMERAS, state.camera, "look from"),
        layers_html(state),
        h.button(
            "Measure",
            cls="toggle",
            do="pick:measure",
            aria_pressed=str(state.picking == "measure").lower(),
            title="metres between two surfaces that you click, here or in the picture (Shift+D; Escape ends)",
        ),
        _point_size(state),
        h.div(toggles, cls="toggles", role="group", aria_label="shown in the scene"),
        h.div(PICTURES, cls="toggles", role="group", aria_label="pictures to keep"),
        h.div(legend, cls="legend") if state.colors == "evidence" else None,
        cls="tools",
    )


def _point_size(state: State) -> Element:
    value = f"{state.point_size:.2f}"
    part = (state.point_size - LEAST_POINT) / (LARGEST_POINT - LEAST_POINT)
    field = h.input(
        type="range", min=LEAST_POINT, max=LARGEST_POINT, step="0.05", value=value, live="point-size", id="point-size",
        css={"--v": f"{part:.3f}"}, title="how large points are drawn (- and =)",
    )  # fmt: skip
    return h.label("points", field, cls="points")


def frame_nav_html(place: int, count: int) -> Element:
    """Which frame of how many, with steps to its neighbours."""
    return h.div(
        _step(-1, "‹", "previous frame (P)", place > 0),
        h.span(f"{place + 1} of {count}", cls="dim"),
        _step(1, "›", "next frame (N)", place + 1 < count),
        cls="nav",
    )


def moves_html(leads: Mapping[str, str] | None) -> Element | None:
    """Where a robot can go from here, of a dataset that has moves."""
    return None if leads is None else h.div((_move(leads, *key) for key in MOVE_KEYS), cls="moves")


def _step(by: int, label: str, hint: str, possible: bool) -> Element:
    how = {"do": f"next-frame:{by}", "title": hint, "aria_label": hint, "id": f"step{by}", "disabled": not possible}
    return h.button(label, cls="try", **how)


def _move(leads: Mapping[str, str], key: str, label: str, message: str) -> Element:
    """A button as the keys lie; a move that is not possible cannot be pressed."""
    move = message.partition(":")[2]
    mark, word = MOVE_MARKS[move]
    hint = f"{label} ({key}): {leads.get(move, 'there is no picture')}"
    return h.button(h.i(mark), word, do=message, title=hint, id=f"move-{move}", disabled=move not in leads)


def suggestions_html(state: State, suggestions: Sequence[str]) -> Element | None:
    """What one could ask of the frame; None where there is nothing to suggest."""
    if state.loaded is not None and state.labels is None and state.loaded.context.viewer.up_source == "assumed":
        return panel(h.p("No example: it would rest on an assumed up.", cls="dim"))
    if not suggestions:
        return None
    tries = (
        h.li(h.button(text, cls="try on" if text == state.text else "try", do=f"try:{i}"))
        for i, text in enumerate(suggestions)
    )
    return panel(h.ul(tries, cls="suggestions"))
