"""What a view shows of the truth: dashed boxes of what should be, none beside what is right, and lit pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline import open_run
from pipeline.answering import LoadedFrame
from pipeline.datasets.demo import demo_run
from pipeline.diagnosis import AnswerView, shown_objects
from pipeline.diagnosis.answer import Answer
from pipeline.evaluation.run_folder import Run
from pipeline.system.errors import needed


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(demo_run())


def seen(run: Run, search: str, number: int = 0) -> tuple[Answer, AnswerView]:
    answer = run.failures(search)[number].answer
    trace, judged = needed(answer.trace, "no answer"), needed(answer.diagnosis, "no verdict")
    loaded = LoadedFrame(judged.evidence.answers.context, ())
    view = AnswerView(loaded=loaded, trace=trace, found=shown_objects(loaded, trace, trace.exact), judged=judged)
    return answer, replace(view, pair=view.at(view.ranked[0]))


def test_no_second_box_stands_beside_a_right_answer(run: Run) -> None:
    _, view = seen(run, "verdict:CORRECT lucky:false")
    assert view.right_roles == {"target", "reference"}
    assert view.ghosts == []


def test_only_what_is_wrong_has_a_second_box(run: Run) -> None:
    _, view = seen(run, "verdict:OPM-CONF")
    assert {ghost.key for ghost in view.ghosts}.isdisjoint(view.right_roles)
    assert view.ghosts
    assert all(ghost.text.startswith("should be ") for ghost in view.ghosts)


def test_a_box_that_is_to_blame_is_not_called_right(run: Run) -> None:
    _, view = seen(run, "verdict:LIFT")
    assert view.right_roles == frozenset()
    assert {ghost.key for ghost in view.ghosts} == {"target", "reference"}


def test_a_labelled_box_names_the_found_one_of_the_same_thing(run: Run) -> None:
    """Both boxes are of one thing where the answer has the right object; not so beside another object."""
    place = {}
    for search in ("verdict:LIFT", "verdict:OPM-CONF"):
        answer, view = seen(run, search)
        judged = needed(answer.diagnosis, "no verdict")
        for ghost in view.ghosts:
            best = judged.evidence.match[getattr(view.ranked[0], ghost.key)]
            same = best == judged.labelled[ghost.key]
            place[search, same] = ghost.of
            assert ghost.of == (needed(view.pair, "no pair")[ghost.key == "reference"] if same else None)
    assert {same for _, same in place} == {True, False}


def test_where_nothing_is_judged_no_box_is_of_the_same_thing(run: Run) -> None:
    _, view = seen(run, "verdict:LIFT")
    assert [ghost.of for ghost in replace(view, pair=None).ghosts] == [None, None]


def test_pixels_of_the_pair_and_of_the_labelled_one_are_lit(run: Run) -> None:
    answer, view = seen(run, "verdict:OPM-CONF")
    judged = needed(answer.diagnosis, "no verdict")
    masks = [view.shown.objects[i].mask for i in view.roles]
    masks += [judged.evidence.objects.mask(k) for k in judged.labelled.values()]
    lit = np.logical_or.reduce(view.lit)
    assert lit.dtype == np.bool_
    assert all(lit[mask].all() for mask in masks)
    assert lit.sum() <= sum(int(mask.sum()) for mask in masks)


def test_a_box_that_is_blamed_is_shown_as_found_beside_the_answers(run: Run) -> None:
    """Of LIFT, where it is of neither object of the chosen pair; of the right pair it is one of the pair's own."""
    shown = 0
    for number in range(len(run.failures("verdict:LIFT"))):
        answer, view = seen(run, "verdict:LIFT", number)
        box = needed(answer.diagnosis, "no verdict").needed_box
        own = [ghost.text for ghost in view.ghosts if ghost.role == "other"]
        beside = box is not None and view.found.place[box[0]] not in (view.pair or ())
        assert own == ([f"{view.name_of(box[0]).replace('·', ' ')} as found"] if box and beside else [])
        shown += beside
    assert shown
