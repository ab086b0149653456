"""Errors that are planted in rendered rooms are found by confident learning alone, and mending them pays."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.planted_labels import ReviewBenchConfig, measure_recovery, plant_flips, review_rooms, with_labels
from needs import needs

from pipeline.corrections import DoubtConfig
from pipeline.corrections.review.doubts import PASSES, doubt_labels, stacked, unstacked
from pipeline.labels import Labels
from pipeline.language import DIRECTIONAL
from pipeline.relations import U
from pipeline.system import InputError
from pipeline.training import LabelData, TrainConfig, read_label_data

pytestmark = [pytest.mark.slow, needs("embreex", "torch")]


QUICK = DoubtConfig(folds=3, passes=1, train=TrainConfig(vocabulary="all", epochs=3, batch=64))
THOROUGH = replace(QUICK, passes=PASSES, train=replace(QUICK.train, epochs=5))
SMALL = ReviewBenchConfig(
    rooms=12, views=1, width=320, height=240, networks=1, again=0.02, doubts=THOROUGH, train=TrainConfig(batch=64)
)


@pytest.fixture(scope="module")
def demo(label_sets: dict[str, Labels]) -> LabelData:
    return read_label_data(label_sets["demo"], "rel14", DIRECTIONAL)


@pytest.fixture(scope="module")
def rooms() -> tuple[LabelData, LabelData]:
    """Cameras are the best of few and not of many: choosing them costs most."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipeline.synthetic.render.CANDIDATES", 4)
        return review_rooms(SMALL)


def test_the_top_of_the_ranking_holds_the_planted_errors(rooms: tuple[LabelData, LabelData]) -> None:
    """In eight rooms; `benchmarks.planted_labels` measures sixty."""
    found = measure_recovery(*rooms, SMALL, 0)
    assert found.planted == round(0.1 * found.cells) > 1000
    assert found.found >= 0.9
    assert found.found_again >= 0.97
    assert found.estimated == pytest.approx(found.planted, rel=0.3)
    assert found.f1["clean"] - found.f1["planted"] > 0.003, "there is something to bring back"
    assert found.recovered("mended") > 0.65
    assert found.recovered("again") >= 0.8
    assert json.loads(json.dumps(found.record()))["found"] == found.found


def test_no_label_of_a_scene_is_evidence_against_it(demo: LabelData) -> None:
    """Whatever is said of a scene, also of a pair's mirror image, what networks say of it stays as it is."""
    before = doubt_labels(demo, QUICK)
    scene = demo.frames[0].key.scene
    turned = replace(
        demo, frames=tuple(replace(f, states=-f.states) if f.key.scene == scene else f for f in demo.frames)
    )
    after = doubt_labels(turned, QUICK)
    fold = before.folds.held[:, 0].argmax()
    alone = [k for k in np.flatnonzero(before.folds.held[fold]).tolist() if demo.frames[k].key.scene == scene]
    assert len(alone) > 1
    for k, frame in enumerate(demo.frames):
        same = np.array_equal(before.probabilities[k], after.probabilities[k])
        assert same == bool(before.folds.held[fold, k]), frame.key


def test_doubts_are_the_same_again_and_cover_every_label(demo: LabelData) -> None:
    demo = plant_flips(demo, 0.1).data
    config = replace(QUICK, train=replace(QUICK.train, epochs=1), passes=2)
    trusted = [np.ones(f.states.shape, np.bool_) for f in demo.frames]
    told: list[tuple[int, int]] = []
    found = doubt_labels(demo, config, progress=lambda done, of: told.append((done, of)))
    again = doubt_labels(demo, config)
    kept = doubt_labels(demo, config, trusted=trusted)
    assert told == [(k, 6) for k in range(1, 7)]
    for frame, p, q, wrong in zip(demo.frames, found.probabilities, again.probabilities, found.wrong, strict=True):
        np.testing.assert_array_equal(p, q)
        apart = ~np.eye(len(p), dtype=np.bool_)
        np.testing.assert_array_equal(np.isfinite(wrong)[apart], (frame.states != U)[apart])
        np.testing.assert_allclose(p[..., 0], p[..., 1].T, atol=1e-12)
    single = doubt_labels(demo, replace(config, passes=1))
    assert all(np.array_equal(a, b) for a, b in zip(kept.probabilities, single.probabilities, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(found.probabilities, single.probabilities, strict=True))


def test_planted_errors_are_single_cells_of_the_share(demo: LabelData) -> None:
    planted = plant_flips(demo, 0.1, 3)
    before, after = (stacked([f.states for f in data.frames]) for data in (demo, planted.data))
    known = before != U
    assert planted.flipped.sum() == round(0.1 * known.sum())
    np.testing.assert_array_equal(after, np.where(planted.flipped, -before, before))
    assert not planted.flipped[~known].any()
    # Mirror images are planted on their own: few pairs of cells are turned together.
    matrices = unstacked(planted.flipped.astype(np.int8), [len(f.rows) for f in demo.frames])
    left, mirrored = (
        np.concatenate([m.ravel() for m in side])
        for side in ([m[..., 0] for m in matrices], [m[..., 1].T for m in matrices])
    )
    assert 0.05 < (left & mirrored).sum() / left.sum() < 0.15
    np.testing.assert_array_equal(stacked([f.states for f in with_labels(planted.data, before).frames]), before)


@pytest.mark.parametrize(
    "change",
    [
        {"rooms": 5},
        {"views": 0},
        {"share": 0.0},
        {"share": 1.0},
        {"top": 1.0},
        {"again": 0.95},
        {"seeds": 0},
        {"width": 8},
        {"doubts": replace(QUICK, folds=1)},
        {"doubts": replace(QUICK, passes=0)},
    ],
)
def test_numbers_without_sense_are_refused(change: dict) -> None:
    with pytest.raises(InputError):
        replace(SMALL, **change).check()
