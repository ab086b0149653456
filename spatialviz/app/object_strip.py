"""Strip of an object's frames: a crop of each, in order; a click shows the object there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pipeline.corrections.sightings import LabelledSighting
from pipeline.geometry.masks import MaskCrop
from pipeline.pictures.marks import outline_path
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
    said = f"{seen.label} {seen.number} in {seen.frame}"
    return h.button(
        picture_part(seen.bbox, seen.size, address),
        do=f"object-at:{seen.number}:{seen.frame}",
        cls="sighting shown" if here else "sighting",
        title=said,
        aria_label=said,
        aria_current="true" if here else None,
    )


def picture_part(
    bbox: Sequence[float], size: Sequence[int], address: str, mask: MaskCrop | None = None
) -> tuple[Element, Element | None]:
    """Square part of a frame's picture around a 2D box, scaled and moved behind a square, and the outline of a mask."""
    x0, y0, x1, y1 = bbox
    height, width = size
    side = max(x1 - x0, y1 - y0, 8.0) * MARGIN
    scale, left, top = CROP / side, (x0 + x1 - side) / 2, (y0 + y1 - side) / 2
    css = {
        "width": f"{width * scale:.0f}px",
        "height": f"{height * scale:.0f}px",
        "left": f"{-left * scale:.0f}px",
        "top": f"{-top * scale:.0f}px",
    }
    drawn = None
    if mask is not None:
        seen = f"{left - mask.x:.1f} {top - mask.y:.1f} {side:.1f} {side:.1f}"
        drawn = h.svg(h.path(d=outline_path(mask.mask)), viewBox=seen, aria_hidden="true")
    return h.img(src=address, alt="", css=css, loading="lazy"), drawn
