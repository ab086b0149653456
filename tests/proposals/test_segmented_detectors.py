"""A segmenter behind a detector: which boxes it masks, its cache, its names."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from segmenter_checks import Boxes, bare, boxes_of, coco_file, iou, masks_of, scene

from pipeline.answering import PreparedFrame, all_objects, open_pipeline, relate_frames
from pipeline.datasets import open_dataset
from pipeline.geometry import Frame
from pipeline.proposals import (
    AnnotationDetector,
    CachedDetector,
    DepthSegmenter,
    Segmented,
    Segmenter,
    box_mask,
    make_segmenter,
)
from pipeline.system import InputError

# Behind a detector.


class Stub:
    """A segmenter that remembers what it was asked and gives the left half of each box."""

    name = "stub"

    def __init__(self) -> None:
        self.asked: list[list[str]] = []

    def fingerprint(self) -> str:
        return "stub:1"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        self.asked.append(list(labels))
        half = boxes.copy()
        half[:, 2] = (boxes[:, 0] + boxes[:, 2]) / 2
        masks = [box_mask(b, frame.height, frame.width) for b in half]
        return np.stack(masks), np.array([label != "laptop" for label in labels])


def test_only_boxes_without_masks_are_segmented() -> None:
    frame = scene()
    mixed = replace(frame, annotations=(frame.annotations[0], *bare(frame).annotations[1:]))
    stub = Stub()
    detector = Segmented(AnnotationDetector(("mug", "laptop")), stub)
    found = detector.detect(mixed, None)
    assert stub.asked == [["laptop", "mug"]]
    assert found.masks is not None
    assert found.has_mask is not None
    assert found.segmented is not None
    assert found.has_mask.tolist() == [True, False, True]
    assert found.segmented.tolist() == [False, False, True]
    assert found.ids.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(found.masks[0], frame.annotations[0].mask)
    np.testing.assert_array_equal(found.masks[1], box_mask(frame.annotations[1].bbox, 240, 320))
    assert 0 < found.masks[2].sum() < box_mask(frame.annotations[2].bbox, 240, 320).sum()
    assert found.take(np.array([2])).segmented is not None
    objects = all_objects(PreparedFrame(mixed), detector)
    assert [o.lifted.quality.mask_source for o in objects] == ["annotation", "box", "segmenter"]
    assert objects[1].lifted.quality.concerns == ("no mask: the whole 2D box was lifted",)
    assert objects[2].lifted.quality.concerns == (), "a segmenter's mask is no reason to doubt by itself"


def test_the_detector_behind_stays_what_it_is() -> None:
    inner = AnnotationDetector(("mug", "laptop"))
    detector = Segmented(inner, Stub())
    assert detector.exact
    assert detector.vocabulary == inner.vocabulary
    assert detector.name == "annotations+stub"
    assert inner.fingerprint() in detector.fingerprint()
    assert detector.fingerprint() != Segmented(inner, DepthSegmenter()).fingerprint()
    assert isinstance(Stub(), Segmenter)
    whole = detector.detect(scene(), ["mug"])
    assert whole.segmented is None
    assert len(detector.detect(bare(replace(scene(), annotations=())), None)) == 0


def test_exact_masks_do_not_depend_on_the_question() -> None:
    frame = bare(scene())
    stub = Stub()
    detector = Segmented(AnnotationDetector(("mug", "laptop")), stub)
    some = detector.detect(frame, ["mug"])
    everything = detector.detect(frame, None)
    assert some.masks is not None
    assert everything.masks is not None
    np.testing.assert_array_equal(some.masks, everything.masks[[0, 2]])
    assert stub.asked == [["mug", "laptop", "mug"]]
    detector.detect(replace(frame, depth=frame.depth.copy()), None)
    assert len(stub.asked) == 2


def test_guesses_at_a_thing_are_segmented_one_by_one_and_the_best_first() -> None:
    boxes = boxes_of(scene())[[0, 0, 2]] + np.array([[0], [1], [0]])
    stub = Stub()
    found = Segmented(Boxes(boxes), stub).detect(scene(), ["mug"])
    assert stub.asked == [["mug"]] * 3
    assert found.segmented is not None
    assert found.segmented.all()
    assert found.masks is not None
    assert (found.masks[0] & found.masks[1]).any()
    many = np.repeat(boxes, 25, axis=0)
    found = Segmented(Boxes(many), Stub()).detect(scene(), None)
    assert found.segmented is not None
    assert found.segmented.tolist() == [False] * 25 + [True] * 50


def test_a_segmenter_that_breaks_the_contract_is_named() -> None:
    class Bad(Stub):
        def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros((len(boxes), 5, 5), np.uint8), np.ones(len(boxes), bool)

    with pytest.raises(InputError, match="'stub' must give masks bool"):
        Segmented(AnnotationDetector(), Bad()).detect(bare(scene()), None)


def test_an_exact_3d_box_goes_before_the_segmenter() -> None:
    frame = scene()
    known = tuple(replace(a, mask=None, box=a.box if a.index else None) for a in frame.annotations)
    objects = all_objects(PreparedFrame(replace(frame, annotations=known)), Segmented(AnnotationDetector(), Stub()))
    assert [o.lifted.quality.mask_source for o in objects] == ["segmenter", "box3d", "box3d"]


def test_the_cache_keeps_whose_masks_they_are(tmp_path: Path) -> None:
    frame = bare(scene())
    for _ in range(2):
        found = CachedDetector(Segmented(AnnotationDetector(), Stub()), tmp_path).detect(frame, None)
        assert found.segmented is not None
        assert found.segmented.tolist() == [True, False, True]


def test_lifted_boxes_gain_by_the_masks() -> None:
    frame = scene()
    plain = all_objects(PreparedFrame(bare(frame)), AnnotationDetector())
    better = all_objects(PreparedFrame(bare(frame)), Segmented(AnnotationDetector(), DepthSegmenter()))
    for box, mask, real in zip(plain, better, all_objects(PreparedFrame(frame), AnnotationDetector()), strict=True):
        off = [np.abs(o.lifted.hi - real.lifted.hi).max() for o in (box, mask)]
        assert off[1] < 0.06
        assert off[1] < off[0]


# Wiring.


def test_segmenters_by_name(tmp_path: Path) -> None:
    assert isinstance(make_segmenter("depth"), DepthSegmenter)
    assert isinstance(make_segmenter("recorded", model=coco_file(tmp_path, scene())), Segmenter)
    with pytest.raises(InputError, match=r"no segmenter 'magic'.*depth or recorded or yolo-seg"):
        make_segmenter("magic")
    for name in ("recorded", "yolo-seg"):
        with pytest.raises(InputError, match="needs --segmenter-model"):
            make_segmenter(name)
    with pytest.raises(InputError, match="takes no model"):
        make_segmenter("depth", model=tmp_path)
    with pytest.raises(InputError, match="--segmenter-model needs --segmenter"):
        open_pipeline("demo", segmenter_model=tmp_path)


def test_jobs_use_the_segmenter(tmp_path: Path) -> None:
    plain = open_pipeline("demo")
    frame = plain.dataset.load(plain.dataset.frame_ids[0])
    entries = [{"label": a.label, "score": 0.9, "bbox": a.bbox.tolist()} for a in frame.annotations[:8]]
    recording = tmp_path / "boxes.json"
    recording.write_text(json.dumps({"frames": {frame.id: entries}}))
    names = [e["label"] for e in entries]
    sources = {}
    for segmenter in (None, "depth"):
        source = open_pipeline("demo", detector="recorded", model=recording, segmenter=segmenter)
        (related,) = relate_frames(source, frame.id)
        sources[segmenter] = {o.lifted.quality.mask_source for o in related.objects}
        trace = source.ask(source.prepare(frame.id), f"{names[0]} left of the {names[1]}")
        assert trace.detector == ("recorded" if segmenter is None else "recorded+depth")
    assert sources[None] == {"box"}
    assert "segmenter" in sources["depth"]
    assert {"segmenter", "box"} >= sources["depth"]


def test_a_real_network_serves_as_a_segmenter(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path))
    segmenter = make_segmenter("yolo-seg", model=shared_data / "onnx" / "yolov8n_seg_480x640.onnx")
    dataset = open_dataset(shared_data / "real" / "ycbv-bop")
    overlaps = []
    for frame_id in dataset.frame_ids[:2]:
        frame = bare(dataset.load(frame_id))
        detector = Segmented(AnnotationDetector(), segmenter)
        real_masks = masks_of(dataset.load(frame_id))
        for found, real in zip(all_objects(PreparedFrame(frame), detector), real_masks, strict=True):
            assert found.lifted.quality.mask_source in ("segmenter", "box")
            if found.lifted.quality.mask_source == "segmenter":
                overlaps.append(iou(found.mask, real))
    assert overlaps
    assert np.mean(overlaps) > 0.7
