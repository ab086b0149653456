"""Commands on a single answer: under edits, saved as a case, run again, and as a page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.answering.answer_words import NO_SUCH_PAIR, probability
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.predictions import read_predictions
from pipeline.datasets.saved_case import MANIFEST
from pipeline.diagnosis.answer import Answer, answer_record
from pipeline.diagnosis.asking import answer, frame_truth, judged, truth_or_reason
from pipeline.diagnosis.cases.manifest import ExpectedRecord
from pipeline.diagnosis.cases.replay import ReplayResult, find_cases, replay_all
from pipeline.diagnosis.cases.saving import open_case, save_case
from pipeline.diagnosis.not_seen import open_scene_maps
from pipeline.diagnosis.whatif import Baseline, Edits, Outcome, edits_record, load_edits, rerun, what_changed
from pipeline.diagnosis.whatif.changes import became
from pipeline.diagnosis.whatif.edit_words import edits_from_words
from pipeline.diagnosis.whatif.region import asked_pair
from pipeline.diagnosis.whatif.rerun import foreign_keys
from pipeline.evaluation.run_folder import RUN_FILE, open_run
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.counted import counted
from pipeline.relations.relations import letter
from pipeline.system.errors import InputError, require
from spatialviz.cli_runs import (
    ReplayCommand,
    ReportCommand,
    SaveCaseCommand,
    WhatifCommand,
)
from spatialviz.options import BAD, FINE, NO, one_frame, warn
from spatialviz.printing import figure, print_rows, say, say_lines

_STYLE = {"same": "green", "updated": "yellow", "changed": "red", "damaged": "red"}


def run_whatif(command: WhatifCommand) -> int:
    edits = Edits() if command.edits is None else load_edits(command.edits)
    pipeline = command.source.open(command.dataset, command.frame)
    context = _one_context(pipeline, command.frame)
    labels = None if command.labels is None else open_labels(command.labels)
    baseline = Baseline(pipeline, context, command.expression)
    edits = edits_from_words(baseline, edits, command.do, command.on)
    record, after = whatif_answer(baseline, edits, labels)
    command.write(record, print_change)
    return FINE if after.holds else NO


def whatif_answer(baseline: Baseline, edits: Edits, labels: Labels | None) -> tuple[dict[str, Any], Answer]:
    """Record of `whatif --json`, and the answer under edits."""
    pipeline, context = baseline.source, baseline.context
    if unknown := foreign_keys(baseline, edits):
        known = ", ".join(sorted(baseline.all_keys)[:30])
        raise InputError("edits of objects that are not there", got=", ".join(unknown), expected=known)
    after = rerun(baseline, edits)
    weights = replace(pipeline.config.rank, **edits.rank)
    truth = truth_or_reason(pipeline, context, labels)
    answers = (
        judged(baseline.outcome.trace, pipeline, context, truth),
        judged(after.trace, pipeline, context, truth, weights),
    )
    record = whatif_record(baseline, after, edits, (answers[0].verdict, answers[1].verdict))
    for when, found in zip(("before", "after"), answers, strict=True):
        record[when]["head"] = found.story.head
    return record | {"said": became(baseline.outcome, after, answers[0].story, answers[1].story)}, answers[1]


def run_save_case(command: SaveCaseCommand) -> None:
    run = open_run(command.dataset) if (Path(command.dataset) / RUN_FILE).is_file() else None
    pipeline = command.source.open(command.dataset, command.frame) if run is None else run.source
    labels = None if command.labels is None else open_labels(command.labels)
    if run is not None:
        require(not command.source.words(), "a run has its own options", got=" ".join(command.source.words()))
        labels = labels or run.labels
    maps = None if run is None else run.maps
    if command.map is not None:
        maps = open_scene_maps(command.map, pipeline.dataset)
    context = _one_context(pipeline, command.frame)
    edits = None if command.edits is None else edits_record(load_edits(command.edits))
    now = save_case(
        command.out,
        pipeline,
        context,
        command.expression,
        truth=frame_truth(pipeline, context, labels),
        confidence=None if run is None else run.spec.confidence,
        maps=maps,
        edits=edits,
        run=None if run is None else {"run": str(run.folder)},
        name=command.name,
    )
    command.write({"case": str(command.out), **answer_record(now)}, print_saved, now, command.out)


def run_replay(command: ReplayCommand) -> int:
    require(command.cases, "a case is missing", expected="the folder that save-case wrote")
    require(
        command.detector != "kept" or (command.model is None and command.min_score is None),
        "--model and --min-score need --detector",
        expected="live or a detector's name",
    )
    require(
        command.predictions is None or (command.detector == "kept" and command.srm is None),
        "--predictions say what detected and what scored relations",
        expected="without --detector and --srm",
    )
    predictions = None if command.predictions is None else read_predictions(command.predictions)
    if predictions is not None and predictions.unread:
        warn(predictions.unread)
    folders = [folder for path in command.cases for folder in find_cases(path)]
    totals = dict.fromkeys(("same", "changed", "updated", "damaged"), 0)
    for result in replay_all(
        folders,
        srm=command.srm,
        vectors=command.vectors,
        tolerance=command.tolerance,
        update=command.update,
        detector=None if command.detector == "kept" else command.detector,
        model=command.model,
        min_score=command.min_score,
        predictions=predictions,
    ):
        totals[result.status] += 1
        command.write(replay_record(result), print_replay, result)
    shown = ", ".join(f"{n} {status}" for status, n in totals.items() if n or status in ("same", "changed"))
    command.write({"cases": len(folders), **totals}, say, f"{counted(len(folders), 'case')}: {shown}")
    return BAD if totals["damaged"] else NO if totals["changed"] else FINE


def run_report(command: ReportCommand) -> None:
    # Bring viser in.
    from spatialviz.report.page import Subject, failure_page, scene_html, write_page

    require(
        not (command.out.is_dir() or (command.out.exists() and not command.overwrite)),
        "the report would replace a file",
        expected="--overwrite",
        path=command.out,
    )
    require(
        command.frame is not None or (Path(command.dataset) / MANIFEST).is_file(),
        "FRAME and EXPRESSION are missing",
        cause=f"{command.dataset} is no saved case",
    )
    if command.frame is None:
        srm = None if command.source.srm == "trained" else command.source.srm
        opened = open_case(command.dataset, srm=srm, vectors=command.source.vectors)
        pipeline, context, answered = opened.source, opened.context, opened.answer()
        subject = Subject.of_case(opened)
    else:
        if command.expression is None:
            raise InputError("EXPRESSION is missing", expected='for example "mug left of the laptop"')
        pipeline = command.source.open(command.dataset, command.frame)
        context = _one_context(pipeline, command.frame)
        labels = None if command.labels is None else open_labels(command.labels)
        answered = answer(pipeline, context, command.expression, truth=frame_truth(pipeline, context, labels))
        subject = Subject.of_dataset(
            command.dataset, pipeline, context, command.expression, command.source.words(), labels
        )
    page = failure_page(answered, pipeline, context, subject, scene_html(answered, context) if command.scene else None)
    write_page(page, command.out)
    verdict = answered.verdict
    command.write(
        {"report": str(command.out), "bytes": len(page.encode()), "verdict": verdict},
        say,
        f"{verdict or 'no verdict'} -> {command.out} ({len(page.encode()) / 2**20:.1f} MB)",
    )


def whatif_record(
    baseline: Baseline, after: Outcome, edits: Edits, verdicts: tuple[str | None, str | None] | None = None
) -> dict[str, Any]:
    """Record of `whatif --json`."""
    trace = after.trace
    record: dict[str, Any] = {
        "frame": trace.frame.id,
        "expression": baseline.text,
        "edits": edits_record(edits),
        "objects": [
            {"key": key, "label": o.label, "score": round(float(o.score), 6)}
            for key, o in zip(after.keys, trace.objects, strict=True)
        ],
        **what_changed(baseline.outcome, after, verdicts=verdicts),
        "timings_ms": {stage: round(seconds * 1000, 3) for stage, seconds in trace.timings.items()},
        "pairs_scored": after.pairs_scored,
    }
    asked = asked_pair(trace, None if trace.ranking is None else trace.ranking.pairs[0], edits)
    if asked is not None:
        placed = asked.placement
        record["placement"] = {
            "relation": trace.relation,
            "state": letter(placed.state),
            "why": placed.why,
            "measures": {name: round(value, 6) for name, value in placed.measures.items()},
        }
    return record


def _one_context(pipeline: Pipeline, text: str) -> PreparedFrame:
    return pipeline.prepare(one_frame(pipeline.dataset.frame_ids, text, pipeline.dataset.root))


_FACTORS = {
    "P(target)": "p_target",
    "P(reference)": "p_reference",
    "P(relation)": "p_relation",
    "product": "product",
    "posterior": "probability",
    "margin": "margin",
}


def print_change(record: dict[str, Any]) -> None:
    """Print before and after side by side, moved pairs, and the winner's place in the relation's region."""
    say(("frame ", "dim"), record["frame"], "  ", (record["expression"], "bold"))
    sides = record["before"], record["after"]
    roles = (role for role in ("target", "reference", "second_reference") if any(role in side for side in sides))
    rows = [(role.replace("_", " "), *(_object(side.get(role)) for side in sides)) for role in roles]
    rows += [(title, *(figure(side.get(key), ".3f", "") for side in sides)) for title, key in _FACTORS.items()]
    if any(side["verdict"] for side in sides):
        rows.append(("verdict", *(side["verdict"] or "" for side in sides)))
        rows.append(("", *(side["head"] for side in sides)))
    print_rows(("", "before", "after"), rows)
    for when, side in zip(("before", "after"), sides, strict=True):
        if "reason" in side:
            say(f"{when}: {side['reason']}", style="yellow")
        elif side["holds"] is False:
            nearest = " with ".join(_object(side[role]) for role in ("target", "reference") if role in side)
            shown = probability(side["relation_probability"])
            say(f"{when}: {NO_SUCH_PAIR}{nearest}, relation {shown}", style="yellow")
    say(record["said"], style="bold" if record["changed"] else "")
    for move in record["moved"][:5]:
        was, now = (move[f"rank_{when}"] or "not there" for when in ("before", "after"))
        say(f"pair {move['target']}, {move['reference']}: {was} -> {now}", style="dim")
    if "placement" in record:
        say(record["placement"]["why"])
    if not any(name != "format" for name in record["edits"]):
        say_lines((f"{entry['key']}  {entry['label']}  {entry['score']:.2f}" for entry in record["objects"]), "dim")


def _object(entry: dict[str, str] | None) -> str:
    return "" if entry is None else f"{entry['label']} {entry['key']}"


def print_saved(now: Answer, folder: Path) -> None:
    """Print the saved files, and the command to run the case again."""
    if now.verdict is not None:
        say((now.verdict, "bold"), "  ", f"{now.story.head}. {now.story}")
    say_lines([now.problem or (now.unjudged if now.verdict is None else None) or ""], "yellow")
    say(f"kept -> {folder}   run it again: spatialviz replay {folder}")


def print_replay(result: ReplayResult) -> None:
    """Print before and after of a case."""
    say((f"{result.status:<8}", _STYLE[result.status]), " ", (str(result.path), "bold"))
    if result.replay is None:
        say(f"         {result.problem}", style="red")
        return
    replay = result.replay
    if replay.changes:
        say(f"  before {in_words(replay.before)}")
        say(f"  after  {in_words(replay.after)}")
        say_lines((f"         {c}" for c in replay.changes), "yellow" if result.status == "updated" else "red")
        if replay.moved is not None:
            say(f"         the first module that gives something else: {replay.moved}")
    say_lines((f"         warning: {warning}" for warning in replay.warnings), "yellow")


def in_words(state: ExpectedRecord) -> str:
    """Answer and verdict on a line."""
    verdict = "" if state.judgement is None else f"   {state.judgement.verdict}: {state.judgement.said}"
    if state.answer is None:
        return f"no answer ({state.reason}){verdict}"
    target, reference = state.answer.target, state.answer.reference
    other = "" if reference is None else f" with {reference.label} ({reference.score:.2f})"
    lead = "" if state.answer.holds in (None, True) else NO_SUCH_PAIR
    return f"{lead}{target.label} ({target.score:.2f}){other}, relation {state.answer.p_relation:.2f}{verdict}"


def replay_record(result: ReplayResult) -> dict[str, Any]:
    """Record of a line of `replay --json`."""
    replay = result.replay
    if replay is None:
        return {"case": str(result.path), "status": result.status, "problem": result.problem}
    return {
        "case": str(result.path),
        "name": replay.name,
        "status": result.status,
        "changes": list(replay.changes),
        "warnings": list(replay.warnings),
        "moved": replay.moved,
        "before": replay.before.model_dump(mode="json"),
        "after": replay.after.model_dump(mode="json"),
    }
