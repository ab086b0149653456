"""Verbs for agents: their arguments, and the JSON printed by the command of the same name with --json."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import ConfigDict, Field

from pipeline.datasets.base import resolve_frame
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import pathless_edits
from pipeline.diagnosis.cases.replay import find_cases, replay_all
from pipeline.diagnosis.opened import Opened
from pipeline.diagnosis.whatif import Baseline
from pipeline.evaluation.run_folder import Run, asked_again, open_database
from pipeline.pictures.looks import frame_picture
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.sql import QueryDatabase
from spatialviz import cli_runs
from spatialviz.options import JournalOptions, SourceOptions
from spatialviz.query_rows import row_records
from spatialviz.run_cases import replay_record, whatif_answer
from spatialviz.run_eval import failures_of

Thing = TypeVar("Thing")
MOST = 1000
"""Of anything that is counted by `limit`."""
WIDEST = 640
"""Width of a picture at most, pixels."""
LONGEST_QUERY = 20
"""Seconds."""

Source = Annotated[str | None, Field(description="Dataset or run that is asked. Default: the first.")]
RunName = Annotated[str | None, Field(description="Run. Default: the first.")]
FrameOf = Annotated[str | int, Field(description="Frame id, or its index from 0.")]
Words = Annotated[str, Field(description='TARGET RELATION REFERENCE, such as "mug left of the laptop".')]
Limit = Annotated[int, Field(ge=0, le=MOST, description="Entries of the longest list that are given.")]
Offset = Annotated[int, Field(ge=0, description="How many of them are left out before the first.")]
Picture = Annotated[bool, Field(description="With a small picture of the answer.")]


@dataclass(frozen=True)
class OpenRun:
    """Run kept open."""

    run: Run
    keep: ExitStack  # Closes its database when the server ends

    @cached_property
    def opened(self) -> Opened:
        """Dataset with the run's detector, judged by the run's labels."""
        return Opened(self.run.source, self.run.labels)

    @cached_property
    def database(self) -> QueryDatabase:
        """Database as by `open_database`."""
        return self.keep.enter_context(open_database(self.run.folder))

    def why(self, id: str) -> Answer:
        """Expression of the run answered and judged again as in the run; InputError for an unknown id."""
        rows = (row for row in self.run.records.select(["id", "frame"]).to_pylist() if row["id"] == id)
        found = needed(
            next(rows, None), "the run has no such expression", got=id, expected="an id of failures or query"
        )
        return asked_again(self.opened, self.run.spec, found["frame"], id)


@dataclass(frozen=True)
class Correcting:
    """Labels to correct, and the author; as the options of `spatialviz correct`."""

    dataset: str
    labels: str
    author: str
    journal: JournalOptions
    source: SourceOptions


@dataclass(frozen=True)
class Session:
    """Everything named at the start of the server, kept open; nothing else is opened."""

    datasets: Mapping[str, Opened]
    runs: Mapping[str, OpenRun]
    cases: Mapping[str, Path]
    correcting: Correcting | None = None  # None where nothing may be written

    def source(self, name: str | None) -> Opened:
        """Pipeline of a name; InputError for an unknown name."""
        found = chosen({**self.datasets, **self.runs}, name, "dataset or run")
        return found.opened if isinstance(found, OpenRun) else found


def chosen(of: Mapping[str, Thing], name: str | None, what: str) -> Thing:
    """Entry of a name, the first without a name; InputError for an unknown name."""
    require(of, f"no {what} was named when the server was started", expected="spatialviz mcp PATH...")
    name = next(iter(of)) if name is None else name
    return needed(of.get(name), f"there is no {what} of this name", got=name, expected=" or ".join(of))


@dataclass(frozen=True)
class Reply:
    """Reply of a verb: a JSON object, and pictures, (H, W, 3) uint8."""

    record: dict[str, Any]
    pictures: tuple[np.ndarray, ...] = ()


def cut(record: dict[str, Any], limit: int, *keys: str) -> dict[str, Any]:
    """Record with at most `limit` entries in lists under `keys`; "left_out" counts the rest."""
    lists = {key: record[key] for key in keys if len(record.get(key) or ()) > limit}
    if not lists:
        return record
    left = {key: f"{len(found) - limit} more" for key, found in lists.items()}
    most = max(len(found) for found in lists.values())
    how = f"limit={most} gives all" if most <= MOST else f"limit={MOST} gives more"
    return {**record, **{key: found[:limit] for key, found in lists.items()}, "left_out": {**left, "how": how}}


def pictures_of(answer: Answer, asked: bool) -> tuple[np.ndarray, ...]:
    """Frame with the answer's objects, on request and if any."""
    frame = None if answer.trace is None else answer.trace.frame
    return (frame_picture(answer, frame, WIDEST),) if asked and frame is not None else ()


