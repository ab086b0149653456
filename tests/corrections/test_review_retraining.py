"""Networks before and after labels were mended, on the same held-out frames."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from label_worlds import label_worlds
from needs import needs
from review_labels import flipped

from pipeline.corrections import RetrainConfig, Retraining, retrain
from pipeline.labels import Labels
from pipeline.language import DIRECTIONAL
from pipeline.metrics import BootstrapConfig
from pipeline.relations import OnnxScorer
from pipeline.system import InputError
from pipeline.training import TrainConfig

pytestmark = needs("torch", "onnx")


CONFIG = RetrainConfig(TrainConfig(epochs=3, batch=32), bootstrap=BootstrapConfig(resamples=200))


@pytest.fixture(scope="module")
def mended(tmp_path_factory: pytest.TempPathFactory) -> tuple[Labels, Labels]:
    """Labels with one cell in four wrong, and right ones."""
    folder = tmp_path_factory.mktemp("mended")
    right = label_worlds(folder / "right", scenes=10, views=2)
    return flipped(right, folder / "wrong", 0.25, 4), right


@pytest.fixture(scope="module")
def found(mended: tuple[Labels, Labels], tmp_path_factory: pytest.TempPathFactory) -> tuple[Retraining, Path]:
    out = tmp_path_factory.mktemp("network") / "new" / "srm.onnx"
    return retrain(*mended, out, CONFIG), out


def test_mended_labels_give_a_better_network(found: tuple[Retraining, Path]) -> None:
    result, _ = found
    assert result.gain.micro_f1.value > 0.02
    assert result.gain.micro_f1.value == pytest.approx(result.after.micro_f1.value - result.before.micro_f1.value)
    right, wrong = result.flips["all"]
    assert right > wrong
    assert sum(result.flips[r][0] for r in DIRECTIONAL) == right
    assert len(result.better) == min(right, 200)
    for cell in (*result.better, *result.worse):
        right = (cell["after"] > 0.5) == (cell["label"] == "T")
        assert right == (cell in result.better)
        assert ((cell["before"] > 0.5) == (cell["label"] == "T")) != right
        assert cell["a"] != cell["b"]


def test_cells_are_named_as_the_labels_name_them(found: tuple[Retraining, Path], mended: tuple[Labels, Labels]) -> None:
    rows = {(r["frame"], r["a"], r["b"]): r for r in mended[1].relations.to_pylist()}
    for cell in (*found[0].better, *found[0].worse):
        state = rows[cell["frame"], cell["a"], cell["b"]][cell["relation"]]
        assert cell["label"] == {1: "T", -1: "F"}[state]


def test_what_changed_is_counted_by_part(found: tuple[Retraining, Path], mended: tuple[Labels, Labels]) -> None:
    result, _ = found
    differ = {
        r: int((mended[0].relations.column(r).to_numpy() != mended[1].relations.column(r).to_numpy()).sum())
        for r in DIRECTIONAL
    }
    assert {r: sum(part[r] for part in result.changed.values()) for r in DIRECTIONAL} == differ
    assert result.changed["dropped"] == dict.fromkeys(DIRECTIONAL, 0)
    assert min(sum(result.changed[part].values()) for part in ("train", "validation", "test")) > 0


def test_the_network_and_what_is_known_of_it_are_written(found: tuple[Retraining, Path]) -> None:
    result, out = found
    assert sorted(p.name for p in out.parent.iterdir()) == [
        "srm.comparison.json",
        "srm.json",
        "srm.onnx",
    ]
    scorer = OnnxScorer(out)
    assert scorer.contract.trained_on is not None
    record = json.loads(out.with_suffix(".comparison.json").read_text())
    assert (
        record["networks"][1]["weights_xxh3_128"]
        == json.loads(out.with_suffix(".json").read_text())["weights_xxh3_128"]
    )
    assert record["networks"][0]["weights_xxh3_128"] != record["networks"][1]["weights_xxh3_128"]
    assert record["became_right"]["cells"] == result.flips["all"][0]


@pytest.mark.slow
def test_equal_labels_give_equal_networks(mended: tuple[Labels, Labels], tmp_path: Path) -> None:
    result = retrain(mended[1], mended[1], tmp_path / "same.onnx", CONFIG)
    assert result.gain.micro_f1.value == 0
    assert result.flips["all"] == (0, 0)
    assert sum(sum(part.values()) for part in result.changed.values()) == 0
    weights = {card["weights_xxh3_128"] for card in result.cards}
    assert len(weights) == 1


def test_labels_of_other_frames_are_refused_and_leave_nothing(
    mended: tuple[Labels, Labels], label_sets: dict[str, Labels], tmp_path: Path
) -> None:
    for before, after in ((label_sets["empty"], mended[1]), (mended[0], label_sets["hostile"])):
        with pytest.raises(InputError):
            retrain(before, after, tmp_path / "out" / "srm.onnx", CONFIG)
    assert not list(tmp_path.rglob("*.onnx"))
    for train in (TrainConfig(vocabulary="semantic-abstraction"), TrainConfig("rel14+lang"), TrainConfig(epochs=0)):
        with pytest.raises(InputError):
            retrain(*mended, tmp_path / "srm.onnx", RetrainConfig(train))
