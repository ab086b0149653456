"""Evaluation, its tables, and what a run got wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.text import Text

from pipeline.answering.pipeline import open_pipeline
from pipeline.diagnosis.marks import read_marks
from pipeline.diagnosis.verdict import VERDICTS, shown_verdict
from pipeline.evaluation.browsing import RunRows
from pipeline.evaluation.causes import with_figures
from pipeline.evaluation.comparing import CHANGES, Comparison, answer_differences, compare
from pipeline.evaluation.job import RunReport, evaluate_dataset
from pipeline.evaluation.leakage import Share, shares_of_run, with_caveats
from pipeline.evaluation.place_reading import told_reading
from pipeline.evaluation.records_file import open_records
from pipeline.evaluation.relation_cases import RelationSpec, uses_language
from pipeline.evaluation.run_figures import doubts_of
from pipeline.evaluation.run_folder import labels_of, manifest_of, open_database, open_run
from pipeline.evaluation.search import among_failures, failing_rows
from pipeline.evaluation.sentences import SentenceReport, evaluate_sentences
from pipeline.evaluation.slices import Slices, dimension_named, figure_rows, slice_by, slice_table
from pipeline.evaluation.summary import RunSummary, cost_words, need_verdicts, summarise_run, summary_tables
from pipeline.evaluation.systems import EvalSpec
from pipeline.language.counted import counted
from pipeline.metrics.tables import latex, markdown
from pipeline.paper.systems import Referring, Vlm
from pipeline.paper.tables import tables_of_folder, tables_of_run
from pipeline.pictures.sheet import failures_sheet
from pipeline.pictures.writing import check_target, write_picture
from pipeline.system.errors import InputError, require
from spatialviz.cli_runs import (
    EvalCommand,
    FailuresCommand,
    QueryCommand,
    TablesCommand,
)
from spatialviz.options import FINE, NO, print_json, warn
from spatialviz.printing import print_rows, print_table, rate_bar, rows_record, say, say_lines, table_record
from spatialviz.query_rows import plain, print_answer, print_json_rows

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

MOST_ROWS = 15
"""Of a slice on the terminal."""
SHOWN = (
    "id",
    "frame",
    "text",
    "target",
    "relation",
    "reference",
    "verdict",
    "detail",
    "lucky",
    "tone",
    "head",
    "said",
    "repair",
    "margin",
    "p_target",
    "p_reference",
    "p_relation",
    "marks",
    "change",
    "second_verdict",
    "second_detail",
    "second_said",
)
"""Columns of a failure in JSON."""


def run_eval(command: EvalCommand) -> None:
    if command.sentences is not None:
        run_sentences(command, command.sentences)
        return
    if command.labels is None or command.out is None:
        raise InputError(
            "nothing says what is asked and what is correct", expected="--labels LABELS --out RUN, or --sentences FILE"
        )
    vlm = None
    if command.vlm_url is not None and command.vlm_model is not None:
        vlm = Vlm(command.vlm_url, command.vlm_model, command.vlm_rate, tuple(map(told_reading, command.places)))
    elif command.system == "vlm":
        raise InputError("--system vlm needs a server and a model", expected="--vlm-url URL --vlm-model NAME")
    elif command.vlm_url is not None or command.vlm_model is not None:
        raise InputError("a server and its model go together", expected="--vlm-url URL --vlm-model NAME")
    require(command.source.reader == "grammar", "--reader llm goes with --sentences, not with labels")
    tables = _tables(command)
    grounding = tables != "relations"
    options = command.source.arguments()
    relations = None if tables == "grounding" else _relations(command, options)
    spec = EvalSpec(
        command.dataset,
        str(command.labels),
        options,
        {"pipeline": None, "referring": Referring(), "vlm": vlm}[command.system],
        vlm,
        command.limit,
        grounding=grounding,
        relations=relations,
        verdicts=command.verdicts,
        marks={} if command.marks is None else read_marks(command.marks),
        map=None if command.map is None else str(command.map),
    )
    with rate_bar("evaluating", "expressions" if grounding else "frames") as advance:
        report = evaluate_dataset(
            spec,
            command.out,
            name=command.name,
            workers=command.workers,
            others=command.others,
            against=command.compare,
            paper=tables_of_folder if command.tables == "paper" else None,
            plots=command.plots,
            overwrite=command.overwrite,
            progress=advance,
        )
    command.write(run_record(report), print_run, report, command.show)
    warn(*report.warnings)


def run_sentences(command: EvalCommand, path: Path) -> None:
    """`eval --sentences`."""
    own = {"dataset", "sentences", "out", "source", "overwrite", "json"}
    other = [f.name for f in fields(command) if f.name not in own and getattr(command, f.name) != f.default]
    require(
        not other,
        "an option is for labels, not for --sentences",
        got=", ".join(f"--{name.replace('_', '-')}" for name in other),
    )
    source = open_pipeline(command.dataset, **command.source.arguments())
    name = "demo" if command.dataset == "demo" else None
    with rate_bar("answering", "sentences") as advance:
        report = evaluate_sentences(
            path, source, name=name, out=command.out, overwrite=command.overwrite, progress=advance
        )
    command.write(report.record(), print_sentences, report, command.out)


def print_sentences(report: SentenceReport, out: Path | None) -> None:
    """Print the tables, the skipped lines, and the place of the lines' records."""
    for table in report.tables:
        if table.rows:
            print_table(table)
            say()
    skipped = report.asked.skipped.items()
    whys = {other: other if report.asked.published else f"of dataset {other!r}" for other, _ in skipped}
    say_lines((f"{counted(count, 'sentence')} skipped: {whys[other]}" for other, count in skipped), "dim")
    say_lines([] if out is None else [f"-> {out}"], "dim")


