"""Training the relation network: what it learns from, that it learns, and that it can be made again."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from needs import needs
from threadpoolctl import threadpool_info, threadpool_limits

from pipeline.language import DIRECTIONAL
from pipeline.metrics import fit_calibration, fit_platt, sigmoid
from pipeline.relations import FEATURES, OnnxScorer
from pipeline.synthetic import choose_views, make_room, render_view, sense_view
from pipeline.system import InputError, MissingExtra
from pipeline.training import (
    FrameSamples,
    RoomConfig,
    TrainConfig,
    card,
    degraded,
    make_samples,
    require_training,
    write_onnx,
)
from pipeline.training.card import save_onnx
from pipeline.training.train import train_srm
from pipeline.training.training_data import (
    WRONG_NAMES,
    iterate_pairs,
    make_split,
    room_seeds,
    varied_camera,
    with_other_sizes,
    with_wrong_names,
)

pytestmark = needs("embreex", "torch", "onnx")


WIDTH, HEIGHT = 200, 150
SCATTERED = 2
SEEDS = (8_500_000, 8_500_002)


@pytest.fixture(scope="module")
def samples() -> tuple[FrameSamples, ...]:
    return make_samples(SEEDS, views=1, width=WIDTH, height=HEIGHT)


def same(a: FrameSamples, b: FrameSamples) -> bool:
    arrays = ("seen_lo", "seen_hi", "exact_lo", "exact_hi")
    return (
        a.room == b.room
        and all(np.array_equal(getattr(a, k), getattr(b, k)) for k in arrays)
        and all(np.array_equal(a.rows[k], b.rows[k]) for k in FEATURES)
    )


# What it learns from.


@pytest.mark.slow
def test_the_sensed_view_is_that_of_the_picture() -> None:
    room = make_room(6)
    (camera,) = choose_views(room, 1, np.random.default_rng(0), 96, 72)
    frame = render_view(room, camera, np.random.default_rng(5))
    depth, instances = sense_view(room, camera, np.random.default_rng(5))
    np.testing.assert_array_equal(depth, frame.depth)
    np.testing.assert_array_equal(instances, frame.instances)


@pytest.mark.slow
def test_samples_are_repeatable_whatever_the_workers(samples: tuple[FrameSamples, ...]) -> None:
    again = make_samples(SEEDS, views=1, workers=2, width=WIDTH, height=HEIGHT)
    assert all(same(a, b) for a, b in zip(samples, again, strict=True))
    varied = make_samples(SEEDS[:1], views=1, maker="varied", width=WIDTH, height=HEIGHT)
    assert not same(samples[0], varied[0])


def test_labels_know_the_whole_object_and_features_only_what_is_seen(samples: tuple[FrameSamples, ...]) -> None:
    for frame in samples:
        assert len(frame.seen_lo) >= 5
        # Half the slack is noise and masks that reach a little past the object.
        inside = (frame.seen_lo > frame.exact_lo - 0.12) & (frame.seen_hi < frame.exact_hi + 0.12)
        assert inside.mean() > 0.95
        seen, whole = frame.seen_hi - frame.seen_lo, frame.exact_hi - frame.exact_lo
        assert np.median(seen[:, 2] / whole[:, 2]) < 0.97, "the backs of things are not seen"
        assert (frame.truth != frame.rule).any()


def test_masks_are_a_little_wrong_and_never_vanish() -> None:
    mask = np.zeros((60, 80), np.bool_)
    mask[20:40, 30:50] = True
    thin = np.zeros_like(mask)
    thin[30:32, :] = True
    areas = {int(degraded(mask, np.random.default_rng(s)).sum()) for s in range(40)}
    assert min(areas) < mask.sum() < max(areas)
    assert len(areas) == 6
    assert all(degraded(thin, np.random.default_rng(s)).sum() >= 100 for s in range(20))


def test_varied_cameras_still_know_what_is_up() -> None:
    (camera,) = choose_views(make_room(5), 1, np.random.default_rng(0), 96, 72)
    for seed in range(10):
        varied = varied_camera(camera, np.random.default_rng(seed))
        assert varied.T_world_camera is not None
        assert varied.up is not None
        np.testing.assert_allclose(varied.T_world_camera[:3, :3] @ varied.up, [0, 0, 1], atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(varied.T_world_camera[:3, :3]), 1)
        assert varied.fx != camera.fx


def test_a_scene_of_another_size_is_judged_anew(samples: tuple[FrameSamples, ...]) -> None:
    frame = samples[0]
    small = frame.scaled(0.1)
    np.testing.assert_allclose(small.exact_hi, frame.exact_hi * 0.1)
    box = FEATURES["paper30"]
    rows, shrunk = frame.rows["paper30"], small.rows["paper30"]
    np.testing.assert_allclose(shrunk[:, 3:12], rows[:, 3:12])
    np.testing.assert_allclose(shrunk[:, list(box.lengths)], rows[:, list(box.lengths)] * 0.1)
    named = list(FEATURES["rel32"].named)
    assert frame.rows["rel32"][:, named].any()
    assert not small.rows["rel32"][:, named].any(), "what is of another size is no longer what its name says"
    assert (small.truth == 0).sum() > (frame.truth == 0).sum(), "dead zones are metres"
    both = with_other_sizes(samples, 3)
    assert len(both) == 2 * len(samples)
    assert both[: len(samples)] == samples
    assert all(same(a, b) for a, b in zip(both, with_other_sizes(samples, 3), strict=True))


def test_some_things_go_by_the_name_of_another(samples: tuple[FrameSamples, ...]) -> None:
    again = with_wrong_names(samples * 20, 3)
    named = list(FEATURES["rel32"].named)
    before, after = (np.concatenate([f.rows["rel32"] for f in frames]) for frames in (samples * 20, again))
    rest = np.setdiff1d(np.arange(before.shape[1]), named)
    np.testing.assert_array_equal(after[:, rest], before[:, rest])
    changed = (after[:, named] != before[:, named]).any(axis=1)
    assert 0.5 * WRONG_NAMES < changed.mean() <= 1.3 * WRONG_NAMES, "so many, less those of the same class"
    known = {tuple(row) for row in before[:, named]}
    assert {tuple(row) for row in after[changed][:, named]} <= known
    for old, new in zip(samples * 20, again, strict=True):
        np.testing.assert_array_equal(new.truth, old.truth)
        assert all(new.rows[name] is old.rows[name] for name in old.rows if name != "rel32")


def test_rooms_are_split_from_rooms() -> None:
    train, calibration, test = room_seeds(2, 50)
    assert (len(train), len(calibration), len(test)) == (35, 5, 10)
    assert len({*train, *calibration, *test}) == 50
    assert not {*train, *calibration, *test} & set(room_seeds(1, 50)[0])
    # `spatialviz render --seed 2` makes rooms 2,000,000 and up.
    assert min(train) == 2_500_000
    assert [len(part) for part in room_seeds(0, 3)] == [1, 1, 1]
    for rooms, seed in ((2, 0), (600_000, 0), (10, -1)):
        with pytest.raises(InputError):
            room_seeds(seed, rooms)
    with pytest.raises(InputError, match="at least"):
        make_samples([1], views=0)


@pytest.fixture
def few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cameras are the best of few and not of many, and scattered rooms are few: they cost most."""
    monkeypatch.setattr("pipeline.synthetic.render.CANDIDATES", 4)
    monkeypatch.setattr("pipeline.training.training_data.SCATTERED_A_ROOM", SCATTERED)


