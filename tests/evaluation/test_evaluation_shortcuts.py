"""The shortcuts of evaluation change no answer."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.answering import PreparedFrame, StageClock, open_pipeline, record_detections
from pipeline.answering.objects import mask_iou
from pipeline.bench import eval_part
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
def test_answers_by_frames_are_those_of_asking_singly(
    labels: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluator, records, *seconds = eval_part.answered(
        EvalSpec("demo", str(labels), {"detector": "recorded", "model": recording})
    )
    assert records.num_rows > 100
    assert min(seconds) > 0
    rate, differing = eval_part.asked_singly(evaluator, records, 12)
    assert rate > 0
    assert differing == []
    same = eval_part._same_answer

    def shifted(row: dict[str, Any], trace: Any) -> bool:
        box = row["box"]
        return same(row if box is None else row | {"box": [box[0] + 1, *box[1:]]}, trace)

    monkeypatch.setattr(eval_part, "_same_answer", shifted)
    assert eval_part.asked_singly(evaluator, records, 6)[1]


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
