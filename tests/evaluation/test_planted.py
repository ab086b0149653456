"""Planted faults: each module is broken in turn, and the verdict names it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from benchmarks.planted import KINDS, Outcome, Planted, clean_source, confusion, judge, planted_failures
from slow_cases import mostly_slow

from pipeline.answering import Pipeline, PreparedFrame, open_pipeline
from pipeline.datasets import demo_labels
from pipeline.evaluation.systems import class_names_of
from pipeline.labels import open_labels, read_cases

NAMED = 0.95
BY_DEFINITION = ("OPM-TARGET", "OPM-REF", "PARSE", "LABEL", "OPM-CONF")
BY_FLIP = ("LIFT", "SRM", "PRM")


@pytest.fixture(scope="module", params=mostly_slow(["rule", "trained"]))
def source(request: pytest.FixtureRequest) -> Pipeline:
    return open_pipeline("demo", srm=request.param)


def outcomes(source: Pipeline, modules: tuple[str, ...], every: int) -> list[Outcome]:
    kinds = {m: KINDS[m] for m in modules}
    return list(planted_failures(source, open_labels(demo_labels()), kinds=kinds, every=every))


DENSITIES = [(BY_DEFINITION, 255), (BY_FLIP, 63), (BY_FLIP, 21)]


@pytest.mark.parametrize(("modules", "every"), mostly_slow(DENSITIES, several=True))
def test_the_verdict_names_the_planted_module(source: Pipeline, modules: tuple[str, ...], every: int) -> None:
    by_module: dict[str, Counter[str]] = {}
    for (module, _), verdicts in confusion(outcomes(source, modules, every)).items():
        by_module.setdefault(module, Counter()).update(verdicts)
    assert set(by_module) == set(modules)
    for module, verdicts in by_module.items():
        assert verdicts[module] >= NAMED * verdicts.total(), (module, verdicts)


def test_the_clean_pipeline_is_right(source: Pipeline) -> None:
    labels = open_labels(demo_labels())
    clean, names = clean_source(source), class_names_of(labels)
    seen: Counter[str] = Counter()
    for truth in read_cases(labels, 0, 3):
        context = PreparedFrame(clean.dataset.load(truth.frame), clean.config.lift)
        seen.update(judge(Planted(clean, context, truth, case), names)[1].verdict for case in truth.cases[::15])
    assert set(seen) <= {"CORRECT", "LABEL", "PARSE"} or source.scorer.name != "rule"
    assert seen["CORRECT"] > 0.8 * seen.total()


@pytest.mark.slow
def test_details_of_planted_misses(source: Pipeline) -> None:
    wanted = {"absent": "ABSENT", "threshold": "THRESHOLD", "rank": "RANK", "localisation": "LOCALISATION"}
    found = outcomes(source, ("OPM-TARGET",), 60)
    right = np.array([wanted[o.kind] == o.detail for o in found])
    assert {o.kind for o in found} == set(wanted)
    assert right.mean() >= NAMED


@pytest.mark.slow
def test_what_is_planted_follows_from_the_seed(source: Pipeline) -> None:
    labels = open_labels(demo_labels())

    def failures(seed: int) -> list[tuple[str, str, str, str]]:
        kinds = {"SRM": ("opposite",), "LIFT": ("shift",)}
        found = planted_failures(source, labels, kinds=kinds, every=15, stop=2, seed=seed)
        return [(o.kind, o.frame, o.id, o.verdict) for o in found]

    assert failures(1) == failures(1) != failures(2)
