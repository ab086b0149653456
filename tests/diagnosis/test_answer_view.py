"""An answer as somebody looks at it: what is chosen and selected stays by its object, and edits are said in words."""

from __future__ import annotations

from dataclasses import replace

import pytest
from whatif_scenes import ScoringDetector, context_of, source

from pipeline.answering import LoadedFrame, all_objects
from pipeline.diagnosis import (
    AnswerView,
    Baseline,
    BothAnswers,
    Edits,
    OtherAnswer,
    edits_from_words,
    shown_objects,
)
from pipeline.diagnosis.whatif import rerun
from pipeline.diagnosis.whatif.answer_view import answer_view
from pipeline.system import InputError

ASKED = "mug left of the laptop"


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    return Baseline(source(scorer="rule"), context_of(), ASKED)


@pytest.fixture(scope="module")
def scored() -> Baseline:
    return Baseline(source(ScoringDetector(), scorer="rule"), context_of(), ASKED)


def looked_at(baseline: Baseline, edits: Edits | None = None) -> AnswerView:
    edits = edits or Edits()
    return answer_view(baseline.context, rerun(baseline, edits), edits)


def after(view: AnswerView, baseline: Baseline, edits: Edits) -> AnswerView:
    """The view with edits, as one goes on looking at it."""
    outcome = rerun(baseline, edits)
    keys = baseline.outcome.keys if view.edited is None else view.edited.after.keys
    return view.under(edits, BothAnswers(baseline.outcome, outcome, None, 0.0), None, keys)


def test_the_best_pair_is_chosen_with_its_roles_and_the_next_ones_beside(baseline: Baseline) -> None:
    view = looked_at(baseline)
    assert view.pair is not None
    assert view.chosen is view.ranked[0]
    assert view.roles == {view.pair[0]: "target", view.pair[1]: "reference"}
    assert view.pair_lines[0] == view.pair
    assert len(view.pair_lines) == len(set(view.pair_lines)) > 1
    assert view.shown.names[view.pair[1]] == "laptop·3"
    assert replace(view, pair=None).roles == {}


def test_all_objects_of_the_frame_are_shown_those_of_the_question_as_it_found_them(baseline: Baseline) -> None:
    objects = all_objects(baseline.context, baseline.detector)
    trace = baseline.outcome.trace
    shown = shown_objects(LoadedFrame(baseline.context, objects), trace, trace.exact)
    assert [o.id for o in shown.objects] == [o.id for o in objects]
    assert [shown.objects[place].id for place in shown.place.values()] == [o.id for o in trace.objects]


def test_what_is_selected_and_chosen_stays_by_its_object_when_the_answer_moves(baseline: Baseline) -> None:
    view = looked_at(baseline)
    other = replace(view, pair=view.at(view.ranked[1]), selected=view.at(view.ranked[1])[0])
    kept = {other.shown.objects[place].id for place in other.pair or ()}
    best = baseline.outcome.keys[view.ranked[0].target]
    hidden = after(other, baseline, Edits().with_hidden(best))
    assert {hidden.shown.objects[place].id for place in hidden.pair or ()} == kept
    # The answer itself is followed by the new one; what was hidden is none of its objects any more.
    moved = after(view, baseline, Edits().with_hidden(best))
    assert moved.chosen is moved.ranked[0]
    assert moved.edited is not None
    assert moved.edited.pair_before(moved.ranked[0])[0] == 2
    back = after(moved, baseline, Edits())
    assert back.edited is None
    assert [o.id for o in back.shown.objects] == [o.id for o in view.shown.objects]


