"""The evaluation job: run, tabulate, draw, and leave a run folder that another run can be compared with."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from pipeline import __version__
from pipeline.diagnosis.confidence import median_confidence
from pipeline.errors import InputError
from pipeline.evaluation.compare import Comparison, compare, read_records
from pipeline.evaluation.grounding_tables import (
    clusters_of,
    full_row,
    opm_row,
    relation_table,
    stages_table,
    systems_table,
)
from pipeline.evaluation.intervals import BootstrapConfig
from pipeline.evaluation.reported import reported_rows
from pipeline.evaluation.run import EvalSpec, Progress, evaluate_labels, write_records
from pipeline.evaluation.tables import Table, as_csv, latex, markdown
from pipeline.labels.exports.staging import staged_folder, write_json
from pipeline.labels.merge import environment
from pipeline.labels.profiles import canonical_hash

if TYPE_CHECKING:
    import pyarrow as pa

RUN_FILE = "run.json"
"""The manifest of a run; a folder that holds it may be overwritten by another run."""


@dataclass(frozen=True)
class RunReport:
    """What an evaluation left.

    Attributes
    ----------
    folder : Path
    tables : tuple of Table
    expressions : int
    seconds : float
    comparison : Comparison or None
    """

    folder: Path
    tables: tuple[Table, ...]
    expressions: int
    seconds: float
    comparison: Comparison | None


def evaluate_dataset(
    spec: EvalSpec,
    out: Path,
    *,
    name: str | None = None,
    workers: int = 1,
    others: Sequence[Path] = (),
    against: Path | None = None,
    plots: bool = True,
    overwrite: bool = False,
    bootstrap: BootstrapConfig | None = None,
    progress: Progress | None = None,
) -> RunReport:
    """Evaluate a dataset on its labels and write the run folder, whole or not at all.

    Parameters
    ----------
    spec : EvalSpec
    out : Path
        `tables.md`, `tables.tex`, `tables/*.csv`, `records.parquet`, `plots/`, `run.json`.
    name : str, optional
        Of the system in the tables; by default detector and relation scorer.
    workers : int
    others : sequence of Path
        Runs on the same labels, whose systems become further rows.
    against : Path, optional
        The run to compare with: `comparison.json`.
    plots : bool
        Draw (extra: report).

    Raises
    ------
    InputError
        Dataset, labels or runs cannot be used, or `out` holds something else.
    """
    start = perf_counter()
    out = Path(out)
    before = None if against is None else read_records(against)
    rows_of_others = {run_name(run): read_records(run) for run in others}
    if plots:
        from pipeline.evaluation.plots import need_plots

        need_plots()
    source, labels = spec.open()
    detector = source.needed_detector()
    seen = 0
    if spec.system == "pipeline" and spec.confidence is None:
        confidence, seen = median_confidence(source, labels)
        spec = replace(spec, confidence=confidence)
    if name is None:
        name = {
            "pipeline": f"{detector.name} + {source.scorer.name}",
            "referring": f"{detector.name}, whole expression",
            "vlm": f"VLM {spec.vlm.model}" if spec.vlm else "VLM",
        }[spec.system]
    with staged_folder(out, overwrite=overwrite, mark=RUN_FILE) as folder:
        count = write_records(
            evaluate_labels(spec, workers=workers, progress=progress), folder / "records.parquet"
        )
        evaluated = perf_counter() - start
        records = read_records(folder)
        systems = {name: records, **rows_of_others}
        tables = make_tables(systems, bootstrap)
        (folder / "tables.md").write_text(markdown(tables), encoding="utf-8")
        (folder / "tables.tex").write_text(latex(tables), encoding="utf-8")
        (folder / "tables").mkdir()
        for table in tables:
            (folder / "tables" / f"{table.key}.csv").write_text(as_csv(table), encoding="utf-8")
        comparison = None if before is None else compare(before, records)
        if comparison is not None:
            write_json(folder / "comparison.json", comparison.record())
        if plots:
            from pipeline.evaluation.plots import draw

            draw(systems, tables, folder / "plots")
        config = {**asdict(source.config), "options": {k: str(v) for k, v in spec.options.items() if k != "config"}}
        plain = json.loads(json.dumps(config, default=str))
        write_json(
            folder / RUN_FILE,
            {
                "tool": "spatialviz",
                "version": __version__,
                "name": name,
                "dataset": spec.dataset,
                "labels": {"path": spec.labels, "config_hash": labels.manifest.config_hash,
                           "content_hash": labels.manifest.tables["expressions"].content_hash},
                "detector": f"{detector.name}: {detector.fingerprint()}",
                "scorer": source.scorer.name,
                "system": spec.system,
                "vlm": None if spec.vlm is None else {"url": spec.vlm.url, "model": spec.vlm.model},
                "limit": spec.limit,
                "marks": len(spec.marks),
                "recalled_confidence": {"median": spec.confidence, "of": seen},
                "config": plain,
                "config_hash": canonical_hash(plain),
                "expressions": count,
                "clusters": clusters_of(records)[1],
                "seconds": {"evaluating": round(evaluated, 2), "in_all": round(perf_counter() - start, 2)},
                "environment": environment(),
                "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            },
        )  # fmt: skip
    return RunReport(out, tuple(tables), count, perf_counter() - start, comparison)


def make_tables(systems: dict[str, pa.Table], bootstrap: BootstrapConfig | None = None) -> list[Table]:
    """All tables of a run; the first system is the run itself."""
    first = next(iter(systems.values()))
    rows = []
    for name, records in systems.items():
        if records.column("opm_iou").null_count < records.num_rows:
            rows.append(opm_row(f"{name}: OPM only", records, bootstrap))
        rows.append(full_row(name, records, bootstrap))
    unit = clusters_of(first)[1]
    grounding = systems_table([*rows, *reported_rows()], unit)
    return [grounding, relation_table(systems, bootstrap), stages_table(systems)]


def run_name(run: Path) -> str:
    """The name of a run's system.

    Raises
    ------
    InputError
        There is no run.
    """
    path = Path(run) / RUN_FILE
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["name"])
    except FileNotFoundError as error:
        raise InputError("no evaluation run here", expected="a folder that `eval` wrote", path=run) from error
    except (ValueError, KeyError) as error:
        raise InputError("the run's manifest cannot be read", got=str(error), path=path) from error
