"""The Edit tab while labels are shown: all of the selected labelled object, saved as it is changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.corrections.object_card import FieldLine, ObjectCard
from pipeline.corrections.scene import Moved
from pipeline.diagnosis.whatif.placement import BoxNumbers
from pipeline.geometry.palette import RGB
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import letter
from spatialviz.app.edit_panel import AXES, MODES, button, field
from spatialviz.app.text import BAD, DOUBT, GOOD, dot, heading, note, panel, safe, segments

STATUS_WORDS = {
    "accepted": ("accept", GOOD, "Y"), "unsure": ("unsure", DOUBT, "Shift+U"),
    "rejected": ("reject", BAD, "Shift+Y"),
}  # fmt: skip
LENGTH_DIGITS, TURN_DIGITS = 3, 1
FIELD_NAMES = {"label": "class", "status": "status", "mask": "mask", "bbox": "2D box", "box": "3D box"}
SOURCES = {"auto": ("auto", "#8a919c", False), "human": ("", GOOD, True),
           "recomputed": ("recomputed", "#4c8dd6", True), "stale": ("stale", DOUBT, True)}  # fmt: skip
"""Of each source the word, the colour of its mark, and whether the mark is filled."""


def saved_html(author: str, said: str, bad: bool, moved: Moved | None) -> str:
    """That this is no what-if: under whose name edits are saved, and what came of the last one."""
    color, done = (BAD, "the last action was not saved; you are") if bad else (GOOD, "saved to the journal as")
    undo = button("undo", "sv('take-back')", "take the last action back (Ctrl+Z)")
    redo = button("redo", "sv('bring-back')", "bring it back (Ctrl+Y)")
    last = f'<div class="dim said2" title="{safe(said)}">{safe(said)}</div>' if said else ""
    if moved is not None:
        last = f'<div class="dim">{_moved(moved)}</div>'
    return panel(
        f'<div class="mode" style="--c:{color}">'
        f'<span class="said2">{done} <b>{safe(author)}</b></span>'
        f'<span class="chips" style="flex:none">{undo}{redo}</span></div>{last}'
    )


def _moved(moved: Moved) -> str:
    cost = f"{moved.seconds * 1000:.1f} ms"
    if moved.card is None:
        return "saved when it is let go"
    would = ", ".join(
        f"<b>{safe(PHRASE[line.relation])} {'none' if line.state is None else letter(line.state)}</b>"
        for line in moved.card.lines
        if line.relation in moved.changed
    )
    return f"{would or 'no relation of the pair changes'} · {cost}"


def object_html(card: ObjectCard, name: str, color: RGB, mode: str, author: str) -> str:
    """The selected object."""
    facts = [counted(card.points, "point"), *([] if card.distance is None else [f"{card.distance:.2f} m"])]
    asked = counted(card.expressions, "expression")
    counts = " ".join(f"{n} {state}" for state, n in card.states.items())
    concern = note(f"Not asked for: {card.concern}", DOUBT) if card.concern else ""
    added = f" · added by {safe(card.added_by)}" if card.added_by else ""
    return panel(
        heading(f"<b>{dot(color)}{safe(name)}</b>", " · ".join(facts)),
        f'<div class="dim" style="margin:-2px 0 5px">relations {counts} · in {asked}{added}</div>',
        _class_row(card),
        _status_row(card, author),
        concern,
        f'<div class="row" title="Shift+E"><label>Handles</label>{segments("edit-mode", MODES, mode)}</div>',
        f'<div class="tight">{_box_rows(card)}</div>',
        heading("Where it comes from"),
        "".join(_from(line, card) for line in card.fields),
        style="padding-bottom:.2em",
    )


def _class_row(card: ObjectCard) -> str:
    return (
        '<div class="row"><label>Class</label><div class="cls">'
        f'<input class="find" aria-label="Class" spellcheck="false" autocomplete="off" value="{safe(card.label)}" '
        'title="Enter saves it, Tab completes it (Shift+O)" oninput="svClassTyped(this)" '
        'onkeydown="svClassKey(event,this)" onblur="svClassLeft()"><div class="offers"></div></div></div>'
    )


def _status_row(card: ObjectCard, author: str) -> str:
    """What this person says of it; beside, what others do."""
    own = card.statuses.get(author)
    cells = "".join(
        f'<span class="{"go" if own == status else ""}" style="--c:{color}" title="{key}" '
        f"onclick=\"sv('object-status:{status}')\">{word}</span>"
        for status, (word, color, key) in STATUS_WORDS.items()
    )
    others = ", ".join(f"{name}: {status}" for name, status in card.statuses.items() if name != author)
    beside = f'<div class="dim" style="padding:0 0 4px 60px">{safe(others)}</div>' if others else ""
    return f'<div class="row"><label>Status</label><div class="seg">{cells}</div></div>{beside}'


def _box_rows(card: ObjectCard) -> str:
    if card.numbers is None:
        return '<div class="dim">No 3D box: there is no depth in its pixels.</div>'
    rows = []
    for kind, label in (("center", "Centre"), ("size", "Size")):
        cells = "".join(
            field(f"box-set:{kind}:{axis}", getattr(card.numbers, kind)[axis], hint=f"{word}, {unit}", step="0.01",
                  name=word[0], digits=LENGTH_DIGITS)
            for axis, (word, unit) in enumerate(AXES[kind])
        )  # fmt: skip
        rows.append(f'<div class="row"><label>{label}</label><div class="fields">{cells}</div></div>')
    turn = field("box-set:yaw", card.numbers.yaw, hint="degrees, from right towards forward", step="1", name="°",
                 digits=TURN_DIGITS)  # fmt: skip
    buttons = (
        button("fit to points", "sv('box-fit')", "the box that its cleaned points make (Shift+J)"),
        button("extend", "sv('box-snap:extend')", "its bottom to what the object stands on, its top stays (Shift+B)"),
        button("set down", "sv('box-snap:move')", "all of it to what the object stands on (Shift+Z)"),
    )
    beside = f'<div class="chips beside">{"".join(buttons)}</div>'
    rows.append(f'<div class="row"><label>Turn</label><div class="fields">{turn}{beside}</div></div>')
    return "".join(rows)


def numbers_said(numbers: BoxNumbers) -> dict[str, str]:
    """What the number fields say of a box, by what they send."""
    sides = {f"box-set:{kind}:{axis}": f"{getattr(numbers, kind)[axis]:.{LENGTH_DIGITS}f}"
             for kind in ("center", "size") for axis in range(3)}  # fmt: skip
    return {**sides, "box-set:yaw": f"{numbers.yaw:.{TURN_DIGITS}f}"}


def _from(line: FieldLine, card: ObjectCard) -> str:
    word, color, filled = SOURCES[line.origin.source]
    said = line.origin.author if line.origin.source == "human" else word
    when = line.origin.time
    more = "" if when is None or line.origin.source != "human" else when.astimezone().strftime(" %H:%M")
    hint = f"{line.origin}{': ' + line.origin.reason if line.origin.reason else ''}"
    if line.automatic is not None and line.automatic != line.text:
        hint += f"; the labeller had {line.automatic}"
    back = ""
    if line.settled:
        as_it_was = "as its points make it" if line.field == "box" else f"back to the labeller's: {line.automatic}"
        click = f"sv('field-back:{line.field}')"
        back = f'<span class="x" role="button" title="{safe(as_it_was)}" onclick="{click}">↺</span>'
    fill = f";--f:{color}" if filled else ""
    return (
        f'<div class="from" title="{safe(hint)}"><span>{FIELD_NAMES[line.field]}</span>'
        f'<span class="v">{safe(_short(line, card))}</span>'
        f'<span class="m" style="--c:{color}{fill}">{safe(said)}{more}</span>{back or "<span></span>"}</div>'
    )


def _short(line: FieldLine, card: ObjectCard) -> str:
    value: Any = line.value
    if line.field == "mask":
        return "the whole 2D box" if value is None else f"{card.mask_pixels:,} pixels"
    if line.field == "bbox":
        x0, y0, x1, y1 = value
        return f"{x0:.0f}, {y0:.0f}, {x1 - x0:.0f} × {y1 - y0:.0f} px"
    if line.field == "box":
        return "none" if card.numbers is None else " × ".join(f"{100 * s:.0f}" for s in card.numbers.size) + " cm"
    if line.field == "status" and value is None and card.statuses:
        return ", ".join(f"{status} ({name})" for name, status in card.statuses.items())
    return line.text


def rejected_html(left_out: Mapping[int, Mapping[str, Any]]) -> str:
    """Objects that were rejected, each with a way back."""
    if not left_out:
        return ""
    rows = "".join(
        f'<div class="gone"><span>{safe(row["label"])}·{number}</span>'
        + button("bring back", f"sv('object-back:{number}')", "unreviewed again")
        + "</div>"
        for number, row in sorted(left_out.items())
    )
    return panel(heading(f"Rejected ({len(left_out)})"), rows)
