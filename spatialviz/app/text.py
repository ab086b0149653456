"""Small pieces of HTML shared by the panels. Every string of a dataset passes `safe` first."""

from __future__ import annotations

import html

from pipeline.geometry.lifting import Pixel
from pipeline.geometry.palette import RGB, hex_color

GOOD, DOUBT, BAD, IDLE = "#35a96b", "#e0982e", "#e5484d", "#8a919c"


def safe(text: object) -> str:
    """Text as HTML, quotes included."""
    return html.escape(str(text), quote=True)


def tail(text: object) -> str:
    """Text as HTML for a line that is cut at its left: written from right to left, where its ends must not move."""
    return f"&lrm;{safe(text)}&lrm;"


def dot(color: RGB) -> str:
    """A filled square in a role's colour."""
    return f'<span class="dot" style="--c:{hex_color(color)}"></span>'


def words(reason: Pixel) -> str:
    """What became of a pixel, in words."""
    return reason.name.lower().replace("_", " ")


def panel(*parts: str, style: str = "") -> str:
    """Parts inside one styled block."""
    return f'<div class="sv" style="{style}">{"".join(parts)}</div>'


def heading(text: str, aside: str = "") -> str:
    """A small capital heading with an optional remark at the right; both are HTML already."""
    return f'<div class="h">{text}<span>{aside}</span></div>'


def note(text: str, color: str = DOUBT) -> str:
    """A remark with a coloured edge; the text is escaped here."""
    return f'<div class="note" style="--c:{color}">{safe(text)}</div>'


def segments(kind: str, options: dict[str, str], chosen: str) -> str:
    """A segmented control; the bus gets "kind:key"."""
    cells = "".join(
        f'<span class="{"on" if key == chosen else ""}" onclick="sv(\'{kind}:{key}\')">{label}</span>'
        for key, label in options.items()
    )
    return f'<div class="seg">{cells}</div>'
