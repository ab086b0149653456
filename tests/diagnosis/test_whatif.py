"""Answers under edits: the same as the whole pipeline's, keys that last, edits that survive JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from whatif_scenes import ScoringDetector, context_of, row, source

from pipeline.answering import AskConfig, PreparedFrame, SceneObject, Trace, appearance_of
from pipeline.answering.ask import ask
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis import Baseline, Edits, edits_record, foreign_keys, load_edits, what_changed
from pipeline.diagnosis.whatif import read_edits, rerun
from pipeline.diagnosis.whatif.pair_tables import detection_keys
from pipeline.geometry import Box3D, LiftConfig
from pipeline.language import PAIRWISE
from pipeline.relations import Profile, make_scorer, pairwise_states
from pipeline.system import InputError, require

QUESTIONS = (
    "mug left of the laptop",
    "mug on the table",
    "mug closest to the book",
    "mug between the book and the laptop",
    "table holding a mug",
    "mug right of the book left of the laptop",
    "lamp left of the mug",
)
FRAME = row()


def object_keys(trace: Trace, found: dict[str, Any]) -> tuple[str, ...]:
    """The key of each object of a trace that was answered without edits, in the order of `trace.objects`.

    Parameters
    ----------
    found : mapping of str to Proposals
        The detector's whole run for each name of the expression.

    Raises
    ------
    InputError
        The trace is of other detections.
    """
    keys: list[str | None] = [f"#{o.id}" if o.id >= 0 else None for o in trace.objects]
    for name, candidates in trace.candidates.items():
        names, proposals = detection_keys(name, found[name]), found[name]
        taken: set[int] = set()
        for at in candidates.index.tolist():
            if keys[at] is not None:
                continue
            entry = trace.objects[at]
            alike = (proposals.boxes == entry.bbox).all(axis=1) & (proposals.scores == np.float32(entry.score))
            indices = [k for k in np.flatnonzero(alike).tolist() if k not in taken]
            require(indices, f"the trace has an object {name!r} that is not among these detections")
            taken.add(indices[0])
            keys[at] = names[indices[0]]
    require(not any(key is None for key in keys), "the trace has an object that is no candidate of any name")
    return tuple(key for key in keys if key is not None)


def apply(baseline: Baseline, edits: Edits) -> Trace:
    return rerun(baseline, edits).trace


def assert_same(a: Trace, b: Trace, exactly: bool = True) -> None:
    """Two traces say the same; only what they cost may differ."""
    close: Any = np.testing.assert_array_equal if exactly else _near
    np.testing.assert_array_equal(a.scores.states, b.scores.states)
    close(a.scores.probabilities, b.scores.probabilities)
    assert (a.scores.relations, a.scores.scored_by) == (b.scores.relations, b.scores.scored_by)
    assert (a.missing, a.detector, a.scorer, a.exact) == (b.missing, b.detector, b.scorer, b.exact)
    assert a.query == b.query
    assert len(a.objects) == len(b.objects)
    for x, y in zip(a.objects, b.objects, strict=True):
        assert (x.id, x.label, x.score) == (y.id, y.label, y.score)
        np.testing.assert_array_equal(x.bbox, y.bbox)
        np.testing.assert_array_equal(x.mask, y.mask)
        np.testing.assert_array_equal(x.lifted.points, y.lifted.points)
        # As text: the distance of nothing is NaN, which is unlike itself.
        assert str(x.lifted.quality) == str(y.lifted.quality)
    assert list(a.candidates) == list(b.candidates)
    for name, own in a.candidates.items():
        np.testing.assert_array_equal(own.index, b.candidates[name].index)
        np.testing.assert_array_equal(own.scores, b.candidates[name].scores)
    if exactly or a.ranking is None or b.ranking is None:
        assert a.ranking == b.ranking
    else:
        assert [(p.target, p.reference) for p in a.ranking.pairs] == [(p.target, p.reference) for p in b.ranking.pairs]
        assert abs(a.ranking.margin - b.ranking.margin) < 1e-9


def _near(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)


@pytest.mark.parametrize("scorer", ["rule", "trained"])
@pytest.mark.parametrize("text", QUESTIONS)
@pytest.mark.parametrize("detector", [None, ScoringDetector()])
def test_without_edits_it_is_the_answer_itself(text: str, scorer: str, detector: Any) -> None:
    asked = source(detector, scorer)
    baseline = Baseline(asked, context_of(FRAME), text)
    whole = asked.ask(context_of(FRAME), text)
    assert_same(baseline.outcome.trace, whole)
    assert_same(apply(baseline, Edits()), whole)
    assert baseline.outcome.keys == object_keys(whole, baseline.found)


@pytest.mark.parametrize(
    ("edits", "config", "scorer"),
    [
        (Edits().with_k(2), AskConfig(k=2), "trained"),
        (Edits().with_settings("rank", relation_weight=0.3, target_weight=2.0), None, "trained"),
        (
            Edits().with_settings("lift", erode=0.0, part=0.5),
            AskConfig(lift=LiftConfig(erode=0.0, part=0.5)),
            "trained",
        ),
        (Edits().with_settings("lift", box="pca"), AskConfig(lift=LiftConfig(box="pca")), "trained"),
        (Edits().with_scorer("rule"), AskConfig(), "rule"),
    ],
)
@pytest.mark.parametrize("text", QUESTIONS[:2])
def test_settings_edited_are_settings_set(edits: Edits, config: AskConfig | None, scorer: str, text: str) -> None:
    if config is None:
        config = AskConfig(rank=RankConfig(relation_weight=0.3, target_weight=2.0))
    baseline = Baseline(source(ScoringDetector()), context_of(FRAME), text)
    whole = ask(PreparedFrame(FRAME, config.lift), text, ScoringDetector(), scorer=make_scorer(scorer), config=config)
    assert_same(apply(baseline, edits), whole)
    # And back: nothing of an edit stays.
    assert_same(apply(baseline, Edits()), baseline.outcome.trace)


@st.composite
def some_edits(draw: st.DrawFn) -> Edits:
    keys = ["#0", "#1", "#2", "#3", "#4", "#5"]
    edits = Edits()
    for key in draw(st.lists(st.sampled_from(keys), max_size=2, unique=True)):
        angle = draw(st.floats(-3, 3))
        R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        center = [draw(st.floats(-1, 1)), draw(st.floats(-0.5, 0.8)), draw(st.floats(0.8, 2.5))]
        size = [draw(st.floats(0.01, 0.5)) for _ in range(3)]
        edits = edits.with_box(key, Box3D(np.array(center), R, np.array(size)))
    for key in draw(st.lists(st.sampled_from(keys), max_size=1)):
        mask = np.zeros((FRAME.height, FRAME.width), np.bool_)
        x, y = draw(st.integers(0, 250)), draw(st.integers(0, 200))
        mask[y : y + draw(st.integers(0, 60)), x : x + 50] = True
        edits = edits.with_mask(key, mask)
    if draw(st.booleans()):
        edits = edits.with_hidden(draw(st.sampled_from(keys)))
    if draw(st.booleans()):
        edits = edits.with_confidence("mug", draw(st.sampled_from(keys)), draw(st.floats(0, 1)))
    if draw(st.booleans()):
        edits = edits.with_relation(draw(st.sampled_from(PAIRWISE)), "#0", "#3", draw(st.floats(0, 1)))
    if draw(st.booleans()):
        edits = edits.with_settings(
            "profile", cone=draw(st.floats(10, 60)), on_footprint_margin=draw(st.floats(0, 0.3))
        )
    return edits


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(some_edits(), min_size=1, max_size=4), st.sampled_from(QUESTIONS), st.sampled_from(["rule", "trained"]))
def test_one_edit_after_another_is_each_from_the_start(steps: list[Edits], text: str, scorer: str) -> None:
    asked, context = source(scorer=scorer), context_of(FRAME)
    baseline = Baseline(asked, context, text)
    for edits in steps:
        assert_same(apply(baseline, edits), apply(Baseline(asked, context_of(FRAME), text), edits), exactly=False)
        assert read_edits(json.dumps(edits_record(edits))) == edits
    assert_same(apply(baseline, Edits()), baseline.outcome.trace)


@pytest.mark.parametrize("scorer", ["rule", "trained"])
@pytest.mark.parametrize("profile", [{}, {"cone": 20.0, "near_diagonals": 0.1, "on_footprint_margin": 0.0}])
def test_a_moved_box_is_scored_as_the_scorer_scores_it(scorer: str, profile: dict[str, Any]) -> None:
    baseline = Baseline(source(scorer=scorer), context_of(FRAME), "mug left of the laptop")
    key = baseline.outcome.keys[1]
    entry = baseline.outcome.trace.objects[1]
    assert entry.lifted.box is not None
    center = entry.lifted.box.center + np.array([0.2, -0.1, 0.3])
    box = Box3D(center, entry.lifted.box.R, entry.lifted.box.size * 1.5)
    outcome = rerun(baseline, Edits().with_box(key, box).with_settings("profile", **profile))
    found = outcome.trace
    objects = list(baseline.outcome.trace.objects)
    objects[1] = replace(entry, lifted=entry.lifted.moved_to(box, found.viewer))
    lifted = [o.lifted for o in objects]
    expected = make_scorer(scorer).score(lifted, found.viewer, appearance_of(objects, found.frame))
    lo, hi = np.stack([o.lo for o in lifted]), np.stack([o.hi for o in lifted])
    axes = found.viewer.matrix.T.astype(np.float32)
    states = pairwise_states(lo, hi, [o.points @ axes for o in lifted], Profile(**profile))
    np.testing.assert_array_equal(found.scores.states, states)
    if not profile:
        np.testing.assert_allclose(found.scores.probabilities, expected.probabilities, atol=1e-9)
    else:
        scored = [k for k, r in enumerate(PAIRWISE) if expected.scored_by[r] != "rule"]
        own, told = found.scores.probabilities[..., scored], expected.probabilities[..., scored]
        np.testing.assert_allclose(own, told, atol=1e-9)
    if not profile:
        # Only the pairs of the moved one were scored.
        assert outcome.pairs_scored == len(objects) - 1


def test_a_slider_does_not_lift_or_score_again(monkeypatch: pytest.MonkeyPatch) -> None:
    baseline = Baseline(source(ScoringDetector()), context_of(FRAME), "mug left of the laptop")
    seen: list[int] = []
    lift = PreparedFrame.lift
    monkeypatch.setattr(PreparedFrame, "lift", lambda self, *a: seen.append(1) or lift(self, *a))
    few = rerun(baseline, Edits().with_k(1))
    many = rerun(baseline, Edits().with_k(10))
    assert not seen
    assert few.pairs_scored == many.pairs_scored == 0
    assert set(few.keys) < set(many.keys)


def test_keys_outlast_k_threshold_and_hiding() -> None:
    baseline = Baseline(source(ScoringDetector()), context_of(FRAME), "mug left of the laptop")
    known = dict(zip(baseline.outcome.keys, baseline.outcome.trace.objects, strict=True))
    assert all("/" in key for key in known)
    best = max(known, key=lambda key: known[key].score)
    for edits in (Edits().with_k(2), Edits().with_min_score(0.5), Edits().with_hidden(best)):
        outcome = rerun(baseline, edits)
        assert outcome.keys
        assert len(set(outcome.keys)) == len(outcome.keys)
        for key, entry in zip(outcome.keys, outcome.trace.objects, strict=True):
            if key in known:
                assert _thing(entry) == _thing(known[key])
    assert best not in rerun(baseline, Edits().with_hidden(best)).keys
    scores = [o.score for o in apply(baseline, Edits().with_min_score(0.5)).objects]
    assert scores
    assert min(scores) >= 0.5


def _thing(entry: SceneObject) -> tuple[str, float, bytes]:
    return entry.label, entry.score, entry.bbox.tobytes()


def test_a_repainted_mask_is_lifted_with_the_whole_cleaning() -> None:
    baseline = Baseline(source(), context_of(FRAME), "mug left of the laptop")
    other = next(a for a in FRAME.annotations if a.label == "book")
    assert other.mask is not None
    found = apply(baseline, Edits().with_mask("#0", other.mask))
    book = apply(Baseline(source(), context_of(FRAME), "book left of the laptop"), Edits()).objects[0]
    mug = next(o for o in found.objects if o.id == 0)
    np.testing.assert_array_equal(mug.lifted.points, book.lifted.points)
    np.testing.assert_array_equal(mug.bbox, other.bbox)
    with pytest.raises(InputError, match="another picture size"):
        apply(baseline, Edits().with_mask("#0", np.ones((3, 4), np.bool_)))


def test_confidence_and_relation_decide_the_answer() -> None:
    baseline = Baseline(source(), context_of(FRAME), "mug left of the laptop")
    assert baseline.outcome.trace.ranking is not None
    won = baseline.outcome.keys[baseline.outcome.trace.ranking.pairs[0].target]
    doubted = rerun(baseline, Edits().with_confidence("mug", won, 0.01))
    change = what_changed(baseline.outcome, doubted, verdicts=("CORRECT", "OPM-CONF"))
    assert change["changed"]
    assert change["before"]["target"]["key"] == won != change["after"]["target"]["key"]
    assert (change["before"]["verdict"], change["after"]["verdict"]) == ("CORRECT", "OPM-CONF")
    assert change["factors"]["winner_before"]["after"]["target"] == pytest.approx(np.log(0.01))
    assert change["moved"]
    edits = Edits().with_confidence("mug", "#0", 0.1).with_confidence("mug", "#2", 0.1)
    forced = rerun(baseline, edits.with_relation("left", "#4", "#3", 1.0))
    assert what_changed(baseline.outcome, forced)["after"]["target"]["key"] == "#4"
    nothing = what_changed(baseline.outcome, rerun(baseline, Edits()))
    assert not nothing["changed"]
    assert not nothing["moved"]
    json.dumps([change, nothing], allow_nan=False)
    closest = Baseline(source(), context_of(FRAME), "mug closest to the book")
    edited = apply(closest, Edits().with_relation("closest", "#4", "#1", 1.0))
    assert edited.ranking is not None
    assert edited.objects[edited.ranking.pairs[0].target].id == 4
    with pytest.raises(InputError, match="no probability"):
        apply(baseline, Edits().with_relation("between", "#4", "#3", 1.0))


def test_everything_hidden_is_nothing_found() -> None:
    baseline = Baseline(source(), context_of(FRAME), "mug left of the laptop")
    outcome = rerun(baseline, Edits(hidden=frozenset(baseline.all_keys)))
    assert outcome.trace.missing == ("mug", "laptop")
    assert outcome.trace.ranking is None
    assert what_changed(baseline.outcome, outcome)["after"]["reason"].startswith("no 'mug'")
    assert foreign_keys(baseline, Edits().with_hidden("#77").with_hidden("#0")) == ("#77",)


def test_edits_are_taken_back() -> None:
    box = Box3D(np.zeros(3), np.eye(3), np.ones(3))
    edits = Edits().with_box("#1", box).with_hidden("#1").with_confidence("mug", "#1", 0.5)
    edits = edits.with_relation("on", "#1", "#2", 0)
    assert edits
    assert not Edits()
    assert Edits() == Edits().with_hidden("#1").with_shown("#1")
    assert edits.keys == {"#1", "#2"}


HOSTILE = [
    "",
    "[]",
    "null",
    "{",
    '"x"',
    "[" * 100_000,
    '{"k": 0}',
    '{"k": 1.5}',
    '{"k": true}',
    '{"k": 1e999}',
    '{"min_score": -1}',
    '{"unknown": 1}',
    '{"format": "spatialviz-edits-9"}',
    '{"boxes": {"#1": {}}}',
    '{"hidden": [1]}',
    '{"hidden": [""]}',
    '{"boxes": {"#1": {"center": [0,0,0], "R": [[1,0,0],[0,1,0],[0,0,-1]], "size": [1,1,1]}}}',
    '{"boxes": {"#1": {"center": [0,0,0], "R": [[1,0,0],[0,1,0],[0,0,1]], "size": [1,1,-1]}}}',
    '{"boxes": {"#1": {"center": [0,0,NaN], "R": [[1,0,0],[0,1,0],[0,0,1]], "size": [1,1,1]}}}',
    '{"boxes": {"#1": {"center": [0,0,"1"], "R": [[1,0,0],[0,1,0],[0,0,1]], "size": [1,1,1]}}}',
    '{"masks": {"#1": {"size": [1000000, 1000000], "counts": "0"}}}',
    '{"confidences": [{"name": "a", "object": "#1", "p": 2}]}',
    '{"relations": [{"relation": "on", "a": "#1", "b": "#1", "p": 1}]}',
    '{"confidences": [{"name": "a", "object": "#1", "p": 1}, {"name": "a", "object": "#1", "p": 0}]}',
    '{"rank": {"target_weight": -1}}',
    '{"rank": {"aggregate": "sum"}}',
    '{"profile": {"cone": 91}}',
    '{"profile": {"cone": 70}}',
    '{"profile": {"gap_switch_band": [0.04, 0.02]}}',
    '{"profile": {"min_extent": 0}}',
    '{"profile": {"__class__": 1}}',
    '{"lift": {"near": 11}}',
    '{"lift": {"erode": 1e9}}',
    '{"lift": {"max_points": 0}}',
    '{"lift": {"box": "x"}}',
    '{"scorer": ""}',
]


@pytest.mark.parametrize("text", HOSTILE)
def test_what_are_no_edits_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        read_edits(text)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 600
    path = tmp_path / "edits.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"edits\.json"):
        load_edits(path)


@pytest.mark.parametrize("spec", ["nothing", "missing.onnx"])
def test_a_scorer_that_is_none_is_refused(spec: str) -> None:
    baseline = Baseline(source(), context_of(FRAME), "mug left of the laptop")
    with pytest.raises(InputError):
        apply(baseline, Edits().with_scorer(spec))
    with pytest.raises(InputError):
        Edits().with_confidence("mug", "#1", float("nan"))


def test_an_unknown_field_of_edits_is_named_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"objects .*; got a field of another name; expected one of format, .*hidden"):
        read_edits({"objects": {}})
    with pytest.raises(InputError, match=r"boxes\.a\.angle cannot be this; got a field of another name$"):
        read_edits({"boxes": {"a": {**BOX, "angle": 3}}})


BOX = {"center": [0, 0, 1], "R": np.eye(3).tolist(), "size": [1, 1, 1]}


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ({"boxes": {"a": 3}}, "the edits: boxes.a cannot be this; got 3; expected an object {...}"),
        ({"boxes": {"a": {**BOX, "center": [0, 0]}}}, "boxes.a.center cannot be this; got [0, 0]; expected 3 values"),
        ({"boxes": {"a": {**BOX, "center": [0, 0, 1e9]}}}, "boxes.a.center.2 cannot be this; got 1000000000.0; "),
        ({"boxes": {"a": {**BOX, "R": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}}}, "boxes.a cannot be this: R of a 3D box"),
        ({"boxes": {"a": {"R": BOX["R"]}}}, "boxes.a.center cannot be this; got nothing; expected a value"),
        ({"hidden": "x"}, 'hidden cannot be this; got "x"; expected a list'),
        ({"k": "3"}, 'k cannot be this; got "3"; expected a whole number'),
        ({"k": 0}, "k cannot be this; got 0; expected at least 1"),
        ({"rank": {"target_weight": "1"}}, 'rank: target_weight cannot be this; got "1"; expected a number'),
        ({"lift": {"near": None}}, "lift: near cannot be this; got null; expected a number"),
        ({"x" * 1000: 1}, f"the edits: {'x' * 60} cannot be this; got a field of another name"),
        ([1], "the edits: the top cannot be this; got [1]; expected an object {...}"),
    ],
)
def test_what_is_wrong_with_edits_is_told_in_plain_words(record: Any, words: str) -> None:
    for given in (record, json.dumps(record)):
        with pytest.raises(InputError) as caught:
            read_edits(given)
        assert words in str(caught.value)
