"""A real network as a detector."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from proposal_checks import _own_cache, equal, frame  # noqa: F401

from pipeline.datasets import open_dataset
from pipeline.geometry import Frame, iou_2d
from pipeline.language import Synonyms, default_synonyms
from pipeline.proposals import CachedDetector, Detector, Proposals, make_detector
from pipeline.system import InputError

# A real network.


@pytest.fixture(scope="module")
def yolo_file(shared_data: Path) -> Path:
    return shared_data / "onnx" / "yolov8n_seg_480x640.onnx"


@pytest.fixture(scope="module")
def yolo(yolo_file: Path) -> Detector:
    from pipeline.proposals.yolo_seg import YoloSegDetector

    return YoloSegDetector(yolo_file)


@pytest.fixture(scope="module")
def dining(shared_data: Path) -> list[Frame]:
    dataset = open_dataset(
        shared_data / "real" / "slambook-diningroom", intrinsics=(518, 519, 325.5, 253.5), depth_scale=1000
    )
    return [dataset.load(f) for f in dataset.frame_ids]


@pytest.fixture(scope="module")
def kitchen(shared_data: Path) -> list[Frame]:
    dataset = open_dataset(shared_data / "real" / "7scenes-redkitchen")
    return [dataset.load(f) for f in dataset.frame_ids[3:9:2]]


def names_in(found: Proposals) -> list[str]:
    return [found.label(i) for i in range(len(found))]


@pytest.mark.slow
def test_the_network_finds_what_is_there(yolo: Detector, dining: list[Frame], kitchen: list[Frame]) -> None:
    for frame in dining:
        found = names_in(yolo.detect(frame, ["chair", "dining table"]))
        assert found.count("chair") >= 2
        assert "dining table" in found
    for frame in kitchen:
        assert set(names_in(yolo.detect(frame, ["cup", "chairs", "zebra"]))) == {"cup", "chair"}


@pytest.mark.slow
def test_masks_lie_in_their_boxes_and_scores_fall(yolo: Detector, dining: list[Frame], kitchen: list[Frame]) -> None:
    for frame in (*dining, *kitchen):
        found = yolo.detect(frame, None)
        assert found.masks is not None
        assert found.masks.shape[1:] == frame.depth.shape
        assert (np.diff(found.scores) <= 0).all()
        assert (found.scores >= 0.15).all()
        overlap = iou_2d(found.boxes, found.boxes)
        assert (overlap[~np.eye(len(found), dtype=bool)] <= 0.5).all()
        own = []
        for box, mask in zip(found.boxes, found.masks, strict=True):
            v, u = np.nonzero(mask)
            x0, y0, x1, y1 = np.floor(box[0]), np.floor(box[1]), np.ceil(box[2]), np.ceil(box[3])
            assert x0 <= u.min() <= u.max() < x1
            assert y0 <= v.min() <= v.max() < y1
            own.append(iou_2d(box, np.array([u.min(), v.min(), u.max() + 1, v.max() + 1]))[0, 0])
        assert min(own) > 0.2
        assert np.median(own) > 0.85


def test_a_detection_is_the_same_whatever_is_asked(yolo: Detector, kitchen: list[Frame]) -> None:
    frame = kitchen[0]
    both, chairs = yolo.detect(frame, ["chair", "cup"]), yolo.detect(frame, ["chair"])
    for k, number in enumerate(chairs.ids):
        at = np.flatnonzero(both.ids == number)
        assert len(at) == 1
        assert both.scores[at[0]] == chairs.scores[k]
        np.testing.assert_array_equal(both.boxes[at[0]], chairs.boxes[k])
    again = yolo.detect(frame, ["chair"])
    assert equal(again, chairs)


@pytest.mark.slow
@pytest.mark.parametrize(("down", "across"), [(160, 0), (0, 320), (200, 100)])
def test_a_moved_picture_moves_the_detections(yolo: Detector, kitchen: list[Frame], down: int, across: int) -> None:
    """A picture of another shape goes through the letterbox and its masks come back in place."""
    frame = kitchen[0]
    h, w = 480 + down, 640 + across
    rgb = np.full((h, w, 3), 114, np.uint8)
    rgb[down:, across:] = frame.rgb
    wider = Frame("wider", rgb, np.ones((h, w), np.float32), replace(frame.camera, height=h, width=w))
    moved, here = yolo.detect(wider, ["tv", "chair"]), yolo.detect(frame, ["tv", "chair"])
    assert here.masks is not None
    assert moved.masks is not None
    for k in range(2):
        overlap = iou_2d(here.boxes[k] + [across, down] * 2, moved.boxes)[0]
        best = int(overlap.argmax())
        assert overlap[best] > 0.8
        mask = moved.masks[best][down:, across:]
        assert (here.masks[k] & mask).sum() / (here.masks[k] | mask).sum() > 0.75


def test_an_unknown_name_is_refused_with_what_is_near(yolo: Detector, kitchen: list[Frame]) -> None:
    with pytest.raises(InputError, match=r"does not know the class 'chiar'.*'chair'"):
        yolo.detect(kitchen[0], ["chiar"])


@pytest.mark.slow
def test_what_a_cached_result_depends_on_is_in_the_fingerprint(yolo_file: Path) -> None:
    from pipeline.proposals.yolo_seg import YoloSegDetector

    other = default_synonyms().extended([["puff", "chair"]])
    made = [
        YoloSegDetector(yolo_file),
        YoloSegDetector(yolo_file, min_score=0.3),
        YoloSegDetector(yolo_file, synonyms=other),
    ]
    assert len({d.fingerprint() for d in made}) == 3
    assert YoloSegDetector(yolo_file).fingerprint() == made[0].fingerprint()
    assert YoloSegDetector(yolo_file, synonyms=Synonyms.load()).fingerprint() == made[0].fingerprint()
    assert isinstance(make_detector("yolo-seg", model=yolo_file), CachedDetector)


@pytest.mark.parametrize(
    "name", ["picodet_s_416_coco.onnx", "gdino_stub.onnx", "sam_encoder_nchw_stub.onnx", "sam_decoder_stub.onnx"]
)
def test_a_model_of_another_contract_is_refused(shared_data: Path, name: str) -> None:
    with pytest.raises(InputError, match="not a yolo-seg model") as caught:
        make_detector("yolo-seg", model=shared_data / "onnx" / name)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


@pytest.mark.parametrize("content", [None, b"", b"this is no model", b"\x08\x07" * 100])
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "model.onnx"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"model\.onnx") as caught:
        make_detector("yolo-seg", model=path)
    assert "\n" not in str(caught.value)
