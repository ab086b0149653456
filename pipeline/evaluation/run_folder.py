"""Run folders opened again, here or elsewhere: specification, records, tables, failures answered once more."""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from pydantic import TypeAdapter

from pipeline.answering.ask import AskConfig
from pipeline.answering.imported import open_source
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets.demo import DEMO_NAME
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import answer, labelled_truth
from pipeline.diagnosis.not_seen import SceneMaps
from pipeline.diagnosis.opened import Opened
from pipeline.diagnosis.verdict import VERDICTS, shown_verdict
from pipeline.evaluation.browsing import RunRows
from pipeline.evaluation.leakage import Share, shares_of_run
from pipeline.evaluation.records import read_records
from pipeline.evaluation.records_file import open_records, texts_of
from pipeline.evaluation.search import find_failures
from pipeline.evaluation.systems import OWN, EvalSpec
from pipeline.labels.reading import Labels, open_labels, read_table
from pipeline.labels.schema import TABLES
from pipeline.language.counted import counted
from pipeline.system.arrow import pa
from pipeline.system.detector_setup import with_files
from pipeline.system.errors import InputError, as_input_error, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.in_notebook import InNotebook
from pipeline.system.model_files import parse_hub_id
from pipeline.system.reading import checked
from pipeline.system.remote import is_url, local_path, named_before
from pipeline.system.safe_files import enter, read_json, read_text
from pipeline.system.sql import QueryDatabase
from pipeline.system.whole_files import scratch_folder

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

RUN_FILE = "run.json"
"""The manifest of a run; a folder that holds it may be overwritten by another run."""
RECORDS_FILE = "records.parquet"
RECORDS = "records"
"""View of the records in SQL."""
_HUB = "hub:"
"""Marks an id on the model hub among paths."""


Answered = Callable[[str, str], Answer]
"""Answers an expression of the labels again, by its frame and id."""


@dataclass(frozen=True)
class Failure(InNotebook):
    """One expression of a run."""

    row: Mapping[str, Any]  # its record: column -> value, as in `records.parquet`
    again: Answered = field(repr=False, compare=False)

    def __repr__(self) -> str:
        return f"<Failure {self.row['text']!r} on {self.row['frame']!r}: {self.verdict}>"

    @property
    def verdict(self) -> str:
        """Verdict with detail: "OPM-TARGET RANK"."""
        return shown_verdict(self.row["verdict"], self.row["detail"], bool(self.row["lucky"]))

    @cached_property
    def answer(self) -> Answer:
        """Answer by the run's models now, judged as in the run; InputError for lost data or models."""
        return self.again(self.row["frame"], self.row["id"])


@dataclass(frozen=True, eq=False)
class Failures(InNotebook):
    """A table of expressions of a run, in the order of the run or as the search sorts them: `found[0]`, `found[:5]`,
    `len(found)`, and a loop.

    What reads Arrow's streams takes it as it is: `polars.DataFrame(found)`, `pyarrow.table(found)`.
    """

    search: str  # what found them
    table: pa.Table  # all columns of the run's records
    again: Answered = field(repr=False)

    def __repr__(self) -> str:
        return f"<Failures {self.search!r}: {counted(len(self), 'expression')}>"

    def __len__(self) -> int:
        return self.table.num_rows

    def __iter__(self) -> Iterator[Failure]:
        return (self[k] for k in range(len(self)))

    @overload
    def __getitem__(self, key: int) -> Failure: ...
    @overload
    def __getitem__(self, key: slice) -> Failures: ...
    def __getitem__(self, key: int | slice) -> Failure | Failures:
        rows = range(len(self))[key]
        if isinstance(rows, int):
            return Failure(self.table.slice(rows, 1).to_pylist()[0], self.again)
        return Failures(self.search, self.table.take(pa.array(rows, pa.int64())), self.again)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self.table.__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> Any:
        """All columns as a pandas.DataFrame; ImportError without pandas."""
        return self.table.to_pandas()


