"""Commands that train, retrain and measure relation networks, run whole."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_label_training import demo
from test_review_recovery import rooms
from test_review_retraining import mended

from pipeline.labels.reading import Labels
from pipeline.relations.model import OnnxScorer
from pipeline.training.label_data import LabelData
from spatialviz.cli import main


def test_train_on_labels_from_the_command_line(
    demo: Labels, word_vectors: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "mine.onnx"
    told = ["--out", str(out), "--features", "2d+lang", "--vectors", str(word_vectors), "--epochs", "2"]
    assert main(["train", str(demo.root), *told, "--split", "blocks", "--pairs", "600"]) == 0
    text = capsys.readouterr()
    assert "micro-F1" in text.out
    assert "in known rooms, not in new ones" in text.err
    assert main(["ask", "demo", "0", "mug left of the laptop", "--srm", str(out), "--json"]) in (0, 1)
    assert json.loads(capsys.readouterr().out)["scorer"] == "geom2d8+lang"
    assert (
        main(
            [
                "train",
                str(demo.root),
                "--out",
                str(out),
                "--epochs",
                "1",
                "--pairs",
                "300",
                "--json",
                "--vocabulary",
                "semantic-abstraction",
            ]
        )
        == 0
    )
    assert json.loads(capsys.readouterr().out)["training"]["output"] == "softmax"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--features", "3d+lang"], "need vectors of class names"),
        (["--features", "3d", "--normalised"], "use no class names"),
        (["--rooms", "30"], "--rooms belongs to training on the word rooms"),
        (["--epochs", "0"], "must be positive"),
        (["--pairs", "1"], "at least two pairs"),
        (["--seed", "-1"], "seed"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(
    arguments: list[str], message: str, demo: Labels, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(demo.root), "--out", str(tmp_path / "m.onnx"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_rooms_refuse_what_only_labels_have(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "m.onnx")]
    for arguments, message in (
        (["--split", "blocks"], "--split belongs to training on a labels folder"),
        (["--features", "rel14+lang"], "six directional relations"),
        (["--vocabulary", "semantic-abstraction"], "six directional relations"),
    ):
        assert main(["train", "rooms", *out, *arguments]) == 2
        assert message in capsys.readouterr().err
    assert main(["train", str(tmp_path / "absent"), *out]) == 2
    assert "no labels here" in capsys.readouterr().err


@pytest.mark.slow
def test_train_writes_a_network_that_answers_and_its_card(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "mine.onnx"
    small = ["--rooms", "3", "--views", "1", "--width", "200", "--height", "150", "--epochs", "3", "--workers", "1"]
    assert main(["train", "rooms", "--out", str(out), *small, "--seed", "4", "--features", "canon"]) == 0
    text = capsys.readouterr().out
    assert "always no" in text
    assert "micro-F1" in text
    card = json.loads(out.with_suffix(".json").read_text())
    assert "--seed 4" in card["command"]
    assert "--features canon " in card["command"]
    assert {"train_rooms", "calibration_rooms", "test_rooms"} <= set(card["rooms"])
    assert card["held_out"]["network"]["all_negative_accuracy"] > 0.7
    assert sorted(p.name for p in out.parent.iterdir()) == ["mine.json", "mine.onnx"]
    status = main(["ask", "demo", "0", "mug left of the laptop", "--srm", str(out), "--json"])
    asked = json.loads(capsys.readouterr().out)
    # Whether so small a network finds that it holds is left open.
    assert status == (0 if asked["answer"]["holds"] else 1)
    assert asked["scorer"] == "canon30"
    assert main(["train", "rooms", "--out", str(tmp_path / "mine.pt"), *small]) == 2
    assert ".onnx" in capsys.readouterr().err


def test_the_command_prints_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    told = ["--rooms", "3", "--views", "1", "--pairs", "300", "--features", "rel14", "--networks", "1", "--epochs", "2"]
    assert main(["ablation", *told, "--batch", "64", "--workers", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"rule", "rel14, 300 pairs"}
    assert 0 < found["rel14, 300 pairs"]["micro-F1"]["value"] < found["rule"]["micro-F1"]["value"] <= 1


@pytest.mark.slow
def test_the_commands_review_and_retrain(
    mended: tuple[Labels, Labels], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import pyarrow.parquet as pq

    before = str(mended[0].root)
    told = ["--limit", "7", "--out", str(tmp_path / "q" / "queue.parquet")]
    assert main(["review", before, *told, "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(rows) == 7
    written = pq.read_table(tmp_path / "q" / "queue.parquet")
    assert {row.pop("state") for row in rows} == {"unreviewed"}
    assert written.slice(0, 7).to_pylist() == rows
    assert written.num_rows > 500
    assert main(["review", before, "--no-networks", "--limit", "2"]) == 0
    assert "labels to look at" in capsys.readouterr().out
    pair = {name: rows[0][name] for name in ("frame", "a", "b", "relation")}
    (tmp_path / "edits.json").write_text(json.dumps([{"edit": "relation", **pair, "to": "T"}]))
    journal = ["--journal", str(tmp_path / "journal.sqlite")]
    assert main(["correct", before, "--edits", str(tmp_path / "edits.json"), "--author", "ann", *journal]) == 0
    told = ["--epochs", "1", "--batch", "128", "--out", str(tmp_path / "again")]
    assert main(["retrain", before, *told, *journal]) == 0
    assert "became correct" in capsys.readouterr().out
    assert np.isfinite(OnnxScorer(tmp_path / "again" / "network.onnx").contract.mean).all()
    assert main(["review", str(tmp_path)]) == 2
    assert main(["review", before, "--limit", "-1"]) == 2


@pytest.mark.parametrize(("arguments", "said"), [(["--members", "2"], "--members"), (["--split", "blocks"], "--split")])
def test_training_on_boxes_refuses_options_of_other_networks(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "boxes", "--out", str(tmp_path / "m.onnx"), *arguments]) == 2
    assert f"{said} does not belong to training on the word boxes" in capsys.readouterr().err


def test_asked_sizes_are_of_completed_boxes_where_they_are_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ask", "demo", "0", "tallest thing", "--boxes", "completed", "--json"]) in (0, 1)
    assert json.loads(capsys.readouterr().out)["answer"]["target"]["whole"]["completed"]
