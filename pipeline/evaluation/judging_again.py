"""Results of an earlier version judged by this one: a run, labels or a case, into a new folder beside the old one."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.datasets.saved_case import MANIFEST as CASE_FILE
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.diagnosis.cases.saving import open_case
from pipeline.evaluation.importing import import_run
from pipeline.evaluation.job import evaluate_dataset
from pipeline.evaluation.run import Progress
from pipeline.evaluation.run_folder import RUN_FILE, open_run
from pipeline.evaluation.systems import System
from pipeline.labels.job import label_dataset
from pipeline.labels.merge import SelectConfig
from pipeline.labels.plan import load_plan
from pipeline.labels.reading import open_labels
from pipeline.labels.store import PLAN_FILE, LabelStore
from pipeline.system.errors import require
from pipeline.system.whole_files import staged_folder


def judge_again(
    path: str | Path,
    out: str | Path,
    *,
    workers: int = 1,
    plots: bool = True,
    progress: Progress | None = None,
    system: Callable[[Mapping[str, Any]], System | None],
) -> dict[str, Any]:
    """Judge a run, labels or a saved case again, by this version, into a new folder; the old one stays unchanged.

    `path`: a folder of `eval` or `import-run`, of `label`, or of `save-case`. `out`: must not exist, or be empty.
    `system`: gives the system of a `run.json` that is not the pipeline's: `pipeline.paper.recorded_system`.

    Returns "kind" ("run", "labels" or "case"), "out", and "expressions", "frames" or "changes".

    Raises InputError: it is none of these, its data or models are gone, or `out` is in use.
    """
    path, out = Path(path), Path(out)
    record = {"out": str(out)}
    if (path / CASE_FILE).is_file():
        return {"kind": "case", **record, "changes": list(_case(path, out))}
    if (path / RUN_FILE).is_file():
        return {"kind": "run", **record, "expressions": _run(path, out, workers, plots, progress, system)}
    require(
        (path / PLAN_FILE).is_file(),
        "nothing here says how it was made",
        expected=f"a run ({RUN_FILE}), labels ({PLAN_FILE}) or a case ({CASE_FILE})",
        path=path,
    )
    return {"kind": "labels", **record, "frames": _labels(path, out, workers, progress)}


def _run(
    path: Path,
    out: Path,
    workers: int,
    plots: bool,
    progress: Progress | None,
    system: Callable[[Mapping[str, Any]], System | None],
) -> int:
    run = open_run(path)
    options: dict[str, Any] = {**run.spec.options, "name": run.name, "workers": workers, "plots": plots}
    if (predictions := options.pop("predictions", None)) is None:
        spec = replace(run.spec, system=system(run.manifest))
        report = evaluate_dataset(spec, out, name=run.name, workers=workers, plots=plots, progress=progress)
        return report.expressions
    require(
        not options.pop("rescored", False),
        "the run was ranked again by a function, which no folder holds",
        expected="import-run FILE, judged by the scores of its pairs",
        path=path,
    )
    return import_run(predictions, run.spec.dataset, run.spec.labels, out, progress=progress, **options).expressions


def _labels(path: Path, out: Path, workers: int, progress: Progress | None) -> int:
    plan, manifest = load_plan(LabelStore(path)), open_labels(path).manifest
    count = len(plan.frames)
    require(
        plan.frames == plan.spec.open(plan.config).dataset.frame_ids[:count],
        "these labels are of some of the dataset's splits only",
        expected="spatialviz label with the same --frames-of",
        path=path,
    )
    select = SelectConfig(**manifest.selection)
    report = label_dataset(plan.spec, out, plan.config, select, workers=workers, limit=count, progress=progress)
    return report.frames


def _case(path: Path, out: Path) -> tuple[str, ...]:
    with staged_folder(out, overwrite=False, mark=CASE_FILE) as folder:
        shutil.copytree(path, folder, dirs_exist_ok=True)
        opened = open_case(folder)
        replay = replay_case(opened)
        opened.expect(replay.record)
    return replay.changes