class Verb:
    """Verb with the arguments given by a client."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    def reply(self, session: Session) -> Reply:
        """Reply to the client; raises InputError in one line."""
        raise NotImplementedError


@dataclass(frozen=True)
class ContentsVerb(Verb):
    """List everything open here: datasets, runs and cases by the names used in the other tools; and the frames of a
    dataset."""

    source: Annotated[str | None, Field(description="Dataset or run whose frames are listed.")] = None
    limit: Limit = 50
    offset: Offset = 0

    def reply(self, session: Session) -> Reply:
        if self.source is not None:
            ids = session.source(self.source).pipeline.dataset.frame_ids
            record = {"source": self.source, "count": len(ids), "frames": list(ids[self.offset :])}
            return Reply(cut(record, self.limit, "frames"))
        datasets = [
            {"name": name, "frames": len(one.pipeline.dataset.frame_ids), "about": repr(one)}
            for name, one in session.datasets.items()
        ]
        runs = [
            {"name": name, "system": one.run.name, "expressions": one.run.manifest.get("expressions")}
            for name, one in session.runs.items()
        ]
        cases = [{"name": name, "cases": len(find_cases(path))} for name, path in session.cases.items()]
        return Reply({"datasets": datasets, "runs": runs, "cases": cases, "writes": session.correcting is not None})


@dataclass(frozen=True)
class AskVerb(Verb):
    """Answer an expression on a frame: the ranked pairs of objects with their factors, and the verdict if the truth is
    known. `holds` is false if no pair stands in the relation: the best pair is then the nearest."""

    frame: FrameOf
    expression: Words
    source: Source = None
    limit: Limit = 10
    picture: Picture = True

    def reply(self, session: Session) -> Reply:
        found = session.source(self.source).ask(self.frame, self.expression)
        record = cut(found.record(), self.limit, "pairs")
        shown = {f"{pair['target']},{pair['reference']}" for pair in record["pairs"]}
        record["relations"] = {pair: states for pair, states in record["relations"].items() if pair in shown}
        return Reply(record, pictures_of(found, self.picture))


@dataclass(frozen=True)
class WhyVerb(Verb):
    """Explain which module failed, with the smallest change to mend it: for an expression on a frame, or for one
    answered by a run, by the id from failures and query."""

    frame: FrameOf | None = None
    expression: Words | None = None
    id: Annotated[str | None, Field(description="Of an expression of a run, in place of frame and expression.")] = None
    source: Source = None
    picture: Picture = True

    def reply(self, session: Session) -> Reply:
        if self.id is not None:
            require(self.frame is None and self.expression is None, "id stands in place of frame and expression")
            found = chosen(session.runs, self.source, "run").why(self.id)
        elif self.frame is None or self.expression is None:
            raise InputError("frame and expression go together", expected="both, or id")
        else:
            found = session.source(self.source).ask(self.frame, self.expression)
        record = {"expression": found.text, "answer": found.sentence, "holds": found.holds, "why": found.why}
        return Reply({**record, "verdict": found.record().get("verdict")}, pictures_of(found, self.picture))


@dataclass(frozen=True)
class WhatIfVerb(Verb):
    """Answer an expression with and without edits: hidden objects, moved boxes, confidences, relations, thresholds.
    Without edits the objects are listed with their keys, used in edits."""

    frame: FrameOf
    expression: Words
    edits: Annotated[
        dict[str, Any],
        Field(
            description='Such as {"hidden": ["#3"]}, {"confidences": [{"name": "mug", "object": "#3", "p": 0.9}]}, '
            '{"relations": [{"relation": "left", "a": "#3", "b": "#2", "p": 0.1}]}, {"k": 5}, {"scorer": "rule"}, '
            '{"boxes": {"#3": {"center": [x, y, z], "R": rows of 3, "size": [x, y, z]}}}; camera frame, metres.'
        ),
    ] = field(default_factory=dict)
    source: Source = None
    limit: Limit = 20
    picture: Picture = True

    def reply(self, session: Session) -> Reply:
        opened = session.source(self.source)
        pipeline = opened.pipeline
        context = pipeline.prepare(resolve_frame(pipeline.dataset, self.frame))
        baseline = Baseline(pipeline, context, self.expression)
        record, after = whatif_answer(baseline, pathless_edits(self.edits), opened.labels)
        return Reply(cut(record, self.limit, "objects", "moved", "candidates"), pictures_of(after, self.picture))


@dataclass(frozen=True)
class FailuresVerb(Verb):
    """List failures of a run found by a search, with the reasons. Words of a search: verdict:SRM relation:behind
    class:chair margin<0.1 -lucky sort:margin; without a search all failures."""

    search: str = ""
    run: RunName = None
    parts: Annotated[
        tuple[Literal["summary", "slices", "facets"], ...],
        Field(
            description="What is told besides: summary (verdicts, what each module costs), slices (shares by the "
            "argument slices), facets (values that a search can name, with their counts)."
        ),
    ] = ()
    slices: Annotated[
        str | None, Field(description="With commas: relation, class, reference, distance, size, occlusion, scene.")
    ] = None
    compare: Annotated[str | None, Field(description="Second run on the same labels: what it fixed and broke.")] = None
    limit: Limit = 20

    def reply(self, session: Session) -> Reply:
        run = chosen(session.runs, self.run, "run").run
        second = None if self.compare is None else chosen(session.runs, self.compare, "run").run.records
        command = cli_runs.FailuresCommand(run.folder, self.search, self.limit, self.slices, json=True)
        record, _ = failures_of(command, run.records, second)
        record["slices"] = {name: cut(found, self.limit, "slices") for name, found in record["slices"].items()}
        for part in {"summary", "slices", "facets"} - set(self.parts):
            del record[part]
        if "summary" not in self.parts:
            del record["of_found"]
        if record["found"] > self.limit:
            record["left_out"] = f"{record['found'] - self.limit} more: a larger limit gives them, or query"
        return Reply(record)


@dataclass(frozen=True)
class QueryVerb(Verb):
    """Query a run in SQL (DuckDB): the view records, one row for each expression, and labels_frames, labels_objects,
    labels_relations, labels_expressions. `SELECT column_name, column_type FROM (DESCRIBE records)` lists columns."""

    sql: Annotated[str, Field(description="One SELECT; it can read nothing else.")]
    run: RunName = None
    limit: Annotated[int, Field(ge=1, le=MOST, description="Rows that are given.")] = 100
    offset: Offset = 0

    def reply(self, session: Session) -> Reply:
        database = chosen(session.runs, self.run, "run").database
        # An agent may ask for the product of two long tables, and would wait for ever.
        found = database.select(self.sql, seconds=LONGEST_QUERY)
        rows = list(islice(row_records(found), self.offset, self.offset + self.limit + 1))
        record: dict[str, Any] = {"columns": list(found.columns), "rows": rows[: self.limit]}
        if len(rows) > self.limit:
            record["left_out"] = f"more rows: offset={self.offset + self.limit} gives the next, in order by ORDER BY"
        return Reply(record)


@dataclass(frozen=True)
class ReplayVerb(Verb):
    """Run saved cases again, and report changed answers and verdicts, those first."""

    cases: Annotated[str | None, Field(description="Case, or folder of cases. Default: the first.")] = None
    srm: Annotated[
        Literal["trained", "rule"] | None, Field(description="Another relation scorer. Default: each case's own.")
    ] = None
    limit: Limit = 20

    def reply(self, session: Session) -> Reply:
        folders = find_cases(chosen(session.cases, self.cases, "case"))
        results = [replay_record(result) for result in replay_all(folders, srm=self.srm)]
        counts = dict.fromkeys(("same", "changed", "damaged"), 0)
        for result in results:
            counts[result["status"]] += 1
        results.sort(key=lambda result: result["status"] == "same")
        return Reply(cut({"cases": len(results), **counts, "results": results}, self.limit, "results"))


VERBS: dict[str, type[Verb]] = {
    "contents": ContentsVerb,
    "ask": AskVerb,
    "why": WhyVerb,
    "whatif": WhatIfVerb,
    "failures": FailuresVerb,
    "query": QueryVerb,
    "replay": ReplayVerb,
}
"""What only reads."""
