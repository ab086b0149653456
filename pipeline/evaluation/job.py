"""The evaluation job: run, tabulate, diagnose, draw, and leave a run folder that others can be compared with."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from time import perf_counter
from typing import Any

from pipeline.diagnosis.verdict import RULES_VERSION
from pipeline.evaluation.causes import causes_of
from pipeline.evaluation.comparing import Comparison, compare
from pipeline.evaluation.confusion import Confusion, answer_standings, count_standings
from pipeline.evaluation.grounding_tables import (
    calibration_warnings,
    clusters_of,
    make_tables,
    recorded_config,
)
from pipeline.evaluation.leakage import (
    Share,
    leakage,
    measured_of_run,
    title_of,
    titles_of,
    with_caveats,
)
from pipeline.evaluation.plots import draw_accuracy, draw_diagnosis, draw_relations, need_matplotlib
from pipeline.evaluation.records import read_records, records_schema
from pipeline.evaluation.relation_cases import RelationSpec, labelled_detector
from pipeline.evaluation.relation_report import measure_relations, relation_sink, shares_by_title
from pipeline.evaluation.run import Progress, evaluate_labels, median_confidence
from pipeline.evaluation.run_folder import RUN_FILE, Run, open_run, read_manifest, spec_record
from pipeline.evaluation.slices import DIMENSIONS, Slices, slice_by, slice_table
from pipeline.evaluation.summary import RunSummary, has_verdicts, summarise_run, summary_tables
from pipeline.evaluation.systems import OWN, EvalSpec, system_of
from pipeline.labels.merge import environment
from pipeline.labels.plan import BY_TIME, files_hash
from pipeline.labels.profiles import canonical_hash
from pipeline.labels.provenance import Makers, makers_of
from pipeline.labels.reading import Labels, labelled_up, open_labels
from pipeline.metrics.intervals import BootstrapConfig
from pipeline.metrics.tables import NOTHING_SHARED, Table, as_csv, latex, markdown
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import MissingExtra, require
from pipeline.system.frozen import dataclass
from pipeline.system.version import __version__
from pipeline.system.whole_files import staged_folder, write_json

CHANGED = "files of the dataset changed while the run was made: some answers are of what was there before"


PaperTables = Callable[..., "list[Table]"]
"""Makes further tables of a run's folder: called as `pipeline.paper.tables_of_folder`."""


@dataclass(frozen=True)
class RunReport:
    """What an evaluation left."""

    folder: Path
    tables: tuple[Table, ...]
    expressions: int
    seconds: float
    comparison: Comparison | None
    pairs: int = 0  # on which relations were measured alone
    warnings: tuple[str, ...] = ()  # why figures say less than they seem to
    causes: tuple[str, ...] = ()  # what keeps it from answering: names not known, frames not labelled or not opened
    shares: tuple[Share, ...] = ()  # what answers have in common with what made the labels

    def __repr__(self) -> str:
        return f"<RunReport {self.folder.name}: {self.expressions} expressions, {len(self.tables)} tables>"


