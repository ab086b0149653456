"""The review of labels, and what a person reads of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import setting_of
from pipeline.corrections.journal.events import outcome_record
from pipeline.corrections.journal.journal import JOURNAL_FILE
from pipeline.corrections.review.bulk import accept_all, found_items, pace_of
from pipeline.corrections.review.evidence import read_relation_labels
from pipeline.corrections.review.items import STATES, ItemKey, State, item_keys, left_to_review, with_states
from pipeline.corrections.review.out_of_fold import EPOCHS, REVIEWED, DoubtConfig
from pipeline.corrections.review.queue import QueueConfig, review_queue
from pipeline.corrections.review.reviewed import (
    PairAgreement,
    Reviewed,
    automatic_version,
    left_for,
    pair_agreements,
    review_progress,
    reviewed_labels,
    states_on_labels,
    without_gone,
)
from pipeline.corrections.review.worklist import read_queue, worklist, write_queue
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.features import CLI_FEATURES
from pipeline.system.arrow import pa
from pipeline.system.errors import MissingExtra, needed, require
from pipeline.system.whole_files import scratch_folder
from pipeline.training.train import TrainConfig, need_torch
from spatialviz.cli_labels import ReviewCommand
from spatialviz.options import FINE, NO, warn
from spatialviz.printing import figure, print_rows, progress_bars, say


def run_review(command: ReviewCommand) -> int:
    _check(command)
    labels = open_labels(command.labels)
    with scratch_folder() as folder:
        reviewed = _reviewed(command, labels, Path(folder) / "labels")
        if command.agreement:
            pairs = pair_agreements(reviewed.judgements, setting_of(labels).inverse)
            command.write((pair.record() for pair in pairs), print_agreement, pairs, command.limit)
            return FINE if pairs else NO
        queue = _queue(command, reviewed, labels)
        states = states_on_labels(reviewed.judgements, read_relation_labels(reviewed.labels))
        if command.queue is not None:
            queue = without_gone(queue, reviewed.labels, states)
    if command.out is not None:
        write_queue(queue, command.out)
    if command.progress:
        command.write({**review_progress(queue, reviewed.judgements, states), **_pace(command, labels)}, print_progress)
        return FINE
    shown = _shown(command, queue, reviewed, states)
    if command.kind is not None or command.find:
        shown = shown.take(found_items(worklist(shown, {}), _label, command.kind, command.find))
    if command.accept:
        return _accept(command, labels, shown)
    rows = shown.slice(0, command.limit).to_pylist()
    command.write(iter(rows), print_queue, shown, rows, command.out, queue.num_rows - shown.num_rows)
    return FINE if shown.num_rows else NO


def _accept(command: ReviewCommand, labels: Labels, shown: pa.Table) -> int:
    author = needed(command.author, "--accept needs --author", cause="who accepts them?")
    corrector = Corrector(labels, command.source.open(labels))
    with command.journal.open(labels) as journal:
        edits = accept_all(
            item_keys(shown.slice(0, command.limit)), lambda frame: corrector.frame(frame, journal), author
        )
        done = journal.append(edits, author)
    record = outcome_record(done)
    command.write(
        record,
        lambda _: say(
            f"accepted {counted(min(shown.num_rows, command.limit), 'item')}; `spatialviz undo` takes all of them back"
        ),
    )
    return FINE if record["saved"] else NO


def _pace(command: ReviewCommand, labels: Labels) -> dict[str, Any]:
    if command.author is None or (command.journal.journal is None and not (labels.root / JOURNAL_FILE).exists()):
        return {}
    with command.journal.open(labels, must_exist=True) as journal:
        return {"pace": pace_of(journal.events(), command.author, datetime.now().astimezone()).record()}


def _check(command: ReviewCommand) -> None:
    require(command.limit >= 0, "--limit must not be negative", got=command.limit)
    require(
        command.author is not None or (not command.overlap and command.second_opinion_of is None),
        "--overlap and --second-opinion-of need --author",
        cause="whose second opinion?",
    )
    require(command.author is None or not command.all, "--all and --author exclude each other")
    require(
        command.queue is None or command.other is None,
        "--queue is a queue that was built before",
        cause="leave out --queue, or the other options",
    )


def _reviewed(command: ReviewCommand, labels: Labels, folder: Path) -> Reviewed:
    if command.journal.journal is None and not (labels.root / JOURNAL_FILE).exists():
        return Reviewed(labels)
    with command.journal.open(labels, must_exist=True) as journal:
        return reviewed_labels(labels, journal, folder, command.source.open(labels))


def _queue(command: ReviewCommand, reviewed: Reviewed, labels: Labels) -> pa.Table:
    if command.queue is not None:
        return read_queue(command.queue, automatic_version(labels.manifest))
    train = TrainConfig(CLI_FEATURES[command.features], REVIEWED, epochs=EPOCHS, seed=command.seed)
    networks = command.networks
    if networks and (why := MissingExtra.missing(need_torch)):
        networks = False
        warn(f"the networks are left out, as with --no-networks: {why}")
    doubts = DoubtConfig(command.folds, command.passes, train) if networks else None
    other = None if command.other is None else open_labels(command.other)
    with progress_bars() as advance:
        return review_queue(
            reviewed.labels,
            QueueConfig(doubts, linter=command.linter),
            other=other,
            judgements=reviewed.judgements,
            progress=lambda done, of: advance("networks", done, of),
        )


def _shown(command: ReviewCommand, queue: pa.Table, reviewed: Reviewed, states: dict[ItemKey, State]) -> pa.Table:
    if command.author is not None:
        return left_for(
            queue,
            reviewed.judgements,
            states,
            command.author,
            overlap=command.overlap,
            second_opinion_of=command.second_opinion_of,
        )
    return with_states(queue, states) if command.all else left_to_review(queue, states)


def print_queue(queue: pa.Table, first: list[dict[str, Any]], out: Path | None, settled: int) -> None:
    """Print the first items with reasons, and the counts; `settled` are hidden."""
    if queue.num_rows:
        print_rows(
            (">wrong", "frame", "label", "reasons"),
            ((f"{row['score']:.2f}", row["frame"], _label(row), "; ".join(row["reasons"])) for row in first),
        )
    metadata = {k.decode(): v.decode() for k, v in (queue.schema.metadata or {}).items()}
    told = f"{counted(queue.num_rows, 'label')} to look at"
    if settled:
        told += f" ({settled} more are settled, or others': --all)"
    if "estimated_wrong" in metadata:
        told += f"; networks take {metadata['estimated_wrong']} relation labels to be wrong"
    if metadata.get("elsewhere", "0") != "0":
        told += f"; {counted(int(metadata['elsewhere']), 'finding')} of no single label: see `spatialviz check`"
    say(told)
    if out is not None:
        say(f"-> {out}", style="dim")


def _label(row: dict[str, Any]) -> str:
    if row["kind"] == "relation":
        return f"{row['a']} {PHRASE[row['relation']]} {row['b']}: {row['label']}"
    if row["place"] is not None:
        return f"no object at {row['place']}: {row['label']}?"
    if row["kind"] == "object":
        return f"object {row['a']}: {row['label']}"
    return f"{row['expression']}: {row['label']!r}"


def print_agreement(pairs: Sequence[PairAgreement], limit: int) -> None:
    """Kappa of each two reviewers by kind, the table, and the first differing items."""
    if not pairs:
        say("no two reviewers have judged the same item")
    for pair in pairs:
        say(f"{pair.first} and {pair.second}: {counted(pair.all.items, 'item')} judged by both", style="bold")
        for kind, found in (("all", pair.all), *pair.kinds.items()):
            kappa = "-" if math.isnan(found.kappa) else f"{found.kappa:.2f}"
            say(f"  {kind}: kappa {kappa}, {figure(found.observed, '.1%')} of {found.items} judged alike")
        judgements = pair.all.judgements
        print_rows(
            (f"{pair.first} \\ {pair.second}", *(f">{judgement}" for judgement in judgements)),
            ((name, *map(str, row)) for name, row in zip(judgements, pair.all.table.tolist(), strict=True)),
        )
        for key, one, other in pair.differ[:limit]:
            item = f"{key.a} {PHRASE[key.what]} {key.b}" if key.kind == "relation" else f"{key.what or key.a}"
            say(f"  {key.frame}, {key.kind} {item}: {pair.first} says {one}, {pair.second} says {other}")
        if len(pair.differ) > limit:
            say(f"  and {len(pair.differ) - limit} more")


def print_progress(record: dict[str, Any]) -> None:
    """Print items by state, by kind and by reviewer."""
    parts = (("queue", record), *record["kinds"].items(), *record["reviewers"].items())
    print_rows(
        ("", *(f">{state}" for state in STATES)),
        ((name, *(str(counts.get(state, "")) for state in STATES)) for name, counts in parts),
    )
    say(f"{record['settled']} of {record['items']} settled ({figure(record['share'], '.1%')})")
    if (pace := record.get("pace")) is not None:
        rate = "" if pace["per_hour"] is None else f", {pace['per_hour']:.0f} an hour"
        say(f"today: {counted(pace['items'], 'item')} in {pace['minutes']:.0f} minutes{rate}")
    for day, count in record["days"].items():
        say(f"{day}: {counted(count, 'item')}")
    if record["disagreements"]:
        say(f"reviewers disagree on {record['disagreements']}: see --agreement")
    if record["elsewhere"]:
        say(f"not in the queue: {counted(record['elsewhere'], 'item')} that people judged")
    if record["estimated_wrong"] is not None:
        say(f"networks take {record['estimated_wrong']:.0f} of the open relation labels to be wrong")
