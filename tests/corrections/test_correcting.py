"""Desks, conflicts and waiting edits: what one person sees, what two do at once, what is never lost."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from editor_checks import Open, desk, place  # noqa: F401
from journal_world import FRAME, an_expression

from pipeline.corrections import (
    Conflict,
    Journal,
    JournalLocation,
    LabelEditor,
    NotSaved,
    Saved,
    Waiting,
    actions_of,
    apply_actions,
    disputes,
    dump_unsaved,
    object_ref,
    read_actions,
    shown_value,
)
from pipeline.corrections.journal import edits
from pipeline.corrections.unsaved import decided
from pipeline.labels import Labels
from pipeline.relations import F, T
from pipeline.system import InputError


class Broken:
    """A journal whose disk is full until it is mended."""

    def __init__(self, place: JournalLocation, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full, real = True, Journal.write

        def write(journal: Journal, made: Any, author: str, action: Any, **how: Any) -> Any:
            if self.full:
                group = how.get("group") or f"{len(made)}" + "X" * 25
                raise NotSaved("the edit could not be saved", made, group, got="disk full", cause=None, path=None)
            return real(journal, made, author, action, **how)

        monkeypatch.setattr(Journal, "write", write)


# ---- conflicts -----------------------------------------------------------------------


def two_on_one_relation(desk: Open) -> tuple[LabelEditor, LabelEditor, Conflict, tuple[int, int]]:
    ann, bob = desk("ann"), desk("bob")
    mine, theirs = ann.frame(FRAME), bob.frame(FRAME)
    a, b = (int(n) for n in mine.pairs.numbers[:2])
    assert isinstance(ann.save(edits.set_relation(mine, a, b, "left", T, "seen so")), Saved)
    conflict = bob.save(edits.set_relation(theirs, a, b, "left", 0))
    assert isinstance(conflict, Conflict)
    return ann, bob, conflict, (a, b)


def test_the_second_is_told_and_may_take_theirs(desk: Open) -> None:
    _, bob, conflict, (a, b) = two_on_one_relation(desk)
    (dispute,) = disputes(conflict, bob.corrector.setting)
    edit, event = dispute.rivals[0].edit, dispute.rivals[0].event
    assert event is not None
    theirs, mine = (shown_value(dispute.rivals[0].edit.ref, value) for value in (event.after, edit.after))
    assert (event.author, theirs, mine, event.reason) == ("ann", "T", "U", "seen so")
    assert len(dispute.edits) == 2, "the inverse stands and falls with its relation"
    assert bob.disputed == (conflict,)
    assert bob.decide(conflict, ()) is None
    assert bob.disputed == ()
    assert bob.frame(FRAME).pairs.state(a, b, "left") == T
    assert len(bob.events(FRAME)) == 2


def test_mine_instead_is_made_on_theirs_and_says_so(desk: Open) -> None:
    ann, bob, conflict, (a, b) = two_on_one_relation(desk)
    done = bob.decide(conflict, (0,))
    assert isinstance(done, Saved)
    assert done.events[0].reason == "instead of ann's T"
    assert (done.events[0].before, done.events[0].base) == (T, 1)
    frame = ann.frame(FRAME)
    assert (frame.pairs.state(a, b, "left"), frame.pairs.state(b, a, "right")) == (0, 0)
    assert not frame.unapplied
    assert bob.disputed == ()


def test_who_decides_is_told_again_where_somebody_was_faster_again(desk: Open) -> None:
    ann, bob, conflict, (a, b) = two_on_one_relation(desk)
    ann.save(edits.set_relation(ann.frame(FRAME), a, b, "left", F))
    again = bob.decide(conflict, (0,))
    assert isinstance(again, Conflict)
    assert again.rivals[0].event is not None
    assert again.rivals[0].event.after == F
    assert bob.disputed == (again,)
    assert bob.frame(FRAME).pairs.state(a, b, "left") == F


def test_what_nobody_disputes_is_saved_with_either_choice(desk: Open) -> None:
    ann, bob = desk("ann"), desk("bob")
    frame = bob.frame(FRAME)
    first, second = sorted(frame.objects)[:2]
    both = (*edits.set_class(frame, first, "vase"), *edits.set_class(frame, second, "bowl"))
    ann.save(edits.set_class(ann.frame(FRAME), second, "cup"))
    conflict = bob.save(both)
    assert isinstance(conflict, Conflict)
    assert [d.rivals[0].edit.ref.numbers for d in disputes(conflict, bob.corrector.setting)] == [(second,)]
    kept = decided(conflict, bob.frame(FRAME), ())
    assert [e.ref for e in kept] == [object_ref(FRAME, first, "label")]
    assert isinstance(bob.decide(conflict, ()), Saved)
    assert [bob.frame(FRAME).objects[n]["label"] for n in (first, second)] == ["vase", "cup"]


def test_answers_of_an_expression_are_decided_as_one(desk: Open) -> None:
    ann, bob = desk("ann"), desk("bob")
    frame = bob.frame(FRAME)
    row = an_expression(frame)
    others = [n for n in frame.objects if n not in row["acceptable"]]
    ann.save(edits.set_ambiguous(ann.frame(FRAME), row["id"], not row["ambiguous"]))
    conflict = bob.save(edits.set_answers(frame, row["id"], others[:1]))
    assert isinstance(conflict, Conflict)
    assert len(conflict.rivals) == 1
    (dispute,) = disputes(conflict, bob.corrector.setting)
    assert len(dispute.edits) == 3
    assert bob.decide(conflict, ()) is None
    assert bob.frame(FRAME).expressions[row["id"]]["targets"] == row["targets"]


def test_an_undo_that_somebody_built_upon_is_a_conflict_to_decide(desk: Open) -> None:
    ann, bob = desk("ann"), desk("bob")
    number = min(ann.frame(FRAME).objects)
    ann.save(edits.set_class(ann.frame(FRAME), number, "vase"))
    bob.save(edits.set_class(bob.frame(FRAME), number, "bowl"))
    conflict = ann.undo()
    assert isinstance(conflict, Conflict)
    was = ann.frame(FRAME).auto.objects[number]["label"]
    assert isinstance(ann.decide(conflict, (0,)), Saved)
    assert ann.frame(FRAME).objects[number]["label"] == was


# ---- waiting -------------------------------------------------------------------------


def test_what_cannot_be_saved_is_shown_kept_and_saved_in_order(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch
) -> None:
    ann = desk("ann")
    name = an_expression(ann.frame(FRAME))["id"]
    disk = Broken(place, monkeypatch)
    for text in ("one", "two"):
        assert isinstance(ann.save(edits.set_text(ann.frame(FRAME), name, text)), Waiting)
    assert ann.frame(FRAME).expressions[name]["text"] == "two"
    again, other = desk("ann"), desk("bob")
    assert again.frame(FRAME).expressions[name]["text"] == "two", "another page of the same author sees them"
    assert other.frame(FRAME).expressions[name]["text"] != "two"
    assert [line.waiting for line in again.history(FRAME, expression=name)] == [True, True]
    assert isinstance(again.retry()[0], Waiting)
    with pytest.raises(InputError, match="not saved yet"):
        ann.sign("cleo")
    disk.full = False
    assert [type(o) for o in again.retry()] == [Saved, Saved]
    assert ann.waiting == ()
    assert [e.after for e in other.events(FRAME)] == ["one", "two"]
    assert [line.waiting for line in ann.history(FRAME, expression=name)] == []
    ann.frame(FRAME)
    assert [line.waiting for line in ann.history(FRAME, expression=name)] == [False, False]


def test_many_pages_of_one_author_save_what_waits_once(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch
) -> None:
    ann = desk("ann")
    numbers = sorted(ann.frame(FRAME).objects)[:5]
    disk = Broken(place, monkeypatch)
    for n in numbers:
        ann.save(edits.set_class(ann.frame(FRAME), n, "vase"))
    disk.full = False
    pages = [threading.Thread(target=desk("ann").retry) for _ in range(4)]
    for page in pages:
        page.start()
    for page in pages:
        page.join()
    ann.retry()
    assert [e.ref.numbers[0] for e in ann.events(FRAME)] == numbers


def test_what_waited_too_long_is_a_conflict_that_is_kept(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch
) -> None:
    ann, bob = desk("ann"), desk("bob")
    number = min(ann.frame(FRAME).objects)
    disk = Broken(place, monkeypatch)
    ann.save(edits.set_class(ann.frame(FRAME), number, "vase"))
    disk.full = False
    bob.save(edits.set_class(bob.frame(FRAME), number, "bowl"))
    (outcome,) = ann.retry()
    assert isinstance(outcome, Conflict)
    assert desk("ann").disputed == (outcome,)
    assert ann.frame(FRAME).objects[number]["label"] == "bowl"
    assert isinstance(desk("ann").decide(outcome, (0,)), Saved)
    assert ann.frame(FRAME).objects[number]["label"] == "vase"


def test_taking_back_what_waits_drops_it(desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch) -> None:
    ann = desk("ann")
    number = min(ann.frame(FRAME).objects)
    was = ann.frame(FRAME).objects[number]["label"]
    disk = Broken(place, monkeypatch)
    ann.save(edits.set_class(ann.frame(FRAME), number, "vase"))
    assert isinstance(ann.undo(), Waiting)
    assert ann.frame(FRAME).objects[number]["label"] == was
    disk.full = False
    assert ann.retry() == ()
    assert ann.undo() is None


def test_who_works_on_while_the_database_is_away_sees_their_own_edits(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch
) -> None:
    ann, bob = desk("ann"), desk("bob")
    number, other = sorted(ann.frame(FRAME).objects)[:2]
    ann.save(edits.set_class(ann.frame(FRAME), number, "vase"))
    Broken(place, monkeypatch)

    def away(*_: Any, **__: Any) -> Any:
        raise InputError("the journal cannot be read")

    ann.frame(FRAME)
    monkeypatch.setattr(Journal, "events", away)
    assert isinstance(ann.save(edits.set_class(ann.frame(FRAME), other, "bowl")), Waiting)
    assert [ann.frame(FRAME).objects[n]["label"] for n in (number, other)] == ["vase", "bowl"]
    with pytest.raises(InputError, match="cannot be read"):
        bob.frame(FRAME)


def test_what_is_left_at_the_end_goes_to_files_that_correct_takes(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    ann, bob = desk("ann"), desk("bob")
    frame = ann.frame(FRAME)
    name, number = an_expression(frame)["id"], min(frame.objects)
    disk = Broken(place, monkeypatch)
    disk.full = False
    stale = edits.set_class(bob.frame(FRAME), number, "bowl")
    ann.save(edits.set_class(frame, number, "vase"))
    assert isinstance(bob.save(stale), Conflict)
    disk.full = True
    for text in ("one", "two"):
        ann.save(edits.set_text(ann.frame(FRAME), name, text))
    ann.save(edits.add_object(ann.frame(FRAME), "lamp", bbox=[10, 10, 60, 60], number=1_000_007))
    ann.save(edits.set_class(ann.frame(FRAME), 1_000_007, "kettle"))
    nowhere = tmp_path / "absent"
    (hers, his) = dump_unsaved(place, [nowhere, tmp_path])
    assert (hers.author, len(hers.edits), len(hers.files)) == ("ann", 4, 2)
    assert "disk full" in hers.problem
    assert (his.author, len(his.files)) == ("bob", 1)
    assert dump_unsaved(place, [nowhere])[0].files == ()
    disk.full = False
    for path in hers.files:
        done = apply_actions(ann.corrector, place.to_write(), read_actions(path), "ann")
        assert isinstance(done, Saved), path.read_text()
    told = apply_actions(ann.corrector, place.to_write(), read_actions(his.files[0]), "bob")
    assert isinstance(told, Conflict)
    fresh = desk("cleo").frame(FRAME)
    assert fresh.expressions[name]["text"] == "two"
    assert fresh.objects[1_000_007]["label"] == "kettle"
    assert fresh.objects[number]["label"] == "vase"
    # What the program saved after all, in spite of the files, is not saved twice.
    assert isinstance(apply_actions(ann.corrector, place.to_write(), read_actions(hers.files[0]), "ann"), Conflict)


@pytest.mark.parametrize("seen", [False, True])
def test_a_lost_answer_to_undo_takes_nothing_back_twice(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch, seen: bool
) -> None:
    ann, real = desk("ann"), Journal.write
    number = min(ann.frame(FRAME).objects)
    for name in ("vase", "bowl", "lamp"):
        ann.save(edits.set_class(ann.frame(FRAME), number, name))
    lost = True

    def write(journal: Journal, made: Any, author: str, action: Any, **how: Any) -> Any:
        done = real(journal, made, author, action, **how)
        if lost:
            assert isinstance(done, Saved)
            raise NotSaved("the answer is lost", made, done.group, got="", cause=None, path=None)
        return done

    def label() -> str:
        return ann.frame(FRAME).objects[number]["label"]

    monkeypatch.setattr(Journal, "write", write)
    with pytest.raises(NotSaved):
        ann.undo()
    lost = False
    if seen:
        # Whoever has seen it taken back means the one before.
        assert label() == "bowl"
        assert isinstance(ann.undo(), Saved)
        assert label() == "vase"
        return
    assert isinstance(ann.undo(), Saved)
    assert label() == "bowl"
    assert isinstance(ann.undo(), Saved)
    assert label() == "vase"
    lost = True
    with pytest.raises(NotSaved):
        ann.redo()
    lost = False
    assert isinstance(ann.redo(), Saved)
    assert label() == "bowl"


def test_a_file_of_edits_is_not_saved_twice(desk: Open, place: JournalLocation) -> None:
    ann, journal = desk("ann"), place.to_write()
    todo = actions_of([{"edit": "new", "frame": FRAME, "label": "lamp", "bbox": [10, 10, 60, 60]}])
    done = apply_actions(ann.corrector, journal, todo, "ann")
    assert isinstance(done, Saved)
    again = apply_actions(ann.corrector, journal, todo, "ann", again=done.group)
    assert again == done
    assert len(journal.events()) == 1


def test_judgements_that_were_not_saved_are_taken_from_the_file(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    ann = desk("ann")
    frame = ann.frame(FRAME)
    a, b = (int(n) for n in frame.pairs.numbers[:2])
    disk = Broken(place, monkeypatch)
    ann.save(edits.judge_relation(frame, a, b, "left", T, "ann"))
    ann.save(edits.set_class(ann.frame(FRAME), a, "vase"))
    (hers,) = dump_unsaved(place, [tmp_path])
    disk.full = False
    (path,) = hers.files
    journal = place.to_write()
    with pytest.raises(InputError, match="judgement of another person"):
        apply_actions(ann.corrector, journal, read_actions(path), "bob")
    assert isinstance(apply_actions(ann.corrector, journal, read_actions(path), "ann"), Saved)
    assert {e.ref.kind for e in journal.events()} == {"review", "object"}


def test_files_of_several_people_do_not_replace_each_other(
    desk: Open, place: JournalLocation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    Broken(place, monkeypatch)
    # Of both names nothing is left in the name of a file.
    for author in ("李", "王"):
        one = desk(author)
        one.save(edits.set_class(one.frame(FRAME), min(one.frame(FRAME).objects), author))
    folder = tmp_path / "a file"
    folder.touch()
    found = dump_unsaved(place, [folder, tmp_path])
    files = [path for each in found for path in each.files]
    assert len(set(files)) == 2
    assert {str(a.model_dump()["to"]) for path in files for a in read_actions(path)} == {"李", "王"}
    assert list(tmp_path.glob(".*")) == []


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (None, ()),
        ("elsewhere.sqlite", ("--journal", "elsewhere.sqlite")),
        ("postgresql://ann:secret@host:5433/team", ("--journal", "postgresql://ann@host:5433/team")),
        ("postgresql://host/team?sslmode=require", ("--journal", "postgresql://host/team?sslmode=require")),
        ("postgresql://host/team?port=1&password=secret", ("--journal", "postgresql://host/team?port=1")),
        ("postgresql://ann:secret@host:5x/team?password=secret", ("--journal", "postgresql://ann@host:5x/team")),
    ],
)
def test_a_place_names_itself_without_its_password(
    demo_labels: Labels, where: str | None, words: tuple[str, ...]
) -> None:
    assert JournalLocation(demo_labels, where).words == words
    place = JournalLocation(demo_labels, where, "kitchen")
    assert place.words == (*words, "--project", "kitchen")
    assert "secret" not in str(place)


def test_who_has_something_to_decide_keeps_the_name(desk: Open) -> None:
    _, bob, conflict, _ = two_on_one_relation(desk)
    with pytest.raises(InputError, match="has not decided"):
        bob.sign("cleo")
    assert bob.author == "bob"
    bob.decide(conflict, ())
    bob.sign("cleo")
    assert bob.author == "cleo"


def test_nothing_waits_nothing_is_written(place: JournalLocation, tmp_path: Path) -> None:
    assert dump_unsaved(place, [tmp_path]) == ()
    assert list(tmp_path.glob("unsaved*")) == []
