"""What a person reads of a review on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from pipeline.language.relation_names import PHRASE
from pipeline.metrics.tables import shown
from spatialviz.printing import make_console
from spatialviz.printing_eval import print_table

if TYPE_CHECKING:
    import pyarrow as pa

    from pipeline.corrections.review.retraining import Retraining
    from pipeline.corrections.review.retraining_run import RetrainingRun
    from pipeline.corrections.review.reviewed import PairAgreement

SHOWN_CELLS = 5


def print_queue(queue: pa.Table, limit: int, out: Path | None, settled: int = 0) -> None:
    """The first items with their reasons, and how many there are; `settled` of them are not shown."""
    console = make_console()
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("wrong", justify="right")
    for column in ("frame", "label", "reasons"):
        table.add_column(column)
    for row in queue.slice(0, limit).to_pylist():
        table.add_row(f"{row['score']:.2f}", row["frame"], Text(_said(row)), Text("; ".join(row["reasons"])))
    if queue.num_rows:
        console.print(table)
    metadata = {k.decode(): v.decode() for k, v in (queue.schema.metadata or {}).items()}
    told = f"{queue.num_rows} labels to look at"
    if settled:
        told += f" ({settled} more are settled, or others': --all)"
    if "estimated_wrong" in metadata:
        told += f"; networks take {metadata['estimated_wrong']} relation labels to be wrong"
    if metadata.get("elsewhere", "0") != "0":
        told += f"; {metadata['elsewhere']} findings of no single label: see `spatialviz check`"
    console.print(told)
    if out is not None:
        console.print(Text(f"-> {out}", "dim"))


def _said(row: dict[str, Any]) -> str:
    if row["kind"] == "relation":
        return f"{row['a']} {PHRASE[row['relation']]} {row['b']}: {row['label']}"
    if row["place"] is not None:
        return f"no object at {row['place']}: {row['label']}?"
    if row["kind"] == "object":
        return f"object {row['a']}: {row['label']}"
    return f"{row['expression']}: {row['label']!r}"


def print_agreement(pairs: Sequence[PairAgreement], limit: int) -> None:
    """Kappa of each two reviewers by kind, the table, and the first items on which they differ."""
    console = make_console()
    if not pairs:
        console.print("no two reviewers have judged the same item")
    for pair in pairs:
        console.print(Text(f"{pair.first} and {pair.second}: {pair.all.items} items judged by both", "bold"))
        for kind, found in (("all", pair.all), *pair.kinds.items()):
            kappa = "-" if found.kappa != found.kappa else f"{found.kappa:.2f}"
            console.print(f"  {kind}: kappa {kappa}, {_share(found.observed)} of {found.items} judged alike")
        table = Table(box=None, pad_edge=False, header_style="dim", title_justify="left")
        table.add_column(f"{pair.first} \\ {pair.second}")
        for judgement in pair.all.judgements:
            table.add_column(judgement, justify="right")
        for judgement, row in zip(pair.all.judgements, pair.all.table.tolist(), strict=True):
            table.add_row(judgement, *map(str, row))
        console.print(table)
        for key, one, other in pair.differ[:limit]:
            place = f"{key.a} {PHRASE[key.what]} {key.b}" if key.kind == "relation" else f"{key.what or key.a}"
            console.print(
                Text(f"  {key.frame}, {key.kind} {place}: {pair.first} says {one}, {pair.second} says {other}")
            )
        if len(pair.differ) > limit:
            console.print(f"  and {len(pair.differ) - limit} more")


def print_progress(record: dict[str, Any]) -> None:
    """How many items are in each state, by kind and by reviewer, and what is left."""
    from pipeline.corrections.review.items import STATES

    console = make_console()
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("")
    for state in STATES:
        table.add_column(state, justify="right")
    for name, counts in (("queue", record), *record["kinds"].items(), *record["reviewers"].items()):
        table.add_row(Text(name), *(str(counts[s]) if s in counts else "" for s in STATES))
    console.print(table)
    console.print(f"{record['settled']} of {record['items']} settled ({_share(record['share'])})")
    for day, count in record["days"].items():
        console.print(f"{day}: {count} items")
    if record["disagreements"]:
        console.print(f"reviewers disagree on {record['disagreements']}: see --agreement")
    if record["elsewhere"]:
        console.print(f"{record['elsewhere']} items that people judged are not in the queue")
    if record["estimated_wrong"] is not None:
        console.print(f"networks take {record['estimated_wrong']:.0f} of the open relation labels to be wrong")


def print_retraining(found: Retraining, out: Path) -> None:
    """The table before and after, and the cells that changed most."""
    console = make_console()
    print_table(found.table())
    for title, count, cells in (
        ("became right", found.counts[0], found.better),
        ("became wrong", found.counts[1], found.worse),
    ):
        console.print(Text(f"{title}: {count} held-out cells", "bold"))
        for cell in cells[:SHOWN_CELLS]:
            console.print(
                f"  frame {cell['frame']}: {cell['a']} {PHRASE[cell['relation']]} {cell['b']} is {cell['label']}: "
                f"{cell['before']:.2f} -> {cell['after']:.2f}"
            )
    console.print(Text(f"-> {out}, {out.with_suffix('.comparison.md')}", "dim"))


def print_circle(circle: RetrainingRun) -> None:
    """What the corrections did: to the labels, to the network, to the answers."""
    console = make_console()
    made = circle.corrections
    console.print(f"{made['events']} events of the journal")
    print_retraining(circle.retraining, circle.network)
    if circle.in_use is not None:
        before, after = (shown(f.micro_f1) for f in (circle.in_use.before, circle.in_use.after))
        console.print(f"the network in use: micro-F1 {before} on the same pairs; the new one {after}")
    for title, found in (("the labels alone", circle.mended), ("the new network", circle.replay)):
        if found is not None:
            gain = found.differences[found.measure]
            console.print(
                f"{title}: {len(found.fixed)} answers became right, {len(found.broken)} wrong, of {found.shared} "
                f"({gain.value * 100:+.1f} points [{gain.low * 100:.1f}, {gain.high * 100:.1f}])"
            )
    console.print(Text(f"-> {circle.folder}; spatialviz install {circle.network} --name NAME takes it into use", "dim"))


def print_review_bench(record: dict[str, Any]) -> None:
    """One line a seed, and the means."""
    console = make_console()
    console.print(
        f"{record['pairs']} pairs, labels {record['labels']}, {record['share']:.0%} of the cells turned; by confident "
        f"learning alone, the first {record['top']:.0%} looked at, then {record['again']:.0%} of the queue made anew"
    )
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("", "planted", "estimated", "found", "found in all", "F1 true", "planted", "mended", "in all",
                 "F1 back", "in all", "seconds"):  # fmt: skip
        table.add_column(name, justify="right")
    for number, run in enumerate(record["runs"]):
        table.add_row(
            f"seed {number}", str(run["planted"]), f"{run['estimated']:.0f}", f"{run['found']:.1%}",
            f"{run['found_again']:.1%}", *(f"{run['f1'][k]:.4f}" for k in ("clean", "planted", "mended", "again")),
            *(_share(run["recovered"][k]) for k in ("mended", "again")), f"{run['seconds']:.1f}",
        )  # fmt: skip
    console.print(table)
    mean = record["mean"]
    console.print(
        f"found {mean['found']:.1%}, in all {mean['found_again']:.1%}; of the lost F1 {_share(mean['recovered'])} is "
        f"back{_between(mean['recovered_interval'])}, in all {_share(mean['recovered_again'])}"
        f"{_between(mean['recovered_again_interval'])}"
    )


def _between(interval: list[float] | None) -> str:
    return "" if interval is None else f" [{interval[0]:.1%}, {interval[1]:.1%}]"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"
