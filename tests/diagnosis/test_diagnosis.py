"""The diagnosis: oracles that replace one thing only, verdicts that are exclusive, changes that really mend."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis_worlds import world
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.answering import PairTable, RankConfig, ScoredPair, alone, rank, side
from pipeline.answering.pair_table import pair_table
from pipeline.diagnosis import (
    CONF,
    LIFT,
    MARKS,
    ORACLES,
    SRM,
    SUBSETS,
    VERDICTS,
    Diagnosis,
    FrameEvidence,
    diagnose,
    names_of,
    shown_verdicts,
    substitute,
)
from pipeline.diagnosis.oracles import RECALL, STATE_PROBABILITY
from pipeline.diagnosis.story import judged_story
from pipeline.evaluation import oracle_deltas
from pipeline.evaluation.records import record
from pipeline.labels import HIT, Case
from pipeline.language import parse
from pipeline.relations import U

SEEDS = st.integers(0, 2**32 - 1)
WEIGHTS = st.builds(
    RankConfig,
    target_weight=st.sampled_from([0.0, 0.5, 1.0]),
    reference_weight=st.sampled_from([0.0, 1.0]),
    relation_weight=st.sampled_from([0.05, 1.0, 2.0]),
)
QUERY = parse("mug left of the box", class_names=("mug", "box"))


def subset_of(names: tuple[str, ...]) -> int:
    """The subset that holds these oracles."""
    return sum(1 << ORACLES.index(name) for name in set(names))


@given(SEEDS, WEIGHTS)
@settings(max_examples=75, deadline=None)
def test_without_oracles_it_is_the_ranking(seed: int, weights: RankConfig) -> None:
    evidence, case = world(seed, weights)
    answers, found = evidence.answers, substitute(evidence, case)
    if not all(len(c.index) for c in answers.candidates.values()):
        assert found.pair() is None
        assert found.alone() is None
        return
    table = answers.probabilities("left")
    assert table is not None
    ranking = rank(
        QUERY.readings,
        answers.candidates,
        lambda attachment, heads, ends: table[np.ix_(heads, ends[0])],
        answers.same,
        answers.mask_sizes,
        weights,
    )
    best, pair = ranking.pairs[0], found.pair()
    if ranking.degenerate:
        assert pair is None
        at = found.alone()
        assert at is not None
        assert int(found.target.index[at]) == best.target == alone(answers.candidates["mug"])
        return
    assert pair is not None
    assert (int(found.target.index[pair[0]]), int(found.reference.index[pair[1]])) == (best.target, best.reference)
    assert found.table.log_score[0][pair] == best.log_score
    scored = answers.score("mug", "left", "box")
    assert scored is not None
    assert np.unravel_index(scored.first()[0], scored.shape) == pair


@given(SEEDS)
@settings(max_examples=75, deadline=None)
def test_each_oracle_replaces_one_thing(seed: int) -> None:
    evidence, case = world(seed)
    found, truth = substitute(evidence, case), evidence.truth
    plain, lifted = found.p_relation[0, 0], found.p_relation[1, 0]
    stay = (found.target.shape_of < 0)[:, None] & (found.reference.shape_of < 0)[None, :]
    np.testing.assert_array_equal(plain[stay], lifted[stay])
    for lift in (0, 1):
        before, after = found.p_relation[lift]
        for i, a in enumerate(evidence.match_at(found.target.index)):
            for j, b in enumerate(evidence.match_at(found.reference.index)):
                if a < 0 or b < 0 or (a != b and not truth.judged[a, b]):
                    assert after[i, j] == before[i, j]
                else:
                    state = -1 if a == b else int(truth.states["left"][a, b])
                    assert after[i, j] == STATE_PROBABILITY[state]
    for role, name, number in ((found.target, "mug", 0), (found.reference, "box", 1)):
        candidates = evidence.answers.candidates[name]
        np.testing.assert_array_equal(role.index[: role.found], candidates.index)
        overlap = evidence.overlap[candidates.index]
        covered = (overlap >= HIT).any(axis=0) if len(overlap) else np.zeros(evidence.labelled, np.bool_)
        missing = np.flatnonzero(truth.alike[number] & ~covered & evidence.objects.known)
        np.testing.assert_array_equal(role.index[role.found :], evidence.detections + missing)
        is_one = (overlap[:, truth.alike[number]] >= HIT).any(axis=1)
        np.testing.assert_array_equal(role.object[: role.found] >= 0, is_one)
    missing = np.isneginf(found.table.log_score)
    for subset in range(SUBSETS):
        if not subset & RECALL:
            assert missing[subset, found.target.found :].all()
            assert missing[subset, :, found.reference.found :].all()
        # SRM and CONF never bring a pair in or out.
        np.testing.assert_array_equal(missing[subset], missing[subset & ~(SRM | CONF)])


@given(SEEDS)
@settings(max_examples=50, deadline=None)
def test_margins(seed: int) -> None:
    evidence, case = world(seed)
    found = substitute(evidence, case)
    for subset in range(SUBSETS):
        s = found.table.log_score[subset]
        right = [x for x, ok in zip(s.ravel(), found.covered.ravel(), strict=True) if ok and np.isfinite(x)]
        other = [x for x, ok in zip(s.ravel(), found.covered.ravel(), strict=True) if not ok and np.isfinite(x)]
        if not right and not other:
            assert np.isnan(found.margins[subset])
            assert not found.accepted[subset]
            continue
        assert found.margins[subset] == max(right, default=-np.inf) - max(other, default=-np.inf)
        if abs(found.margins[subset]) > 1e-6:
            assert found.accepted[subset] == (found.margins[subset] > 0)


@given(SEEDS, WEIGHTS, st.booleans(), st.sampled_from([None, *MARKS]))
@settings(max_examples=100, deadline=None)
def test_verdicts_are_exclusive_and_hold_what_they_say(
    seed: int, weights: RankConfig, parse_ok: bool, mark: str | None
) -> None:
    evidence, case = world(seed, weights)
    d, found = diagnose(evidence, case, parse_ok=parse_ok, mark=mark), substitute(evidence, case)
    assert d.verdict in VERDICTS
    pair = found.pair()
    at = pair[0] if pair is not None else found.alone()
    hit = at is not None and found.target.overlap[at, case.target_object] >= HIT
    right = at is not None and bool(found.right[at])
    any_target, any_pair = (
        found.right[: found.target.found].any(),
        found.covered[: found.target.found, : found.reference.found].any(),
    )
    flips = {bit for bit in (LIFT, SRM, CONF) if found.accepted[bit]}
    together = [s for s in range(SUBSETS) if not s & RECALL and found.accepted[s]]
    expected = {
        "CORRECT": parse_ok and hit,
        "PARSE": not parse_ok,
        "LABEL": parse_ok and not hit and (right or mark is not None),
        "OPM-TARGET": parse_ok and not hit and not right and mark is None and not any_target,
        "OPM-REF": parse_ok and not hit and not right and mark is None and any_target and not any_pair,
    }
    if d.verdict in expected:
        assert [name for name, holds in expected.items() if holds] == [d.verdict]
    else:
        assert not any(expected.values())
        assert d.verdict != "LIFT" or LIFT in flips
        assert d.verdict != "SRM" or SRM in flips
        if d.verdict == "OPM-CONF":
            assert CONF in flips
            assert d.false_target or d.false_reference
        if d.verdict == "PRM" and d.detail is None:
            assert CONF in flips
            assert not d.false_target
            assert not d.false_reference
        assert (d.detail == "DEGENERATE") == (not together)
        assert (d.verdict == "COMPOUND") == (not flips and bool(together))
        if d.verdict == "COMPOUND":
            assert subset_of(d.repair).bit_count() == min(s.bit_count() for s in together)
            assert d.detail == "+".join(d.repair)
        if together:
            assert found.accepted[subset_of(d.repair)]
    said = judged_story(d, QUERY).sentence
    assert said.endswith(".")
    assert "None" not in said
    assert d.right_with is not None
    assert all(bool(d.right_with >> s & 1) == bool(found.right_target[s]) for s in range(SUBSETS))


Diagnosed = list[tuple[FrameEvidence, Case, Diagnosis]]


@pytest.fixture(scope="module")
def diagnosed() -> Diagnosed:
    """Many worlds and what is found in them; not to be changed."""
    return [(e, c, diagnose(e, c, parse_ok=True)) for e, c in map(world, range(1500))]


@pytest.mark.slow
def test_all_verdicts_of_ranking_occur_in_the_worlds(diagnosed: Diagnosed) -> None:
    assert set(shown_verdicts(())) - {"PARSE"} == {d.verdict for _, _, d in diagnosed}


@given(SEEDS, WEIGHTS)
@settings(max_examples=75, deadline=None)
def test_a_needed_change_and_no_smaller_one_puts_the_right_pair_first(seed: int, weights: RankConfig) -> None:
    evidence, case = world(seed, weights)
    d = diagnose(evidence, case, parse_ok=True)
    table = substitute(evidence, case).plain
    for change in d.needed:
        assert d.winner is not None
        assert d.right is not None
        for pair, at in ((d.right, change.right_above), (d.winner, change.winner_below)):
            if at is None:
                continue
            for sign in (-1, 1):
                value = at * (1 + sign * 1e-6)
                if not 1e-5 <= value <= 1 - 1e-5:
                    continue
                changed = _changed(table, change.factor, pair, value)
                first = changed.pair(int(changed.first()[0]))
                is_right = (first.target, first.reference) == (d.right.target, d.right.reference)
                assert is_right == (sign == (1 if pair is d.right else -1))


def _changed(table: PairTable, factor: str, pair: ScoredPair, value: float) -> PairTable:
    """All pairs where one factor of a pair is another."""
    i = int(np.flatnonzero(table.target.index == pair.target)[0])
    j = int(np.flatnonzero(table.ends[0].index == pair.reference)[0])
    p, config = table.p_relation.copy(), table.config
    sides = [s.scores.copy() for s in (table.target, table.ends[0])]
    if factor == "relation":
        p[i, j] = value
    else:
        sides[factor == "reference"][j if factor == "reference" else i] = value
    return pair_table(
        side(table.target.index, sides[0], config.target_weight),
        (side(table.ends[0].index, sides[1], config.reference_weight),),
        p,
        np.isneginf(table.log_score),
        table.sizes,
        config,
    )


def test_words_name_the_numbers(diagnosed: Diagnosed) -> None:
    seen = set()
    for *_, d in diagnosed:
        said = d.text
        if d.winner is None or d.right is None or d.detail == "DEGENERATE":
            continue
        if d.verdict in ("LIFT", "SRM"):
            assert f"{d.right.p_relation:.2f}" in said
            assert f"{d.winner.p_relation:.2f}" in said
        elif d.verdict in ("PRM", "OPM-CONF") and not (d.false_target and d.false_reference):
            ends = ((d.winner.p_target, d.right.p_target), (d.winner.p_reference, d.right.p_reference))
            ratios = [f"{ours / theirs:.0f} times as high" for ours, theirs in ends]
            assert any(f"{ours:.2f}" in said and f"{theirs:.2f}" in said for ours, theirs in ends) or any(
                ratio in said for ratio in ratios
            )
        else:
            continue
        seen.add(d.verdict)
    assert seen == {"LIFT", "SRM", "PRM", "OPM-CONF"}


def test_true_masks_tell_two_objects_apart(diagnosed: Diagnosed) -> None:
    """Masks that leak into each other make two things one; true geometry mends it, and LIFT is named."""
    seen = 0
    for evidence, case, d in diagnosed:
        if d.verdict == "LIFT" and d.right is None:
            found = substitute(evidence, case)
            assert np.isneginf(found.table.log_score[0][found.covered]).all()
            assert found.accepted[LIFT]
            assert "count as one thing" in d.text
            seen += 1
    assert seen


@given(st.lists(st.integers(0, 2**16 - 1), min_size=1, max_size=60))
@settings(max_examples=30, deadline=None)
def test_shapley_adds_up(right_with: list[int]) -> None:
    found = oracle_deltas(np.array(right_with), np.arange(len(right_with)))
    total = sum(e.value for e in found.shapley.values())
    assert total == pytest.approx(found.value[-1] - found.value[0], abs=1e-9)


def test_records_answer_alone_where_all_pairs_are_one_thing() -> None:
    evidence, case = next(
        (e, c)
        for e, c in map(world, range(3000))
        if substitute(e, c).alone() is not None and e.truth.states["left"].max() >= U
    )
    answers = evidence.answers
    for o in answers.objects:
        quality = type("Q", (), {"points": 5, "depth_missing": 0.0, "distance": 1.0})
        vars(o)["lifted"] = type("L", (), {"quality": quality})
    row = record(case, evidence.truth, answers, (QUERY, None), evidence.overlap)
    first = alone(answers.candidates["mug"])
    assert row["degenerate"] is True
    assert row["box"] == answers.boxes[first].tolist()
    assert row["reference_box"] is None
    assert row["p_relation"] is None
    assert row["correct"] == (row["iou"] >= HIT)
    d = diagnose(evidence, case, parse_ok=True)
    assert (d.verdict == "CORRECT") == row["correct"]


def test_names_of_subsets() -> None:
    assert [subset_of(names_of(s)) for s in range(SUBSETS)] == list(range(SUBSETS))
