"""Commands showing, saving, undoing and applying corrections of labels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.batch import apply_actions, needs_pictures, read_actions
from pipeline.corrections.journal.connection import back_up, check_journal, examined_record, recover, written_record
from pipeline.corrections.journal.effective import Corrector, EffectiveLabels
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Event, NotSaved, Saved, event_record, outcome_record
from pipeline.corrections.journal.examining import Examined
from pipeline.corrections.journal.field_refs import shown_value
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal, journal_place
from pipeline.corrections.journal.materialise import materialise
from pipeline.corrections.journal.replay import redo, undo
from pipeline.corrections.object_card import ObjectCard, object_card
from pipeline.corrections.scene import PairCard, effective_truth, pair_card
from pipeline.corrections.wording import event_text
from pipeline.labels.by_hand import begun_labels, grows, with_frames
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import letter
from pipeline.system.errors import InputError, require
from spatialviz.cli_labels import (
    ConfirmCommand,
    CorrectCommand,
    EffectiveCommand,
    JournalCommand,
    OfPerson,
    ShowCommand,
)
from spatialviz.options import FINE, NO, Output, numbers, one_frame, warn
from spatialviz.printing import figure, print_rows, say, say_lines

FrameOf = Callable[[str], EffectiveFrame | None]


def run_show(command: ShowCommand) -> int:
    require(command.object is None or command.pair is None, "--object and --pair exclude each other")
    labels = open_labels(command.labels)
    corrected = command.journal.journal is not None or (labels.root / JOURNAL_FILE).exists()
    journal = command.journal.open(labels, must_exist=True) if corrected else ()
    corrector = Corrector(labels, command.source.open(labels))
    name = one_frame(tuple(corrector.index.of_frame), command.frame, labels.root)
    frame = corrector.frame(name, journal)
    if command.pair is not None:
        a, b = numbers(command.pair, "A,B", int, "a pair is two numbers of objects", ", such as --pair 3,5")
        card = pair_card(frame, a, b)
        command.write(card.record(), print_pair, card)
        return FINE if card.lines else NO
    shown = sorted({*frame.objects, *frame.left_out}) if command.object is None else [command.object]
    cards = [object_card(frame, n) for n in shown]
    command.write((card.record() for card in cards), print_objects, cards, command.object is not None)
    return FINE if cards else NO


def run_journal(command: JournalCommand) -> int:
    whole = [command.check, command.backup is not None, command.recover is not None]
    if any(whole):
        chosen = any(v is not None for v in (command.author, command.frame, command.last))
        require(
            sum(whole) <= 1 and not chosen,
            "--check, --backup and --recover are of the whole journal, and one at a time",
        )
        return _as_a_whole(command)
    require(command.last is None or command.last >= 1, "--last must be at least 1", got=command.last)
    labels = open_labels(command.labels)
    frame = command.frame
    if frame is not None:
        frame = one_frame(labels.frames.column("frame").to_pylist(), frame, labels.root)
    with command.journal.open(labels, must_exist=True) as journal:
        events = journal.events(author=command.author, frame=frame, last=command.last)
    command.write(map(event_record, events), print_events, events)
    return FINE if events else NO


def _as_a_whole(command: JournalCommand) -> int:
    where = command.journal.journal or journal_place(open_labels(command.labels), None)
    if command.check:
        found = check_journal(where).known()
        command.write(examined_record(found), print_examined, found)
        return NO if found.damage else FINE
    if command.backup is not None:
        made = found = back_up(where, command.backup)
    else:
        assert command.recover is not None
        found, made = recover(where, command.recover)
    command.write(written_record(found, made), print_written, found, made)
    return FINE


def run_correct(command: CorrectCommand) -> int:
    return apply_edits(command, read_actions(command.edits))


def apply_edits(command: CorrectCommand, actions: list[Any]) -> int:
    """Apply edits read already."""
    labels = open_labels(command.labels)
    dataset = command.source.open(labels) if needs_pictures(actions) or grows(labels) else None
    if grows(labels) and dataset is not None:
        labels = with_frames(labels, dataset, dict.fromkeys(a.frame for a in actions))
    with command.journal.open(labels) as journal, told_how_to_try_again():
        corrector = Corrector(labels, dataset)
        done = apply_actions(corrector, journal, actions, command.author, again=command.again)
        return _told(command, done, "saved", frames_of(corrector, journal))


def run_confirm(command: ConfirmCommand) -> int:
    from pipeline.corrections.judging import right_pair  # These bring models and the review of labels in.
    from pipeline.corrections.label_editor import LabelEditor
    from pipeline.corrections.unsaved import JournalLocation
    from pipeline.diagnosis.asking import judged

    source = command.source.open(command.dataset, command.frame)
    name = one_frame(source.dataset.frame_ids, command.frame, source.dataset.root)
    labels = begun_labels(source.dataset, command.labels, command.source.camera(command.frame))
    location = JournalLocation(labels, command.journal.journal, command.journal.project)
    editor, context = LabelEditor(labels, location, command.author, source.dataset), source.prepare(name)
    trace = source.ask(context, command.expression)
    pairs = () if trace.ranking is None or trace.ranking.degenerate else trace.ranking.pairs
    require(1 <= command.pair <= len(pairs), "the answer has no such pair", got=command.pair, expected=len(pairs))
    editor.take_in(name)
    edits = right_pair(editor, trace, pairs[command.pair - 1])
    editor.keep_frames([name])
    done = location.to_write().append(edits, command.author)
    found = judged(trace, source, context, effective_truth(editor.frame(name)))
    record = {**outcome_record(done), "verdict": found.verdict}
    command.write(record, lambda _: (print_outcome(done, "saved", editor.frame), say(f"verdict: {found.verdict}")))
    location.close()
    return FINE if record["saved"] else NO


def _undo_or_redo(command: OfPerson, way: Callable[..., Saved | Conflict | None], verb: str) -> int:
    labels = open_labels(command.labels)
    with command.journal.open(labels, must_exist=True) as journal, told_how_to_try_again():
        done = way(journal, command.author, group=command.group, again=command.again)
        return _told(command, done, verb, frames_of(Corrector(labels), journal))


run_undo = partial(_undo_or_redo, way=undo, verb="taken back")
run_redo = partial(_undo_or_redo, way=redo, verb="brought back")


def run_effective(command: EffectiveCommand) -> None:
    labels = open_labels(command.labels)
    with command.journal.open(labels, must_exist=True) as journal:
        manifest, found = materialise(labels, journal, command.out, dataset=command.source.open(labels))
    command.write(manifest.corrections or {}, print_effective, labels, found, command.out, command.show)


@contextmanager
def told_how_to_try_again() -> Iterator[None]:
    """Tell how to repeat after a database error; events already saved are named by the next try."""
    try:
        yield
    except NotSaved as error:
        warn(f"to try this once more, and not twice, add --again {error.group}")
        raise


def _told(command: Output, done: Saved | Conflict | None, verb: str, frame_of: FrameOf) -> int:
    record = outcome_record(done)
    command.write(record, print_outcome, done, verb, frame_of)
    return FINE if record["saved"] else NO


def print_events(events: Sequence[Event]) -> None:
    """Print an event on each line."""
    if not events:
        say("nothing was corrected")
        return
    print_rows(
        ("time (UTC)", "who", "what", "of", "before", "after", "why"),
        (
            (
                e.time.strftime("%Y-%m-%d %H:%M:%S"),
                e.author,
                e.ref.field if e.action == "edit" else f"{e.action}: {e.ref.field}",
                f"{e.ref.entity} in {e.ref.frame}",
                shown_value(e.ref, e.before),
                shown_value(e.ref, e.after),
                e.reason,
            )
            for e in events
        ),
        overflow="fold",
    )
    say(counted(len(events), "event"))


def print_outcome(done: Saved | Conflict | None, verb: str, frame_of: FrameOf) -> None:
    """Print the saved events, or the conflicting events."""
    if done is None:
        say("there is nothing of this person's left to take back or bring back")
    elif isinstance(done, Saved):
        say_lines(_text(event, frame_of) for event in done.events)
        say(f"{verb}: {counted(len(done.events), 'change')}, group {done.group}")
    else:
        say("nothing was saved: somebody else has been there", style="yellow")
        say_lines(map(str, done.rivals))


def print_effective(labels: Labels, found: EffectiveLabels, out: Path, show: int) -> None:
    """Print the makers of the values, and corrections no longer applicable."""
    counts = found.counts
    say(
        f"{counted(found.events, 'event')}: {counted(counts['human'], 'value')} by people, {counts['recomputed']} "
        f"recomputed, {counts['stale']} stale; {counted(counts['withdrawn'], 'expression')} withdrawn, "
        f"{counts['marks']} marked as wrong"
    )
    if counts["stale"]:
        say("stale values follow from masks or boxes: they need the dataset (--dataset)", style="yellow")
    frame_of = frames_of(Corrector(labels), ())
    lines = (f"{_text(one.event, frame_of)} by {one.event.author}: {one.reason}" for one in found.unapplied)
    say_lines((f"does not apply: {line}" for line in lines), "yellow", show, ", in unapplied.json")
    say(f"-> {out}", style="dim")


def print_examined(found: Examined) -> None:
    """Print the check of a journal, and the intact part of a damaged one."""
    say_lines((f"damaged: {line}" for line in found.damage), "red")
    if found.damage:
        say(found.summary)
        say(found.help or "", style="yellow")
    else:
        chained = "" if found.chained else "; not chained yet: the next opening does it, and keeps this one beside"
        say(f"{counted(len(found.intact), 'event')}, all as they were saved{chained}")
    say(found.location, style="dim")


def print_written(found: Examined, made: Examined) -> None:
    """Print the contents of a copy, or of a new journal."""
    intact = len(made.intact)
    events = counted(intact, "event") if found.events is None else f"{intact:,} of {counted(found.events, 'event')}"
    say(f"{events} written and checked")
    left = len(found.intact) - len(made.intact)
    if found.damage and left:
        say(f"{left:,} intact ones are left out: they take back what is not intact", style="yellow")
    if found.damage:
        say(
            f"to go on: --journal {made.location}, or put it in the place of the damaged one, without the -wal and "
            "-shm files of that"
        )
    say(f"-> {made.location}", style="dim")


def frames_of(corrector: Corrector, journal: Journal | Sequence[Event]) -> FrameOf:
    """Look-up of frames by name, for the classes of objects in messages; None for a frame outside the labels."""

    def frame_of(frame: str) -> EffectiveFrame | None:
        try:
            return corrector.frame(frame, journal)
        except InputError:
            return None

    return frame_of


def _text(event: Event, frame_of: FrameOf) -> str:
    """Event in words, with the frame."""
    return f"{event.ref.frame}: {event_text(event, frame_of(event.ref.frame))}"


def print_objects(cards: Sequence[ObjectCard], whole: bool) -> None:
    """Print a line for each object; for a single object with `whole` every field with source."""
    print_rows(
        ("object", "class", "status", "size (m)", "away (m)", "T U F", "not the labeller's"),
        (
            (
                str(card.number),
                card.label,
                card.status or ("" if card.stands else "rejected"),
                "" if card.numbers is None else " ".join(f"{x:.2f}" for x in card.numbers.size),
                figure(card.distance, ".2f", ""),
                " ".join(str(n) for n in card.states.values()),
                ", ".join(f"{x.field} {x.origin.source}" for x in card.fields if x.origin.source != "auto"),
            )
            for card in cards
        ),
        overflow="fold",
    )
    for card in cards if whole else ():
        print_rows(
            ("field", "value", "from", "the labeller's"),
            (
                (x.field, x.text, str(x.origin), "" if x.automatic in (None, x.text) else x.automatic)
                for x in card.fields
            ),
            overflow="fold",
        )
        say_lines(f"{name} says: {status}" for name, status in card.statuses.items())
        more = (f"; box {card.fit}" if card.fit else "") + (f"; {card.concern}" if card.concern else "")
        added = f"; added by {card.added_by}" if card.added_by else ""
        points, asked = counted(card.points, "point"), counted(card.expressions, "expression")
        say(f"{points} of {card.mask_pixels} pixels; {asked}{more}{added}", style="dim")


def print_pair(card: PairCard) -> None:
    """Print a line for each relation."""
    away = "" if card.distance is None else f", {card.distance:.2f} m apart"
    say(f"{card.names[0]}·{card.a} ... {card.names[1]}·{card.b}{away}")
    if card.why_none:
        say(f"takes part in no relation: {card.why_none}", style="yellow")
        return
    print_rows(
        ("relation", "state", "margin (cm)", "status", "from"),
        (
            (
                PHRASE[line.relation],
                "" if line.state is None else letter(line.state),
                "" if line.margin is None else f"{100 * line.margin:+.1f}",
                line.status or "",
                str(line.origin),
            )
            for line in card.lines
        ),
        overflow="fold",
    )
