"""Commands judging predictions of other pipelines as runs, and writing runs as predictions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.evaluation.adapters import import_published
from pipeline.evaluation.exporting import export_run
from pipeline.evaluation.importing import judge_again
from pipeline.evaluation.job import RunReport
from pipeline.evaluation.run_folder import open_run
from pipeline.evaluation.systems import PREDICTIONS_FILE
from pipeline.language.counted import counted
from pipeline.paper.systems import recorded_system
from spatialviz.cli_runs import ExportRunCommand, ImportRunCommand, JudgeAgainCommand
from spatialviz.options import warn
from spatialviz.printing import rate_bar, say
from spatialviz.run_eval import print_run, run_record

_NAMED = {"proposals": "OPM-TARGET or OPM-REF", "boxes_3d": "LIFT", "relations": "SRM, OPM-CONF or PRM"}


def run_import_run(command: ImportRunCommand) -> None:
    with rate_bar("judging", "expressions") as advance:
        report = import_published(
            command.predictions,
            command.dataset,
            command.labels,
            command.out,
            format=command.format,
            key=command.key,
            places=command.places,
            name=command.name,
            workers=command.workers,
            plots=command.plots,
            overwrite=command.overwrite,
            progress=advance,
            **command.camera.camera(),
        )
    imported = open_run(report.folder).manifest["imported"]

    command.write({**run_record(report), "imported": imported}, print_imported, report, imported)
    warn(*report.warnings)


def print_imported(report: RunReport, imported: Mapping[str, Any]) -> None:
    """Print the tables, and the system behind the answers."""
    print_run(report, 0)
    lines, lacks = counted(imported["lines"], "line"), imported["lacks"]
    say(f"{imported['system']}: imported, level {imported['level']} of 3, {lines} as they stand in the file")
    if lacks is not None:
        more = f" and {lacks['lines'] - 1} more give" if lacks["lines"] > 1 else " gives"
        without = f"no {lacks['field']}, without which a verdict cannot name {_NAMED[lacks['field']]}"
        say(f"line {lacks['line']}{more} {without} [{report.folder / PREDICTIONS_FILE}]")


def run_judge_again(command: JudgeAgainCommand) -> None:
    with rate_bar("judging", "steps") as advance:
        record = judge_again(
            command.folder, command.out, workers=command.workers, progress=advance, system=recorded_system
        )
    what = next(what for what in ("expressions", "frames", "changes") if what in record)
    counts = "; ".join(record[what]) or "the same answer" if what == "changes" else f"{record[what]:,} {what}"
    command.write(record, say, f"{record['kind']}: {counts} -> {command.out}")


def run_export_run(command: ExportRunCommand) -> None:
    run = open_run(command.run_folder)
    lines = export_run(run, command.out)
    record = {"out": str(command.out), "lines": lines, "system": run.name}
    command.write(record, say, f"{counted(lines, 'line')} of {run.name} -> {command.out}")
