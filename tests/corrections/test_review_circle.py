"""The full circle: a failure that wrong labels taught is found, the labels are corrected, and it is gone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest
from needs import needs
from review_labels import with_relations

from pipeline.corrections import (
    JournalLocation,
    LabelEditor,
    RetrainConfig,
    RetrainingJob,
    RetrainingRun,
    Saved,
    run_retraining,
    set_relation,
)
from pipeline.corrections.review.label_jobs import AFTER, BEFORE
from pipeline.evaluation import EvalSpec, evaluate_dataset, open_run, read_records
from pipeline.labels import Labels, open_labels, write_table
from pipeline.language import DIRECTIONAL
from pipeline.metrics import TEST, BootstrapConfig, split_frames
from pipeline.relations import F, T
from pipeline.system import InputError
from pipeline.training import LabelTraining, TrainConfig, read_label_data, train_on_labels

pytestmark = [pytest.mark.slow, needs("torch", "onnx")]


CONFIG = RetrainConfig(TrainConfig(epochs=4, batch=64, seed=2), bootstrap=BootstrapConfig(resamples=100))


@pytest.fixture(scope="module")
def held_out(label_sets: dict[str, Labels]) -> set[str]:
    """The frames that no network learns from."""
    keys = [f.key for f in read_label_data(label_sets["demo"], "rel14", DIRECTIONAL).frames]
    plan = split_frames(keys, "scene", CONFIG.train.seed)
    return {keys[k].frame for k in plan.indices(TEST)}


@pytest.fixture(scope="module")
def planted(label_sets: dict[str, Labels], held_out: set[str], tmp_path_factory: pytest.TempPathFactory) -> Labels:
    """The demo's labels with "in front of" and "behind" the wrong way round, but for the frames held out."""
    relations = label_sets["demo"].relations
    wrong = ~np.isin(relations.column("frame").to_numpy(zero_copy_only=False), list(held_out))
    front, behind = (relations.column(name).to_numpy() for name in ("front", "behind"))
    columns = {"front": np.where(wrong, behind, front), "behind": np.where(wrong, front, behind)}
    labels = with_relations(label_sets["demo"], tmp_path_factory.mktemp("planted") / "labels", columns)
    # Nothing here is about sentences with other relations, and answering all of them would take longest.
    asked = labels.expressions.filter(pc.field("relation").isin(["front", "behind"]))
    write_table(asked, labels.root / "expressions.parquet")
    return open_labels(labels.root)


@pytest.fixture(scope="module")
def failed(planted: Labels, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with the network that has learnt the wrong labels."""
    folder = tmp_path_factory.mktemp("failed")
    train_on_labels(LabelTraining(planted.root, CONFIG.train, "scene"), folder / "wrong.onnx")
    spec = EvalSpec("demo", str(planted.root), {"srm": folder / "wrong.onnx"})
    evaluate_dataset(spec, folder / "run", plots=False, bootstrap=BootstrapConfig(resamples=50))
    return folder / "run"


@pytest.fixture(scope="module")
def circle(
    planted: Labels, held_out: set[str], failed: Path, tmp_path_factory: pytest.TempPathFactory
) -> RetrainingRun:
    """Every wrong cell corrected as a person does it, then retrained and replayed."""
    folder = tmp_path_factory.mktemp("circle")
    place = JournalLocation(planted, folder / "journal.sqlite")
    desk = LabelEditor(planted, place, "ann")
    for name in set(planted.frames.column("frame").to_pylist()) - held_out:
        frame = desk.frame(name)
        numbers = frame.pairs.numbers.tolist()
        found = {(a, b): frame.pairs.state(a, b, "front") for a in numbers for b in numbers}
        # The mirror, "b behind a", is set with it.
        edits = [
            edit
            for (a, b), state in found.items()
            if state is not None and state in (T, F)
            for edit in set_relation(frame, a, b, "front", -state)
        ]
        assert isinstance(desk.save(edits), Saved)
    place.close()
    job = RetrainingJob(
        planted.root,
        str(folder / "journal.sqlite"),
        dataset="demo",
        out=folder / "out",
        run=failed,
        config=replace(CONFIG, split="scene"),
    )
    return run_retraining(job)


def _failures(run: Path, held_out: set[str]) -> dict[tuple[str, str], dict]:
    """Wrong answers about front and behind in the frames that were held out, where the labels are right.

    LABEL: one of several right answers, and not the one that the label names.
    """
    rows = [r for r in read_records(run).to_pylist() if r["relation"] in ("front", "behind") and not r["correct"]]
    wanted = [r for r in rows if r["frame"] in held_out and r["verdict"] != "LABEL"]
    return {(r["frame"], r["id"]): r for r in wanted}


def test_the_debugger_blames_the_relations_for_what_wrong_labels_taught(failed: Path, held_out: set[str]) -> None:
    verdicts = [r["verdict"] for r in _failures(failed, held_out).values()]
    assert len(verdicts) >= 10
    assert verdicts.count("SRM") > 0.9 * len(verdicts)


def test_what_was_mended_is_learnt_and_the_failures_are_gone(
    circle: RetrainingRun, failed: Path, held_out: set[str]
) -> None:
    wrong = _failures(failed, held_out)
    left = _failures(circle.folder / AFTER, held_out)
    blamed = [{k for k, r in found.items() if r["verdict"] == "SRM"} for found in (wrong, left)]
    assert len(blamed[1]) < 0.3 * len(blamed[0])
    assert len(left) < 0.3 * len(wrong)
    assert circle.replay is not None
    fixed = {(r["frame"], r["id"]) for r in circle.replay.fixed}
    gone = wrong.keys() - left.keys()
    # What is fixed is counted over all acceptable answers, and one of several may have been given before.
    assert len(fixed & gone) > 0.7 * len(gone)
    assert circle.retraining.gain.f1[circle.retraining.relations.index("front")].value > 0.5


def test_runs_of_the_circle_can_be_opened_and_name_what_made_them(circle: RetrainingRun, failed: Path) -> None:
    for name in (BEFORE, AFTER):
        run = open_run(circle.folder / name)
        assert Path(run.spec.labels) == circle.folder / "labels"
        assert len(run.records) == len(open_run(failed).records)
    assert Path(str(open_run(circle.folder / AFTER).spec.options["srm"])) == circle.network
    assert open_run(circle.folder / BEFORE).spec.options["srm"] == open_run(failed).spec.options["srm"]


def test_without_corrections_nothing_is_trained(planted: Labels, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no journal here"):
        run_retraining(RetrainingJob(planted.root, str(tmp_path / "none.sqlite"), out=tmp_path / "out"))
    JournalLocation(planted, tmp_path / "empty.sqlite").to_write().close()
    with pytest.raises(InputError, match="nothing was corrected"):
        run_retraining(RetrainingJob(planted.root, str(tmp_path / "empty.sqlite"), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
