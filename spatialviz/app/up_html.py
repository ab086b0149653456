"""The mark that says how up is known, and how to say it oneself."""

from __future__ import annotations

from pipeline.datasets.up_words import ASSUMED, SOURCES
from spatialviz.app.state import State
from spatialviz.app.text import DOUBT, IDLE, note, safe

PICK = "Click a level surface, a floor or a table-top, in the picture or in the scene. Shift+U leaves it as it is."
HOW = "Click here (Shift+U), then a surface that is level: up is then known."


def up_chip(state: State) -> str:
    """How up is known, small; loud where it is only assumed. A click asks for a level surface."""
    if state.loaded is None:
        return ""
    source = state.loaded.context.viewer.up_source
    loud = source == "assumed"
    said = f"{ASSUMED[0].upper()}{ASSUMED[1:]}." if loud else f"Up: {SOURCES[source]}."
    return (
        f'<span class="upchip{" loud" if loud else ""}" style="--c:{DOUBT if loud else IDLE}" role="button" '
        f'aria-pressed="{"true" if state.picking else "false"}" onclick="event.stopPropagation();sv(\'level\')" '
        f'title="{safe(said)} {HOW}">up {source}</span>'
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
