"""The list of objects of a frame, with their pictures, sizes and scores."""

from __future__ import annotations

from pipeline.geometry.palette import palette
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State
from spatialviz.app.text import chosen, heading, named, note, panel


def objects_html(state: State) -> Element | None:
    """The objects as they are numbered, and above them those of the chosen pair once more; a click selects one."""
    if state.loaded is None:
        return None
    if not state.shown.objects:
        reason = state.loaded.problem or "Nothing is annotated or detected in this frame."
        return panel(heading("Objects"), note(reason), cls="objects")
    count = len(state.shown.objects)
    # Rows that change places would be sent again, all of them.
    pair = [_row(state, i, "of-pair") for i in dict.fromkeys(state.pair or ())]
    head = [h.tr(h.th(words, colspan=4)) for words in ("of the pair", "all")] if pair else [None, None]
    every = (_row(state, i, "object") for i in range(count))
    table = h.table(h.tbody(head[0], pair, id="of-pair"), h.tbody(head[1], every), cls="objects")
    return panel(heading(f"Objects{' of A' if state.beside else ''} ({count})"), table)


def _row(state: State, i: int, kind: str) -> Element:
    assert state.loaded is not None
    in_pair = kind == "object" and i in (state.pair or ())
    marks = chosen(i == state.selected, "r")
    # The page scrolls to the first of two rows of the same object.
    marks |= {"data_shown": None} if in_pair else {}
    entry, color = state.shown.objects[i], palette(state.dark)[state.roles.get(i, "other")]
    box, quality = entry.lifted.box, entry.lifted.quality
    size = "no depth" if box is None else " × ".join(f"{s * 100:.0f}" for s in box.size) + " cm"
    doubts = "; ".join(quality.concerns)
    return h.tr(
        h.td(thumb(state, i)),
        h.td(named(color, state.shown.names[i]), h.div(size, cls="dim"), cls="w"),
        h.td("" if box is None else f"{quality.distance:.1f} m", cls="n dim"),
        h.td(score(entry.score), h.span("!", cls="low", title=doubts, aria_label=doubts) if doubts else "", cls="n"),
        id=f"{kind}-{i}",
        do=f"object:{i}",
        hover=f"hover:{i}",
        **marks,
    )


def thumb(state: State, i: int) -> Element:
    """The small picture of an object; an empty place where it has none."""
    url = "" if state.loaded is None else state.loaded.thumb(state.shown.objects[i].bbox)
    return h.img(src=url, alt="", cls="thumb", loading="lazy") if url else h.span(cls="thumb")


def score(value: float) -> str:
    """A detector's score; nothing where the objects are the dataset's own."""
    return "" if value >= 0.9995 else f"{value:.2f}"
