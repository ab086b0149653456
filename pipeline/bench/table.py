"""Table of a run's claims, and the figures that documents take from it.

    python -m pipeline.bench.table docs/bench.json README.md docs/*.md

renews the table between `<!-- bench: table -->` and `<!-- bench: end -->`, and each figure that stands before a mark:
`2.1<!-- bench: label.packed ratio -->`, or `value` or `floor`, or what is worked out of one, from left to right:
`14.8<!-- bench: label.packed value / 3.6 -->`.
"""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from operator import add, mul, sub, truediv
from pathlib import Path

from pipeline.bench.claims import BenchRun, SpeedClaim, read_bench
from pipeline.system.errors import needed
from pipeline.system.whole_files import write_whole

HEAD = ("claim", "what", "figure", "beside", "its figure", "ratio", "promise", "kept")
_TABLE = re.compile(r"(<!-- bench: table -->\n).*?(<!-- bench: end -->)", re.DOTALL)
_FIGURE = re.compile(r"[\d.,]+(<!-- bench: ([\w.]+) (value|floor|ratio)((?: [-+*/] [\d.]+)*) -->)")
_SIGNS = {"+": add, "-": sub, "*": mul, "/": truediv}


def shown(figure: float | None, unit: str = "") -> str:
    """Three digits that count, with the unit; a dash for none.

    >>> shown(1033120.0, "pairs/s"), shown(0.20812), shown(None)
    ('1,030,000 pairs/s', '0.208', '-')
    """
    if figure is None:
        return "-"
    short = float(f"{figure:.3g}")
    return f"{f'{short:,.0f}' if abs(short) >= 100 else f'{short:g}'} {unit}".strip()


def table_head(run: BenchRun) -> tuple[str, ...]:
    """Heads of the columns; two more where there is a run before."""
    return HEAD if run.before is None else (*HEAD, "before", "ratio before")


def table_rows(run: BenchRun) -> list[tuple[str, ...]]:
    """Cells of each claim."""
    return [(*_cells(c), *(() if run.before is None else _before(run.before.claim(c.name)))) for c in run.claims]


def _cells(claim: SpeedClaim) -> tuple[str, ...]:
    kept = f"not measured: {claim.reason}" if claim.value is None else claim.kept
    figures = shown(claim.value, claim.unit), claim.beside, shown(claim.floor, claim.unit), shown(claim.ratio)
    return claim.name, claim.what, *figures, claim.promise, kept


def _before(claim: SpeedClaim | None) -> tuple[str, ...]:
    return ("-", "-") if claim is None else (shown(claim.value, claim.unit), shown(claim.ratio))


def machine_line(run: BenchRun) -> str:
    """One line of the machine, the versions and the state of the program."""
    m = run.machine
    versions = ", ".join(f"{name} {m[name]}" for name in ("numpy", "cv2", "onnxruntime"))
    about = f"{m['processor']}, {m['cores']} cores, {m['ram_gb']} GB; {m['os']}; Python {m['python']}, {versions}"
    short = "; quick: fewer passes, figures of large numbers scaled up" if run.quick else ""
    return f"{about}; spatialviz {m['version']} ({m['commit']}), {m['date']}{short}"


def markdown(run: BenchRun) -> str:
    """Table in Markdown, with the machine above it."""
    lines = [table_head(run), ("---",) * len(table_head(run)), *table_rows(run)]
    return "\n".join([machine_line(run), "", *(f"| {' | '.join(cells)} |" for cells in lines)]) + "\n"


def renewed(text: str, run: BenchRun) -> str:
    """Text of a document with the table and the figures of a run; InputError for a figure that it lacks."""

    def figure(found: re.Match[str]) -> str:
        value = getattr(run.claim(found[2]), found[3], None)
        value = needed(value, "the bench has no such figure", got=f"{found[2]} {found[3]}")
        for sign, number in re.findall(r"(\S) (\S+)", found[4]):
            value = _SIGNS[sign](value, float(number))
        return shown(value) + found[1]

    return _FIGURE.sub(figure, _TABLE.sub(lambda found: found[1] + markdown(run) + found[2], text))


def main(file: str, *documents: str) -> None:
    """Renew documents by the file of a run."""
    run = replace(read_bench(Path(file)), before=None)
    for path in map(Path, documents):
        write_whole(path, renewed(path.read_text(encoding="utf-8"), run).encode(), "the document")


if __name__ == "__main__":
    main(*sys.argv[1:])