def asked_again(opened: Opened, spec: EvalSpec, frame: str, expression: str) -> Answer:
    """Answer an expression of the labels (by id) now, judged by the run's specification.

    Raises InputError: the dataset has no such frame, or the labels no such expression.
    """
    assert opened.labels is not None
    source, root = opened.pipeline, opened.labels.root
    truth = needed(labelled_truth(frame, source, opened.labels), f"the labels say nothing of frame {frame}", path=root)
    case = next((c for c in truth.cases if c.id == expression), None)
    case = needed(case, f"the labels have no expression {expression} of frame {frame}", path=root)
    mark, context = spec.marks.get((frame, expression)), source.prepare(frame)
    found = answer(source, context, case.text, truth=truth, case=case, mark=mark, confidence=spec.confidence)
    maps = spec.maps(source.dataset)
    return replace(found if maps is None else maps.answered(found), origin=opened)


@dataclass(frozen=True, eq=False)
class Run(InNotebook):
    """A finished evaluation.

    >>> from pipeline.datasets.demo import demo_run
    >>> run = open_run(demo_run())
    >>> run.verdicts["OPM-CONF"], run.records.num_rows
    (120, 1800)
    >>> run.failures("verdict:SRM")[0]
    <Failure 'show me the lamp above the rug' on '000002/000002': SRM>
    """

    folder: Path  # The run folder
    name: str  # Of the system that answered
    manifest: Mapping[str, Any]  # the whole of `run.json`
    spec: EvalSpec  # what was evaluated on what; paths are those of this machine

    def __repr__(self) -> str:
        return f"<Run {self.folder.name}: {self.name}, {self.manifest.get('expressions')} expressions>"

    @property
    def system(self) -> str:
        """Kind of system: "pipeline", "referring", "vlm"."""
        return str(self.manifest.get("system", OWN))

    @cached_property
    def tables(self) -> dict[str, list[dict[str, str | float]]]:
        """The run's tables by name, each a list of rows: column -> text or number, as in `tables/*.csv`. Shares lie
        between 0 and 1; an empty cell is left out. Empty for a run whose tables were not kept."""
        return {path.stem: _rows(path) for path in sorted((self.folder / "tables").glob("*.csv"))}

    @cached_property
    def verdicts(self) -> dict[str, int]:
        """How many expressions have each verdict, in the order of VERDICTS; empty for a run without any."""
        if "verdict" not in self.on_file.column_names:
            return {}
        counts = Counter(texts_of(self.on_file, "verdict").tolist())
        return {name: counts[name] for name in VERDICTS if counts[name]}

    @cached_property
    def records(self) -> pa.Table:
        """One row an expression.

        Raises
        ------
        InputError
            They are missing or damaged.
        """
        return read_records(self.folder)

    @cached_property
    def on_file(self) -> Records:
        """The same, read as they are asked for; raises as `open_records`."""
        return open_records(self.folder)

    @cached_property
    def frame_counts(self) -> dict[str, tuple[int, int]]:
        """By frame, how many expressions are answered right, by any of the acceptable answers, and how many are not."""
        table = self.on_file.select(["frame", "set_correct"]).group_by("frame", use_threads=False)
        table = table.aggregate([("set_correct", "sum"), ("set_correct", "count")])
        frames, right, all_ = (table.column(c).to_pylist() for c in ("frame", "set_correct_sum", "set_correct_count"))
        return {f: (r or 0, n - (r or 0)) for f, r, n in zip(frames, right, all_, strict=True)}

    @cached_property
    def source(self) -> Pipeline:
        """The dataset with the run's models, or with the predictions that were imported; raises as `open_source`."""
        return open_source(named_before(self.spec.dataset), **self.spec.options)

    @cached_property
    def shares(self) -> tuple[Share, ...]:
        """Shares of the answers with the labels' makers, and so the meaning of the figures."""
        return shares_of_run(self.manifest, self.spec.labels)

    @cached_property
    def labels(self) -> Labels:
        """The labels; raises as `open_labels`."""
        return open_labels(named_before(self.spec.labels))

    @cached_property
    def maps(self) -> SceneMaps | None:
        """The object maps; errors as of `open_scene_maps`."""
        return self.spec.maps()

    def failures(self, search: str = "") -> Failures:
        """Expressions found by a search, as by `spatialviz failures`: "verdict:SRM relation:behind margin<0.1"; without
        a search all failures.

        Raises
        ------
        InputError
            The search cannot be read, or the run has no verdicts.
        """
        return Failures(search, find_failures(RunRows(self.on_file, self.folder).records, search), self.answer)

    def answer(self, frame: str, expression: str) -> Answer:
        """Answer an expression of the labels by id, with the run's models now, judged as in the run.

        Raises
        ------
        InputError
            As `source` and `labels`; or the labels have no such expression.
        """
        return asked_again(Opened(self.source, self.labels), self.spec, frame, expression)