def _tables(command: EvalCommand) -> Literal["grounding", "relations", "both"]:
    """Measured parts: grounding, relations or both."""
    asked = "both" if command.tables == "paper" and command.system == "pipeline" else command.tables
    chosen = ("grounding" if asked == "paper" else asked) or ("both" if command.system == "pipeline" else "grounding")
    if chosen == "grounding" and command.tables != "grounding" and command.relations_of:
        chosen = "both"
    given = {
        "--relations-of": command.relations_of,
        "--relation-frames": command.relation_frames,
        "--relation-boxes": command.relation_boxes,
    }
    for name, value in given.items():
        require(
            chosen != "grounding" or value in ((), None),
            f"{name} belongs to relations alone",
            expected="--tables relations or both",
        )
    require(
        chosen != "relations" or (command.compare is None and not command.others and command.limit is None),
        "--compare, --others and --limit are about expressions",
        got="--tables relations",
    )
    return chosen


def _relations(command: EvalCommand, options: dict[str, Any]) -> RelationSpec:
    """Options of relations alone; `options` lose vectors without use for the run's own scorer."""
    vectors = options["vectors"]
    if vectors is not None and command.relations_of and not uses_language(str(options["srm"])):
        options["vectors"] = None
    return RelationSpec(
        others=command.relations_of,
        vectors=None if vectors is None else str(vectors),
        geometry=command.relation_boxes,
        frames=command.relation_frames,
        pairs=command.relation_pairs,
        vlm_pairs=command.vlm_pairs,
        seed=command.seed,
    )


def run_failures(command: FailuresCommand) -> int:
    require(command.limit >= 0, "--limit is a count", got=command.limit, expected="0 or more")
    if command.answers:
        return _differing_answers(command)
    if command.sheet is not None:
        check_target(command.sheet)
        with rate_bar("drawing", "failures") as advance:
            write_picture(failures_sheet(open_run(command.run_folder), command.search, advance), command.sheet)
    second = None if command.compare is None else open_records(command.compare)
    record, show = failures_of(command, open_records(command.run_folder), second)
    command.write(record, show)
    return FINE if record["found"] else NO


def _differing_answers(command: FailuresCommand) -> int:
    """`failures --compare --answers`."""
    if command.compare is None:
        raise InputError("--answers needs --compare", expected="--compare RUN_OR_ANSWERS --answers")
    plain = not command.search and command.slices is None and command.sheet is None
    require(plain, "--answers takes no search, no --slices and no --sheet")
    found = answer_differences(command.run_folder, command.compare)
    shown = {**found, "differ": len(found["answers"]), "answers": found["answers"][: command.limit]}
    command.write(shown, _print_differences)
    return FINE if found["answers"] else NO


