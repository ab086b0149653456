"""What a person reads of the benchmark of evaluation."""

from __future__ import annotations

from typing import Any

from rich.table import Table
from rich.text import Text

from spatialviz.printing import make_console

_MEANING = {
    "read": "labels and frames",
    "parse": "sentences",
    "opm": "recorded proposals and their masks",
    "lift": "up vector, depth edges, points",
    "srm": "relations of all pairs",
    "rank": "the best pair",
    "records": "what was right",
    "verdicts": "which module failed",
    "tables": "tables with intervals, of 50,000 records",
}


def print_evaluation_bench(record: dict[str, Any]) -> None:
    """Stages, one by one, the whole job, training, and what the goals would take."""
    console = make_console()
    console.print(
        f"{record['expressions']} expressions of {record['frames']} frames, K={record['k']}, {record['scorer']}; "
        "stages in processor time of one thread"
    )
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("stage", "seconds", "ms/expression", ""):
        table.add_column(column, justify="right" if column in ("seconds", "ms/expression") else "left")
    for name, seconds in record["stages_s"].items():
        each = "" if name == "tables" else f"{seconds / record['expressions'] * 1000:.3f}"
        table.add_row(name, f"{seconds:.3f}", each, Text(_MEANING[name], "dim"))
    console.print(table)
    alone = record["asked_singly"]
    console.print(
        f"{record['expressions_per_s']:.0f} expressions/s; asked one by one {alone['expressions_per_s']:.1f}: "
        f"{alone['ratio']:.1f} times as fast"
    )
    same = f"the same answer for {alone['same_answers']} of {alone['expressions']} asked both ways"
    console.print(Text(same, "red" if alone["differ"] else ""))
    job = record["job"]
    memory = "unknown here" if job["peak_memory_mb"] is None else f"{job['peak_memory_mb']} MB"
    console.print(
        f"whole job: {job['seconds']} s with {job['workers']} workers, "
        f"peak memory {memory} in {job['processes']} processes"
    )
    training = record["training"]
    if "skipped" in training:
        console.print(Text(f"training was not measured: {training['skipped']}", "yellow"))
    else:
        repeated = f", {training['of_labels']} repeated" if training["of_labels"] < training["pairs"] else ""
        console.print(
            f"training {training['features']} on {training['pairs']} pairs{repeated}, {training['epochs']} epochs: "
            f"{training['seconds']} s, {training['pairs_per_s']:,.0f} pairs/s"
        )
    console.print("extrapolated:")
    for name, seconds in record["extrapolated"].items():
        if name != "workers":
            count = int(name.split("_")[2])
            with_workers = f" with {record['extrapolated']['workers']} workers" if "expressions" in name else ""
            shown = "not known" if seconds is None else f"{seconds} s"
            console.print(f"  {count:,} {name.split('_')[3]}{with_workers}: {shown}")
