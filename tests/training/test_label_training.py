"""Training on labels: what is learnt from, that it can be repeated, the paper's experiments, and the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from label_worlds import label_worlds
from needs import needs

from pipeline.answering import PreparedFrame, all_objects, appearance_of, open_pipeline
from pipeline.labels import Labels
from pipeline.language import DIRECTIONAL, VOCABULARIES
from pipeline.relations import FEATURES, ClassVectors, OnnxScorer, T, U, feature_set
from pipeline.system import InputError
from pipeline.training import LabelTraining, TrainConfig, pair_set, read_label_data, train_on_labels, train_pairs
from pipeline.training.card import save_onnx
from pipeline.training.label_data import PairSet
from pipeline.training.label_training import held_out

pytestmark = needs("torch", "onnx")


SA = VOCABULARIES["semantic-abstraction"]
FAST = TrainConfig(hidden=16, epochs=2, batch=256)


@pytest.fixture(scope="module")
def demo(label_sets: dict[str, Labels]) -> Labels:
    return label_sets["demo"]


# What is learnt from.


@pytest.mark.parametrize("features", FEATURES)
def test_labels_give_what_a_network_is_fed_at_run_time(features: str, demo: Labels) -> None:
    data = read_label_data(demo, features, DIRECTIONAL)
    usable = demo.objects.filter(demo.objects.column("usable")).to_pylist()
    source = open_pipeline("demo")
    contract = feature_set(features)
    for frame in data.frames[:3]:
        context = PreparedFrame(source.dataset.load(frame.key.frame))
        numbers = [row["object"] for row in usable if row["frame"] == frame.key.frame]
        objects = [o for o in all_objects(context, source.needed_detector()) if o.id in numbers]
        assert len(objects) == len(frame.rows)
        rows = contract.describe([o.lifted for o in objects], context.viewer, appearance_of(objects, context.frame))
        np.testing.assert_allclose(frame.rows, rows, atol=1e-9)
        assert [data.names[k] for k in frame.classes] == [o.label for o in objects]


def test_states_are_those_of_the_table(demo: Labels) -> None:
    data = read_label_data(demo, "rel14", SA)
    usable = {(r["frame"], r["object"]) for r in demo.objects.to_pylist() if r["usable"]}
    rows = [r for r in demo.relations.to_pylist() if {(r["frame"], r["a"]), (r["frame"], r["b"])} <= usable]
    for k, relation in enumerate(SA):
        for state in (T, -1):
            assert sum(int((f.states[..., k] == state).sum()) for f in data.frames) == sum(
                r[relation] == state for r in rows
            )
    first = data.frames[0]
    numbers = sorted(n for frame, n in usable if frame == first.key.frame)
    for r in rows[:50]:
        if r["frame"] == first.key.frame:
            a, b = numbers.index(r["a"]), numbers.index(r["b"])
            assert [r[name] for name in SA] == first.states[a, b].tolist()


def test_one_relation_to_a_pair_where_one_is_asked_for(demo: Labels) -> None:
    data = read_label_data(demo, "rel14", SA)
    several, one = (pair_set(data.frames, "rel14", output) for output in ("sigmoid", "softmax"))
    assert ((one.states == T).sum(axis=1) == 1).all()
    counts = (several.states == T).sum(axis=1)
    assert len(one) == (counts == 1).sum()
    assert (counts == 0).any(), "pairs without any relation teach a sigmoid network what does not hold"
    some = pair_set(data.frames, "rel14", "sigmoid", limit=100, seed=1)
    again, other = (pair_set(data.frames, "rel14", "sigmoid", limit=100, seed=s) for s in (1, 2))
    assert len(some) == 100
    assert some.hash() == again.hash() != other.hash()


def test_labels_without_the_relations_are_refused(demo: Labels, tmp_path: Path) -> None:
    manifest = demo.manifest.model_copy(update={"config": {"relations": list(DIRECTIONAL)}})
    with pytest.raises(InputError, match="lack the relation 'on'"):
        read_label_data(replace(demo, manifest=manifest), "rel14", SA)


# The network.


def random_pairs(rng: np.random.Generator, n: int = 400) -> PairSet:
    features = rng.normal(size=(n, 14)).astype(np.float32)
    return PairSet(features, rng.choice([-1, 0, 1], (n, 6)).astype(np.int8))


def test_pairs_in_doubt_change_nothing() -> None:
    rng = np.random.default_rng(0)
    pairs = random_pairs(rng)
    doubtful = PairSet(rng.normal(size=(50, 14)).astype(np.float32) * 9, np.zeros((50, 6), np.int8))
    both = PairSet(np.concatenate([pairs.features, doubtful.features]), np.concatenate([pairs.states, doubtful.states]))
    config = FAST
    assert train_pairs(pairs, config).weights_hash == train_pairs(both, config).weights_hash


def test_a_doubtful_cell_has_no_gradient() -> None:
    import torch

    from pipeline.training.train import _loss

    states = random_pairs(np.random.default_rng(1), 32).states
    logits = torch.randn(32, 6, requires_grad=True)
    _loss(torch, "sigmoid", states)(logits, torch.arange(32)).backward()
    gradient = logits.grad
    assert gradient is not None
    np.testing.assert_array_equal(gradient.numpy() == 0, states == U)


def test_equal_seeds_give_equal_weights_whatever_is_watched() -> None:
    pairs = random_pairs(np.random.default_rng(2))
    one, two, other = (
        train_pairs(pairs, replace(FAST, seed=s), validation=v)
        for s, v in ((0, None), (0, pairs.take(np.arange(90))), (1, None))
    )
    assert one.weights_hash == two.weights_hash != other.weights_hash
    assert one.losses == two.losses
    assert [e.metric for e in one.curve] == [None, None]
    assert all(0 < e.metric < 1 for e in two.curve if e.metric is not None)


def test_language_trains_as_if_the_vectors_stood_in_every_pair() -> None:
    rng = np.random.default_rng(3)
    pairs, table = random_pairs(rng), ClassVectors(("a", "b", "c"), rng.normal(size=(3, 4)).astype(np.float32))
    classes = rng.integers(0, 3, (len(pairs), 2)).astype(np.int32)
    worded = PairSet(pairs.features, pairs.states, classes, table)
    wide = np.concatenate([pairs.features, table.vectors[classes[:, 0]], table.vectors[classes[:, 1]]], axis=1)
    mean, std = worded.moments()
    np.testing.assert_allclose(mean, wide.mean(axis=0, dtype=np.float64), atol=1e-6)
    np.testing.assert_allclose(std, wide.std(axis=0, dtype=np.float64), atol=1e-6)
    geometry, first, second = worded.standardised(mean, std)
    gathered = np.concatenate([geometry, first[classes[:, 0]], second[classes[:, 1]]], axis=1)
    np.testing.assert_allclose(gathered, (wide - mean) / std, atol=1e-5)


def test_the_same_labels_and_seed_give_the_same_files(demo: Labels, word_vectors: Path, tmp_path: Path) -> None:
    made = []
    for name, seed in (("a", 0), ("b", 0), ("c", 5)):
        config = replace(FAST, features="geom2d8+lang", seed=seed)
        out = tmp_path / name / "n.onnx"
        card = train_on_labels(LabelTraining(demo.root, config, vectors=word_vectors, pairs=500), out)
        assert card["training"]["pairs"] == 500
        assert sorted(p.name for p in out.parent.iterdir()) == ["n.json", "n.onnx", "n.vectors.npz"]
        made.append((card["weights_xxh3_128"], *(p.read_bytes() for p in sorted(out.parent.iterdir()))))
    assert made[0] == made[1]
    assert made[0][0] != made[2][0]


# The paper's experiments.


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> tuple[Labels, Labels, Labels]:
    """To learn from; other worlds; those worlds from other heights, tilts and rolls."""
    folder = tmp_path_factory.mktemp("worlds")
    shifted = {"camera_height": (0.7, 2.2), "pitch": (-2.0, 35.0), "roll": 15.0}
    return (
        label_worlds(folder / "train", 10, 3),
        label_worlds(folder / "test", 5, 2, seed=1),
        label_worlds(folder / "shifted", 5, 2, seed=1, **shifted),
    )


def figures(
    worlds: tuple[Labels, Labels, Labels], features: str, limit: int, folder: Path, epochs: int = 10
) -> list[dict]:
    train, *others = (read_label_data(labels, features, DIRECTIONAL) for labels in worlds)
    learnt = pair_set(train.frames, features, "sigmoid", limit=limit)
    assert len(learnt) == limit
    save_onnx(folder / "m.onnx", train_pairs(learnt, TrainConfig(features, epochs=epochs)))
    scorer = OnnxScorer(folder / "m.onnx")
    return [held_out(scorer, data.frames, data.names) for data in others]


@pytest.mark.slow
def test_a_thousand_pairs_are_enough_for_relative_extents(
    worlds: tuple[Labels, Labels, Labels], tmp_path: Path
) -> None:
    same, shifted = figures(worlds, "rel14", 1000, tmp_path)
    assert same["pairs"] > 1000
    assert same["micro_f1"] >= 0.95
    assert shifted["micro_f1"] >= same["micro_f1"] - 0.015


@pytest.mark.slow
def test_depth_tells_front_from_behind_where_the_image_does_not(
    worlds: tuple[Labels, Labels, Labels], tmp_path: Path
) -> None:
    flat, deep = (figures(worlds, name, 4000, tmp_path, epochs=4) for name in ("geom2d8", "paper30"))
    for image, space in zip(flat, deep, strict=True):
        assert space["relations"]["front"]["f1"] > image["relations"]["front"]["f1"] + 0.1
        assert space["relations"]["behind"]["f1"] > image["relations"]["behind"]["f1"] + 0.1
    assert flat[0]["relations"]["left"]["f1"] > 0.8, "left and right are seen in the image"


# The command.
