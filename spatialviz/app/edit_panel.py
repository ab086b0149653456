"""Edit tab: fields of the selected object, labelled or not, of the pair and of the settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.pipeline import Pipeline
from pipeline.corrections.object_card import FieldLine, ObjectCard
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.changes import each_edit
from pipeline.diagnosis.whatif.edit_words import PROFILE_SETTINGS, WEIGHTS
from pipeline.diagnosis.whatif.placement import BoxNumbers, box_numbers
from pipeline.geometry.palette import RGB, hex_color, palette
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.model import installed_networks
from pipeline.relations.relations import Profile
from spatialviz.app.markup import Child, Element, button, dot, h, heading, note, panel, segments, sign, slider, textbox
from spatialviz.app.state import State

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
    """Cost of the last answer, and the undo button."""
    edits = each_edit(state.edits)
    nothing = "nothing is edited" if state.trace is not None else "ask something: edits are of a question"
    cost = "" if state.edited is None else f" · recomputed in {state.edited.seconds * 1000:.1f} ms"
    said = (h.b(counted(len(edits), "edit")), cost) if edits else nothing
    undo = button("undo", "edit-undo", "take the last edit back (Ctrl+Z)", disabled=not undos)
    reset = button("reset all", "edit-reset", "take all edits back (0)", disabled=not edits)
    return panel(
        h.div("what if · nothing is saved", cls="mode"),
        h.div(h.span(said, cls="dim"), h.span(undo, reset, cls="chips"), cls="nav"),
    )


def edit_html(state: State, trace: Trace, source: Pipeline, editable: bool) -> Element:
    """All editable fields; `editable` includes the selected object."""
    return in_parts(
        handles=row("Handles", segments("edit-mode", MODES, state.mode, "Handles")),
        object=_object(state, trace, editable),
        pair=_pair(state),
        settings=_settings(state, trace, source),
        list=_list(state),
    )


def in_parts(**parts: Child) -> Element:
    """Panel of parts sent separately on change."""
    return panel(h.div(part, id=f"edit-{name}") for name, part in parts.items())


def row(label: str, *parts: Child, **more: object) -> Element:
    """Line of the panel with a label at the left."""
    return h.div(h.span(label, cls="label"), parts, cls="row", **more)


def _object(state: State, trace: Trace, editable: bool) -> Child:
    i = state.selected
    if i is None or i >= len(state.shown.objects):
        return heading("Object"), h.div("Select one: click its row, its pixels or its box.", cls="dim")
    entry = state.shown.objects[i]
    name = h.b(dot(state.color(i)), state.shown.names[i])
    if not editable:
        return heading(name), h.div("Not a candidate of this question: nothing depends on it.", cls="dim")
    hidden = f"#{entry.id}" in state.edits.hidden
    hide = button("show it again" if hidden else "hide it", "edit:hide", "as if it had not been found")
    head = heading(name, hide).with_(id="edit-name")
    if hidden:
        return head, h.div("Hidden: as if the detector had not found it.", cls="dim")
    box = entry.lifted.box
    numbers = None if box is None or state.loaded is None else box_numbers(box, state.loaded.context.viewer)
    return head, _box_rows(numbers, "edit", 2), _confidences(state, trace, i), _mask_row(state, entry.mask)


def _confidences(state: State, trace: Trace, i: int) -> Iterator[Element]:
    for number, (name, candidates) in enumerate(trace.candidates.items()):
        at = [k for k, place in enumerate(candidates.index.tolist()) if state.shown.place[place] == i]
        if at:
            yield _slider(
                f"confidence:{number}",
                f"P(· | {name})",
                float(candidates.scores[at[0]]),
                f"the detector's confidence that this is “{name}”",
            )


def _mask_row(state: State, mask: np.ndarray) -> Child:
    buttons = (
        (
            button(f"{pixels:+d} px".replace("-", "−"), f"edit:mask:grow:{pixels}", "grow or shrink its pixels")
            for pixels in GROWTHS
        ),
        button("labelled", "edit:mask:label", "the pixels of the label in place of its own")
        if isinstance(state.judged, Diagnosis)
        else None,
    )
    hint = "Shift and drag over the picture to put a rectangle in place of its pixels."
    size = f"{int(mask.sum()):,} pixels · Shift-drag in the picture: a rectangle"
    return row("Mask", h.div(buttons, cls="chips"), title=hint), h.div(size, cls="dim under-row", id="edit-pixels")


def _pair(state: State) -> Child:
    pair, trace = state.chosen, state.trace
    if pair is None or trace is None or pair.reference is None or pair.second_reference is not None:
        return None
    relation = trace.relation
    ends = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    a, b = (state.shown.place[k] for k in ends)
    names = [state.name_of(k) for k in ends]
    return heading("Chosen pair", f"{names[0]} {PHRASE[relation]} {names[1]}"), _slider(
        f"relation:{a}:{b}",
        f"P({PHRASE[relation]})",
        pair.p_relation,
        "the probability of the asked relation for this pair",
    )


def _settings(state: State, trace: Trace, source: Pipeline) -> Child:
    edits, config = state.edits, source.config
    rank, profile = replace(config.rank, **edits.rank), replace(Profile(), **edits.profile)
    detector = None
    if not trace.exact:
        fields = _setting("k", edits.k or config.k, "1"), _setting("min_score", edits.min_score or 0.0, "0.01")
        detector = row("OPM", h.div(fields, cls="fields"))
    weights = [_setting(name, getattr(rank, name), "0.1") for name in WEIGHTS]
    thresholds = [_setting(n, getattr(profile, n), "1" if "cone" in n else "0.01") for n in PROFILE_SETTINGS]
    scorers = {"own": f"own: {source.scorer.name}", "trained": "trained", "rule": "rule"}
    own = {n.stem: n.stem for n in installed_networks()}
    return (
        heading("Settings"),
        detector,
        row("PRM", h.div(weights, cls="fields")),
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
    """Number field; Enter or leaving sends "kind:value", and an invalid value is reset."""
    said = f"{value:g}" if digits is None else f"{value:.{digits}f}"
    return h.label(
        h.span(name),
        h.input(type="number", step=step, value=said, change=kind, id=f"field-{kind}"),
        cls="field",
        title=hint,
    )


def _slider(kind: str, label: str, value: float, hint: str) -> Element:
    """Probability slider; the answer follows the drag."""
    return h.label(
        h.span(label),
        slider(value, live=f"edit-live:{kind}", change=f"edit:{kind}"),
        h.output(f"{value:.2f}"),
        id=f"slide-{kind}",
        cls="slide",
        title=hint,
    )


LENGTH_DIGITS, TURN_DIGITS = 3, 1
FIELD_NAMES = {"label": "class", "status": "status", "mask": "mask", "bbox": "2D box", "box": "3D box"}
SOURCES = {
    "auto": ("auto", "idle", False),
    "human": ("", "good", True),
    "recomputed": ("recomputed", "#4c8dd6", True),
    "stale": ("stale", "doubt", True),
}
"""By source: word, colour of the mark, and filled or not."""


_FITS = h.div(
    button("fit to points", "box-fit", "the box that its cleaned points make (Shift+J)"),
    cls="chips beside",
)


def object_html(card: ObjectCard, name: str, color: RGB, named: bool, strip: Child = None) -> Element:
    """Fields of a labelled object and the strip of its frames; `named`: its class is named beside the question."""
    facts = [counted(card.points, "point"), *([] if card.distance is None else [f"{card.distance:.2f} m"])]
    asked = counted(card.expressions, "expression")
    counts = " ".join(f"{n} {state}" for state, n in card.states.items())
    added = f" · added by {card.added_by}" if card.added_by else ""
    return in_parts(
        head=(
            heading(h.b(dot(color), name), " · ".join(facts)),
            h.div(f"relations {counts} · in {asked}{added}", cls="dim"),
        ),
        label=None if named else row("Class", class_field(card.label)),
        concern=note(f"Not asked for: {card.concern}") if card.concern else None,
        box=h.div(
            _box_rows(card.numbers, box_command(card.frame, card.number), LENGTH_DIGITS, _FITS),
            h.div(f"Fitted {card.fit}.", cls="dim") if card.fit else None,
        ),
        strip=strip,
        sources=(heading("Where it comes from"), (_from(line, card) for line in card.fields)),
    )


def class_field(label: str) -> Element:
    """Text field of a class, with completions."""
    return textbox("Class", "Enter saves it, Tab completes it (Shift+O)", value=label, field="class")


def _box_rows(numbers: BoxNumbers | None, sends: str, digits: int, *more: Child) -> Child:
    """Number fields of a box, with further elements beside."""
    if numbers is None:
        return h.div("No 3D box: there is no depth in its pixels.", cls="dim")
    rows = []
    for kind, label in (("center", "Centre"), ("size", "Size")):
        cells = (
            field(
                f"{sends}:{kind}:{axis}",
                getattr(numbers, kind)[axis],
                hint=f"{word}, {unit}",
                step="0.01",
                name=word,
                digits=digits,
            )
            for axis, (word, unit) in enumerate(AXES[kind])
        )
        rows.append(row(label, h.div(cells, cls="fields")))
    turn = field(
        f"{sends}:yaw",
        numbers.yaw,
        hint="degrees, from right towards forward",
        step="1",
        name="yaw °",
        digits=TURN_DIGITS,
    )
    return rows, row("Turn", h.div(turn, more, cls="fields"))


def box_command(frame: str, number: int) -> str:
    """Command of an object's number fields; names the object, so that a later selection is left alone."""
    return "box-set:" + f"{frame}@{number}".replace(":", "_")


