"""What a person reads of two detectors' agreement."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from pipeline.answering.agreement.agreement import FrameAgreement
from pipeline.answering.agreement.agreement_figures import AgreementFigures
from spatialviz.printing import make_console

SHOWN_NAMES = 8


def print_frame_agreement(frame_id: str, found: FrameAgreement) -> None:
    """What the two detectors disagree on in one frame, row by row."""
    console = make_console()
    console.print(Text.assemble(("frame ", "dim"), frame_id, (f"  {int(found.same.sum())} things alike", "")))
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("", "A", "score", "B", "score", "IoU"):
        table.add_column(column, justify="right" if column in ("score", "IoU") else "left")
    for p in found.named_otherwise.tolist():
        i, j = found.pairs[p].tolist()
        table.add_row(
            "named otherwise", Text(found.labels_a[i]), f"{found.scores_a[i]:.2f}", Text(found.labels_b[j]),
            f"{found.scores_b[j]:.2f}", f"{found.iou[p]:.2f}",
        )  # fmt: skip
    for i in found.only_a.tolist():
        score, near = f"{found.scores_a[i]:.2f}", f"{found.nearest_a[i]:.2f}"
        table.add_row("only A", Text(found.labels_a[i]), score, "", "", near)
    for j in found.only_b.tolist():
        score, near = f"{found.scores_b[j]:.2f}", f"{found.nearest_b[j]:.2f}"
        table.add_row("only B", "", "", Text(found.labels_b[j]), score, near)
    if table.row_count:
        console.print(table)
        console.print(Text("IoU of what one found alone: with the nearest of the other's", "dim"))


def print_agreement(sums: AgreementFigures, detectors: Sequence[str]) -> None:
    """The figures of all frames, and the table of classes."""
    console = make_console()
    a, b = detectors
    console.print(Text.assemble(("A ", "dim"), a, ("   B ", "dim"), b, (f"   {sums.frames} frames", "dim")))
    console.print(
        f"{sums.both} things alike, {sums.otherwise} named otherwise, {sums.only_a} only A, {sums.only_b} only B"
    )
    if sums.beyond_a or sums.beyond_b:
        beyond = f"of classes that the other does not know: {sums.beyond_a} of A, {sums.beyond_b} of B (not counted)"
        console.print(Text(beyond, "dim"))
    console.print(
        f"agreement {shown(sums.share)}, whatever the name {shown(sums.share_placed)}; kappa of names "
        f"{shown(sums.name_kappa)}; mean IoU {shown(sums.mean_iou)}; score correlation {shown(sums.score_correlation)}"
    )
    if not sums.classes:
        return
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("class")
    for column in ("A", "B", "alike", "otherwise", "only A", "only B", "agreement", "mean IoU"):
        table.add_column(column, justify="right")
    for row in sums.classes:
        counts = (row.a, row.b, row.both, row.otherwise, row.only_a, row.only_b)
        table.add_row(Text(row.name), *map(str, counts), shown(row.share), shown(row.mean_iou))
    console.print(table)
    if sums.renamed:
        said = ", ".join(f"{a}/{b} {n}" for a, b, n in sums.renamed[:SHOWN_NAMES])
        more = len(sums.renamed) - SHOWN_NAMES
        console.print(Text(f"named otherwise, A/B: {said}" + (f" and {more} more" if more > 0 else "")))
        console.print(Text("names that mean the same can be declared in a file: --synonyms", "dim"))


def shown(figure: float | None) -> str:
    """Two decimals; a dash where there is no figure."""
    return "–" if figure is None else f"{figure:.2f}"