def _print_differences(found: dict[str, Any]) -> None:
    of = counted(found["shared"], "expression")
    say(f"{found['differ']} of {of} answered otherwise, {found['same']} alike", style="bold")
    rows = [
        (one["frame"], one["text"], one["differs"], *(_shown_boxes(one[name]) for name in ("first", "second")))
        for one in found["answers"]
    ]
    if rows:
        print_rows(("frame", "expression", "differs", "first", "second"), rows)
    if found["differ"] > len(rows):
        say(f"and {found['differ'] - len(rows)} more (--limit)", style="dim")
    only = {name: found[f"only_{name}"] for name in ("first", "second")}
    say_lines((f"only in the {name}: {count}" for name, count in only.items() if count), "dim")


def _shown_boxes(answer: dict[str, list[float] | None]) -> str:
    boxes = [box for box in answer.values() if box is not None]
    return " / ".join(",".join(f"{value:.0f}" for value in box) for box in boxes) or "no answer"


def failures_of(
    command: FailuresCommand, records: Records, second: Records | None
) -> tuple[dict[str, Any], Callable[[dict[str, Any]], None]]:
    """Record of `failures --json` of a run (and of `--compare`), with a printer for people."""
    dimensions = [dimension_named(name) for name in (command.slices or "relation").split(",") if name.strip()]
    need_verdicts(records)
    rows = RunRows(records, command.run_folder, second)
    found = failing_rows(rows.records, command.search)
    manifest = manifest_of(command.run_folder)
    name = str(manifest.get("name") or command.run_folder.name)
    shares = shares_of_run(manifest, labels_of(command.run_folder))
    summary, cuts = None, []
    if command.json or not command.search or command.slices is not None:
        figures = figure_rows(records)
        summary = summarise_run(figures)
        cuts = [slice_by({name: figures}, d, most=None if command.json else MOST_ROWS) for d in dimensions]
    comparison = None if second is None else compare(records, second)
    doubts: tuple[str, ...] = ()
    with suppress(InputError):
        # A run of the first releases does not say what it was made of.
        doubts = doubts_of(open_run(command.run_folder))
    shown = rows.read(found[: command.limit])

    def show(_: dict[str, Any]) -> None:
        judged = records.num_rows - records.column("verdict").null_count
        print_failures(command, name, shares, summary, cuts, (len(found), judged, shown), comparison)
        say_lines(doubts, "yellow")

    if not command.json or summary is None:
        return {"found": len(found)}, show
    of_found = None
    if command.search and len(found):
        figures = figure_rows(records, found)
        parts = [slice_by({name: figures}, d) for d in dimensions]
        of_found = {
            "summary": summarise_run(figures).record(),
            "slices": {s.dimension.name: s.record() for s in parts},
        }
    record = {
        "search": command.search,
        "system": name,
        "shares": [share.record() for share in shares],
        "doubts": list(doubts),
        "found": len(found),
        "failures": [{name: plain(row[name]) for name in SHOWN if name in row} for row in shown],
        "of_found": of_found,
        "summary": summary.record(),
        "slices": {s.dimension.name: s.record() for s in cuts},
        "facets": {f.name: f.record() for f in rows.facets(among_failures(command.search, rows.records.schema))},
        "filters": rows.notes.filters,
        "comparison": None if comparison is None else comparison.record(),
    }
    return record, show


def run_query(command: QueryCommand) -> int:
    with open_database(command.run_folder) as database:
        answer = database.select(command.sql)
        show = print_json_rows if command.json else print_answer
        return FINE if show(answer) else NO


def run_tables(command: TablesCommand) -> None:
    require(not (command.json and command.format != "text"), "--json and --format exclude each other")
    tables = tables_of_run(command.run_folder)
    if command.json:
        print_json({"tables": {table.key: table_record(table) for table in tables}, "rows": rows_record(tables)})
    elif command.format == "text":
        for table in tables:
            print_table(table)
    else:
        print(markdown(tables) if command.format == "markdown" else latex(tables), end="")


