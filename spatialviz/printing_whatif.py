"""What a person reads of an answer under edits."""

from __future__ import annotations

from typing import Any

from rich.table import Table
from rich.text import Text

from pipeline.answering.told_answer import NO_SUCH_PAIR, probability
from spatialviz.printing import make_console

_ROWS = (
    ("P(target)", "p_target", "{:.3f}"),
    ("P(reference)", "p_reference", "{:.3f}"),
    ("P(relation)", "p_relation", "{:.3f}"),
    ("product", "product", "{:.3f}"),
    ("posterior", "probability", "{:.3f}"),
    ("margin", "margin", "{:.3f}"),
)


def print_change(record: dict[str, Any]) -> None:
    """Before and after side by side, what moved, and where the winner falls in the relation's region."""
    console = make_console()
    console.print(Text.assemble(("frame ", "dim"), record["frame"], "  ", (record["expression"], "bold")))
    sides = record["before"], record["after"]
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("", "before", "after"):
        table.add_column(column)
    for role in ("target", "reference", "second_reference"):
        if any(role in side for side in sides):
            table.add_row(role.replace("_", " "), *(_object(side.get(role)) for side in sides))
    for title, field, form in _ROWS:
        table.add_row(title, *("" if field not in side else form.format(side[field]) for side in sides))
    if any(side["verdict"] for side in sides):
        table.add_row("verdict", *(side["verdict"] or "" for side in sides))
    console.print(table)
    for when, side in zip(("before", "after"), sides, strict=True):
        if "reason" in side:
            console.print(Text(f"{when}: {side['reason']}", "yellow"))
        elif not side["holds"]:
            nearest = " with ".join(_object(side[role]) for role in ("target", "reference") if role in side)
            shown = probability(side["relation_probability"])
            console.print(Text(f"{when}: {NO_SUCH_PAIR}{nearest}, relation {shown}", "yellow"))
    if record["changed"]:
        console.print(Text("the answer is another", "bold"))
    for move in record["moved"][:5]:
        was, now = (move[f"rank_{when}"] or "not there" for when in ("before", "after"))
        console.print(Text(f"pair {move['target']}, {move['reference']}: {was} -> {now}", "dim"))
    if "placement" in record:
        console.print(Text(record["placement"]["why"]))
    if not any(name != "format" for name in record["edits"]):
        for entry in record["objects"]:
            console.print(Text(f"{entry['key']}  {entry['label']}  {entry['score']:.2f}", "dim"))
    if "decision_map" in record:
        shares = ", ".join(f"{key} {share:.0%}" for key, share in record["decision_map"]["share"].items())
        console.print(f"decision map of {record['decision_map']['key']}: {shares}")


def _object(entry: dict[str, str] | None) -> str:
    return "" if entry is None else f"{entry['label']} {entry['key']}"