@pytest.mark.usefixtures("few_candidates")
def test_progress_counts_all_rooms() -> None:
    seen = []
    train, calibration, test = make_split(
        1, 3, views=1, width=64, height=48, progress=lambda done, of: seen.append((done, of))
    )
    total = 3 + 4 * SCATTERED
    assert seen == [(k, total) for k in range(1, total + 1)]
    assert len(test) == 1
    assert len(calibration) == SCATTERED
    assert len(train) > 1


# That it learns.


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rel32", "rel26", "rel14", "paper30", "canon30"])
def test_training_lowers_the_loss(name: str, samples: tuple[FrameSamples, ...]) -> None:
    model = train_srm(samples, TrainConfig(features=name, hidden=32, epochs=9, batch=16, halve_every=9))
    assert len(model.losses) == 9
    assert model.losses[-1] < 0.7 * model.losses[0]
    assert [w.shape for w, _ in model.layers] == [(FEATURES[name].dimension, 32), (32, 32), (32, 6)]
    assert model.pairs == sum(len(f) for f, _ in iterate_pairs(samples, name))


def test_the_file_computes_what_was_trained(samples: tuple[FrameSamples, ...], tmp_path: Path) -> None:
    from pipeline.metrics import antisymmetric

    model = train_srm(samples, TrainConfig(hidden=16, epochs=2))
    save_onnx(tmp_path / "m.onnx", model)
    rows = samples[0].rows["rel14"]
    x = (FEATURES["rel14"].pair(rows) - model.mean) / model.std
    (w0, b0), (w1, b1), (w2, b2) = model.layers
    expected = np.maximum(np.maximum(x @ w0 + b0, 0) @ w1 + b1, 0) @ w2 + b2
    found = OnnxScorer(tmp_path / "m.onnx").logits(rows)
    np.testing.assert_allclose(found, antisymmetric(expected, DIRECTIONAL), atol=1e-4)