def _from(line: FieldLine, card: ObjectCard) -> Element:
    word, color, filled = SOURCES[line.origin.source]
    said = line.origin.author if line.origin.source == "human" else word
    when = line.origin.time
    more = "" if when is None or line.origin.source != "human" else when.astimezone().strftime(" %H:%M")
    hint = f"{line.origin}{': ' + line.origin.reason if line.origin.reason else ''}"
    if line.automatic is not None and line.automatic != line.text:
        hint += f"; the labeller had {line.automatic}"
    back = h.span()
    if line.settled:
        as_it_was = "as its points make it" if line.field == "box" else f"back to the labeller's: {line.automatic}"
        back = sign("↺", f"field-back:{line.field}", as_it_was, "x")
    return h.div(
        h.span(FIELD_NAMES[line.field]),
        h.span(_short(line, card), cls="v"),
        h.span(f"{said}{more}", cls="m", color=color, css={"--f": "var(--c)" if filled else "transparent"}),
        back,
        id=f"from-{line.field}",
        cls="from",
        title=hint,
    )


def _short(line: FieldLine, card: ObjectCard) -> str:
    match line.field, line.value:
        case "mask", value:
            return "the whole 2D box" if value is None else f"{card.mask_pixels:,} pixels"
        case "bbox", [x0, y0, x1, y1]:
            return f"{x0:.0f}, {y0:.0f}, {x1 - x0:.0f} × {y1 - y0:.0f} px"
        case "box", _:
            return "none" if card.numbers is None else " × ".join(f"{100 * s:.0f}" for s in card.numbers.size) + " cm"
        case "status", None if card.statuses:
            return ", ".join(f"{status} ({name})" for name, status in card.statuses.items())
    return line.text


def rejected_html(left_out: Mapping[int, Mapping[str, Any]]) -> Element | None:
    """Rejected objects, each with a restore button."""
    if not left_out:
        return None
    rows = (
        h.div(
            h.span(f"{row['label']} {number}"),
            button("bring back", f"object-back:{number}", "unreviewed again"),
            cls="gone",
        )
        for number, row in sorted(left_out.items())
    )
    return panel(heading(f"Rejected ({len(left_out)})"), rows)
