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
from spatialviz.app.edit_scene import map_colors
from spatialviz.app.state import State
from spatialviz.app.text import dot, heading, panel, safe, segments

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


def cost_html(state: State, undos: int) -> str:
    """What the last answer cost, and the way back."""
    edits = each_edit(state.edits)
    if not edits:
        said = "nothing is edited" if state.trace is not None else "ask something: edits are of a question"
    else:
        assert state.edited is not None or state.trace is None
        cost = "" if state.edited is None else f" · recomputed in {state.edited.seconds * 1000:.1f} ms"
        said = f"<b>{counted(len(edits), 'edit')}</b>{cost}"
    undo = button("undo", "sv('edit-undo')", "take the last edit back (Ctrl+Z)", bool(undos))
    reset = button("reset all", "sv('edit-reset')", "take all edits back (0)", bool(edits))
    return panel(
        f'<div class="mode">what if · nothing is saved</div><div class="nav"><span class="dim">{said}</span>'
        f'<span class="chips" style="flex:none">{undo}{reset}</span></div>'
    )


def edit_html(state: State, source: Pipeline, editable: bool, found: DecisionMap | None) -> str:
    """Everything that can be edited; `editable` says whether the selected object is among it."""
    if state.trace is None:
        return ""
    return panel(
        f'<div class="row"><label>Handles</label>{segments("edit-mode", MODES, state.mode)}</div>',
        _object(state, editable),
        _pair(state),
        _map(state, editable, found),
        _settings(state, source),
        _list(state),
    )


def _object(state: State, editable: bool) -> str:
    i = state.selected
    if i is None or i >= len(state.shown.objects):
        return heading("Object") + '<div class="dim">Select one: click its row, its pixels or its box.</div>'
    entry = state.shown.objects[i]
    color = palette(state.dark)[state.roles.get(i, "other")]
    name = f"<b>{dot(color)}{safe(state.shown.names[i])}</b>"
    if not editable:
        return heading(name) + '<div class="dim">Not a candidate of this question: nothing depends on it.</div>'
    hidden = f"#{entry.id}" in state.edits.hidden
    hide = button("show it again" if hidden else "hide it", "sv('edit:hide')", "as if it had not been found")
    head = heading(name, hide)
    if hidden:
        return head + '<div class="dim">Hidden: as if the detector had not found it.</div>'
    return head + _numbers(state, i) + _confidences(state, i) + _mask_row(state, entry.mask)


def _numbers(state: State, i: int) -> str:
    box = state.shown.objects[i].lifted.box
    if box is None or state.loaded is None:
        return '<div class="dim">No 3D box: there is no depth in its pixels.</div>'
    numbers = box_numbers(box, state.loaded.context.viewer)
    rows = []
    for kind, label in (("center", "Centre"), ("size", "Size")):
        cells = "".join(
            field(f"edit:{kind}:{axis}", getattr(numbers, kind)[axis], hint=f"{word}, {unit}", step="0.01", name=word)
            for axis, (word, unit) in enumerate(AXES[kind])
        )
        rows.append(f'<div class="row"><label>{label}</label><div class="fields">{cells}</div></div>')
    turn = field("edit:yaw", numbers.yaw, hint="degrees, from right towards forward", step="1", name="yaw °", digits=1)
    rows.append(f'<div class="row"><label>Turn</label><div class="fields">{turn}<span></span><span></span></div></div>')
    return "".join(rows)


def _confidences(state: State, i: int) -> str:
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
    return "".join(rows)


def _mask_row(state: State, mask: np.ndarray) -> str:
    buttons = [
        button(f"{pixels:+d} px".replace("-", "−"), f"sv('edit:mask:grow:{pixels}')", "grow or shrink its pixels")
        for pixels in GROWTHS
    ]
    if isinstance(state.judged, Diagnosis):
        buttons.append(button("labelled", "sv('edit:mask:label')", "the pixels of the label in place of its own"))
    if state.pair is not None and state.selected is not None and len(set(state.pair[:2]) - {state.selected}):
        other = state.shown.names[partners(state)[1]]
        hint = f"this one gets the pixels of {other}, and that one its own"
        buttons.append(button(f"⇄ {other}", "sv('edit:mask:swap')", hint))
    hint = "Shift and drag over the picture in the Image tab to put a rectangle in place of its pixels."
    return (
        f'<div class="row" title="{hint}"><label>Mask</label><div class="chips">{"".join(buttons)}</div></div>'
        f'<div class="dim" style="font-size:11px;padding-left:60px">{int(mask.sum()):,} pixels · Shift-drag in the '
        "picture: a rectangle</div>"
    )


def _pair(state: State) -> str:
    pair, trace = state.chosen, state.trace
    if pair is None or trace is None or pair.reference is None or pair.second_reference is not None:
        return ""
    relation = trace.relation
    ends = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    a, b = (state.shown.place[k] for k in ends)
    names = [safe(state.shown.names[k]) for k in (a, b)]
    return heading("Chosen pair", f"{names[0]} {PHRASE[relation]} {names[1]}") + _slider(
        f"relation:{a}:{b}", f"P({PHRASE[relation]})", pair.p_relation,
        "the probability of the asked relation for this pair",
    )  # fmt: skip