def print_run(report: RunReport, show: int) -> None:
    """What keeps it from answering, the tables, the comparison, and where everything lies."""
    say_lines(report.causes, "bold yellow")
    shown, empty = with_figures(report.tables)
    for table in shown:
        print_table(table, caveats=False)
        say()
    if empty:
        say(f"without a figure other than 0, and left out: {', '.join(table.title for table in empty)}", style="dim")
    for caveat in dict.fromkeys(caveat for table in shown for caveat in table.caveats):
        say(caveat, style="yellow")
    if report.comparison is not None:
        print_comparison(report.comparison, show)
    done = [f"{n} {what}" for n, what in ((report.expressions, "expressions"), (report.pairs, "pairs")) if n]
    rate = (report.expressions or report.pairs) / report.seconds if report.seconds else 0.0
    say(f"{' and '.join(done)} in {report.seconds:.1f} s, {rate:.0f} a second")
    say(f"-> {report.folder}", style="dim")


def print_comparison(found: Comparison, show: int) -> None:
    """Differences with intervals and tests, and the first expressions of each kind."""
    say(f"compared on {counted(found.shared, 'expression')}", style="bold")
    tests = ((name, estimate, found.tests[name]) for name, estimate in found.differences.items())
    print_rows(
        ("measure", ">difference", ">only now correct", ">only before correct", ">McNemar p"),
        ((name, e.formatted(signed=True), str(test.b), str(test.c), f"{test.p_value:.2g}") for name, e, test in tests),
    )
    if found.verdicts is not None:
        say("verdicts: before in rows, after in columns", style="bold")
        after = [v for v in VERDICTS if any(v in line for line in found.verdicts.values())]
        print_rows(
            ("", *(f">{v}" for v in after)),
            (
                (before, *(Text(str(line.get(v, "·")), "dim" if v == before else "") for v in after))
                for before, line in found.verdicts.items()
            ),
        )
    for title, entries in (
        ("fixed", found.fixed),
        ("broken", found.broken),
        ("correct for another reason", found.other_reason),
    ):
        say(f"{title}: {len(entries)}")
        say_lines((f"  {entry['frame']}  {entry['text']}  ({entry['id']})" for entry in entries[:show]), "dim")
    say()


def run_record(report: RunReport) -> dict[str, Any]:
    """`eval --json`."""
    return {
        "run": str(report.folder),
        "expressions": report.expressions,
        "pairs": report.pairs,
        "causes": list(report.causes),
        "warnings": list(report.warnings),
        "shares": [share.record() for share in report.shares],
        "seconds": round(report.seconds, 2),
        "caveats": {t.key: list(t.caveats) for t in report.tables},
        "tables": {t.key: table_record(t) for t in report.tables},
        "rows": rows_record(report.tables),
        "comparison": None if report.comparison is None else report.comparison.record(),
    }


def print_failures(
    command: FailuresCommand,
    name: str,
    shares: Sequence[Share],
    summary: RunSummary | None,
    cuts: Sequence[Slices],
    found: tuple[int, int, list[dict[str, Any]]],
    comparison: Comparison | None,
) -> None:
    """Print the results of a search before verdicts, costs and slices of the run; without a search after.

    `found`: number of rows, of how many, and those that are shown.
    """
    if comparison is not None:
        print_comparison(comparison, 0)
    if command.search:
        _print_found(command, name, *found)
    if summary is not None:
        for table in (*summary_tables({name: summary}), *(slice_table(s, intervals=False) for s in cuts)):
            print_table(with_caveats(table, {name: shares}), caveats=False)
            say()
        say(cost_words(summary))
    if not command.search:
        _print_found(command, name, *found)
    say_lines((share.sentence for share in shares), "yellow")


def _print_found(command: FailuresCommand, name: str, count: int, of: int, shown: list[dict[str, Any]]) -> None:
    what = f"search {command.search}" if command.search else "failed"
    say((f"{what}: {count} of {counted(of, 'expression')}", "bold"), (f"  in {name}", "dim"))
    for row in shown:
        verdict = shown_verdict(row["verdict"], row["detail"], bool(row["lucky"]))
        changed = ""
        if row.get("change") not in (None, "same"):
            changed = f"  {CHANGES[row['change']]}: {row['second_verdict']}"
        marks = "".join(f"  #{name}" for name in row["marks"])
        told = (f"  {row['head']}", "bold yellow"), (f"  {verdict}", "yellow")
        say((row["frame"], "dim"), "  ", row["text"], *told, changed, (marks, "cyan"))
        say(f"    {row['said'] or ''}  ({row['id']})", style="dim")
    if count > command.limit:
        say(f"and {count - command.limit} more (--limit)", style="dim")
