"""What of the labels somebody looks at, and their editors of several sources under one name."""

from __future__ import annotations

import getpass
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from journal_world import FRAME, an_expression, widest

from pipeline.answering import Pipeline, open_pipeline
from pipeline.corrections import JournalLocation, LabelEditor, LabelEditors, LabelView, labelled_box, paired, set_box
from pipeline.corrections.label_editor import login_name
from pipeline.datasets import Dataset
from pipeline.geometry import Box3D
from pipeline.labels import Labels
from pipeline.system import InputError


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline("demo", srm="rule")


@pytest.fixture
def place(demo_labels: Labels, tmp_path: Path) -> JournalLocation:
    return JournalLocation(demo_labels, tmp_path / "j.sqlite")


@pytest.fixture
def editor(demo_labels: Labels, place: JournalLocation, demo_dataset: Dataset) -> LabelEditor:
    return LabelEditor(demo_labels, place, "ann", demo_dataset)


def test_objects_stand_in_the_order_of_their_numbers(editor: LabelEditor) -> None:
    view = LabelView(editor.frame(FRAME))
    assert list(view.numbers) == sorted(view.frame.objects)
    assert [view.place(number) for number in view.numbers] == list(range(len(view.numbers)))
    assert view.places(*view.numbers[:2]) == (0, 1)
    assert (view.place(10_000), view.places(view.numbers[0], 10_000)) == (None, None)
    assert (view.number(None), view.number(len(view.numbers)), view.number(1)) == (None, None, view.numbers[1])


def test_a_view_tells_of_the_pair_that_is_chosen(editor: LabelEditor) -> None:
    frame = editor.frame(FRAME)
    view = LabelView(frame, relation="no relation")
    expression = an_expression(frame)
    ends = view.places(expression["target_object"], expression["reference_object"])
    told = view.detailed(editor, ends, None)
    assert told.card is not None
    assert (told.card.a, told.card.b) == (expression["target_object"], expression["reference_object"])
    assert told.relation == told.relations[0]
    assert told.about == (told.card.a, told.card.b)
    assert told.expressions[0].is_of(told.about)
    assert (told.history, told.author) == ((), "ann")
    kept = replace(told, expression=told.expressions[0].id, relation=told.relations[1]).detailed(editor, ends, None)
    assert kept.relation == told.relations[1]
    assert kept.sentence is not None
    alone = kept.detailed(editor, (0, 0), 0)
    assert (alone.card, alone.relations, alone.about) == (None, [], told.about)


def test_what_the_labeller_had_is_told_once_it_is_another(editor: LabelEditor) -> None:
    frame = editor.frame(FRAME)
    number, size = widest(frame), (480, 640)
    assert LabelView(frame).as_labelled(number, size) is None
    box = labelled_box(frame.objects[number])
    assert box is not None
    editor.save(set_box(frame, number, Box3D(box.center + 0.05, box.R, box.size)))
    changed = LabelView(editor.frame(FRAME))
    before = changed.as_labelled(number, size)
    assert before is not None
    assert before[0].any()
    assert before[1] is not None
    np.testing.assert_allclose(before[1].center, box.center)
    history = changed.detailed(editor, None, changed.place(number)).history
    assert {line.event.author for line in history} == {"ann"}


@pytest.mark.parametrize(
    ("pair", "selected", "before", "expected"),
    [
        ((1, 2), 3, 2, (3, 2)),
        ((1, 2), 2, 1, (1, 2)),
        (None, 3, None, None),
        (None, 3, 1, (3, 1)),
        ((1, 2), None, 1, (1, 2)),
        ((1, 2), 3, None, (3, 1)),
    ],
)
def test_a_pair_is_what_is_selected_and_what_was_before(
    pair: tuple[int, ...] | None, selected: int | None, before: int | None, expected: tuple[int, ...] | None
) -> None:
    assert paired(pair, selected, before) == expected


def test_one_name_for_the_labels_of_all_sources(place: JournalLocation, source: Pipeline) -> None:
    editors = LabelEditors({"demo": place}, {"demo": source, "other": source}, None)
    assert (editors.opened("demo"), editors.of("other"), editors.corrected("other", FRAME)) == (None, None, None)
    editors.greet("ben")
    opened = editors.of("demo")
    assert opened is not None
    assert opened is editors.opened("demo")
    assert opened.author == "ben"
    editors.sign(" cleo ")
    assert opened.author == "cleo"
    with pytest.raises(InputError, match="author"):
        editors.sign("   ")
    assert opened.author == "cleo"
    editors.sign_for_token("dora")
    editors.greet("ben")
    assert opened.author == "dora"
    with pytest.raises(InputError, match="token"):
        editors.sign("ben")
    given = LabelEditors({"demo": place}, {"demo": source}, "eve")
    given.greet("ben")
    found = given.of("demo")
    assert found is not None
    assert found.author == "eve"


def test_who_is_logged_in_nowhere_is_somebody(monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> str:
        raise OSError

    assert login_name() == getpass.getuser()
    monkeypatch.setattr(getpass, "getuser", nobody)
    assert login_name() == "somebody"