def _map(state: State, editable: bool, found: DecisionMap | None) -> str:
    label = "hide the map" if found is not None else "show it"
    name = "the selected object"
    if found is not None:
        name = state.named(found.key)
    elif editable and state.selected is not None:
        name = state.shown.names[state.selected]
    name = safe(name)
    hint = "colours the floor by the answer that would win if the object stood there"
    head = heading("Decision map", button(label, "sv('edit-map')", hint, found is not None or editable))
    if found is None:
        return head + f'<div class="dim">Which answer wins if {name} stands elsewhere.</div>'
    colors = map_colors(found)
    winners, counts = np.unique(found.winner, return_counts=True)
    rows = "".join(
        f"<span>{dot((int(colors[w][0]), int(colors[w][1]), int(colors[w][2])) if w >= 0 else (150, 150, 150))}"
        f"{safe(state.named(found.keys[w])) if w >= 0 else 'no pair'} {n / found.winner.size:.0%}"
        f' <span class="dim">{n:,} cells</span></span>'
        for n, w in sorted(zip(counts.tolist(), winners.tolist(), strict=True), reverse=True)
    )
    return (
        head
        + f'<div class="dim">Who wins where {name} stands; paler: by less. {found.seconds * 1000:.0f} ms</div>'
        + f'<div class="legend">{rows}</div>'
    )


def _settings(state: State, source: Pipeline) -> str:
    edits, config = state.edits, source.config
    rank, profile = replace(config.rank, **edits.rank), replace(Profile(), **edits.profile)
    fields = []
    if not state.trace or not state.trace.exact:
        for name, value, step in (("k", edits.k or config.k, "1"), ("min_score", edits.min_score or 0.0, "0.01")):
            fields.append(_setting(name, value, step))
    weights = [_setting(name, getattr(rank, name), "0.1") for name in WEIGHTS]
    thresholds = [_setting(n, getattr(profile, n), "1" if "cone" in n else "0.01") for n in PROFILE_SETTINGS]
    scorers = {"own": f"own: {safe(source.scorer.name)}", "trained": "trained", "rule": "rule"}
    own = {n.name: n.name for n in installed_networks()}
    aggregates = {"max": "best pair", "marginal": "sum of pairs"}
    installed = ""
    if own:
        installed = f'<div class="row"><label></label>{segments("edit:set:scorer", own, edits.scorer or "")}</div>'
    detector = f'<div class="row"><label>OPM</label><div class="fields">{"".join(fields)}<span></span></div></div>'
    return (
        heading("Settings")
        + (detector if fields else "")
        + f'<div class="row"><label>PRM</label><div class="fields">{"".join(weights)}</div></div>'
        + f'<div class="row"><label></label>{segments("edit:set:aggregate", aggregates, rank.aggregate)}</div>'
        + f'<div class="row"><label>SRM</label>{segments("edit:set:scorer", scorers, edits.scorer or "own")}</div>'
        + installed
        + f'<div class="row"><label>Rule</label><div class="fields four">{"".join(thresholds)}</div></div>'
    )


def _setting(name: str, value: float, step: str) -> str:
    label, hint = SETTING_NAMES[name]
    return field(f"edit:set:{name}", value, hint=hint, step=step, name=label, digits=None)


def _list(state: State) -> str:
    found = each_edit(state.edits, state.named)
    if not found:
        return ""
    color = hex_color(palette(state.dark)["edited"])
    rows = "".join(
        f'<div class="edit" style="--c:{color}"><span title="{safe(edit.text)}">{safe(edit.text)}</span>'
        f'<span class="try" data-id="{safe(edit.id)}" onclick="sv(\'edit-remove:\'+this.dataset.id)" '
        f'title="take this edit back">×</span></div>'
        for edit in found
    )
    return heading(f"Edits ({len(found)})") + rows


def button(label: str, click: str, hint: str, possible: bool = True) -> str:
    way = f'role="button" onclick="{safe(click)}"' if possible else 'aria-disabled="true"'
    return f'<span class="try" {way} title="{safe(hint)}">{safe(label)}</span>'


def field(kind: str, value: float, *, hint: str, step: str, name: str, digits: int | None = 2) -> str:
    """A number; Enter, or leaving it, sends "kind:value". One that is not taken falls back to what is."""
    said = f"{value:g}" if digits is None else f"{value:.{digits}f}"
    back = "const v=this.value;setTimeout(()=>{if(this.value===v)this.value=this.defaultValue},900)"
    return (
        f'<label class="field" title="{safe(hint)}"><i>{safe(name)}</i><input type="number" step="{step}" '
        f'data-of="{kind}" value="{said}" onchange="sv(\'{kind}:\'+this.value);{safe(back)}"></label>'
    )


def _slider(kind: str, label: str, value: float, hint: str) -> str:
    """A probability; the answer follows while it is dragged."""
    follow = (
        "this.style.setProperty('--v',this.value);this.nextElementSibling.textContent=(+this.value).toFixed(2);"
        f"svLive('edit-live:{kind}:'+this.value)"
    )
    done = f"svLive(null);sv('edit:{kind}:'+this.value)"
    return (
        f'<div class="slide" title="{safe(hint)}"><span>{safe(label)}</span>'
        f'<input type="range" min="0" max="1" step="0.01" value="{value:.4f}" style="--v:{value:.4f}" '
        f'oninput="{safe(follow)}" onchange="{safe(done)}"><b>{value:.2f}</b></div>'
    )
