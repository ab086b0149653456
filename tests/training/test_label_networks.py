"""Networks trained on labels: every variant answers, what they need to know of class names, and what is refused."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from needs import needs
from slow_cases import mostly_slow

from pipeline.answering import PreparedFrame, all_objects, open_pipeline
from pipeline.labels import Labels
from pipeline.language import DIRECTIONAL, INVERSE, VOCABULARIES
from pipeline.metrics import antisymmetric_log_softmax, fit_temperature, softmax
from pipeline.metrics.calibration_metrics import log_softmax
from pipeline.relations import (
    CLI_FEATURES,
    FEATURES,
    Appearance,
    ClassVectors,
    NetworkContract,
    OnnxScorer,
    T,
    make_scorer,
    vectors_path,
)
from pipeline.system import InputError
from pipeline.training import (
    LabelTraining,
    TrainConfig,
    pair_set,
    read_label_data,
    train_on_labels,
    train_pairs,
    write_onnx,
)
from pipeline.training.card import evaluate_classes

pytestmark = needs("torch", "onnx")


SA = VOCABULARIES["semantic-abstraction"]
FAST = TrainConfig(hidden=16, epochs=2, batch=256)


@pytest.fixture(scope="module")
def demo(label_sets: dict[str, Labels]) -> Labels:
    return label_sets["demo"]


@pytest.fixture(scope="module")
def networks(demo: Labels, word_vectors: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple, Path]:
    """A network of each variant, hardly trained, when it is asked for."""
    folder = tmp_path_factory.mktemp("networks")

    class Trained(dict[tuple, Path]):
        def __missing__(self, variant: tuple) -> Path:
            short, vocabulary = variant
            self[variant] = out = folder / f"{short}-{vocabulary}.onnx"
            vectors = word_vectors if "lang" in short else None
            config = replace(FAST, features=CLI_FEATURES[short], vocabulary=vocabulary)
            train_on_labels(LabelTraining(demo.root, config, vectors=vectors), out)
            return out

    return Trained()


VARIANTS = list(product(CLI_FEATURES, ["avd", "semantic-abstraction"]))


@pytest.mark.parametrize(("short", "vocabulary"), mostly_slow(VARIANTS, fast=(0, 6), several=True))
def test_every_variant_answers_and_its_card_says_what_made_it(
    short: str, vocabulary: str, networks: dict[tuple, Path]
) -> None:
    path = networks[short, vocabulary]
    card = json.loads(path.with_suffix(".json").read_text())
    assert f"--features {short} --vocabulary {vocabulary}" in card["command"]
    assert len(card["training"]["curve"]) == FAST.epochs
    parts = [set(card["split"][f"{p}_scenes"]) for p in ("train", "validation", "test")]
    assert sum(len(p) for p in parts) == len(set.union(*parts))
    assert vectors_path(path).is_file() == ("lang" in short)
    scorer = make_scorer(path)
    assert isinstance(scorer, OnnxScorer)
    source = replace(open_pipeline("demo"), scorer=scorer)
    context = PreparedFrame(source.dataset.load(source.dataset.frame_ids[0]))
    objects = all_objects(context, source.needed_detector())
    scores = source.score(context, objects)
    for relation in scorer.contract.vocabulary:
        assert scores.scored_by[relation] == CLI_FEATURES[short]
        table = scores.of(relation)
        assert ((table >= 0) & (table <= 1)).all()
        if vocabulary == "avd":
            apart = ~np.eye(len(objects), dtype=np.bool_)
            np.testing.assert_allclose(table[apart], scores.of(INVERSE[relation]).T[apart])
    if scorer.features.needs_appearance:
        with pytest.raises(InputError, match="look like in the image"):
            scorer.score([o.lifted for o in objects], context.viewer)


# Class names.


def seen(*labels: str) -> Appearance:
    return Appearance(np.tile([1.0, 2.0, 30.0, 40.0], (len(labels), 1)), labels, 64, 48)


def test_a_class_that_was_not_trained_on_needs_the_vectors(networks: dict[tuple, Path], word_vectors: Path) -> None:
    path = networks["2d+lang", "avd"]
    known = ClassVectors.read(vectors_path(path)).names[0]
    scorer, with_file = OnnxScorer(path), OnnxScorer(path, word_vectors)
    rows = np.zeros((2, 4))
    both = [scorer.with_words(rows, [known, spelt]) for spelt in (known, known.upper().replace(" ", "_"))]
    np.testing.assert_array_equal(both[0], both[1])
    with pytest.raises(InputError, match=r"not trained on these classes; got 'zebra'.*words\.npz"):
        scorer.with_words(rows, [known, "zebra"])
    fed = with_file.with_words(rows, [known, "zebra"])
    np.testing.assert_array_equal(fed[0], both[0][0])
    assert fed[1, 4:].any()
    with pytest.raises(InputError, match="no word of a name"):
        with_file.with_words(rows, ["qqqq"])


def test_other_vectors_and_other_networks_are_refused(
    networks: dict[tuple, Path], word_vectors: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.npz"
    loaded = np.load(word_vectors)
    np.savez(other, words=loaded["words"], vectors=loaded["vectors"] + 1, kind=loaded["kind"])
    path = networks["rel14+lang", "avd"]
    with pytest.raises(InputError, match="other ones than the network was trained with"):
        OnnxScorer(path, other).with_words(np.zeros((1, 6)), ["zebra"])
    with pytest.raises(InputError, match="uses no class names"):
        OnnxScorer(networks["rel14", "avd"], word_vectors)
    with pytest.raises(InputError, match="uses no class names"):
        make_scorer("rule", word_vectors)
    alone = tmp_path / "alone.onnx"
    shutil.copy(path, alone)
    with pytest.raises(InputError, match="class vectors are missing"):
        OnnxScorer(alone)
    assert OnnxScorer(alone, word_vectors).with_words(np.zeros((1, 6)), ["zebra"]).shape == (1, 11)
    known = ClassVectors.read(vectors_path(path))
    vectors_path(alone).write_bytes(ClassVectors(known.names[::-1], known.vectors).content())
    with pytest.raises(InputError, match="belong to another network"):
        OnnxScorer(alone)
    vectors_path(alone).write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="cannot be read"):
        OnnxScorer(alone)


# One relation of several.


def test_mirrored_pairs_share_their_logits_and_on_and_in_stay() -> None:
    rng = np.random.default_rng(4)
    logits = rng.normal(size=(5, 5, 6)) * 3
    found = antisymmetric_log_softmax(logits, SA)
    np.testing.assert_allclose(np.exp(found).sum(axis=2), 1)
    plain = log_softmax(logits)
    on = [SA.index("on"), SA.index("in")]
    np.testing.assert_allclose(found[..., on], plain[..., on])
    inside = [SA.index(r) for r in ("left", "right", "front", "behind")]
    share = softmax(found[..., inside])
    np.testing.assert_allclose(share[..., 0], share[..., 1].T)
    np.testing.assert_allclose(share[..., 2], share[..., 3].T)
    # A pair's logits have no zero: adding a constant to one pair changes nothing.
    moved = logits + rng.normal(size=(5, 5, 1)) * 10
    np.testing.assert_allclose(antisymmetric_log_softmax(moved, SA), found, atol=1e-9)


def test_the_prior_is_divided_out_in_ranking(networks: dict[tuple, Path]) -> None:
    scorer = OnnxScorer(networks["rel14", "semantic-abstraction"])
    prior = np.array(scorer.contract.prior)
    assert prior.max() > 2 * prior.min(), "classes are not balanced"
    rows = np.sort(np.random.default_rng(6).uniform(0, 3, (6, 2, 3)), axis=1).reshape(6, 6)
    posterior, ranked = scorer.class_probabilities(rows), scorer.probabilities(rows)
    expected = posterior / prior
    np.testing.assert_allclose(ranked, expected / expected.sum(axis=2, keepdims=True))
    for relation, share in zip(scorer.contract.vocabulary, prior, strict=True):
        if relation in INVERSE:
            assert prior[scorer.contract.vocabulary.index(INVERSE[relation])] == share


def test_a_temperature_softens_what_is_too_sure() -> None:
    rng = np.random.default_rng(5)
    logits = rng.normal(size=(1, 3000, 6)) * 2
    truth = np.array([rng.choice(6, p=p) for p in softmax(logits[0])])[None]
    slope, shift = fit_temperature([logits * 4], [truth], SA)["on"]
    assert slope == pytest.approx(0.25, rel=0.1)
    assert shift == 0
    assert fit_temperature([logits[:, :20]], [truth[:, :20]], SA)["on"] == (1.0, 0.0)


def test_figures_of_classes_by_hand() -> None:
    p = np.array([[[0.6, 0.3, 0.1], [0.5, 0.4, 0.1]], [[0.2, 0.3, 0.5], [0.9, 0.05, 0.05]]])
    truth = np.array([[0, 1], [0, -1]])
    report = evaluate_classes([p], [truth], (0.8, 0.1, 0.1), ("left", "on", "in"))
    assert report["pairs"] == 3
    assert report["top1"] == pytest.approx(1 / 3)
    assert report["top2"] == pytest.approx(2 / 3)
    assert report["top1_prior_divided"] == pytest.approx(1 / 3)
    assert report["most_frequent"] == pytest.approx(2 / 3)
    assert report["relations"]["left"] == {"precision": 0.5, "recall": 0.5, "f1": 0.5, "positives": 2}


def test_a_class_without_examples_is_left_to_the_rule(demo: Labels) -> None:
    pairs = pair_set(read_label_data(demo, "rel14", SA).frames, "rel14", "softmax")
    none = pairs.take(pairs.states[:, SA.index("in")] != T)
    model = train_pairs(none, replace(FAST, vocabulary="semantic-abstraction"))
    assert model.vocabulary == tuple(r for r in SA if r != "in")
    assert len(model.prior) == 5
    assert sum(model.prior) == pytest.approx(1)
    only_left = pairs.take(pairs.states[:, SA.index("left")] == T)
    with pytest.raises(InputError, match="too few relations"):
        train_pairs(only_left, replace(FAST, vocabulary="semantic-abstraction"))


SOFT = {"output": "softmax", "prior": json.dumps([1 / 6] * 6)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"output": "argmax"}, "output is not known"),
        ({"prior": SOFT["prior"]}, "output is not known.*with a prior"),
        ({"output": "softmax"}, "prior must be"),
        ({**SOFT, "prior": json.dumps([0.5, 0.1, 0.1, 0.1, 0.1, 0.1])}, "prior must be"),
        ({**SOFT, "prior": json.dumps([1 / 7] * 6)}, "prior must be"),
        ({**SOFT, "prior": "5"}, "cannot be read"),
        (
            {**SOFT, "calibration": json.dumps({r: [2 if r in ("left", "right") else 1, 0] for r in DIRECTIONAL})},
            "one temperature",
        ),
        ({"features": "rel14+lang"}, "language features do not fit"),
        ({"features": "geom2d8"}, "geom2d8 is another one"),
    ],
)
def test_a_wrong_pairing_is_refused(tmp_path: Path, changes: dict[str, str], message: str) -> None:
    contract = NetworkContract(
        "rel14",
        FEATURES["rel14"].columns,
        np.zeros(14),
        np.ones(14),
        DIRECTIONAL,
        dict.fromkeys(DIRECTIONAL, (1.0, 0.0)),
        0,
        "abc",
    )
    metadata = {**contract.metadata(), **{f"srm.{k}": v for k, v in changes.items()}}
    write_onnx(tmp_path / "m.onnx", [(np.zeros((14, 6)), np.zeros(6))], metadata)
    with pytest.raises(InputError, match=message):
        OnnxScorer(tmp_path / "m.onnx")


def test_a_softmax_network_gives_no_second_opinion(networks: dict[tuple, Path]) -> None:
    from pipeline.labels import open_second_opinion

    with pytest.raises(InputError, match="judges each relation alone"):
        open_second_opinion(str(networks["rel14", "semantic-abstraction"]))
    assert open_second_opinion(str(networks["2d", "avd"])) is not None