def _rows(path: Path) -> list[dict[str, str | float]]:
    """Rows of a table in CSV."""
    lines = io.StringIO(read_text(path), newline="")
    return [{name: _number(cell) for name, cell in row.items() if cell} for row in csv.DictReader(lines)]


def _number(cell: str) -> str | float:
    try:
        return float(cell)
    except ValueError:
        return cell


def spec_record(spec: EvalSpec, folder: Path) -> dict[str, Any]:
    """A specification as JSON.

    What lies in or beside the run's folder is named as seen from it, so that
    both may be moved together; everything else by its absolute path.
    """
    given = {k: v for k, v in spec.options.items() if k != "config" and v is not None}
    config = spec.options.get("config")
    return {
        "dataset": spec.dataset if spec.dataset == DEMO_NAME else written_path(spec.dataset, folder),
        "labels": written_path(spec.labels, folder),
        "options": with_files(given, lambda path: _written_model(path, folder)),
        "config": None if config is None else asdict(config),
        "system": OWN if spec.system is None else spec.system.name,
        "limit": spec.limit,
        "confidence": spec.confidence,
        "marks": [[frame, expression, mark] for (frame, expression), mark in sorted(spec.marks.items())],
    } | ({} if spec.map is None else {"map": written_path(spec.map, folder)})


def written_path(path: str | Path, folder: Path) -> str:
    """Write a path for the manifest of a run in `folder`; a URL stays."""
    if is_url(path):
        return str(path)
    absolute = os.path.abspath(path)
    try:
        nearby = os.path.relpath(absolute, os.path.abspath(folder))
    except ValueError:  # Another drive.
        return absolute
    return absolute if nearby.startswith(os.path.join("..", "..")) else Path(nearby).as_posix()


def resolved_path(written: str, folder: Path) -> str:
    """Resolve a path of `written_path` for a run in `folder`."""
    return written if is_url(written) else os.path.normpath(folder / written)


def _written_model(path: str | Path, folder: Path) -> str:
    hub_id = parse_hub_id(path)
    return written_path(path, folder) if hub_id is None else f"{_HUB}{hub_id}"


def _resolved_model(written: str, folder: Path) -> Path:
    if written.startswith(_HUB):
        return Path(written.removeprefix(_HUB))
    return Path(resolved_path(written, folder))


def read_manifest(folder: Path) -> dict[str, Any]:
    """The whole of `run.json`.

    Raises InputError: no run there, or a manifest that cannot be read.
    """
    path, wrong = enter(folder) / RUN_FILE, "the run's manifest cannot be read"
    with as_input_error(wrong, OSError, ValueError, KeyError, TypeError, got=str, path=path):
        require(path.is_file(), "no evaluation run here", expected="a folder that `eval` wrote", path=folder)
        manifest = read_json(path)
        if not isinstance(manifest["name"], str) or not isinstance(manifest.get("labels", {}), dict):
            raise ValueError("no name of a system, or no labels")
    return manifest


