"""The command that measures speed."""

from __future__ import annotations

import sys
from pathlib import Path

from pipeline.bench.claims import BenchRun
from pipeline.bench.clock import Setup
from pipeline.bench.running import run_bench as measured
from pipeline.bench.table import machine_line, table_head, table_rows
from spatialviz.cli_models import BenchCommand
from spatialviz.options import FINE, NO
from spatialviz.printing import print_rows, say

PAGE = Path(__file__).with_name("bench_page.py")


def run_bench(command: BenchCommand) -> int:
    setup = Setup(command.quick, None if command.peers is None else str(command.peers.resolve()))
    run = measured(
        command.only,
        setup,
        before=command.before,
        further={"page": PAGE},
        progress=lambda step: print(step, file=sys.stderr, flush=True),
    )
    if command.out is not None:
        run.write(command.out)
    command.write(run.record(), print_bench, run)
    return NO if any(c.kept == "no" for c in run.claims) else FINE


def print_bench(run: BenchRun) -> None:
    """Print the table, with the machine above it."""
    say(machine_line(run), style="dim")
    print_rows(table_head(run), table_rows(run))
