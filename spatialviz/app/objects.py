"""The list of objects of a frame, with their pictures, sizes and scores."""

from __future__ import annotations

from pipeline.geometry.palette import palette
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State
from spatialviz.app.text import chosen, heading, named, note, panel

ROLE_ORDER = {"target": 0, "reference": 1, "other": 2}


def objects_html(state: State) -> Element | None:
    """The objects, those of the chosen pair first; a click selects one."""
    if state.loaded is None:
        return None
    if not state.shown.objects:
        reason = state.loaded.problem or "Nothing is annotated or detected in this frame."
        return panel(heading("Objects"), note(reason), cls="objects")
    count = len(state.shown.objects)
    order = sorted(range(count), key=lambda i: ROLE_ORDER[state.roles.get(i, "other")])
    rows = h.tbody(_row(state, i) for i in order)
    return panel(heading(f"Objects{' of A' if state.beside else ''} ({count})"), h.table(rows, cls="objects"))


def _row(state: State, i: int) -> Element:
    assert state.loaded is not None
    entry, color = state.shown.objects[i], palette(state.dark)[state.roles.get(i, "other")]
    box, quality = entry.lifted.box, entry.lifted.quality
    size = "no depth" if box is None else " × ".join(f"{s * 100:.0f}" for s in box.size) + " cm"
    doubts = "; ".join(quality.concerns)
    return h.tr(
        h.td(thumb(state, i)),
        h.td(named(color, state.shown.names[i]), h.div(size, cls="dim"), cls="w"),
        h.td("" if box is None else f"{quality.distance:.1f} m", cls="n dim"),
        h.td(score(entry.score), h.span("!", cls="low", title=doubts, aria_label=doubts) if doubts else "", cls="n"),
        id=f"object-{i}",
        do=f"object:{i}",
        **chosen(i == state.selected, "r"),
    )


def thumb(state: State, i: int) -> Element:
    """The small picture of an object; an empty place where it has none."""
    url = "" if state.loaded is None else state.loaded.thumb(state.shown.objects[i].bbox)
    return h.img(src=url, alt="", cls="thumb", loading="lazy") if url else h.span(cls="thumb")


def score(value: float) -> str:
    """A detector's score; nothing where the objects are the dataset's own."""
    return "" if value >= 0.9995 else f"{value:.2f}"
