"""The mark that says how up is known, and how to say it oneself."""

from __future__ import annotations

from pipeline.datasets.settings import ASSUMED, SOURCES
from pipeline.geometry.camera import UpSource
from spatialviz.app.state import State
from spatialviz.app.text import DOUBT, IDLE, note, safe

PICK = "Click a level surface, a floor or a table-top, in the picture or in the scene. Shift+U leaves it as it is."
ASK = "event.stopPropagation();sv('level')"
MADE_WITH = "The labels were made with it."
HOW = "Click here (Shift+U), then a surface that is level: up is then known."


def up_chip(state: State) -> str:
    """How up is known, small; loud where it is only assumed. A click asks for a level surface.

    Of labels that are shown it is the up that they were made with, which no click changes.
    """
    if state.loaded is None:
        return ""
    labels = state.labels
    source: UpSource | None = state.loaded.context.viewer.up_source if labels is None else labels.frame.row["up_source"]
    if source is None:
        return ""
    loud = source == "assumed"
    said = f"{ASSUMED[0].upper()}{ASSUMED[1:]}." if loud else f"Up: {SOURCES[source]}."
    click, how = "", MADE_WITH
    if labels is None:
        click, how = f' role="button" aria-pressed="{"true" if state.picking else "false"}" onclick="{ASK}"', HOW
    return (
        f'<span class="upchip{" loud" if loud else ""}" style="--c:{DOUBT if loud else IDLE}"{click} '
        f'title="{safe(said)} {how}">up {source}</span>'
    )


def level_html(state: State) -> str:
    """What to click while a level surface is asked for; afterwards, how to keep what was said."""
    if state.picking:
        return note(PICK)
    loaded = state.loaded
    if loaded is None or loaded.told is None or loaded.context.viewer.up_source != "given":
        return ""
    save, back = "keep it in spatialviz.toml beside the data", "as it was before"
    return (
        '<div class="dim uptold">Up as you said, until the program ends; it is said again by '
        f"<code>--level-at {safe(loaded.told.words)}</code> "
        f'<span class="try" role="button" onclick="sv(\'level-keep\')" title="{save}">save</span> '
        f'<span class="try" role="button" onclick="sv(\'level-back\')" title="{back}">take back</span></div>'
    )
