"""The benchmark of evaluation measures what it says, and its shortcuts change no answer."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import evaluation_stages as bench
from benchmarks.peak_memory import PeakMemory

from pipeline.answering import PreparedFrame, StageClock, open_pipeline, record_detections
from pipeline.answering.objects import mask_iou
from pipeline.datasets import load_picture
from pipeline.evaluation import EvalSpec, evaluate_labels
from pipeline.geometry import lift
from pipeline.labels import SourceSpec, label_dataset
from pipeline.proposals import reads_annotations
from pipeline.system import InputError

FRAMES = 3


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench") / "labels"
    label_dataset(SourceSpec("demo"), out, limit=FRAMES)
    return out


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench") / "recording"
    source = open_pipeline("demo", detector="simulated", srm="rule")
    record_detections(source, out, source.dataset.class_names, frame_ids=source.dataset.frame_ids[:FRAMES])
    return out


@pytest.mark.slow
def test_answers_agree_and_figures_follow_from_each_other(labels: Path, recording: Path) -> None:
    record = bench.bench_evaluation("demo", labels, recording=recording, workers=1, singly=12, pairs=500)
    assert record.keys() == {
        "frames",
        "expressions",
        "k",
        "scorer",
        "stages_s",
        "expressions_per_s",
        "asked_singly",
        "job",
        "training",
        "extrapolated",
    }
    assert record["frames"] == FRAMES
    assert record["k"] == 10
    assert tuple(record["stages_s"]) == bench.STAGES
    assert all(seconds > 0 for seconds in record["stages_s"].values())
    answering = sum(s for name, s in record["stages_s"].items() if name != "tables")
    assert record["expressions_per_s"] == pytest.approx(record["expressions"] / answering, rel=0.02)
    alone = record["asked_singly"]
    assert alone["expressions"] == alone["same_answers"] == 12
    assert alone["differ"] == []
    assert alone["ratio"] == pytest.approx(record["expressions_per_s"] / alone["expressions_per_s"], rel=0.05)
    assert set(record["job"]) == {"workers", "seconds", "expressions_per_s", "peak_memory_mb", "processes"}
    found = record["extrapolated"]
    assert set(found) == {"workers", "seconds_for_50000_expressions", "seconds_for_75000_pairs"}
    assert found["seconds_for_50000_expressions"] >= 50_000 / record["expressions_per_s"]
    if "skipped" not in record["training"]:
        assert record["training"]["pairs"] == 500


@pytest.mark.slow
def test_an_answer_that_differs_is_told(labels: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = bench._same_answer

    def shifted(row: dict[str, Any], trace: Any) -> bool:
        box = row["box"]
        return record(row if box is None else row | {"box": [box[0] + 1, *box[1:]]}, trace)

    monkeypatch.setattr(bench, "_same_answer", shifted)
    found = bench.bench_evaluation("demo", labels, recording=recording, singly=6, pairs=100)["asked_singly"]
    assert found["same_answers"] < 6
    assert len(found["differ"]) == 6 - found["same_answers"]


@pytest.mark.slow
def test_training_without_torch_is_said_plainly(labels: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    record = bench.bench_evaluation("demo", labels, recording=recording, singly=1, pairs=100)
    assert "train" in record["training"]["skipped"]
    assert record["extrapolated"]["seconds_for_75000_pairs"] is None


@pytest.mark.parametrize("wrong", [{"singly": 0}, {"workers": 0}, {"pairs": 1}])
def test_nothing_to_measure_is_an_error(wrong: dict[str, int]) -> None:
    with pytest.raises(InputError):
        bench.bench_evaluation("demo", **wrong)  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_rows_do_not_depend_on_the_blocks(labels: Path, recording: Path) -> None:
    import pyarrow as pa

    spec = EvalSpec("demo", str(labels), {"detector": "recorded", "model": recording})
    one, many = (pa.concat_tables(list(evaluate_labels(spec, frames_a_block=n))) for n in (24, 1))
    assert one.equals(many)


def test_a_picture_is_the_frame_without_annotations() -> None:
    dataset = open_pipeline("demo").dataset
    whole, bare = dataset.load(dataset.frame_ids[0]), load_picture(dataset, dataset.frame_ids[0])
    assert whole.annotations
    assert not bare.annotations
    np.testing.assert_array_equal(bare.rgb, whole.rgb)
    np.testing.assert_array_equal(bare.depth, whole.depth)
    np.testing.assert_array_equal(bare.camera.K, whole.camera.K)
    with pytest.raises(InputError):
        load_picture(dataset, "nowhere/000000")


def test_only_a_recording_is_known_to_need_no_annotations(recording: Path) -> None:
    needed = {
        name: reads_annotations(open_pipeline("demo", detector=name, model=model).needed_detector())
        for name, model in (("recorded", recording), ("simulated", None), ("annotations", None))
    }
    assert needed == {"recorded": False, "simulated": True, "annotations": True}


def test_lifting_without_boxes_changes_nothing_else() -> None:
    dataset = open_pipeline("demo").dataset
    context = PreparedFrame(dataset.load(dataset.frame_ids[0]))
    frame = context.frame
    masks = [a.mask for a in frame.annotations if a.mask is not None]
    full, bare = (lift(frame.depth, frame.camera, masks, context.viewer, boxes=b) for b in (True, False))
    assert len(masks) > 5
    for a, b in zip(full, bare, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal((a.lo, a.hi), (b.lo, b.hi))
        assert a.quality == b.quality
        assert (b.box, b.yaw_confidence) == (None, 0.0)


def test_mask_overlaps_are_those_of_all_pixels() -> None:
    rng = np.random.default_rng(3)
    masks = [np.zeros((120, 160), np.bool_) for _ in range(25)]
    for mask in masks[:-1]:
        y, x = rng.integers(0, 90), rng.integers(0, 120)
        mask[y : y + 30, x : x + 40] = rng.random((30, 40)) < 0.8
    flat = np.stack([m.ravel() for m in masks]).astype(np.int64)
    shared, area = flat @ flat.T, flat.sum(axis=1)
    union = area[:, None] + area - shared
    np.testing.assert_allclose(mask_iou(masks), np.where(union > 0, shared / np.maximum(union, 1), 0.0), rtol=1e-12)
    assert mask_iou([]).shape == (0, 0)


def test_inner_stages_do_not_count_for_outer_ones() -> None:
    clock = StageClock()
    with clock.stage("outer"):
        with clock.stage("inner"):
            end = time.process_time() + 0.05
            while time.process_time() < end:
                pass
        with clock.stage("inner"):
            pass
    assert clock.seconds["inner"] >= 0.05
    assert clock.seconds["outer"] < clock.seconds["inner"]
    with pytest.raises(ValueError, match="wrong"), clock.stage("failing"):
        raise ValueError("wrong")
    assert set(clock.seconds) == {"outer", "inner", "failing"}


@pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="only Linux tells the memory of processes")
def test_memory_of_children_counts() -> None:
    hold = "import time; b = bytearray(b'x') * (64 << 20); print(1, flush=True); time.sleep(60)"
    with PeakMemory() as alone:
        pass
    with PeakMemory() as together, subprocess.Popen([sys.executable, "-c", hold], stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout is not None
            child.stdout.readline()
            together._look()
        finally:
            child.kill()
    assert alone.megabytes is not None
    assert together.megabytes is not None
    assert together.megabytes > alone.megabytes + 50
    assert together.processes >= 2
