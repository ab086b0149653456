"""The dialog that tells who was faster, and lets one decide field by field; nothing is overwritten without it."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timezone

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict
from pipeline.corrections.unsaved import Dispute, disputes
from pipeline.corrections.wording import ref_text, value_text
from pipeline.system.errors import InputError
from spatialviz.app.correct import Correct
from spatialviz.app.dialog import Dialog
from spatialviz.app.markup import Element, h


class Conflicts:
    """Shows the conflicts of one client, the oldest first.

    Parameters
    ----------
    dialog : Dialog
    correct : Correct
        Saves what was decided.
    """

    def __init__(self, dialog: Dialog, correct: Correct) -> None:
        self._dialog, self._correct = dialog, correct

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {"conflict": lambda _: self.show(), "decide": self.decide}

    def _first(self) -> Conflict | None:
        desk = self._correct.desk
        return None if desk is None or not desk.disputed else desk.disputed[0]

    def show(self) -> None:
        """Show the oldest conflict that is not decided."""
        conflict, desk = self._first(), self._correct.desk
        if conflict is None or desk is None:
            return
        frame = self._correct.frame_of(conflict)
        found = disputes(conflict, desk.corrector.setting)
        mine = h.button("Mine instead (M)", do="decide:0", aria_keyshortcuts="M")
        theirs = h.button("Keep theirs (T)", do="decide:", aria_keyshortcuts="T")
        save = h.button("Save as chosen", local="checked:decide:")
        buttons = (save,) if len(found) > 1 else (mine, theirs)
        self._dialog.show("Somebody was faster", conflict_html(found, frame), *buttons)

    def decide(self, mine: str) -> None:
        """Save one's own in the disputes that are named: "0,2"."""
        conflict, desk = self._first(), self._correct.desk
        self._dialog.close()
        if conflict is None or desk is None:
            return
        chosen = {int(k) for k in mine.split(",") if k.isdecimal()}
        try:
            outcome = desk.decide(conflict, chosen)
        except InputError as error:
            self._correct.refuse(str(error))
            return
        if outcome is None:
            self._correct.tell("kept as the other one has it")
        else:
            self._correct.came_to(outcome, "saved instead of theirs")
        if self._first() is not None:
            self.show()


def conflict_html(found: tuple[Dispute, ...], frame: EffectiveFrame | None) -> Element:
    """Each disputed field: who made it what and when, and what one wanted."""
    rows = []
    for k, dispute in enumerate(found):
        rival = dispute.rivals[0]
        event, cell, edit = rival.event, rival.edit.ref, rival.edit
        what = ref_text(cell, frame)
        if event is None:
            theirs, who = "not what you saw", "It was taken back in the meantime"
        else:
            theirs = value_text(cell, event.after, frame)
            reason = f" · {event.reason}" if event.reason else ""
            who = (h.b(event.author), f" changed it {_when(event.time)}{reason}")
        values = (
            ("you saw", value_text(cell, edit.before, frame)),
            ("theirs", theirs),
            ("yours", value_text(cell, edit.after, frame)),
        )
        rows.append(
            h.div(
                h.div(what, cls="what"),
                h.div(who, cls="dim"),
                h.div(((h.span(whose), h.b(value)) for whose, value in values), cls="two"),
                _choice(k, what) if len(found) > 1 else None,
                cls="dispute",
            )
        )
    said = (
        "Nothing of yours was saved, and nothing of theirs is lost."
        if len(found) == 1
        else ("Nothing of yours was saved yet, and nothing of theirs is lost. Choose for each field.")
    )
    return h.div(h.div(said), rows, cls="conflict")


def _choice(k: int, what: str) -> Element:
    """Theirs or one's own of a disputed field; what is checked is sent when all is decided."""
    name = f"dispute-{k}"
    theirs = h.label(h.input(type="radio", name=name, value="", checked=True), "keep theirs")
    mine = h.label(h.input(type="radio", name=name, value=k), "mine instead")
    return h.fieldset(h.legend(what, cls="unseen"), theirs, mine, cls="seg pick")


def _when(time: datetime) -> str:
    seconds = (datetime.now(timezone.utc) - time).total_seconds()
    clock = time.strftime("%Y-%m-%d %H:%M:%S UTC")
    return f"{seconds:.0f} s ago ({clock})" if 0 <= seconds < 120 else f"at {clock}"
