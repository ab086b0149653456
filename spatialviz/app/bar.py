"""The bar at the top of the page: dataset and frame, what the page is for, and tools."""

from __future__ import annotations

from collections.abc import Sequence

from spatialviz.app.layout import listed
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State
from spatialviz.app.text import BAD, note, segments
from spatialviz.app.toolbar import frame_nav_html

TOOLS = (
    ("share", "Copy link", "the address of this view, into the clipboard", {"local": "share"}),
    ("copy-state", "Copy view", "the view with its edits as a string (Shift+C)", {"do": "copy-state"}),
    ("paste-state", "Open view", "open a view from its string (Shift+V)", {"do": "paste-state"}),
    ("keep-case", "Save case", "a folder that `spatialviz replay` runs again (Shift+K)", {"do": "keep-case"}),
    ("report", "Report", "one page of this answer, as a download (Shift+P)", {"do": "report"}),
    ("theme", "Dark or light", "M", {"do": "theme"}),
    ("help", "Keys", "all keys (?)", {"do": "help"}),
)


def where_html(state: State, sources: Sequence[str], ids: Sequence[str]) -> list[Element]:
    """Which dataset and which frame of it, with steps to its neighbours."""
    place = ids.index(state.frame_id)
    made = []
    if len(sources) > 1:
        options = (h.option(name, value=name, selected=name == state.source) for name in sources)
        made.append(h.select(options, aria_label="Dataset", change="data:"))
    else:
        made.append(h.span(state.source, cls="dataset"))
    field = h.input(
        type="text", value=state.frame_id, list="frame-ids", aria_label="Frame", change="open:", cls="frame-id",
        autocomplete="off", spellcheck="false",
    )  # fmt: skip
    offered = h.datalist((h.option(value=one) for one in listed(ids, state.frame_id)), id="frame-ids")
    return [*made, field, offered, frame_nav_html(place, len(ids))]


def tasks_html(state: State, with_run: bool, with_labels: bool) -> Element | None:
    """What the page is for: only what it can be for here."""
    tasks = {"explain": "Explain"} | ({"evaluate": "Evaluate"} if with_run else {})
    tasks |= {"label": "Label"} if with_labels else {}
    return segments("task", tasks, state.task, "What the page is for") if len(tasks) > 1 else None


def tools_html() -> Element:
    """What one may want to keep or change, in one menu."""
    items = (
        h.button(name, h.small(hint), title=hint, role="menuitem", id=f"tool-{key}", **how)
        for key, name, hint, how in TOOLS
    )
    return h.details(
        h.summary("⋯", aria_label="Tools", title="share, keep, look"), h.div(items, role="menu"), cls="menu"
    )


def problem_html(state: State) -> Element | None:
    """Why the frame cannot be shown."""
    return note(f"This frame is broken: {state.problem}", BAD) if state.problem else None


def refusal_html(state: State) -> Element | None:
    """Beside the field: why the question could not be asked, and what is in this frame."""
    if not state.error:
        return None
    names = sorted({o.label for o in state.shown.objects})
    there = h.p("In this frame: ", ", ".join(names)) if names else None
    close = h.button("×", cls="close", local="dismiss", aria_label="close", title="close")
    return h.div(note(state.error, BAD), close, there, cls="refusal", role="alert")
