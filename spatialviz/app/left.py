"""The left dock: what the expression was read as, how each module fared, what is shown, the objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from pipeline.answering.ask import Trace
from pipeline.answering.asked_names import taken_as, unused_words
from pipeline.answering.json_records import why_no_answer
from pipeline.answering.pair_table import HOLDS
from pipeline.diagnosis.verdict import MODULE_OF, Diagnosis
from pipeline.geometry.palette import DROPPED, VERDICTS, hex_color, palette
from pipeline.language.counted import counted
from spatialviz.app.beside_html import layers_html
from spatialviz.app.keys import MOVE_KEYS
from spatialviz.app.state import State
from spatialviz.app.text import BAD, DOUBT, GOOD, IDLE, dot, heading, note, panel, safe, segments, words

COLORS = {"rgb": "Colour", "objects": "Objects", "depth": "Depth", "evidence": "Cleaning"}
CAMERAS = {"sensor": "Sensor", "orbit": "Orbit", "top": "Top"}
MOVE_MARKS = {
    "rotate_ccw": ("↶", "turn left"),
    "forward": ("↑", "forward"),
    "rotate_cw": ("↷", "turn right"),
    "left": ("←", "left"),
    "backward": ("↓", "back"),
    "right": ("→", "right"),
}
SHOW_SELECTED = (
    "const s=this.parentElement.querySelector('.scroll'),r=s&&s.querySelector('tr.sel');"
    "if(r&&(r.offsetTop<s.scrollTop||r.offsetTop+r.offsetHeight>s.scrollTop+s.clientHeight))"
    "s.scrollTop=r.offsetTop-s.clientHeight/2"
)
"""Scrolls the list of objects to the selected one; an update of the list begins at its top again."""
ROLE_ORDER = {"target": 0, "reference": 1, "other": 2}
FLAGS = {
    "cloud": "cloud",
    "boxes": "boxes",
    "labels": "all names",
    "pairs": "pairs",
    "ghosts": "labelled",
    "truth": "exact boxes",
    "axes": "axes",
    "region": "region",
    "context": "room",
    "camera": "camera",
}


def frame_html(place: int, count: int, leads: Mapping[str, str] | None = None) -> str:
    """Which frame of how many, with steps to its neighbours; below it the moves of a dataset that has moves."""
    return panel(
        f'<div class="nav">{_step(-1, "‹ previous", "previous frame (P)", place > 0)}'
        f'<span class="dim">{place + 1} of {count}</span>'
        f"{_step(1, 'next ›', 'next frame (N)', place + 1 < count)}</div>",
        "" if leads is None else _moves_html(leads),
    )


def _step(by: int, label: str, hint: str, possible: bool) -> str:
    way = f'role="button" onclick="sv(\'next-frame:{by}\')"' if possible else 'aria-disabled="true"'
    return f'<span class="try" {way} title="{hint}">{label}</span>'


def _moves_html(leads: Mapping[str, str]) -> str:
    """Six buttons in two rows as the keys lie; a move that is not possible cannot be pressed."""
    cells = []
    for key, label, message in MOVE_KEYS:
        move = message.partition(":")[2]
        mark, word = MOVE_MARKS[move]
        hint = f"{label} ({key}): {leads.get(move, 'there is no picture')}"
        way = f'class="on" role="button" onclick="sv(\'{message}\')"' if move in leads else 'aria-disabled="true"'
        cells.append(f'<span {way} title="{safe(hint)}"><i>{mark}</i>{word}</span>')
    return f'<div class="moves">{"".join(cells)}</div>'


def parse_html(state: State, suggestions: Sequence[str]) -> str:
    """How the expression was read, as chips; its error; or what one could ask."""
    parts = []
    if state.problem:
        parts.append(note(f"This frame is broken: {state.problem}", BAD))
    if state.error:
        parts.append(note(state.error, BAD))
    elif state.trace is not None:
        parts.append(_chips(state, state.trace))
        if len(state.trace.query.readings) > 1 and state.trace.ranking is not None:
            ranking = state.trace.ranking
            for reading, score in zip(state.trace.query.readings, ranking.reading_scores, strict=True):
                taken = reading is ranking.reading
                style = "font-weight:600" if taken else "opacity:.7"
                parts.append(
                    f'<div style="padding-top:3px;{style}" title="best score {score:.2f}">'
                    f'<span class="dim">{"read as" if taken else "or"}</span> {safe(reading.description)}</div>'
                )
        expression = state.trace.query.expression
        notes = [expression.note] if expression is not None and expression.note else []
        labels = {label: c.labels for label, c in state.trace.candidates.items()}
        notes += [f"“{text}” taken as {meant.name}" for text, meant in taken_as(state.trace.query, labels)]
        notes += [f"not used: “{words}”: {why}" for words, why in unused_words(state.trace.query)]
        parts += [f'<div class="dim" style="padding-top:3px">{safe(note)}</div>' for note in notes]
    if state.loaded is not None and state.labels is None and state.loaded.context.viewer.up_source == "assumed":
        parts.append('<div class="dim" style="padding-top:4px">No example: it would rest on an assumed up.</div>')
    if suggestions:
        tries = "".join(
            f'<span class="try{" on" if text == state.text else ""}" onclick="sv(\'try:{i}\')">{safe(text)}</span>'
            for i, text in enumerate(suggestions)
        )
        parts.append(f'<div class="chips" style="padding-top:6px">{tries}</div>')
    return panel(*parts, style="padding-top:.2em")


def _chips(state: State, trace: Trace) -> str:
    colors = palette(state.dark)
    parts = []
    for span in trace.query.spans:
        said = safe(trace.query.text[span.start : span.end])
        if span.role in ("relation", "attribute", "choice"):
            parts.append(f'<span class="chip rel" title="{span.role}">{said}</span>')
        elif span.role == "unused":
            parts.append(
                f'<span class="chip rel" style="opacity:.55" title="not used: {safe(span.note)}"><s>{said}</s></span>'
            )
        elif span.role in ("target", "reference"):
            color = hex_color(colors["target" if span.role == "target" else "reference"])
            click = f"sv('chip:{span.role}')"
            parts.append(f'<span class="chip" style="--c:{color};cursor:pointer" onclick="{click}">{said}</span>')
    return f'<div class="chips">{"".join(parts)}</div>'


def modules_html(state: State, working: str = "") -> str:
    """The module strip: OPM, LIFT, ATTRIBUTE where one is asked, SRM, PRM and LABEL with their state and cost.

    `working` says what is being done now; it is seen from 0.15 s on, so that quick work does not flicker.
    """
    cells = "".join(
        f'<div class="mod" style="--c:{color}" title="{safe(hint)}"><b>{name[:5]}</b><i>{safe(cost)}</i></div>'
        for name, color, cost, hint in _modules(state)
    )
    strip = f'<div class="strip">{cells}</div>'
    return panel(f'<div class="busy">{strip}<span role="status">{safe(working)}</span></div>' if working else strip)


def _modules(state: State) -> list[tuple[str, str, str, str]]:
    trace = state.trace
    annotated = 0 if state.loaded is None else len(state.loaded.context.frame.annotations)
    label = (
        ("LABEL", GOOD, f"{annotated} known", f"the dataset annotates {counted(annotated, 'object')} in this frame")
        if annotated
        else ("LABEL", IDLE, "none", "the dataset annotates nothing in this frame")
    )
    if trace is None:
        return [(n, IDLE, "–", "no question asked yet") for n in ("OPM", "LIFT", "SRM", "PRM")] + [label]

    def ms(stage: str) -> str:
        value = trace.timings.get(stage, 0.0) * 1000
        return f"{value:.1f} ms" if value < 100 else f"{value:.0f} ms"

    counts = ", ".join(f"{len(c.index)} for “{n}”" for n, c in trace.candidates.items())
    opm = ("OPM", BAD if trace.missing else GOOD, ms("opm"), f"{trace.detector}: {counts}")
    answered = why_no_answer(trace) is None
    concerns = [
        f"{state.shown.names[i]}: {c}"
        for i in (state.roles or {})
        for c in state.shown.objects[i].lifted.quality.concerns
    ]
    assumed = ["the up vector is assumed to be image-up"] if trace.viewer.up_source == "assumed" else []
    doubts = concerns + assumed
    # An object that was lifted for an earlier question costs nothing now.
    cost = ms("lift") if trace.timings.get("lift", 0.0) > 1e-4 else "kept"
    lifted = "; ".join(doubts) or f"{counted(len(trace.objects), 'object')} lifted"
    lift = ("LIFT", DOUBT if doubts else GOOD, cost, lifted)
    chosen = state.chosen
    weak = chosen is not None and not chosen.holds
    doubtful = chosen is not None and abs(chosen.relation_probability - HOLDS) < 0.1
    srm_hint = f"relations by {trace.scorer}"
    if chosen is not None:
        srm_hint += f"; the asked relation has {chosen.p_relation:.2f} for the chosen pair"
    srm = ("SRM", DOUBT if weak or doubtful else GOOD if trace.objects else IDLE, ms("srm"), srm_hint)
    if not answered or trace.ranking is None:
        prm = ("PRM", IDLE if trace.missing else BAD, ms("prm"), why_no_answer(trace) or "")
    else:
        close = len(trace.ranking.pairs) > 1 and trace.ranking.margin < 0.1
        hint = f"{counted(len(trace.ranking.pairs), 'pair')}, margin {trace.ranking.margin:.2f} to the runner-up"
        prm = ("PRM", DOUBT if close else GOOD, ms("prm"), hint)
    seen = [f for f in (() if chosen is None else chosen.factors) if f.kind == "attribute"]
    attribute = [
        ("ATTRIBUTE", GOOD if f.holds else DOUBT, f"{f.probability:.2f}", f"{f.text}: {f.probability:.2f}")
        for f in sorted(seen, key=lambda f: f.probability)[:1]
    ]
    return [_blamed(cell, state) for cell in (opm, lift, *attribute, srm, prm, label)]


def _blamed(cell: tuple[str, str, str, str], state: State) -> tuple[str, str, str, str]:
    """The cell of a module as the verdict has it: the module that failed stands out, and what did not fail is fine."""
    if not isinstance(state.judged, Diagnosis):
        return cell
    name, _, cost, hint = cell
    d = state.judged
    blamed = {MODULE_OF[d.verdict]} if d.verdict in MODULE_OF else set()
    if d.verdict == "COMPOUND":
        blamed = {"OPM" if part in ("CONF", "RECALL") else part for part in d.repair}
    if name in blamed:
        said = (d.detail or d.verdict.removeprefix("OPM-")).lower()
        said = "at fault" if said == name.lower() else said
        return name, hex_color(VERDICTS[d.verdict]), said, f"{state.judged.text} ({cost}; {hint})"
    return (name, GOOD, cost, hint) if d.correct and name != "LABEL" else cell


def controls_html(state: State) -> str:
    """How the scene is coloured, seen from where, and what is shown in it."""
    flags = asdict(state.flags)
    exact = state.loaded is not None and any(a.box is not None for a in state.loaded.context.frame.annotations)
    toggles = "".join(
        f'<span class="{"on" if flags[key] else ""}" onclick="sv(\'flag:{key}\')">{label}</span>'
        for key, label in FLAGS.items()
        if key != "truth" or exact
    )
    legend = ""
    if state.colors == "evidence":
        legend = '<div class="legend" style="padding:0 0 4px 60px">' + "".join(
            f"<span>{dot(color)}{words(reason)}</span>" for reason, color in DROPPED.items()
        )
        legend += "</div>"
    return panel(
        f'<div class="row"><label>Paint</label>{segments("color", COLORS, state.colors)}</div>{legend}',
        f'<div class="row"><label>From</label>{segments("camera", CAMERAS, state.camera)}</div>',
        layers_html(state),
        f'<div class="row"><label>Show</label><div class="tog">{toggles}</div></div>',
        style="padding-top:.3em",
    )


def keep_html() -> str:
    """Buttons for what one may want to keep."""
    ways = (
        ("copy-state", "Copy view", "the view as a string, into the clipboard (Shift+C)"),
        ("paste-state", "Paste view", "open a view from its string (Shift+V)"),
        ("keep-case", "Save case", "a folder that `spatialviz replay` runs again (Shift+K)"),
        ("report", "Report", "one page of this answer, as a download (Shift+P)"),
    )
    cells = "".join(
        f'<span class="try" role="button" onclick="sv(\'{message}\')" title="{safe(hint)}">{label}</span>'
        for message, label, hint in ways
    )
    return panel(f'<div class="keep">{cells}</div>')


def objects_html(state: State, moving: bool = False) -> str:
    """The list of objects with their pictures, sizes and scores; `moving` leaves room for the buttons of the moves."""
    if state.loaded is None:
        return ""
    if not state.shown.objects:
        reason = state.loaded.problem or "Nothing is annotated or detected in this frame."
        return panel(heading("Objects"), note(reason))
    colors, roles = palette(state.dark), state.roles
    rows = []
    order = sorted(range(len(state.shown.objects)), key=lambda i: ROLE_ORDER[roles.get(i, "other")])
    for i in order:
        entry = state.shown.objects[i]
        box, quality = entry.lifted.box, entry.lifted.quality
        size = "no depth" if box is None else " × ".join(f"{s * 100:.0f}" for s in box.size) + " cm"
        away = "" if box is None else f"{quality.distance:.1f} m"
        doubts = safe("; ".join(quality.concerns))
        mark = f'<span class="low" title="{doubts}">!</span>' if doubts else ""
        score = "" if entry.score >= 0.9995 else f"{entry.score:.2f}"
        name = f'<span class="name">{dot(colors[roles.get(i, "other")])}<b>{safe(state.shown.names[i])}</b></span>'
        rows.append(
            f'<tr class="r{" sel" if i == state.selected else ""}" onclick="sv(\'object:{i}\')">'
            f'<td style="width:42px"><img class="thumb" src="{state.loaded.thumb(entry.bbox)}"></td>'
            f'<td class="w">{name}<div class="dim" style="font-size:11px">{size}</div></td>'
            f'<td class="n dim">{away}</td><td class="n">{score} {mark}</td></tr>'
        )
    height = 626 if moving else 566
    # The legend of the cleaned pixels stands above.
    height += 44 if state.colors == "evidence" else 0
    height += 0 if state.beside is None else 26
    return panel(
        heading(f"Objects{' of A' if state.beside else ''} ({len(rows)})"),
        f'<div class="scroll" style="--mh:max(150px, calc(100vh - {height}px))"><table>{"".join(rows)}</table></div>',
        f'<img src="" style="display:none" onerror="{safe(SHOW_SELECTED)}">',
        '<div class="dim" style="font-size:11px;padding-top:5px"><kbd>/</kbd> ask &nbsp;<kbd>J</kbd> <kbd>K</kbd> pair'
        " &nbsp;<kbd>N</kbd> <kbd>P</kbd> frame &nbsp;<kbd>?</kbd> all keys</div>",
    )
