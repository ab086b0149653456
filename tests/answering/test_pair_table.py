"""One scoring: the pair that is shown, recorded and judged is one, and the one that the rules put first."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosis_worlds import world
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.answering import MIN_RELATION, MIN_SCORE, RankConfig, rank
from pipeline.answering.pair_table import TIE
from pipeline.diagnosis import diagnose, substitute
from pipeline.evaluation.records import record
from pipeline.language import parse

SEEDS = st.integers(0, 2**32 - 1)
CONFIGS = st.builds(
    RankConfig,
    target_weight=st.sampled_from([0.0, 0.3, 1.0, 2.0]),
    reference_weight=st.sampled_from([0.0, 0.3, 1.0, 2.0]),
    relation_weight=st.sampled_from([0.0, 0.05, 1.0, 2.0]),
)
QUERY = parse("mug left of the box", class_names=("mug", "box"))


def by_the_rules(answers: Any, config: RankConfig) -> list[tuple[int, int]]:
    """The pairs one by one, best first: S, relation, target's score, mask, places."""
    p = answers.probabilities("left")
    targets, references = answers.candidates["mug"], answers.candidates["box"]
    score, found = {}, {}
    for t, st_ in zip(targets.index.tolist(), targets.scores.tolist(), strict=True):
        for r, sr in zip(references.index.tolist(), references.scores.tolist(), strict=True):
            if answers.same[t, r]:
                continue
            score[t, r] = (
                config.target_weight * np.log(min(max(st_, MIN_SCORE), 1 - MIN_SCORE))
                + config.reference_weight * np.log(min(max(sr, MIN_SCORE), 1 - MIN_SCORE))
                + config.relation_weight * np.log(max(p[t, r], MIN_RELATION))
            )
            found[t, r] = (-p[t, r], -st_, -int(answers.mask_sizes[t]), t, r)
    if not score:
        return []
    return sorted(score, key=lambda pair: (-round(score[pair] / TIE / 10), *found[pair]))


@given(SEEDS, CONFIGS)
@settings(max_examples=100, deadline=None)
def test_the_pair_that_is_shown_recorded_and_judged_is_one(seed: int, config: RankConfig) -> None:
    evidence, case = world(seed, config)
    answers = evidence.answers
    if not all(len(c.index) for c in answers.candidates.values()):
        return
    for o in answers.objects:
        vars(o)["lifted"] = SimpleNamespace(quality=SimpleNamespace(points=5, depth_missing=0.0, distance=1.0))
    table = answers.probabilities("left")
    assert table is not None
    ranking = rank(
        QUERY.readings,
        answers.candidates,
        lambda attachment, heads, ends: table[np.ix_(heads, ends[0])],
        answers.same,
        answers.mask_sizes,
        config,
    )
    row = record(case, evidence.truth, answers, (QUERY, None), evidence.overlap)
    judged = diagnose(evidence, case, parse_ok=True).winner
    order = by_the_rules(answers, config)
    if not order:
        assert ranking.degenerate
        assert row["degenerate"]
        assert judged is None
        return
    shown = ranking.pairs[0]
    assert judged is not None
    assert [(p.target, p.reference) for p in ranking.pairs] == order
    assert (judged.target, judged.reference) == order[0]
    assert row["box"] == answers.boxes[shown.target].tolist()
    assert row["reference_box"] == answers.boxes[shown.reference].tolist()
    for name in ("p_target", "p_reference", "p_relation", "log_score"):
        assert getattr(shown, name) == getattr(judged, name)
        if name != "p_target":
            assert row[name] == getattr(shown, name)
    assert (shown.product, shown.probability) == pytest.approx((judged.product, judged.probability), rel=1e-12)
    assert row["log_margin"] == (None if np.isinf(ranking.log_margin) else pytest.approx(ranking.log_margin, abs=2e-9))


@given(SEEDS, CONFIGS)
@settings(max_examples=30, deadline=None)
def test_a_margin_has_the_sign_of_who_comes_first(seed: int, config: RankConfig) -> None:
    evidence, case = world(seed, config)
    found = substitute(evidence, case)
    for subset in range(16):
        if np.isfinite(found.margins[subset]) and abs(found.margins[subset]) > 1e-6:
            assert found.accepted[subset] == (found.margins[subset] > 0)
    at = found.best_acceptable
    if at is not None:
        everyone = found.plain.order().tolist()
        assert next(k for k in everyone if found.covered.flat[k]) == at[0] * found.covered.shape[1] + at[1]
        assert len(everyone) == np.isfinite(found.table.log_score[0]).sum()


def test_scenes_side_by_side_are_scenes_one_by_one() -> None:
    for seed in range(40):
        found = substitute(*world(seed, RankConfig()))
        scenes = [found.table.scene(k) for k in range(16)]
        assert [int(scene.first()[0]) for scene in scenes] == found.winners.tolist()
        for scene, first in zip(scenes, found.winners.tolist(), strict=True):
            assert scene.order().tolist()[:1] == [first] * (first >= 0)
