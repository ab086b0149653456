"""The contract that a relation network carries in its file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from network_checks import random_rows, scene  # noqa: F401

from pipeline.answering import PreparedFrame, all_objects
from pipeline.geometry import Frame
from pipeline.language import DIRECTIONAL
from pipeline.metrics import antisymmetric, sigmoid
from pipeline.proposals import AnnotationDetector
from pipeline.relations import FEATURES, OnnxScorer, RuleScorer, make_scorer, shipped_network
from pipeline.relations.model import NetworkContract
from pipeline.system import InputError

# The contract.


def written(path: Path, metadata: dict[str, str], inputs: int = 14, outputs: int = 6) -> Path:
    """A network of the given shape that says the given things about itself."""
    pytest.importorskip("onnx")
    from pipeline.training import write_onnx

    rng = np.random.default_rng(0)
    write_onnx(path, [(rng.normal(size=(inputs, outputs)), np.zeros(outputs))], metadata)
    return path


def said(**changes: Any) -> dict[str, str]:
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
    metadata = contract.metadata()
    metadata.update({f"srm.{key}": value for key, value in changes.items()})
    return {key: value for key, value in metadata.items() if value != ""}


def test_a_contract_survives_the_file_to_the_last_digit(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    calibration: dict[str, tuple[float, float]] = {r: (1.1, 1 / 3) for r in DIRECTIONAL}  # noqa: C420
    contract = NetworkContract(
        "canon30",
        FEATURES["canon30"].columns,
        rng.normal(size=30),
        rng.uniform(0.1, 2, 30),
        DIRECTIONAL,
        calibration,
        7,
        "f00d",
    )
    scorer = OnnxScorer(written(tmp_path / "m.onnx", contract.metadata(), inputs=30))
    np.testing.assert_array_equal(scorer.contract.mean, contract.mean)
    np.testing.assert_array_equal(scorer.contract.std, contract.std)
    for key in ("features", "columns", "vocabulary", "calibration", "seed", "data"):
        assert getattr(scorer.contract, key) == getattr(contract, key)
    assert scorer.name == "canon30"


def test_the_scorer_standardises_and_calibrates(tmp_path: Path) -> None:
    rows = random_rows(2)
    plain = OnnxScorer(written(tmp_path / "a.onnx", said()))
    moved = OnnxScorer(written(tmp_path / "b.onnx", said(mean=json.dumps([0.5] * 14), std=json.dumps([2.0] * 14))))
    bent = dict.fromkeys(DIRECTIONAL, (2.0, 0.5))
    sharp = OnnxScorer(written(tmp_path / "c.onnx", said(calibration=json.dumps(bent))))
    np.testing.assert_allclose(plain.probabilities(rows), sigmoid(plain.logits(rows)))
    np.testing.assert_allclose(sharp.probabilities(rows), sigmoid(2 * plain.logits(rows) + 0.5))
    W = np.random.default_rng(0).normal(size=(14, 6))
    expected = antisymmetric(((FEATURES["rel14"].pair(rows) - 0.5) / 2.0) @ W, DIRECTIONAL)
    np.testing.assert_allclose(moved.logits(rows), expected, atol=1e-4)


def test_a_network_for_some_relations_leaves_the_others_to_the_rule(tmp_path: Path, scene: Frame) -> None:
    pair = json.dumps(["on", "behind"])
    calibration = json.dumps({"on": [1.0, 0.0], "behind": [1.0, 0.0]})
    scorer = OnnxScorer(written(tmp_path / "m.onnx", said(vocabulary=pair, calibration=calibration), outputs=2))
    context = PreparedFrame(scene)
    objects = [o.lifted for o in all_objects(context, AnnotationDetector(("a", "b", "c")))]
    scores = scorer.score(objects, context.viewer)
    assert [r for r, by in scores.scored_by.items() if by == "rel14"] == ["behind", "on"]
    np.testing.assert_array_equal(scores.of("left"), RuleScorer().score(objects, context.viewer).of("left"))


BENT = {r: [1.0, 0.0] for r in DIRECTIONAL}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"contract": ""}, "not a relation network.*no contract"),
        ({"contract": "spatialviz-srm-9"}, "not a relation network.*spatialviz-srm-9"),
        ({"features": "rel15"}, "features that are not known.*'rel15'"),
        ({"features": "paper30"}, "paper30 is another one.*14 features"),
        (
            {"columns": json.dumps([*FEATURES["rel14"].columns[:-2], "forward_b", "a"])},
            "14 features, 'forward_b' out of place",
        ),
        ({"mean": json.dumps([0.0] * 13)}, "mean and deviation"),
        ({"std": json.dumps([1.0] * 13 + [0.0])}, "mean and deviation"),
        ({"mean": json.dumps([0.0] * 13)[:-1]}, "cannot be read"),
        ({"std": ""}, "cannot be read.*KeyError"),
        ({"seed": "many"}, "cannot be read"),
        ({"calibration": "[1, 2]"}, "cannot be read"),
        ({"vocabulary": json.dumps([*DIRECTIONAL[:-1], "beneath"])}, "vocabulary is not known.*beneath"),
        ({"vocabulary": json.dumps(["left"] * 6)}, "vocabulary is not known"),
        ({"vocabulary": "[]"}, "vocabulary is not known"),
        ({"calibration": json.dumps({"left": [1, 0]})}, "for other relations"),
        ({"calibration": json.dumps({**BENT, "left": [-1, 0]})}, "calibration must be"),
        ({"calibration": json.dumps({**BENT, "left": [2, 0]})}, "the same for inverse relations.*left"),
        ({"calibration": json.dumps({**BENT, "left": [float("nan"), 0]})}, "calibration must be"),
    ],
)
def test_a_wrong_pairing_is_refused_with_its_reason(tmp_path: Path, changes: dict, message: str) -> None:
    path = written(tmp_path / "m.onnx", said(**changes))
    with pytest.raises(InputError, match=message) as error:
        OnnxScorer(path)
    assert error.value.path == path


def test_a_graph_of_another_shape_is_refused(tmp_path: Path) -> None:
    for inputs, outputs in ((30, 6), (14, 9)):
        with pytest.raises(InputError, match="does not fit its metadata"):
            OnnxScorer(written(tmp_path / "m.onnx", said(), inputs, outputs))


def test_files_of_another_kind_are_refused(tmp_path: Path, shared_data: Path) -> None:
    with pytest.raises(InputError, match="not a relation network"):
        make_scorer(shared_data / "onnx" / "yolov8n_seg_480x640.onnx")
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(shipped_network().read_bytes()[:5000])
    for path in (broken, tmp_path):
        with pytest.raises(InputError):
            OnnxScorer(path)
