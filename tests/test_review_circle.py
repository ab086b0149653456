"""The full circle: a failure that wrong labels taught is found, the labels are corrected, and it is gone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from review_labels import with_relations

from pipeline.correcting.desk import Desk
from pipeline.correcting.journal_place import JournalPlace
from pipeline.errors import InputError
from pipeline.evaluation.compare import read_records
from pipeline.evaluation.intervals import BootstrapConfig
from pipeline.evaluation.job import evaluate_dataset
from pipeline.evaluation.run import EvalSpec
from pipeline.evaluation.run_folder import open_run
from pipeline.journal.edits import set_relation
from pipeline.journal.events import Saved
from pipeline.labels.reading import Labels
from pipeline.relations import F, T
from pipeline.review.circle import AFTER, BEFORE, Circle, CircleJob, run_circle
from pipeline.review.retraining import RetrainConfig
from pipeline.srm.label_training import LabelTraining, train_on_labels
from pipeline.srm.train import TrainConfig

pytest.importorskip("torch")
pytest.importorskip("onnx")

CONFIG = RetrainConfig(TrainConfig(epochs=4, batch=64), bootstrap=BootstrapConfig(resamples=100))
ASKED = 150


@pytest.fixture(scope="module")
def planted(demo_labels: Labels, tmp_path_factory: pytest.TempPathFactory) -> Labels:
    """The demo's labels with "in front of" and "behind" the wrong way round."""
    columns = {
        name: demo_labels.relations.column(other).to_numpy()
        for name, other in (("front", "behind"), ("behind", "front"))
    }
    return with_relations(demo_labels, tmp_path_factory.mktemp("planted") / "labels", columns)


@pytest.fixture(scope="module")
def failed(planted: Labels, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with the network that has learnt the wrong labels."""
    folder = tmp_path_factory.mktemp("failed")
    train_on_labels(LabelTraining(planted.root, CONFIG.train, "random"), folder / "wrong.onnx")
    spec = EvalSpec("demo", str(planted.root), {"srm": folder / "wrong.onnx"}, limit=ASKED)
    evaluate_dataset(spec, folder / "run", plots=False, bootstrap=BootstrapConfig(resamples=50))
    return folder / "run"


@pytest.fixture(scope="module")
def circle(planted: Labels, failed: Path, tmp_path_factory: pytest.TempPathFactory) -> Circle:
    """Every wrong cell corrected as a person does it, then retrained and replayed."""
    folder = tmp_path_factory.mktemp("circle")
    place = JournalPlace(planted, folder / "journal.sqlite")
    desk = Desk(planted, place, "ann")
    for name in planted.frames.column("frame").to_pylist():
        frame = desk.frame(name)
        numbers = frame.pairs.numbers.tolist()
        pairs = [(a, b) for a in numbers for b in numbers if frame.pairs.state(a, b, "front") in (T, F)]
        # The mirror, "b behind a", is set with it.
        edits = [
            edit for a, b in pairs for edit in set_relation(frame, a, b, "front", -int(frame.pairs.state(a, b, "front")))
        ]
        assert isinstance(desk.save(edits), Saved)
    place.close()
    job = CircleJob(
        planted.root, folder / "out", str(folder / "journal.sqlite"), dataset="demo", run=failed,
        config=replace(CONFIG, split="random"),
    )  # fmt: skip
    return run_circle(job)


def test_the_debugger_blames_the_relations_for_what_wrong_labels_taught(failed: Path) -> None:
    rows = [r for r in read_records(failed).to_pylist() if r["relation"] in ("front", "behind") and not r["correct"]]
    assert len(rows) > 5
    verdicts = [r["verdict"] for r in rows]
    assert verdicts.count("SRM") > 0.7 * len(verdicts)


def test_what_was_mended_is_learnt_and_the_failures_are_gone(circle: Circle, failed: Path) -> None:
    before = {(r["frame"], r["id"]): r for r in read_records(failed).to_pylist()}
    wrong = {k for k, r in before.items() if r["relation"] in ("front", "behind") and not r["correct"]}
    after = {(r["frame"], r["id"]): r for r in read_records(circle.folder / AFTER).to_pylist()}
    assert np.mean([bool(after[k]["correct"]) for k in wrong]) > 0.8
    assert circle.replay is not None
    assert len(circle.replay.fixed) > 3 * len(circle.replay.broken)
    assert circle.retraining.gain.f1[circle.retraining.relations.index("front")].value > 0.5


def test_runs_of_the_circle_can_be_opened_and_name_what_made_them(circle: Circle, failed: Path) -> None:
    for name in (BEFORE, AFTER):
        run = open_run(circle.folder / name)
        assert Path(run.spec.labels) == circle.folder / "labels"
        assert len(run.records) == ASKED
    assert Path(str(open_run(circle.folder / AFTER).spec.options["srm"])) == circle.network
    assert open_run(circle.folder / BEFORE).spec.options["srm"] == open_run(failed).spec.options["srm"]


def test_without_corrections_nothing_is_trained(planted: Labels, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no journal here"):
        run_circle(CircleJob(planted.root, tmp_path / "out", str(tmp_path / "none.sqlite")))
    JournalPlace(planted, tmp_path / "empty.sqlite").to_write().close()
    with pytest.raises(InputError, match="nothing was corrected"):
        run_circle(CircleJob(planted.root, tmp_path / "out", str(tmp_path / "empty.sqlite")))
    assert not (tmp_path / "out").exists()