def evaluate_dataset(
    spec: EvalSpec,
    out: Path,
    *,
    name: str | None = None,
    workers: int = 1,
    others: Sequence[Path] = (),
    against: Path | None = None,
    paper: PaperTables | None = None,
    plots: bool = True,
    overwrite: bool = False,
    bootstrap: BootstrapConfig | None = None,
    progress: Progress | None = None,
) -> RunReport:
    """Evaluate a dataset on labels and write the run folder, whole or not at all.

    `out`: `tables.md`, `tables.tex`, `tables/*.csv`, `slices.md`, `records.parquet`, `relation_records.parquet`,
    `diagnosis.json`, `plots/`, `run.json`. `name`: of the system in the tables; by default detector and relation
    scorer. `others`: runs on the same labels, whose systems become further rows. `against`: the run to compare with:
    `comparison.json`. `paper`: makes the paper's tables, which stand first and are those of the report:
    `pipeline.paper.tables_of_folder`. `plots`: draw; without the extra `report` they are left out with a warning.

    Raises InputError: dataset, labels or runs cannot be used, or `out` holds something else.
    """
    start = perf_counter()
    out = Path(out)
    for name_of, count_of in (("--limit", spec.limit), ("--workers", workers)):
        require(count_of is None or count_of >= 1, f"{name_of} is a count", got=count_of, expected="at least 1")
    before = None if against is None else read_records(against)
    left_out: tuple[str, ...] = ()
    if plots and (why := MissingExtra.missing(need_matplotlib)):
        plots, left_out = False, (f"the plots are left out, as with --no-plots: {why}",)
    require(
        spec.grounding or (against is None and not others and spec.relations is not None),
        "runs are compared by their expressions, and this one answers none",
    )
    # Answers are judged by labels, and so in their axes.
    spec = replace(spec, options=labelled_up(open_labels(spec.labels).manifest, spec.options))
    system = system_of(spec)
    source, labels = spec.open()
    detector = source.needed_detector() if spec.grounding else labelled_detector(source)
    seen = 0
    if system.name == OWN and spec.grounding and spec.verdicts and spec.confidence is None:
        confidence, seen = median_confidence(source, labels)
        spec = replace(spec, confidence=confidence)
    if name is None:
        name = system.title(replace(source, detector=detector))
    decisions: tuple[str, ...] = ()
    if spec.grounding:
        system, decisions = system.decided(spec, source, labels)
        spec = replace(spec, system=spec.system and system)
    asked = labels.manifest.tables["expressions"].content_hash
    makers = makers_of(labels.manifest)
    measured = system.measured(source, labels.relation_names) if spec.grounding else None
    own = () if measured is None else leakage(makers, measured)
    of_others = other_systems(others, name, asked, makers)
    shares = {name: own, **{n: shared for n, (_, shared) in of_others.items()}}
    files = files_hash(source.dataset.root, out, BY_TIME)
    with staged_folder(out, overwrite=overwrite, mark=RUN_FILE) as folder:
        with (
            relation_sink(spec, labels, folder) as sink,
            pq.ParquetWriter(folder / "records.parquet", records_schema(), compression="zstd") as writer,
        ):
            tables = evaluate_labels(spec, workers=workers, progress=progress, relations=sink)
            for table in in_groups(tables):
                writer.write_table(table, row_group_size=table.num_rows or None)
        evaluated = perf_counter() - start
        changed = () if files_hash(source.dataset.root, out, BY_TIME) == files else (CHANGED,)
        records = read_records(folder)
        systems = {name: records, **{n: answered for n, (answered, _) in of_others.items()}}
        tables = make_tables(systems, bootstrap, shares) if spec.grounding else []
        relations = None if sink is None else measure_relations(spec, source, labels, folder, bootstrap)
        tables += [] if relations is None else relations.tables
        diagnosed = spec.grounding and spec.verdicts and system.name == OWN
        diagnosis = diagnose_run(systems, labels, bootstrap, shares) if diagnosed else None
        tables += [] if diagnosis is None else diagnosis.tables
        shown = tables
        if paper is not None:
            blocks = {n: title_of(found) for n, found in shares.items()}
            blocks |= {} if relations is None else {n: share.title for n, share in relations.shares.items()}
            held_out = spec.relations is not None and spec.relations.pairs == "held-out"
            answered = systems if spec.grounding else {}
            shown = paper(folder, labels, answered, blocks, held_out=held_out, config=bootstrap)
            tables = [*shown, *tables]
        write_tables(tables, folder, "tables.md")
        (folder / "tables.tex").write_text(latex(tables), encoding="utf-8")
        comparison = None if before is None else compare(before, records)
        if comparison is not None:
            write_json(folder / "comparison.json", comparison.record())
        if diagnosis is not None:
            diagnosis.write(folder)
        if plots:
            if spec.grounding:
                accuracy = next(t for t in tables if t.key == "relations")
                draw_accuracy(accuracy, folder / "plots", titles_of(shares))
            if relations is not None:
                alike = titles_of(shares_by_title(relations.figures, relations.shares))
                draw_relations(relations.figures, folder / "plots", alike)
            if diagnosis is not None:
                draw_diagnosis(diagnosis.summaries, folder / "plots", titles_of(diagnosis.shares))
        of_calibration = calibration_warnings(source, labels, records) if spec.grounding and system.name == OWN else ()
        of_relations = () if relations is None else relations.warnings
        causes = causes_of(records, source, labels, detector if system.name == OWN else None) if spec.grounding else ()
        warnings = (*decisions, *left_out, *changed, *of_calibration, *of_relations)
        options = {k: str(v) for k, v in spec.options.items() if k != "config"}
        config = {**recorded_config(source.config), "options": options}
        plain = json.loads(json.dumps(config, default=str))
        spec, more = system.kept(spec, source, folder, out.resolve())
        write_json(
            folder / RUN_FILE,
            {
                "tool": "spatialviz",  # Program that wrote it
                "version": __version__,  # Of the program
                "verdict_rules": RULES_VERSION,  # Version of the rules of verdicts
                "name": name,  # Of the system that answered
                # Hashes of the labels that were asked
                "labels": {"config_hash": labels.manifest.config_hash, "content_hash": asked},
                # What found the objects, with its fingerprint
                "detector": f"{detector.name}: {detector.fingerprint()}",
                "scorer": source.scorer.name,  # What scored relations
                "system": system.name,  # Kind: pipeline, referring, vlm, imported
                # Of a vision-language model: which, and how it was asked
                "vlm": None if spec.pairs is None else spec.pairs.record(),
                "limit": spec.limit,  # Only so many expressions; null for all
                # What was evaluated, on what; paths as seen from this folder
                "spec": json.loads(json.dumps(spec_record(spec, out.resolve()), default=str)),
                **more,
                "marks": len(spec.marks),  # Expressions that a person marked as wrong
                # Score that an object gets that the detector missed
                "recalled_confidence": {"median": spec.confidence, "of": seen},
                "config": plain,  # All settings of an answer
                "config_hash": canonical_hash(plain),  # Of `config`
                "expressions": records.num_rows,  # How many were answered
                "warnings": [*causes, *warnings],  # What a reader should know
                "makers": makers.record(),  # What made the labels
                "measured": None if measured is None else measured.record(),  # What was measured
                "shares": [share.record() for share in own],  # Makers that labels and answers have in common
                # What the intervals are drawn over: scene or frame
                "clusters": clusters_of(records)[1] if spec.grounding else None,
                "relations": None if relations is None else relations.record,  # Relations measured alone, pair by pair
                # Time it took
                "seconds": {"evaluating": round(evaluated, 2), "in_all": round(perf_counter() - start, 2)},
                "environment": environment(),  # Versions of Python and libraries
                "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),  # Time, UTC
            },
        )
        if not spec.grounding:
            (folder / "records.parquet").unlink()
    return RunReport(
        out,
        tuple(shown),
        records.num_rows,
        perf_counter() - start,
        comparison,
        0 if relations is None else relations.pairs,
        warnings,
        causes,
        own,
    )


