"""The commands that look into a run of `eval`: SQL, failures by words, and the paper's tables."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from pipeline.system.errors import InputError
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json

if TYPE_CHECKING:
    from pipeline.evaluation.shared_makers import Share

MOST_SHOWN = 1000


@dataclass(frozen=True)
class Query:
    """Ask a run in SQL: the view records, and labels_frames, labels_objects, labels_relations, labels_expressions."""

    run_folder: Positional[Path]
    """Run folder of `spatialviz eval`."""
    sql: Positional[str]
    """One SELECT, such as "SELECT verdict, count(*) FROM records GROUP BY ALL". It can read nothing else."""
    json: bool = False
    """Print one JSON object for each row."""
    csv: bool = False
    """Print CSV."""

    def run(self) -> int:
        from pipeline.evaluation.run_database import open_run
        from spatialviz.printing_runs import print_answer, print_csv, print_rows

        if self.json and self.csv:
            raise InputError("--json and --csv exclude each other")
        with open_run(self.run_folder) as database:
            answer = database.select(self.sql)
            if self.json:
                rows = print_rows(answer)
            elif self.csv:
                rows = print_csv(answer)
            else:
                rows = print_answer(answer, MOST_SHOWN)
        return FINE if rows else NO


@dataclass(frozen=True)
class Failures:
    """What a run got wrong: verdicts, what each module costs, slices, and the failing expressions with the reason."""

    run_folder: Positional[Path]
    """Run folder of `spatialviz eval`."""
    search: Positional[str] = ""
    """Words, such as "verdict:SRM relation:behind class:chair margin<0.1 -lucky sort:margin". One that begins with "-"
    goes after all options and a "--"."""
    limit: int = 20
    """Expressions shown at most."""
    slices: str = "relation"
    """By what the run is cut, with commas: relation, class, reference, distance, size, occlusion, same_class,
    label_margin, scene, frame."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.evaluation.compare import read_records
        from pipeline.evaluation.search import find_failures
        from pipeline.evaluation.slices import dimension_named, slice_by
        from pipeline.evaluation.summary import need_verdicts, summarise_run
        from spatialviz.printing_runs import FoundFailures, print_failures

        if self.limit < 0:
            raise InputError("--limit is a count", got=self.limit, expected="0 or more")
        dimensions = [dimension_named(name) for name in self.slices.split(",") if name.strip()]
        records = read_records(self.run_folder)
        need_verdicts(records)
        found = find_failures(records, self.search)
        summary = summarise_run(records)
        name = _name_of(self.run_folder)
        shares = _shares_of(self.run_folder)
        slices = [slice_by({name: records}, d, most=None if self.json else MOST_ROWS) for d in dimensions]
        told = FoundFailures(name, shares, summary, slices, found, self.limit, self.search)
        if self.json:
            print_json(told.record())
        else:
            print_failures(told)
        return FINE if found.num_rows else NO


@dataclass(frozen=True)
class Tables:
    """The paper's tables of a run, with its published rows; those of the vocabulary of the run's labels."""

    run_folder: Positional[Path]
    """Run folder of `spatialviz eval`."""
    format: Literal["text", "markdown", "latex"] = "text"
    """text | markdown | latex."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.evaluation.paper_tables import tables_of_run
        from pipeline.metrics.tables import latex, markdown
        from spatialviz.printing_eval import print_table, rows_record, table_record

        if self.json and self.format != "text":
            raise InputError("--json and --format exclude each other")
        tables = tables_of_run(self.run_folder)
        if self.json:
            print_json({"tables": {table.key: table_record(table) for table in tables}, "rows": rows_record(tables)})
        elif self.format == "text":
            for table in tables:
                print_table(table)
        else:
            print(markdown(tables) if self.format == "markdown" else latex(tables), end="")
        return FINE


MOST_ROWS = 15


def _shares_of(run: Path) -> tuple[Share, ...]:
    """What the run shares with what made its labels, of whatever release it is."""
    from pipeline.evaluation.run_database import labels_of, manifest_of
    from pipeline.evaluation.shared_makers import shares_of_run

    return shares_of_run(manifest_of(run), labels_of(run))


def _name_of(run: Path) -> str:
    from pipeline.evaluation.run_database import manifest_of

    return str(manifest_of(run).get("name") or run.name)
