"""What a person reads on the terminal of labelled objects and pairs."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from pipeline.corrections.cards import PairCard
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.object_card import ObjectCard
from pipeline.corrections.support import Support, support_name
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import letter
from spatialviz.printing import make_console


def print_objects(cards: Sequence[ObjectCard], *, whole: bool) -> None:
    """One line an object; of a single one every field with where it comes from."""
    console = make_console()
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("object", "class", "status", "size (m)", "away (m)", "T U F", "not the labeller's"):
        table.add_column(column, overflow="fold")
    for card in cards:
        size = "" if card.numbers is None else " ".join(f"{x:.2f}" for x in card.numbers.size)
        away = "" if card.distance is None else f"{card.distance:.2f}"
        counts = " ".join(str(n) for n in card.states.values())
        others = ", ".join(f"{x.field} {x.origin.source}" for x in card.fields if x.origin.source != "auto")
        status = card.status or ("" if card.stands else "rejected")
        table.add_row(*(Text(x) for x in (str(card.number), card.label, status, size, away, counts, others)))
    console.print(table)
    for card in cards if whole else ():
        fields = Table(box=None, pad_edge=False, header_style="dim")
        for column in ("field", "value", "from", "the labeller's"):
            fields.add_column(column, overflow="fold")
        for line in card.fields:
            was = "" if line.automatic is None or line.automatic == line.text else line.automatic
            fields.add_row(*(Text(x) for x in (line.field, line.text, str(line.origin), was)))
        console.print(fields)
        more = f"; {card.concern}" if card.concern else ""
        added = f"; added by {card.added_by}" if card.added_by else ""
        for name, status in card.statuses.items():
            console.print(Text(f"{name} says: {status}"))
        console.print(Text(f"{card.points} points of {card.mask_pixels} pixels; {card.expressions} expressions"
                           f"{more}{added}", "dim"))  # fmt: skip


def print_pair(card: PairCard) -> None:
    """One line a relation."""
    console = make_console()
    away = "" if card.distance is None else f", {card.distance:.2f} m apart"
    console.print(Text(f"{card.names[0]}·{card.a} ... {card.names[1]}·{card.b}{away}"))
    if card.why_none:
        console.print(Text(f"takes part in no relation: {card.why_none}", "yellow"))
        return
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("relation", "state", "margin (cm)", "status", "from"):
        table.add_column(column, overflow="fold")
    for line in card.lines:
        state = "" if line.state is None else letter(line.state)
        margin = "" if line.margin is None else f"{100 * line.margin:+.1f}"
        row = (PHRASE[line.relation], state, margin, line.status or "", str(line.origin))
        table.add_row(*(Text(x) for x in row))
    console.print(table)


def print_support(frame: EffectiveFrame, support: Support, gap: float) -> None:
    """What an object stands on."""
    said = f"{abs(gap) * 100:.1f} cm {'above' if gap > 0 else 'below the top of'} {support_name(frame, support)}"
    fitted = f"{support.points} points, {support.spread * 1000:.1f} mm" if support.points else "its upper extent"
    make_console().print(Text(f"its box ends {said} ({fitted})"))
