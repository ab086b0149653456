"""What a noun phrase means among labelled things: parts that labels make no sentences of, degrees between T and F."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import frame_of, upright

from pipeline.answering.objects import PreparedFrame, all_objects
from pipeline.labels import LabelConfig, label_objects
from pipeline.labels.tree_truth import TreeTruth, _at_rank, states_of
from pipeline.language import parse
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.relations import F, T, U

BOXES = [upright((x, 0.9, z), (0.2, 0.3, 0.2)) for x, z in ((-1, 2.5), (-0.4, 2.5), (0.4, 2.5), (1, 2.5), (0, 2.5))]
NAMES = ["mug", "mug", "mug", "vase", "lamp"]
"""From left to right: two mugs, a lamp, a mug, a vase."""


@pytest.fixture(scope="module")
def truth() -> TreeTruth:
    context = PreparedFrame(frame_of(BOXES, NAMES))
    objects = all_objects(context, AnnotationDetector())
    made = label_objects(context, objects, LabelConfig(vocabulary="all"), frame_index=0, scene="", exact=True)
    assert made.judged is not None
    return TreeTruth(context, objects, made.judged.states, [True] * len(objects), [0.0] * len(objects))


@pytest.mark.parametrize(
    ("text", "right"),
    [
        ("the mug between the lamp and the vase", [2]),
        ("the mug closest to the vase", [2]),
        ("the mug farthest from the vase", [0]),
        ("the middle mug", [1]),
        ("the second mug from the left", [1]),
        ("the mug that is not left of the lamp", [2]),
        ("the thing between the mug and the vase, not the lamp", [1, 2]),
        ("the mug to the left of the lamp", [0, 1]),
        ("the fourth mug from the left", []),
        ("the seventh mug from the left", []),
    ],
)
def test_phrases_mean_what_people_mean(truth: TreeTruth, text: str, right: list[int]) -> None:
    found = truth.means(parse(text).default.root)
    assert np.flatnonzero(found == T).tolist() == right
    assert set(found.tolist()) <= {T, F, U}


@pytest.mark.parametrize("text", ["the wooden mug", "the mug behind me", "the mug behind the wooden lamp"])
def test_what_is_not_judged_is_never_true(truth: TreeTruth, text: str) -> None:
    assert (truth.means(parse(text).default.root) < T).all()


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=6, unique=True), st.integers(1, 7))
def test_one_thing_at_most_has_a_place_in_an_order(places: list[float], rank: int) -> None:
    keys = np.array(places)
    before = np.clip((keys[None] - keys[:, None]) / 0.2, F, T)
    np.fill_diagonal(before, F)
    degrees = _at_rank(before, np.full(len(keys), float(T)), rank)
    assert (states_of(degrees) == T).sum() <= 1
    assert (degrees > 0).sum() <= 1
    assert rank <= len(keys) or (degrees == F).all()
    assert ((degrees >= F) & (degrees <= T)).all()
    if rank <= len(keys):
        assert degrees.argmax() == np.argsort(keys)[rank - 1] or degrees.max() <= 0
