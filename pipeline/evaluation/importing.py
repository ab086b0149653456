"""Runs made of what is there: of predictions, and back; and of results of an earlier version, judged again."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.coordinate_conventions import box_2d, check_places
from pipeline.answering.imported import ImportedPipeline, open_imported
from pipeline.answering.pair_rules import outranked
from pipeline.answering.predictions import (
    Header,
    Prediction,
    Predictions,
    as_json,
    parse_header,
)
from pipeline.answering.tracing import plain
from pipeline.datasets.saved_case import MANIFEST as CASE_FILE
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.diagnosis.cases.saving import open_case
from pipeline.evaluation.job import RunReport, evaluate_dataset
from pipeline.evaluation.run import Progress
from pipeline.evaluation.run_folder import RUN_FILE, Run, open_run
from pipeline.evaluation.systems import EvalSpec, System
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, read_cases
from pipeline.labels.job import label_dataset
from pipeline.labels.plan import load_plan
from pipeline.labels.reading import Labels, open_labels
from pipeline.labels.selection import SelectConfig
from pipeline.labels.store import PLAN_FILE, LabelStore
from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import scratch_folder, staged_folder

Record = Prediction | Mapping[str, Any]
VERSION_FIELD = "spatialviz_predictions"
LEAST_BESIDE = 10
"""Of fewer proposals nothing is said of where they lie."""
SIZES = (2.0, 1.5, 3.0, 4.0)
"""By how much pictures are often made smaller for a network."""


def import_run(
    predictions: str | Path,
    dataset: str | Path,
    labels: str | Path,
    out: str | Path,
    *,
    name: str | None = None,
    workers: int = 1,
    plots: bool = True,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> RunReport:
    """Judge the predictions of another pipeline on a dataset and labels; the run folder keeps a copy.

    `predictions`: a file as `docs/predictions.md` describes it. `name`: of the system in tables; the header's by
    default.
    `options`: of the dataset: intrinsics, depth_scale, up, ...

    Raises InputError: the file does not follow the schema, its frames or coordinates are not the dataset's, or no line
    is an expression of the labels; nothing is written then.
    """
    given: dict[str, Any] = {"predictions": Path(predictions), **options}
    spec = EvalSpec(str(dataset), str(labels), given)
    source, read = open_imported(dataset=spec.dataset, **given), open_labels(labels)
    file = source.predictions
    asked = {(t.frame, c.text) for t in read_cases(read, 0, 2**31 - 1) for c in t.cases if file.line(t.frame, c.text)}
    first = next(iter(file.lines.values()))
    require(
        asked,
        "no line of the file is an expression of the labels",
        got=f"{first.text!r} on frame {first.frame}, and {len(file.lines) - 1} more",
        expected="the words of an expression of the labels",
        path=file.path,
    )
    check_places([(source, frame) for frame in sorted({frame for frame, _ in asked})])
    spec = replace(spec, confidence=file.header.confidence)
    report = evaluate_dataset(
        spec,
        Path(out),
        name=name or file.header.system,
        workers=workers,
        plots=plots,
        overwrite=overwrite,
        progress=progress,
    )
    unasked, total = len(file.lines) - len(asked), read.manifest.counts["expressions"]
    warnings, causes = report.warnings, report.causes
    if file.unread:
        warnings += (file.unread,)
    if unasked > 0:
        causes += (f"{unasked} of {len(file.lines)} lines are no expression of the labels, and are not judged",)
    if len(asked) < total:
        warnings += (f"the file has lines for {len(asked)} of the {total} expressions of the labels",)
    if (words := _beside_all(source, read)) is not None:
        causes += (words,)
    if (words := _otherwise_ranked(file)) is not None:
        causes += (words,)
    return replace(report, warnings=warnings, causes=causes)


def import_records(
    records: str | Path | Iterable[Header | Record],
    dataset: str | Path,
    labels: str | Path,
    out: str | Path | None = None,
    *,
    header: Header | Mapping[str, Any] | None = None,
    **options: Any,
) -> Run:
    """Make a run of predictions of another pipeline, like `spatialviz import-run` of a file.

    Parameters
    ----------
    records : iterable of dict or Prediction, or path
        As the lines of `docs/predictions.md`, or the file of them; a header may come first.
    out : str or Path, optional
        The run's folder; by default a temporary one.
    header : Header or mapping, optional
        Fields of the first line ("system", "ranking", ...), where `records` begins with none.
    options
        What `import_run` takes: name, workers, plots, overwrite.

    Raises
    ------
    InputError
        As `import_run`; messages count the records from 1, without the header. No record.

    Warns
    -----
    UserWarning
        What `import-run` tells of a file: lines that are not read or not judged.

    Examples
    --------
    >>> import tempfile
    >>> from pipeline.datasets.demo import demo_labels
    >>> text = "which potted plant is on the left side of a shelf?"
    >>> line = {"frame": "000001/000000", "text": text, "answer": {"point": [320, 240]}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     import_records([line], "demo", demo_labels(), f"{folder}/run", header={"system": "mine"}, plots=False)
    <Run run: mine, 1 expressions>
    """
    return open_run(_judged(records, dataset, labels, out, header, options))


def _judged(
    records: str | Path | Iterable[Header | Record],
    dataset: str | Path,
    labels: str | Path,
    out: str | Path | None,
    header: Header | Mapping[str, Any] | None,
    options: Mapping[str, Any],
) -> Path:
    """The folder of the run."""
    folder = Path(tempfile.mkdtemp(prefix="spatialviz-run-")) / "run" if out is None else Path(out)
    if isinstance(records, str | Path):
        require(header is None, "a file has a header of its own", path=records)
        report = import_run(records, dataset, labels, folder, **options)
        for told in (*report.causes, *report.warnings):
            warnings.warn(told, stacklevel=3)
        return folder
    rest = iter(records)
    first = next(rest, None)
    if first is None:
        raise InputError("there are no predictions", expected="a record for each expression")
    if header is None and (isinstance(first, Header) or (not isinstance(first, Prediction) and VERSION_FIELD in first)):
        header = first
    else:
        rest = chain([first], rest)
    with scratch_folder() as place:
        file = Path(place) / "records.jsonl"
        try:
            if not isinstance(header, Header):
                header = parse_header({VERSION_FIELD: 1, **(header or {})}, file)
            with file.open("w", encoding="utf-8") as lines:
                for line in chain([header], rest):
                    lines.write(
                        as_json(line) if isinstance(line, (Header, Prediction)) else json.dumps(line, default=plain)
                    )
                    lines.write("\n")
            import_run(file, dataset, labels, folder, **options)
        except InputError as error:
            if error.path != file:
                raise
            raise InputError(_of_records(str(error).removesuffix(f" [{file}]"))) from error
    return folder


def _of_records(message: str) -> str:
    """Reword a message about lines of a file for the header and records from 1."""
    numbered = re.sub(r"\bline (\d+)", lambda found: f"record {int(found[1]) - 1}", message)
    return numbered.replace("record 0", "header")


def _otherwise_ranked(file: Predictions) -> str | None:
    """A warning where more than a tenth of the answers are not the best by the product that the header names."""
    if file.header.ranking != "product":
        return None
    answered = [line for line in file.lines.values() if line.ranked and line.answer is not None]
    off = [line for line in answered if outranked(file.header, line)]
    if len(off) <= len(answered) / 10:
        return None
    return (
        f"{len(off)} of {len(answered)} answers are not the best product of their line, as the header says; "
        f"the first: {file.where(off[0], 'answer')}. Does something else rank? "
        'Then say "ranking": "pair_scores", with pairs, or "none"'
    )


def _beside_all(source: ImportedPipeline, labels: Labels) -> str | None:
    """A warning where no proposal of any line lies on a labelled object, as of pictures of another size."""
    best, count, file = 0.0, 0, source.predictions
    on = dict.fromkeys(SIZES, 0)
    for truth in read_cases(labels, 0, 2**31 - 1):
        every = [p.box for line in file.of_frame(truth.frame) for p in line.objects.values() if p.box is not None]
        if every and len(truth.boxes):
            frame = source.dataset.load(truth.frame)
            boxes = np.array([box_2d(box, file.header, frame.width, frame.height) for box in every])
            best, count = max(best, float(iou_2d(boxes, truth.boxes).max())), count + len(every)
            for size in SIZES:
                on[size] += int((iou_2d(boxes * size, truth.boxes).max(axis=1) >= HIT).sum())
        if best >= HIT:
            return None
    if count < LEAST_BESIDE:
        return None
    size = max(SIZES, key=lambda size: on[size])
    likely = "another size of the pictures, or in another unit?"
    if on[size] >= count / 4:
        likely = f"smaller pictures? Times {size:g}, {on[size]} of them do"
    return f"none of {count} proposals lies on a labelled object (best overlap {best:.2f}): are their boxes of {likely}"


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
