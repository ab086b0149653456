"""Strip of an object's frames: a crop of each, in order; a click shows the object there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pipeline.corrections.sightings import LabelledSighting
from spatialviz.app.markup import Element, button, h, heading

CROP = 72
"""Pixels of a crop's side."""
MARGIN = 1.4
"""Side of a crop, as a multiple of the object's longer side."""
MOST = 60
"""So many frames around the shown one."""


def strip_html(found: Sequence[LabelledSighting], frame: str, picture: Callable[[str], str]) -> Element | None:
    """Crops of an object in all frames; None for an object of one frame. `picture` gives the address of a frame's."""
    at = next((k for k, s in enumerate(found) if s.frame == frame), 0)
    first = max(0, min(at - MOST // 2, len(found) - MOST))
    if len(found) < 2:
        return None
    crops = [_crop(s, s.frame == frame, picture(s.frame)) for s in found[first : first + MOST]]
    steps = h.span(
        button("‹", "same-object:-1", "in the frame before (Shift+Z)", disabled=at == 0),
        button("›", "same-object:1", "in the next frame (Shift+T)", disabled=at + 1 == len(found)),
        cls="chips",
    )
    head = heading("The same object", f"{at + 1} of {len(found)} frames", steps).with_(id="strip-head")
    return h.div(head, h.div(crops, cls="strip"))


def _crop(seen: LabelledSighting, here: bool, address: str) -> Element:
    """Crop out of the frame's picture, which is scaled and moved behind a square."""
    x0, y0, x1, y1 = seen.bbox
    height, width = seen.size
    side = max(x1 - x0, y1 - y0, 8.0) * MARGIN
    scale = CROP / side
    css = {
        "width": f"{width * scale:.0f}px",
        "height": f"{height * scale:.0f}px",
        "left": f"{CROP / 2 - (x0 + x1) / 2 * scale:.0f}px",
        "top": f"{CROP / 2 - (y0 + y1) / 2 * scale:.0f}px",
    }
    return h.button(
        h.img(src=address, alt="", css=css, loading="lazy"),
        do=f"object-at:{seen.number}:{seen.frame}",
        cls="sighting shown" if here else "sighting",
        title=f"{seen.label} {seen.number} in {seen.frame}",
        aria_label=f"{seen.label} {seen.number} in {seen.frame}",
        aria_current="true" if here else None,
    )
