"""The Edit tab: what can be changed of the selected object, of the chosen pair and of the settings, and what is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.changes import each_edit
from pipeline.diagnosis.whatif.decision_map import DecisionMap
from pipeline.diagnosis.whatif.placement import box_numbers
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.installed import installed_networks
from pipeline.relations.relations import Profile
from spatialviz.app.edit_messages import PROFILE_SETTINGS, WEIGHTS, partners
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.state import State
from spatialviz.app.text import button, dot, heading, panel, segments

MODES = {"off": "Off", "move": "Move", "turn": "Turn", "resize": "Resize"}
AXES = {
    "center": (("right", "m along the viewer's right"), ("forward", "m along the viewer's forward"), ("up", "m up")),
    "size": (("width", "m"), ("height", "m"), ("depth", "m")),
}
GROWTHS = (-4, -1, 1, 4)
SETTING_NAMES = {
    "k": ("K", "proposals of each name that go on"),
    "min_score": ("min. score", "detections below are dropped"),
    "target_weight": ("α target", "weight of log P(target)"),
    "reference_weight": ("β reference", "weight of log P(reference)"),
    "relation_weight": ("γ relation", "weight of log P(relation)"),
    "cone": ("cone °", "degrees off the axis up to which a direction holds"),
    "doubtful_cone": ("doubtful °", "degrees off the axis up to which it may hold"),
    "dead_zone": ("dead zone m", "centres nearer than this along the axis are in doubt"),
    "dead_zone_depth": ("in depth m", "the same along forward"),
}


def cost_html(state: State, undos: int) -> Element:
    """What the last answer cost, and the way back."""
    edits = each_edit(state.edits)
    said: Child
    if not edits:
        said = "nothing is edited" if state.trace is not None else "ask something: edits are of a question"
    else:
        assert state.edited is not None or state.trace is None
        cost = "" if state.edited is None else f" · recomputed in {state.edited.seconds * 1000:.1f} ms"
        said = h.b(counted(len(edits), "edit")), cost
    undo = button("undo", "edit-undo", "take the last edit back (Ctrl+Z)", disabled=not undos)
    reset = button("reset all", "edit-reset", "take all edits back (0)", disabled=not edits)
    return panel(
        h.div("what if · nothing is saved", cls="mode"),
        h.div(h.span(said, cls="dim"), h.span(undo, reset, cls="chips"), cls="nav"),
    )


def edit_html(state: State, source: Pipeline, editable: bool, found: DecisionMap | None) -> Element | None:
    """Everything that can be edited; `editable` says whether the selected object is among it."""
    if state.trace is None:
        return None
    return in_parts(
        handles=row("Handles", segments("edit-mode", MODES, state.mode, "Handles")),
        object=_object(state, editable),
        pair=_pair(state),
        map=_map(state, editable, found),
        settings=_settings(state, source),
        list=_list(state),
    )


def in_parts(**parts: Child) -> Element:
    """A panel of parts that are sent one by one when they change."""
    return panel(h.div(part, id=f"edit-{name}") for name, part in parts.items())


def row(label: str, *parts: Child, **more: object) -> Element:
    """A line of the panel under a name at its left."""
    return h.div(h.span(label, cls="label"), parts, cls="row", **more)


def _object(state: State, editable: bool) -> Child:
    i = state.selected
    if i is None or i >= len(state.shown.objects):
        return heading("Object"), h.div("Select one: click its row, its pixels or its box.", cls="dim")
    entry = state.shown.objects[i]
    name = h.b(dot(palette(state.dark)[state.roles.get(i, "other")]), state.shown.names[i])
    if not editable:
        return heading(name), h.div("Not a candidate of this question: nothing depends on it.", cls="dim")
    hidden = f"#{entry.id}" in state.edits.hidden
    hide = button("show it again" if hidden else "hide it", "edit:hide", "as if it had not been found")
    head = heading(name, hide)
    if hidden:
        return head, h.div("Hidden: as if the detector had not found it.", cls="dim")
    return head, _numbers(state, i), _confidences(state, i), _mask_row(state, entry.mask)


def _numbers(state: State, i: int) -> Child:
    box = state.shown.objects[i].lifted.box
    if box is None or state.loaded is None:
        return h.div("No 3D box: there is no depth in its pixels.", cls="dim")
    numbers = box_numbers(box, state.loaded.context.viewer)
    rows = []
    for kind, label in (("center", "Centre"), ("size", "Size")):
        cells = (
            field(f"edit:{kind}:{axis}", getattr(numbers, kind)[axis], hint=f"{word}, {unit}", step="0.01", name=word)
            for axis, (word, unit) in enumerate(AXES[kind])
        )
        rows.append(row(label, h.div(cells, cls="fields")))
    turn = field("edit:yaw", numbers.yaw, hint="degrees, from right towards forward", step="1", name="yaw °", digits=1)
    return rows, row("Turn", h.div(turn, cls="fields"))


def _confidences(state: State, i: int) -> Child:
    assert state.trace is not None
    rows = []
    for number, (name, candidates) in enumerate(state.trace.candidates.items()):
        at = [k for k, place in enumerate(candidates.index.tolist()) if state.shown.place[place] == i]
        if at:
            rows.append(
                _slider(
                    f"confidence:{number}", f"P(· | {name})", float(candidates.scores[at[0]]),
                    f"the detector's confidence that this is “{name}”",
                )
            )  # fmt: skip
    return rows


def _mask_row(state: State, mask: np.ndarray) -> Child:
    buttons = [
        button(f"{pixels:+d} px".replace("-", "−"), f"edit:mask:grow:{pixels}", "grow or shrink its pixels")
        for pixels in GROWTHS
    ]
    if isinstance(state.judged, Diagnosis):
        buttons.append(button("labelled", "edit:mask:label", "the pixels of the label in place of its own"))
    if state.pair is not None and state.selected is not None and len(set(state.pair[:2]) - {state.selected}):
        other = state.shown.names[partners(state)[1]]
        hint = f"this one gets the pixels of {other}, and that one its own"
        buttons.append(button(f"⇄ {other}", "edit:mask:swap", hint))
    hint = "Shift and drag over the picture in the Image tab to put a rectangle in place of its pixels."
    size = f"{int(mask.sum()):,} pixels · Shift-drag in the picture: a rectangle"
    return row("Mask", h.div(buttons, cls="chips"), title=hint), h.div(size, cls="dim under-row")


def _pair(state: State) -> Child:
    pair, trace = state.chosen, state.trace
    if pair is None or trace is None or pair.reference is None or pair.second_reference is not None:
        return None
    relation = trace.relation
    ends = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    a, b = (state.shown.place[k] for k in ends)
    return heading("Chosen pair", f"{state.shown.names[a]} {PHRASE[relation]} {state.shown.names[b]}"), _slider(
        f"relation:{a}:{b}", f"P({PHRASE[relation]})", pair.p_relation,
        "the probability of the asked relation for this pair",
    )  # fmt: skip


def _map(state: State, editable: bool, found: DecisionMap | None) -> Child:
    name = "the selected object"
    if found is not None:
        name = state.named(found.key)
    elif editable and state.selected is not None:
        name = state.shown.names[state.selected]
    hint = "colours the floor by the answer that would win if the object stood there"
    label = "hide the map" if found is not None else "show it"
    head = heading("Decision map", button(label, "edit-map", hint, disabled=found is None and not editable))
    if found is None:
        return head, h.div(f"Which answer wins if {name} stands elsewhere.", cls="dim")
    said = f"In the scene: who wins where {name} stands. {found.winner.size:,} cells, {found.seconds * 1000:.0f} ms"
    return head, h.div(said, cls="dim")


def _settings(state: State, source: Pipeline) -> Child:
    edits, config = state.edits, source.config
    rank, profile = replace(config.rank, **edits.rank), replace(Profile(), **edits.profile)
    detector = None
    if not state.trace or not state.trace.exact:
        fields = _setting("k", edits.k or config.k, "1"), _setting("min_score", edits.min_score or 0.0, "0.01")
        detector = row("OPM", h.div(fields, cls="fields"))
    weights = [_setting(name, getattr(rank, name), "0.1") for name in WEIGHTS]
    thresholds = [_setting(n, getattr(profile, n), "1" if "cone" in n else "0.01") for n in PROFILE_SETTINGS]
    scorers = {"own": f"own: {source.scorer.name}", "trained": "trained", "rule": "rule"}
    own = {n.name: n.name for n in installed_networks()}
    aggregates = {"max": "best pair", "marginal": "sum of pairs"}
    return (
        heading("Settings"),
        detector,
        row("PRM", h.div(weights, cls="fields")),
        row("", segments("edit:set:aggregate", aggregates, rank.aggregate, "The best pair, or the sum of pairs")),
        row("SRM", segments("edit:set:scorer", scorers, edits.scorer or "own", "Relation scorer")),
        row("", segments("edit:set:scorer", own, edits.scorer or "", "Installed networks")) if own else None,
        row("Rule", h.div(thresholds, cls="fields four")),
    )


def _setting(name: str, value: float, step: str) -> Element:
    label, hint = SETTING_NAMES[name]
    return field(f"edit:set:{name}", value, hint=hint, step=step, name=label, digits=None)


def _list(state: State) -> Child:
    found = each_edit(state.edits, state.named)
    if not found:
        return None
    color = hex_color(palette(state.dark)["edited"])
    rows = (
        h.div(
            h.span(edit.text, title=edit.text),
            button("×", f"edit-remove:{edit.id}", "take this edit back", aria_label=f"take back: {edit.text}"),
            cls="edit",
            css={"--c": color},
        )
        for edit in found
    )
    return heading(f"Edits ({len(found)})"), rows


def field(kind: str, value: float, *, hint: str, step: str, name: str, digits: int | None = 2) -> Element:
    """A number; Enter, or leaving it, sends "kind:value". One that is not taken falls back to what is."""
    said = f"{value:g}" if digits is None else f"{value:.{digits}f}"
    return h.label(
        h.span(name),
        h.input(type="number", step=step, value=said, change=kind),
        id=f"field-{kind}",
        cls="field",
        title=hint,
    )


def _slider(kind: str, label: str, value: float, hint: str) -> Element:
    """A probability; the answer follows while it is dragged."""
    shown = f"{value:.4f}"
    return h.label(
        h.span(label),
        h.input(
            type="range", min=0, max=1, step="0.01", value=shown, css={"--v": shown},
            live=f"edit-live:{kind}", change=f"edit:{kind}",
        ),
        h.output(f"{value:.2f}"),
        id=f"slide-{kind}",
        cls="slide",
        title=hint,
    )  # fmt: skip