def open_run(folder: str | Path, *, dataset: str | None = None, labels: str | None = None) -> Run:
    """Open a run folder.

    Parameters
    ----------
    dataset, labels : str, optional
        Where they are now, if they are no longer where the run found them.

    Raises
    ------
    InputError
        No run there, a manifest that cannot be read, or one of an earlier release.

    Examples
    --------
    >>> from pipeline.datasets.demo import demo_run
    >>> open_run(demo_run())
    <Run run: simulated detector, 1800 expressions>
    """
    folder = Path(folder)
    path, manifest = folder / RUN_FILE, read_manifest(folder)
    require(
        isinstance(manifest.get("spec"), dict),
        "the run does not say what it was made of",
        cause="made by an earlier release? run `eval` again",
        path=path,
    )
    with as_input_error("the run's manifest cannot be read", KeyError, TypeError, ValueError, got=str, path=path):
        spec = _read_spec(manifest["spec"], folder, manifest.get("config"))
    if dataset is not None:
        if is_url(dataset):
            local_path(dataset)  # So that it was named by a person.
        spec = replace(spec, dataset=dataset)
    if labels is not None:
        if is_url(labels):
            open_labels(labels)  # So that they were named by a person.
        spec = replace(spec, labels=labels)
    return Run(folder, manifest["name"], manifest, spec)


def _read_spec(record: Mapping[str, Any], folder: Path, used: Any = None) -> EvalSpec:
    options = with_files(record["options"], lambda path: _resolved_model(str(path), folder))
    options |= {
        n: tuple(options[n])
        for n in ("intrinsics", "registration", "segmenter_model")
        if isinstance(options.get(n), list)
    }
    # Defaults change between releases: a run that named no settings was made with those in `used`.
    inside = ("config",) if record["config"] is None else ("spec", "config")
    config = used if record["config"] is None else record["config"]
    if config is not None:
        wrong, check = "the run's manifest cannot be read, at {}", TypeAdapter(AskConfig).validate_python
        options["config"] = checked(check, config, wrong, folder / RUN_FILE, inside=inside)
    dataset = str(record["dataset"])
    return EvalSpec(
        dataset if dataset == DEMO_NAME else resolved_path(dataset, folder),
        resolved_path(str(record["labels"]), folder),
        options,
        limit=record["limit"],
        confidence=record["confidence"],
        marks={(frame, expression): mark for frame, expression, mark in record["marks"]},
        map=resolved_path(str(record["map"]), folder) if record.get("map") else None,
    )


def manifest_of(run: Path) -> dict[str, Any]:
    """Manifest of a run; empty if unreadable."""
    try:
        return read_manifest(Path(run))
    except InputError:
        return {}


def labels_of(run: Path) -> Path | None:
    """Place of a run's labels; None where the manifest has none."""
    try:
        return Path(open_run(run).spec.labels)
    except InputError:
        return None


@contextmanager
def open_database(run: Path) -> Iterator[QueryDatabase]:
    """Open a run and its labels as views of a database without access to anything else.

    The views "records", and "labels_frames", "labels_objects", "labels_relations", "labels_expressions" where the
    labels of the run are still where they were.

    Raises InputError: there is no run, or the tables of its labels are damaged.
    """
    run = Path(run)
    read_records(run, [])
    tables, root = {RECORDS: run / RECORDS_FILE}, labels_of(run)
    if root is not None and all((root / f"{n}.parquet").is_file() for n in TABLES):
        for name in TABLES:
            tables[f"labels_{name}"] = root / f"{name}.parquet"
            # Reads the footer alone, and checks it.
            read_table(root / f"{name}.parquet", name, [])
    moved = f", and the labels of this run are not at {root}" if len(tables) == 1 else ""
    with scratch_folder() as spill:
        database = QueryDatabase(tables, spill, f"there is {', '.join(tables)}{moved}")
        try:
            yield database
        finally:
            database.close()