def test_equal_seeds_give_equal_bytes(samples: tuple[FrameSamples, ...], tmp_path: Path) -> None:
    import torch

    threads = torch.get_num_threads()
    config = TrainConfig(hidden=16, epochs=2)
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        save_onnx(tmp_path / name, train_srm(samples, TrainConfig(hidden=16, epochs=2, seed=seed)))
        torch.rand(3)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    first, third = (train_srm(samples, c) for c in (config, TrainConfig(hidden=16, epochs=2, seed=1)))
    assert not np.array_equal(first.layers[0][0], third.layers[0][0])
    assert torch.get_num_threads() == threads
    assert not torch.are_deterministic_algorithms_enabled()


@pytest.mark.slow
@pytest.mark.usefixtures("few_candidates")
def test_a_training_job_does_not_depend_on_the_threads_it_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch")
    rooms, config = RoomConfig(rooms=3, views=1, width=WIDTH, height=HEIGHT, seed=8), TrainConfig(epochs=1)
    rng = np.random.default_rng(0)
    many = rng.normal(size=300_000)
    holds = rng.random(len(many)) < sigmoid(2 * many)
    fitted, loose = [], []

    def fit(*given: Any) -> dict[str, Any]:
        # As many pairs as hundreds of rooms have: with few of them the sums are not shared among threads.
        fitted.append(fit_platt(many, holds))
        return fit_calibration(*given)

    monkeypatch.setattr(card, "fit_calibration", fit)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with threadpool_limits(threads):
                loose.append(fit_platt(many, holds))
                card.train_on_rooms(tmp_path / f"{threads}" / "srm.onnx", rooms, config)
                counts = {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
                assert counts == {threads}, "they are as they were afterwards"
    finally:
        torch.set_num_threads(before)
    assert fitted == [loose[0]] * 2
    for name in ("srm.onnx", "srm.json"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


def test_doubtful_cells_teach_nothing(samples: tuple[FrameSamples, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    import pipeline.training.train as module

    def half_doubtful(frames: object, name: str) -> list[tuple[np.ndarray, np.ndarray]]:
        x = np.random.default_rng(0).normal(size=(400, 14))
        states = np.ones((400, 6), np.int8)
        states[:, 0] = 0
        states[:, 1] = np.where(x[:, 0] > 0, 1, -1)
        return [(x, states)]

    monkeypatch.setattr(module, "iterate_pairs", half_doubtful)
    model = train_srm(samples, TrainConfig(hidden=16, epochs=3))
    before = train_srm(samples, TrainConfig(hidden=16, epochs=3))
    assert model.losses == before.losses
    # The output that was always in doubt kept its initial bias; the others moved.
    assert model.layers[-1][1][0] == 0
    assert (model.layers[-1][1][1:] != 0).all()


def test_nothing_to_learn_from_is_refused(samples: tuple[FrameSamples, ...]) -> None:
    with pytest.raises(InputError, match="no pairs"):
        train_srm(())
    with pytest.raises(InputError, match="positive"):
        train_srm(samples, TrainConfig(epochs=0))
    with pytest.raises(InputError, match="feature contract"):
        train_srm(samples, TrainConfig(features="rel15"))


@pytest.mark.parametrize("package", ["torch", "onnx"])
def test_a_missing_extra_is_named(
    package: str, samples: tuple[FrameSamples, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtra, match=r"spatialviz\[train\]"):
        require_training()
    layers = [(np.zeros((2, 2)), np.zeros(2))]
    needs = (lambda: train_srm(samples)) if package == "torch" else (lambda: write_onnx(tmp_path / "m", layers, {}))
    with pytest.raises(MissingExtra, match=r"spatialviz\[train\]"):
        needs()


# The command.
