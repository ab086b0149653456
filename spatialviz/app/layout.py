"""Where everything stands on the page, made once for each client."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import viser

from spatialviz.app.bridge import Bridge
from spatialviz.app.left import keep_html

LEFT_WIDTH, RIGHT_WIDTH = 304, 372


LISTED_FRAMES = 1000
"""A list of more frames would be slow to open; around the current one are enough to pick from."""


def listed(ids: Sequence[str], current: str) -> tuple[str, ...]:
    """The frames that the dropdown offers."""
    if len(ids) <= LISTED_FRAMES:
        return tuple(ids)
    start = max(0, min(ids.index(current) - LISTED_FRAMES // 2, len(ids) - LISTED_FRAMES))
    return tuple(ids[start : start + LISTED_FRAMES])


@dataclass(frozen=True)
class Page:
    """Handles of everything that changes."""

    dataset: viser.GuiDropdownHandle[str]
    frame: viser.GuiDropdownHandle[str]
    expression: viser.GuiTextHandle | viser.GuiInputHandle[str]
    ask: viser.GuiButtonHandle
    form: viser.GuiFormHandle
    steps: viser.GuiHtmlHandle
    parse: viser.GuiHtmlHandle
    modules: viser.GuiHtmlHandle
    controls: viser.GuiHtmlHandle
    objects: viser.GuiHtmlHandle
    answer: viser.GuiHtmlHandle
    pairs: viser.GuiHtmlHandle
    relations: viser.GuiHtmlHandle
    why: viser.GuiHtmlHandle
    object: viser.GuiHtmlHandle
    image: viser.GuiHtmlHandle
    search: viser.GuiHtmlHandle
    offers: viser.GuiHtmlHandle
    listing: viser.GuiHtmlHandle
    run_summary: viser.GuiHtmlHandle
    run_slices: viser.GuiHtmlHandle
    run_confusion: viser.GuiHtmlHandle
    cost: viser.GuiHtmlHandle
    edit: viser.GuiHtmlHandle
    frames: viser.GuiHtmlHandle
    log: viser.GuiHtmlHandle
    review_head: viser.GuiHtmlHandle | None = None
    review_item: viser.GuiHtmlHandle | None = None
    review_pair: viser.GuiHtmlHandle | None = None
    review_list: viser.GuiHtmlHandle | None = None
    review_train: viser.GuiHtmlHandle | None = None
    agreement: viser.GuiHtmlHandle | None = None


def build(
    client: viser.ClientHandle,
    bridge: Bridge,
    datasets: Sequence[str],
    dataset: str,
    frame_ids: Sequence[str],
    with_run: bool = False,
    with_labels: bool = False,
    with_second: bool = False,
) -> Page:
    """Build the page of one client."""
    gui = client.gui
    gui.set_panel_label("spatialviz")
    bridge.install()
    dataset_box = gui.add_dropdown("Dataset", tuple(datasets), initial_value=dataset, visible=len(datasets) > 1)
    frame_box = gui.add_dropdown("Frame", listed(frame_ids, frame_ids[0]), initial_value=frame_ids[0])
    steps = gui.add_html("")
    form = gui.add_form(None)
    with form:
        expression = gui.add_text("Ask", "")
        ask = gui.add_button("Ask", icon=viser.Icon.PLAYER_PLAY)
    parse, modules, controls, objects = (gui.add_html("") for _ in range(4))
    gui.add_html(keep_html())
    gui.main_panel.dock_left()
    gui.main_panel.set_width(LEFT_WIDTH)

    upper, lower = gui.add_panel(), gui.add_panel()
    upper.dock_right()
    upper.set_width(RIGHT_WIDTH)
    lower.dock_below(upper)
    own: dict[str, tuple[viser.GuiHtmlHandle, ...]] = {}
    # Six names fit into one row only without pictures.
    with upper.add_tab("Answer", viser.Icon.TARGET_ARROW):
        answer, pairs, relations = (gui.add_html("") for _ in range(3))
    with upper.add_tab("Why", viser.Icon.HELP_CIRCLE):
        why = gui.add_html("")
    agreement = None
    if with_second:
        with upper.add_tab("Agree", viser.Icon.LAYERS_INTERSECT):
            agreement = gui.add_html("")
    review: tuple[viser.GuiHtmlHandle, ...] = ()
    if with_labels:
        with upper.add_tab("Review", viser.Icon.CHECKLIST):
            review = tuple(gui.add_html("") for _ in range(5))
    # The first tab is the one that is open: with a run, what failed in it.
    for name in ("Failures", "Run", "Image") if with_run else ("Image", "Failures", "Run"):
        with lower.add_tab(name):
            own[name] = tuple(gui.add_html("") for _ in range(2 if name == "Image" else 3))
    image, object_ = own["Image"]
    search, offers, listing = own["Failures"]
    run_summary, run_slices, run_confusion = own["Run"]
    with lower.add_tab("Edit"):
        cost, edit = gui.add_html(""), gui.add_html("")
    with lower.add_tab("Frames"):
        frames = gui.add_html("")
    with lower.add_tab("Log"):
        log = gui.add_html("")
    return Page(
        dataset_box, frame_box, expression, ask, form, steps, parse, modules, controls, objects,
        answer, pairs, relations, why, object_, image, search, offers, listing,
        run_summary, run_slices, run_confusion, cost, edit, frames, log, *review,
        agreement=agreement,
    )  # fmt: skip
