"""Toolbar around the scene and the answer: Ask with suggestions, tools, steps, source of up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from pipeline.datasets.settings import ASSUMED, SOURCES
from pipeline.diagnosis.story_words import capital
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.geometry.camera import UpSource
from pipeline.language.relation_names import PHRASE
from spatialviz.app.keys import KEYS, MOVE_KEYS
from spatialviz.app.markup import Element, button, h, hint_of, note, panel, segments, slider, toggle
from spatialviz.app.state import State

COLORS = {"rgb": "Colour", "objects": "Objects", "depth": "Depth", "evidence": "Cleaning"}
CAMERAS = {"pair": "Pair", "sensor": "Camera", "top": "Top"}
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
    "pairs": "pair lines",
    "ghosts": "labelled",
    "truth": "exact boxes",
    "axes": "axes",
    "region": "region",
    "context": "room",
    "camera": "cameras",
    "grid": "metre grid",
    "dim": "dim the rest",
}
HINTS = {message: f"{label} ({key})" for key, label, message in KEYS["Looking"]}
LEAST_POINT, LARGEST_POINT = 0.4, 4.0
"""Least and largest factor of point size."""


def scene_tools_html(state: State) -> list[Element]:
    """Viewpoints, and the menu of what is shown in the scene."""
    flags = asdict(state.flags)
    exact = state.loaded is not None and any(a.box is not None for a in state.loaded.context.frame.annotations)
    toggles = (
        toggle(label, f"flag:{key}", flags[key], hint_of(label, HINTS.get(f"flag:{key}", "")), cls="toggle")
        for key, label in FLAGS.items()
        if key != "truth" or exact
    )
    size = {"live": "point-size", "id": "point-size", "title": "how large points are drawn (- and =)"}
    menu = h.div(
        segments("color", COLORS, state.colors, "paint"),
        h.div(toggles, cls="toggles", role="group", aria_label="shown in the scene"),
        h.label("points", slider(state.point_size, LEAST_POINT, LARGEST_POINT, "0.05", **size), cls="points"),
    )
    return [
        segments("camera", CAMERAS, state.camera, "look from"),
        h.details(h.summary("Show"), menu, cls="menu stays", id="show"),
    ]


def scene_buttons_html(state: State) -> list[Element]:
    """Buttons at the lower edge of the scene."""
    metres = "metres between two surfaces that you click, here or in the picture (Shift+D; Escape ends)"
    drawn = "outline something on the picture (Shift+N; Shift-drag on the picture)"
    edit, change = ("What if", ", and see the answer") if state.labels is None else ("Edit", "")
    change, objects = f"change a box, a score or a setting{change}", f"Objects {len(state.shown.objects)}"
    return [
        button("Measure", "pick:measure", metres, aria_pressed=state.picking == "measure"),
        *([] if state.labels is None else [button("New object", "px-new", drawn)]),
        h.button(edit, cls="try", local="tab:Edit", title=change),
        h.button(objects, cls="try", local="tab:Objects", title="all objects of this frame"),
    ]


def moves_html(leads: Mapping[str, str]) -> Element:
    """Moves of the robot from here: frames by possible move."""
    return h.div((_move(leads, *key) for key in MOVE_KEYS), cls="moves")


def _move(leads: Mapping[str, str], key: str, label: str, message: str) -> Element:
    """Move button, placed as on the keyboard; disabled for an impossible move."""
    move = message.removeprefix("move:")
    mark, word = MOVE_MARKS[move]
    hint = f"{label} ({key}): {leads.get(move, 'there is no picture')}"
    return h.button(h.i(mark), word, do=message, title=hint, id=f"move-{move}", disabled=move not in leads)


def suggestions_html(state: State, suggestions: Sequence[str]) -> Element | None:
    """Suggested questions on the frame; None without any."""
    if state.loaded is not None and state.labels is None and state.loaded.context.viewer.up_source == "assumed":
        return panel(h.p("No example: it would rest on an assumed up.", cls="dim"))
    judged = state.judged
    rows = [h.li(button(t, f"try:{i}", cls="on" if t == state.text else "")) for i, t in enumerate(suggestions)]
    if isinstance(judged, Diagnosis) and judged.verdict == "PARSE" and judged.case.relation in PHRASE:
        # What was meant comes first.
        meant = f"{judged.case.target} {PHRASE[judged.case.relation]} the {judged.case.reference}"
        rows.insert(0, h.li(button(meant, f"ask:{meant}", "what was meant", "go")))
    return panel(h.ul(rows, cls="suggestions")) if rows else None


def where_html(state: State, sources: Sequence[str]) -> Element:
    """Name of the dataset, or the choice of one."""
    if len(sources) < 2:
        return h.span(state.source, cls="dataset")
    options = (h.option(name, value=name, selected=name == state.source) for name in sources)
    return h.select(options, aria_label="Dataset", change="data:")


TASK_HINTS = {
    "explain": "one answer, and why it is correct or wrong",
    "evaluate": "all answers of a run: which fail, and where the accuracy goes",
    "label": "review and correct labels, one item at a time",
}


def tasks_html(state: State, with_labels: bool) -> Element:
    """Available tasks of the page; without a run, Evaluate says how one is made."""
    tasks = {name: name.capitalize() for name in TASK_HINTS if name != "label" or with_labels}
    return segments("task", tasks, state.task, "What the page is for", TASK_HINTS)


PICK = "Click a level surface, a floor or a table-top, in the picture or in the scene. Shift+U leaves it as it is."
MADE_WITH = "The labels were made with it."
HOW = "Click here (Shift+U), then a surface that is level: up is then known."


def up_chip(state: State) -> Element | None:
    """Doubt of an assumed or implausible up, or one that was said. A click asks for a level surface."""
    # Shown labels have the up of their making, unchanged by clicks.
    if state.loaded is None:
        return None
    labels, viewer = state.labels, state.loaded.context.viewer
    source: UpSource | None = viewer.up_source if labels is None else labels.frame.row["up_source"]
    doubt = viewer.up_doubt if viewer.up_source == source else ""
    loud = source == "assumed" or bool(doubt)
    if source is None or not (loud or state.loaded.up_hint is not None):
        return None
    said = capital(ASSUMED) if source == "assumed" else f"Up: {SOURCES[source]}"
    said += f". It may be wrong: {doubt}." if doubt else "."
    look = {"cls": f"upchip{' loud' * loud}", "color": "doubt" if loud else "idle"}
    if labels is not None:
        return h.span(f"up {source}", title=f"{hint_of('up')} {said} {MADE_WITH}", **look)
    look["title"], pressed = f"{hint_of('up')} {said} {HOW}", state.picking == "level"
    return h.button(f"up {source}", do="pick:level", aria_pressed=pressed, **look)


def depth_chip(state: State) -> Element | None:
    """Warning of estimated or implausible depth; None for measured depth plausible in a room."""
    if state.loaded is None:
        return None
    source, doubt = state.loaded.context.frame.depth_source, capital(state.loaded.doubt)
    title = f"The depth is {source}." if source else doubt
    kind = "estimated" if source else "odd"
    return h.span(f"depth {kind}", cls="upchip loud", color="doubt", title=title) if title else None


def level_html(state: State) -> Element | None:
    """Instructions for clicking a level surface; afterwards, for saving up."""
    if state.picking == "level":
        return note(PICK)
    loaded = state.loaded
    if loaded is None or loaded.up_hint is None or loaded.context.viewer.up_source != "given":
        return None
    return h.div(
        "Up as you said, until the program ends; it is said again by ",
        h.code(f"--level-at {loaded.up_hint.words}"),
        " ",
        button("save", "level-keep", "keep it in spatialviz.toml beside the data"),
        " ",
        button("take back", "level-back", "as it was before"),
        cls="dim uptold",
    )
