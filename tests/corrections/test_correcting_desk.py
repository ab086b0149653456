"""A desk: what one person sees, saves, takes back, and what waits where it cannot be saved."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journal_world import FRAME, an_expression

from pipeline.corrections import (
    ASKED_BEYOND_M,
    Conflict,
    Journal,
    JournalLocation,
    LabelEditor,
    Saved,
    Waiting,
    events_text,
    judge_relation,
    labelled_objects,
    pair_card,
    set_class,
    set_relation,
    set_text,
)
from pipeline.datasets import Dataset
from pipeline.geometry import decode_run_length
from pipeline.labels import Labels
from pipeline.relations import F, T, U
from pipeline.system import InputError


def _away(*_: Any, **__: Any) -> Any:
    raise InputError("the journal cannot be read")


@pytest.fixture
def place(demo_labels: Labels, tmp_path: Path) -> JournalLocation:
    return JournalLocation(demo_labels, tmp_path / "j.sqlite")


def test_looking_writes_nothing(demo_labels: Labels, place: JournalLocation, tmp_path: Path) -> None:
    desk = LabelEditor(demo_labels, place, "ann")
    desk.frame(FRAME)
    assert desk.undo() is None
    assert desk.redo() is None
    assert not list(tmp_path.iterdir())


def test_what_is_saved_is_seen_by_everyone_taken_back_and_brought_back(
    demo_labels: Labels, place: JournalLocation
) -> None:
    ann, ben = (LabelEditor(demo_labels, place, name) for name in ("ann", "ben"))
    frame = ann.frame(FRAME)
    a, b = frame.pairs.numbers[:2].tolist()
    was = frame.pairs.state(a, b, "left")
    assert was in (T, F)
    assert was is not None
    assert isinstance(ann.save(set_relation(frame, a, b, "left", T if was == F else F)), Saved)
    assert len(ben.news(FRAME)) == 2
    for desk in (ann, ben):
        line = pair_card(desk.frame(FRAME), a, b).lines[0]
        assert (line.relation, line.state) == ("left", -was)
        assert (line.origin.source, line.origin.author) == ("human", "ann")
    assert ben.undo() is None
    assert isinstance(ann.undo(), Saved)
    assert ben.frame(FRAME).pairs.state(a, b, "left") == was
    assert isinstance(ann.redo(), Saved)
    assert ben.frame(FRAME).pairs.state(a, b, "left") == -was


def test_geometry_contradicts_what_its_margin_does_not_allow(demo_labels: Labels, place: JournalLocation) -> None:
    desk = LabelEditor(demo_labels, place, "ann")
    frame = desk.frame(FRAME)
    a, b = frame.pairs.numbers[:2].tolist()
    lines = [x for n in frame.pairs.numbers[2:].tolist() for x in pair_card(frame, a, n).lines]
    for line in lines:
        assert line.state is not None
        assert line.margin is not None
        # The rule never contradicts itself, and doubts contradict nothing.
        assert line.against(line.state) == line.against(U) == 0
        assert line.against(-line.state) == (abs(line.margin) if line.state != U else 0)
    assert any(line.against(-line.state) > ASKED_BEYOND_M for line in lines if line.state)
    line = pair_card(frame, a, b).lines[0]
    assert line.state in (T, F)
    desk.save(set_relation(frame, a, b, line.relation, -line.state))
    # What a person has decided already is not held against the next one.
    mended = pair_card(desk.frame(FRAME), a, b).lines[0]
    assert mended.against(T) == mended.against(F) == 0


@pytest.mark.parametrize("moved", [True, False])
def test_a_journal_that_was_put_back_is_read_afresh(demo_labels: Labels, place: JournalLocation, moved: bool) -> None:
    ann, copy = LabelEditor(demo_labels, place, "ann"), Path(f"{place.where}.copy")
    ann.save(set_class(ann.frame(FRAME), 3, "jar"))
    place.close()
    copy.write_bytes(Path(str(place.where)).read_bytes())
    ann.save(set_class(ann.frame(FRAME), 3, "mug"))
    assert ann.frame(FRAME).objects[3]["label"] == "mug"
    assert not ann.replaced(FRAME)
    place.close()
    copy.replace(str(place.where))
    for left in ("-wal", "-shm"):
        Path(f"{place.where}{left}").unlink(missing_ok=True)
    if moved:
        # What is saved now has the number of an event that was seen, or a smaller one.
        ben = LabelEditor(demo_labels, JournalLocation(demo_labels, place.where), "ben")
        assert isinstance(ben.save(set_class(ben.frame(FRAME), 5, "cup")), Saved)
        ben.location.close()
    assert ann.replaced(FRAME)
    assert [e.author for e in ann.news(FRAME)] == ["ben"] * moved
    frame = ann.frame(FRAME)
    assert (frame.objects[3]["label"], frame.objects[5]["label"] == "cup") == ("jar", moved)
    assert not ann.replaced(FRAME)
    assert isinstance(ann.save(set_class(frame, 3, "mug")), Saved)
    assert ann.frame(FRAME).objects[3]["label"] == "mug"


def test_what_was_saved_last_is_seen_while_the_journal_is_away(
    demo_labels: Labels, place: JournalLocation, monkeypatch: pytest.MonkeyPatch
) -> None:
    ann = LabelEditor(demo_labels, place, "ann")
    assert isinstance(ann.save(set_class(ann.frame(FRAME), 3, "jar")), Saved)
    with monkeypatch.context() as patch:
        patch.setattr(Journal, "events", _away)
        frame = ann.frame(FRAME)
        assert frame.objects[3]["label"] == "jar"
    # What is made on it is made on what is there.
    assert isinstance(ann.save(set_class(frame, 3, "mug")), Saved)
    assert [e.after for e in ann.events(FRAME)] == ["jar", "mug"]


def test_who_comes_second_is_told_and_overwrites_nothing(demo_labels: Labels, place: JournalLocation) -> None:
    ann, ben = (LabelEditor(demo_labels, place, name) for name in ("ann", "ben"))
    seen = ann.frame(FRAME), ben.frame(FRAME)
    assert isinstance(ann.save(set_class(seen[0], 3, "beaker")), Saved)
    outcome = ben.save(set_class(seen[1], 3, "jar"))
    assert isinstance(outcome, Conflict)
    said = str(outcome.rivals[0])
    assert "ann" in said
    assert "beaker" in said
    assert ben.frame(FRAME).objects[3]["label"] == "beaker"


def test_what_cannot_be_saved_is_kept_shown_and_saved_later(
    demo_labels: Labels, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "away"
    place = JournalLocation(demo_labels, folder / "j.sqlite")
    desk = LabelEditor(demo_labels, place, "ann")
    first = desk.save(set_class(desk.frame(FRAME), 3, "beaker"))
    assert isinstance(first, Waiting)
    assert "folder" in first.problem
    # What is made on it waits, too.
    assert isinstance(desk.save(set_class(desk.frame(FRAME), 3, "jar")), Waiting)
    assert desk.frame(FRAME).objects[3]["label"] == "jar"
    assert [type(x) for x in desk.retry()] == [Waiting]
    assert len(desk.waiting) == 2
    folder.mkdir()
    assert [type(x) for x in desk.retry()] == [Saved, Saved]
    assert not desk.waiting
    with monkeypatch.context() as patch:
        # It goes away again before anybody has looked.
        patch.setattr(Journal, "events", _away)
        assert desk.frame(FRAME).objects[3]["label"] == "jar"
        assert len(desk.events(FRAME)) == 2
    assert LabelEditor(demo_labels, place, "ben").frame(FRAME).objects[3]["label"] == "jar"
    assert [e.after for e in place.to_write().events()] == ["beaker", "jar"]


def test_what_waits_can_be_dropped_and_is_a_conflict_where_somebody_was_faster(
    demo_labels: Labels, tmp_path: Path
) -> None:
    folder = tmp_path / "away"
    place = JournalLocation(demo_labels, folder / "j.sqlite")
    ann, ben = (LabelEditor(demo_labels, place, name) for name in ("ann", "ben"))
    name = ann.frame(FRAME).objects[3]["label"]
    ann.save(set_class(ann.frame(FRAME), 3, "jar"))
    assert isinstance(ann.undo(), Waiting)
    assert ann.frame(FRAME).objects[3]["label"] == name
    ann.save(set_class(ann.frame(FRAME), 3, "jar"))
    seen = ben.frame(FRAME)
    folder.mkdir()
    assert isinstance(ben.save(set_class(seen, 3, "beaker")), Saved)
    (outcome,) = ann.retry()
    assert isinstance(outcome, Conflict)
    assert not ann.waiting
    assert ann.frame(FRAME).objects[3]["label"] == "beaker"


def test_an_edit_that_is_none_does_not_wait(demo_labels: Labels, place: JournalLocation) -> None:
    desk = LabelEditor(demo_labels, place, "ann")
    with pytest.raises(InputError, match="nothing to save"):
        desk.save(())
    assert not desk.waiting
    with pytest.raises(InputError, match="no such frame"):
        desk.frame("nowhere")


def test_labelled_objects_are_what_the_rows_say(demo_labels: Labels, place: JournalLocation) -> None:
    frame = LabelEditor(demo_labels, place, "ann").frame(FRAME)
    objects = labelled_objects(frame)
    assert [o.id for o in objects] == sorted(frame.objects)
    for entry in objects:
        row = frame.objects[entry.id]
        assert entry.label == row["label"]
        np.testing.assert_array_equal(entry.mask, decode_run_length(entry.mask.shape, row["mask"]))
        if row["center"] is not None:
            assert entry.lifted.box is not None
            np.testing.assert_allclose(entry.lifted.box.center, row["center"])
            np.testing.assert_allclose(entry.lifted.box.R.ravel(), row["R"])
            np.testing.assert_allclose(entry.lifted.lo, row["lo"])


def test_a_new_class_makes_one_object_anew(demo_labels: Labels, place: JournalLocation) -> None:
    desk = LabelEditor(demo_labels, place, "ann")
    frame = desk.frame(FRAME)
    objects, number = labelled_objects(frame), min(frame.objects)
    desk.save(set_class(frame, number, "mug" if frame.objects[number]["label"] != "mug" else "lamp"))
    now = labelled_objects(desk.frame(FRAME))
    assert [a.id for a, b in zip(objects, now, strict=True) if a is not b] == [number]


def test_a_card_mirrors_the_pair_the_other_way_round(demo_labels: Labels, place: JournalLocation) -> None:
    frame = LabelEditor(demo_labels, place, "ann").frame(FRAME)
    a, b = frame.pairs.numbers[:2].tolist()
    one, other = ({line.relation: line.state for line in pair_card(frame, *ends).lines} for ends in ((a, b), (b, a)))
    for relation, mirror in (("left", "right"), ("above", "below"), ("front", "behind"), ("near", "near")):
        assert one[relation] == other[mirror]
    for ends in ((a, a), (a, 99_999)):
        with pytest.raises(InputError):
            pair_card(frame, *ends)


def test_background_takes_part_in_no_relation_and_says_why(demo_labels: Labels, demo_dataset: Dataset) -> None:
    for name in demo_labels.frames.column("frame").to_pylist():
        frame = LabelEditor(demo_labels, JournalLocation(demo_labels, "nowhere/j"), "ann", demo_dataset).frame(name)
        lonely = [n for n in frame.objects if frame.pairs.index_of(n) is None]
        if lonely:
            card = pair_card(frame, lonely[0], frame.pairs.numbers[0])
            assert not card.lines
            assert str(lonely[0]) in card.why_none
            return
    pytest.skip("everything of the demo takes part in relations")


def test_actions_in_words_name_the_objects_and_do_not_count_the_mirror(
    demo_labels: Labels, place: JournalLocation
) -> None:
    desk = LabelEditor(demo_labels, place, "ann")
    frame = desk.frame(FRAME)
    a, b = frame.pairs.numbers[:2].tolist()
    names = [f"{frame.objects[n]['label']}·{n}" for n in (a, b)]
    state = frame.pairs.state(a, b, "left")
    assert state is not None
    assert state in (T, F)
    done = desk.save(judge_relation(frame, a, b, "left", state, "ann"))
    assert isinstance(done, Saved)
    assert events_text(done.events, frame) == f"{names[0]} left of {names[1]} is {'T' if state == T else 'F'}: accepted"
    done = desk.save(set_relation(frame, a, b, "left", -state))
    assert isinstance(done, Saved)
    assert len(done.events) == 2
    said = events_text(done.events, frame)
    assert said.startswith(f"{names[0]} left of {names[1]}: ")
    assert "more" not in said
    row = an_expression(frame)
    done = desk.save(set_text(frame, row["id"], "the one over there"))
    assert isinstance(done, Saved)
    assert "the one over there" in events_text(done.events, desk.frame(FRAME))
    # Without its frame an expression has its id.
    assert events_text(done.events, None).startswith(f"text of expression {done.events[0].ref.key}: ")


def test_what_was_made_on_an_edit_that_is_disputed_is_disputed_with_it(demo_labels: Labels, tmp_path: Path) -> None:
    folder = tmp_path / "away"
    place = JournalLocation(demo_labels, folder / "j.sqlite")
    ann, ben = (LabelEditor(demo_labels, place, name) for name in ("ann", "ben"))
    first, other = sorted(ann.frame(FRAME).objects)[:2]
    for name in ("vase", "bowl"):
        ann.save(set_class(ann.frame(FRAME), first, name))
    ann.save(set_class(ann.frame(FRAME), other, "lamp"))
    seen = LabelEditor(demo_labels, JournalLocation(demo_labels, tmp_path / "none.sqlite"), "ben").frame(FRAME)
    folder.mkdir()
    assert isinstance(ben.save(set_class(seen, first, "jar")), Saved)
    # The second edit is of version 1, which is ben's by now.
    conflict, saved = ann.retry()
    assert isinstance(conflict, Conflict)
    assert isinstance(saved, Saved)
    (edit,) = conflict.edits
    assert (edit.base, edit.after) == (0, "bowl")
    assert not ann.waiting
    frame = ann.frame(FRAME)
    assert [frame.objects[n]["label"] for n in (first, other)] == ["jar", "lamp"]
    assert frame.unapplied == ()
    assert isinstance(ann.decide(ann.disputed[0], {0}), Saved)
    assert ann.disputed == ()
    assert ben.frame(FRAME).objects[first]["label"] == "bowl"


def test_an_edit_is_kept_while_another_thread_saves_what_waits(
    demo_labels: Labels, place: JournalLocation, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk = LabelEditor(demo_labels, place, "ann")
    number = min(desk.frame(FRAME).objects)
    early = Waiting(set_class(desk.frame(FRAME), number, "vase"), "ann", "g", datetime.now(timezone.utc), "disk full")
    edits = set_class(desk.frame(FRAME), number, "bowl")
    answers = iter([(early,)])
    # Whoever asks a second time hears that nothing waits any more.
    monkeypatch.setattr(type(place.unsaved), "waiting", lambda *_: next(answers, ()))
    assert isinstance(desk.save(edits), Waiting)