def test_a_confidence_is_seen_at_the_object_and_a_relation_beside_what_it_was(scored: Baseline) -> None:
    view = looked_at(scored)
    key = scored.outcome.keys[view.ranked[0].target]
    seen = after(view, scored, Edits().with_confidence("mug", key, 0.07))
    place = seen.place_of(key)
    assert place is not None
    assert seen.shown.objects[place].score == pytest.approx(0.07)
    pair = view.ranked[0]
    assert pair.reference is not None
    ends = scored.outcome.keys[pair.target], scored.outcome.keys[pair.reference]
    again = after(view, scored, Edits().with_relation("left", *ends, 0.05))
    assert again.edited is not None
    a, b = (again.edited.after.keys.index(end) for end in ends)
    assert again.edited.relation_before(a, b, "left") == pytest.approx(pair.p_relation)
    assert again.edited.relation_before(a, b, "no relation") is None


def test_objects_are_found_again_by_their_keys(baseline: Baseline, scored: Baseline) -> None:
    # Objects of a detector without ids have keys where the answer is edited.
    edited = after(looked_at(scored), scored, Edits().with_confidence("mug", scored.outcome.keys[0], 0.5))
    for asked, view in ((baseline, looked_at(baseline)), (scored, edited)):
        keys = [view.key_of(place) for place in range(len(view.shown.objects))]
        assert {key for key in keys if key is not None} == set(asked.outcome.keys)
        assert [view.place_of(key or "") for key in keys] == list(range(len(keys)))
    assert looked_at(baseline).place_of("#99") is None


def test_the_other_runs_answer_is_told_by_what_of_it_is_another_thing(baseline: Baseline) -> None:
    view = looked_at(baseline)
    assert view.other_pair == ""
    assert view.ghosts == []
    same = replace(view, other=OtherAnswer("", baseline.outcome.trace, name="second"))
    assert (same.other_pair, same.ghosts) == ("the same pair", [])
    hidden = rerun(baseline, Edits().with_hidden(baseline.outcome.keys[view.ranked[0].target]))
    another = replace(view, other=OtherAnswer("", hidden.trace, name="second"))
    assert another.other_pair == "another target"
    assert [(g.key, g.role) for g in another.ghosts] == [("other-target", "edited")]
    assert replace(view, other=OtherAnswer("", problem="no", name="second")).other_pair == ""


def test_edits_are_said_in_words_one_after_the_other(baseline: Baseline) -> None:
    view, keys = looked_at(baseline), baseline.outcome.keys
    target = keys[view.ranked[0].target]
    made = edits_from_words(baseline, Edits(), ["size:1:0.3", "set:target_weight:2", "relation:0.2"])
    assert made.boxes[target].size[1] == pytest.approx(0.3)
    assert made.rank == {"target_weight": 2.0}
    assert list(made.relations.values()) == [0.2]
    grown = edits_from_words(baseline, made, ["mask:grow:2"], target)
    assert (list(grown.masks), grown.boxes) == ([target], {})
    laptop = next(key for key, o in zip(keys, baseline.outcome.trace.objects, strict=True) if o.label == "laptop")
    assert edits_from_words(baseline, Edits(), ["hide"], laptop).hidden == {laptop}
    assert edits_from_words(baseline, Edits(), ["set:scorer:own", f"set:k:{baseline.source.config.k}"]) == Edits()


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("size:1", "no such number"),
        ("size:7:0.2", "no such number"),
        ("yaw:wide", "must be a number"),
        ("center:0:nan", "must be a number"),
        ("confidence:9:0.5", "no such name"),
        ("mask:blow", "no such mask"),
        ("mask:rectangle:1,2", "four numbers"),
        ("set:colour:1", "no such setting"),
        ("dance", "no such edit"),
        ("set:scorer:magic", "no such relation scorer"),
        ("mask:label", "no labelled object"),
        ("mask:swap", "no such mask"),
        ("relation:2", "probability"),
    ],
)
def test_what_is_no_edit_is_refused_in_a_line(baseline: Baseline, said: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        edits_from_words(baseline, Edits(), [said])
    with pytest.raises(InputError, match="no such object"):
        edits_from_words(baseline, Edits(), ["hide"], "#99")
