"""The mark that says how up is known, and how to say it oneself."""

from __future__ import annotations

from pipeline.datasets.settings import ASSUMED, SOURCES
from pipeline.geometry.camera import UpSource
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State
from spatialviz.app.text import DOUBT, IDLE, button, note

PICK = "Click a level surface, a floor or a table-top, in the picture or in the scene. Shift+U leaves it as it is."
MADE_WITH = "The labels were made with it."
HOW = "Click here (Shift+U), then a surface that is level: up is then known."


def up_chip(state: State) -> Element | None:
    """How up is known, small; loud where it is only assumed. A click asks for a level surface.

    Of labels that are shown it is the up that they were made with, which no click changes.
    """
    if state.loaded is None:
        return None
    labels = state.labels
    source: UpSource | None = state.loaded.context.viewer.up_source if labels is None else labels.frame.row["up_source"]
    if source is None:
        return None
    loud = source == "assumed"
    said = f"{ASSUMED[0].upper()}{ASSUMED[1:]}." if loud else f"Up: {SOURCES[source]}."
    chip = h.button if labels is None else h.span
    made = chip(
        f"up {source}",
        cls=f"upchip{' loud' if loud else ''}",
        css={"--c": DOUBT if loud else IDLE},
        title=f"{said} {HOW if labels is None else MADE_WITH}",
    )
    on = str(state.picking == "level").lower()
    return made if labels is not None else made.with_(do="pick:level", aria_pressed=on)


def level_html(state: State) -> Element | None:
    """What to click while a level surface is asked for; afterwards, how to keep what was said."""
    if state.picking == "level":
        return note(PICK)
    loaded = state.loaded
    if loaded is None or loaded.told is None or loaded.context.viewer.up_source != "given":
        return None
    return h.div(
        "Up as you said, until the program ends; it is said again by ",
        h.code(f"--level-at {loaded.told.words}"),
        " ",
        button("save", "level-keep", "keep it in spatialviz.toml beside the data"),
        " ",
        button("take back", "level-back", "as it was before"),
        cls="dim uptold",
    )