def evaluate(
    dataset: str | Path,
    labels: str | Path | Labels,
    out: str | Path,
    *,
    limit: int | None = None,
    name: str | None = None,
    workers: int = 1,
    against: str | Path | None = None,
    relations: bool = True,
    plots: bool = True,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Run:
    """Answer every expression of labels, and write the run folder: tables, records, verdicts, plots.

    Parameters
    ----------
    out : str or Path
        Run folder to write.
    limit : int, optional
        Only so many expressions, spread evenly.
    against : str or Path, optional
        A run to compare with.
    relations : bool
        Measure relations alone too, pair by pair.
    options
        Further arguments of `open_pipeline`: detector, model, min_score, srm, config, ...

    Examples
    --------
    >>> import tempfile
    >>> from pipeline.datasets.demo import demo_labels
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     evaluate("demo", demo_labels(), f"{folder}/run", limit=20, relations=False, plots=False).verdicts
    {'CORRECT': 19, 'LABEL': 1}
    """
    vectors = options.get("vectors")
    alone = RelationSpec(vectors=None if vectors is None else str(vectors)) if relations else None
    where = labels.root if isinstance(labels, Labels) else labels
    spec = EvalSpec(str(dataset), str(where), options, limit=limit, relations=alone)
    report = evaluate_dataset(
        spec,
        Path(out),
        name=name,
        workers=workers,
        against=None if against is None else Path(against),
        plots=plots,
        overwrite=overwrite,
        progress=progress,
    )
    return open_run(report.folder)


ROWS_A_GROUP = 4096
"""Rows that are written together: fewer make searches slower, more the reading of a few rows."""


def in_groups(tables: Iterable[pa.Table], rows: int = ROWS_A_GROUP) -> Iterator[pa.Table]:
    """Join tables to larger ones of at least so many rows, but for the last."""
    waiting: list[pa.Table] = []
    for table in tables:
        waiting.append(table)
        if sum(part.num_rows for part in waiting) >= rows:
            yield pa.concat_tables(waiting)
            waiting = []
    if waiting:
        yield pa.concat_tables(waiting)


def other_systems(
    runs: Sequence[Path], name: str, content_hash: str, makers: Makers
) -> dict[str, tuple[pa.Table, tuple[Share, ...]]]:
    """Records of other runs by system, with everything shared with the labels' makers.

    A name that is taken is told apart by its run's folder, and by a number where that is not enough.

    `name`: of the run that they stand beside. `content_hash`: of the expressions that were asked.

    Raises InputError: there is no run, or it is of other labels.
    """
    found: dict[str, tuple[pa.Table, tuple[Share, ...]]] = {}
    taken = {name}
    for run in map(Path, runs):
        manifest = read_manifest(run)
        asked = manifest.get("labels", {}).get("content_hash")
        require(
            asked == content_hash,
            "a run on other labels cannot be a row beside this one",
            got=f"expressions {asked}",
            expected=f"expressions {content_hash}",
            path=run,
        )
        own = str(manifest["name"])
        choices = [own, f"{own} ({run.resolve().name})"]
        choices += [f"{own} ({run.resolve().name}, {k})" for k in range(2, len(runs) + 2)]
        own = next(n for n in choices if n not in taken)
        taken.add(own)
        found[own] = read_records(run), leakage(makers, measured_of_run(manifest))
    return found


def write_tables(tables: Sequence[Table], folder: Path, name: str) -> None:
    """Write tables under each other into a file of Markdown of this name, and each as `tables/KEY.csv`."""
    (folder / name).write_text(markdown(tables), encoding="utf-8")
    (folder / "tables").mkdir(exist_ok=True)
    for table in tables:
        (folder / "tables" / f"{table.key}.csv").write_text(as_csv(table), encoding="utf-8")


DIAGNOSIS_FILE = "diagnosis.json"
MOST = 20
"""Classes, scenes and frames of their own in files; the rest is one slice."""


@dataclass(frozen=True)
class RunDiagnosis:
    """The diagnosis of a run and of those beside it."""

    summaries: dict[str, RunSummary]  # by system; those without verdicts are left out
    slices: tuple[Slices, ...]  # by every dimension that the runs have
    confusions: tuple[Confusion, ...]  # that of the answers, where the labels are at hand
    shares: Mapping[str, Sequence[Share]]  # what the systems have in common with what made the labels

    @property
    def tables(self) -> list[Table]:
        """Tables of verdicts and oracles; empty without verdicts."""
        return [with_caveats(table, self.shares) for table in summary_tables(self.summaries)]

    def record(self) -> dict[str, Any]:
        """Convert to JSON: `diagnosis.json`."""
        return {
            "systems": {name: s.record() for name, s in self.summaries.items()},
            "slices": {s.dimension.name: s.record() for s in self.slices},
            "confusions": {c.key: c.record() for c in self.confusions},
        }

    def write(self, folder: Path) -> None:
        """Write `diagnosis.json`, `slices.md` and tables into a run's folder."""
        write_json(folder / DIAGNOSIS_FILE, self.record())
        tables = [*map(slice_table, self.slices), *(c.table() for c in self.confusions)]
        write_tables([with_caveats(table, self.shares) for table in tables], folder, "slices.md")


def diagnose_run(
    systems: Mapping[str, pa.Table],
    labels: Labels | None = None,
    config: BootstrapConfig | None = None,
    shares: Mapping[str, Sequence[Share]] = NOTHING_SHARED,
) -> RunDiagnosis:
    """Summaries, slices and confusions of runs; the first is the run itself.

    `systems`: records by system. `labels`: of the first run: needed for the confusion of its answers.
    """
    confusions = [] if labels is None else [count_standings(answer_standings(next(iter(systems.values())), labels))]
    summaries = {name: summarise_run(r, config) for name, r in systems.items() if has_verdicts(r)}
    cuts = [d for d in DIMENSIONS.values() if all(d.column in r.column_names for r in systems.values())]
    slices = tuple(slice_by(systems, d, config, most=MOST) for d in cuts)
    return RunDiagnosis(summaries, slices, tuple(confusions), {name: shares.get(name, ()) for name in summaries})
