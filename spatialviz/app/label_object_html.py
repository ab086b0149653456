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
from spatialviz.app.edit_panel import AXES, MODES, field, in_parts, row
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.text import BAD, DOUBT, GOOD, button, dot, heading, joined, note, panel, segments

STATUS_WORDS = {
    "accepted": ("accept", GOOD, "Y"), "unsure": ("unsure", DOUBT, "Shift+U"),
    "rejected": ("reject", BAD, "Shift+Y"),
}  # fmt: skip
LENGTH_DIGITS, TURN_DIGITS = 3, 1
FIELD_NAMES = {"label": "class", "status": "status", "mask": "mask", "bbox": "2D box", "box": "3D box"}
SOURCES = {"auto": ("auto", "#8a919c", False), "human": ("", GOOD, True),
           "recomputed": ("recomputed", "#4c8dd6", True), "stale": ("stale", DOUBT, True)}  # fmt: skip
"""Of each source the word, the colour of its mark, and whether the mark is filled."""


def saved_html(author: str, said: str, bad: bool, moved: Moved | None) -> Element:
    """That this is no what-if: under whose name edits are saved, and what came of the last one."""
    color, done = (
        (BAD, "the last action was not saved; you are ") if bad else (GOOD, "edits are saved to the journal as ")
    )
    last = h.div(said, cls="dim said2", title=said) if said else None
    if moved is not None:
        last = h.div(_moved(moved), cls="dim")
    return panel(
        h.div(
            h.span(done, h.b(author), cls="said2"),
            h.span(
                button("undo", "take-back", "take the last action back (Ctrl+Z)"),
                button("redo", "bring-back", "bring it back (Ctrl+Y)"),
                cls="chips",
            ),
            cls="mode",
            css={"--c": color},
        ),
        last,
    )


def _moved(moved: Moved) -> Child:
    if moved.card is None:
        return "saved when it is let go"
    would = [
        h.b(f"{PHRASE[line.relation]} {'none' if line.state is None else letter(line.state)}")
        for line in moved.card.lines
        if line.relation in moved.changed
    ]
    return joined(would, ", ") if would else "no relation of the pair changes", f" · {moved.seconds * 1000:.1f} ms"


def object_html(card: ObjectCard, name: str, color: RGB, mode: str, author: str) -> Element:
    """The selected object."""
    facts = [counted(card.points, "point"), *([] if card.distance is None else [f"{card.distance:.2f} m"])]
    asked = counted(card.expressions, "expression")
    counts = " ".join(f"{n} {state}" for state, n in card.states.items())
    added = f" · added by {card.added_by}" if card.added_by else ""
    return in_parts(
        head=(
            heading(h.b(dot(color), name), " · ".join(facts)),
            h.div(f"relations {counts} · in {asked}{added}", cls="dim"),
        ),
        label=row("Class", _class_field(card)),
        status=_status_row(card, author),
        concern=note(f"Not asked for: {card.concern}", DOUBT) if card.concern else None,
        handles=row("Handles", segments("edit-mode", MODES, mode, "Handles"), title="Shift+E"),
        box=h.div(_box_rows(card), cls="tight"),
        sources=(heading("Where it comes from"), (_from(line, card) for line in card.fields)),
    )


def _class_field(card: ObjectCard) -> Element:
    return h.input(
        cls="find",
        aria_label="Class",
        spellcheck="false",
        autocomplete="off",
        value=card.label,
        title="Enter saves it, Tab completes it (Shift+O)",
        field="class",
    )


def _status_row(card: ObjectCard, author: str) -> Child:
    """What this person says of it; beside, what others do."""
    own = card.statuses.get(author)
    cells = (
        h.button(
            word,
            aria_pressed=str(own == status).lower(),
            css={"--c": color},
            do=f"object-status:{status}",
            title=key,
        )
        for status, (word, color, key) in STATUS_WORDS.items()
    )
    others = ", ".join(f"{name}: {status}" for name, status in card.statuses.items() if name != author)
    return row("Status", h.div(cells, cls="seg")), h.div(others, cls="dim under-row") if others else None


def _box_rows(card: ObjectCard) -> Child:
    if card.numbers is None:
        return h.div("No 3D box: there is no depth in its pixels.", cls="dim")
    rows = []
    for kind, label in (("center", "Centre"), ("size", "Size")):
        cells = (
            field(f"box-set:{kind}:{axis}", getattr(card.numbers, kind)[axis], hint=f"{word}, {unit}", step="0.01",
                  name=word[0], digits=LENGTH_DIGITS)
            for axis, (word, unit) in enumerate(AXES[kind])
        )  # fmt: skip
        rows.append(row(label, h.div(cells, cls="fields")))
    turn = field("box-set:yaw", card.numbers.yaw, hint="degrees, from right towards forward", step="1", name="°",
                 digits=TURN_DIGITS)  # fmt: skip
    buttons = (
        button("fit to points", "box-fit", "the box that its cleaned points make (Shift+J)"),
        button("extend", "box-snap:extend", "its bottom to what the object stands on, its top stays (Shift+B)"),
        button("set down", "box-snap:move", "all of it to what the object stands on (Shift+Z)"),
    )
    return rows, row("Turn", h.div(turn, h.div(buttons, cls="chips beside"), cls="fields"))


def numbers_said(numbers: BoxNumbers) -> dict[str, str]:
    """What the number fields say of a box, by what they send."""
    sides = {f"box-set:{kind}:{axis}": f"{getattr(numbers, kind)[axis]:.{LENGTH_DIGITS}f}"
             for kind in ("center", "size") for axis in range(3)}  # fmt: skip
    return {**sides, "box-set:yaw": f"{numbers.yaw:.{TURN_DIGITS}f}"}


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
        back = h.button("↺", cls="x", do=f"field-back:{line.field}", title=as_it_was, aria_label=as_it_was)
    return h.div(
        h.span(FIELD_NAMES[line.field]),
        h.span(_short(line, card), cls="v"),
        h.span(f"{said}{more}", cls="m", css={"--c": color, "--f": color if filled else "transparent"}),
        back,
        id=f"from-{line.field}",
        cls="from",
        title=hint,
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


def rejected_html(left_out: Mapping[int, Mapping[str, Any]]) -> Element | None:
    """Objects that were rejected, each with a way back."""
    if not left_out:
        return None
    rows = (
        h.div(
            h.span(f"{row['label']}·{number}"),
            button("bring back", f"object-back:{number}", "unreviewed again"),
            cls="gone",
        )
        for number, row in sorted(left_out.items())
    )
    return panel(heading(f"Rejected ({len(left_out)})"), rows)
