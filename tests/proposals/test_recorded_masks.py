"""Masks that were made elsewhere: each goes once to the box that it fits."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from segmenter_checks import Boxes, bare, boxes_of, coco_file, iou, masks_of, run_lengths, scene

from pipeline.geometry import Annotation, Frame
from pipeline.proposals import AnnotationDetector, make_segmenter
from pipeline.proposals.segmenter import DetectorSegmenter, Segments, assign
from pipeline.system import FrameUnusable, InputError

# Assignment.


def assigned(boxes: Any, labels: Sequence[str], rectangles: Any, names: Sequence[str | None]) -> list[int]:
    segments = Segments(np.array(rectangles, float).reshape(-1, 4), tuple(names), lambda i: np.zeros((1, 1), bool))
    return assign(np.array(boxes, float).reshape(-1, 4), labels, segments).tolist()


def test_each_segment_goes_once_to_the_box_that_it_fits() -> None:
    box = [0, 0, 10, 10]
    assert assigned([box], ["mug"], [[0, 0, 10, 4], [0, 0, 10, 6]], [None, None]) == [1]
    assert assigned([box], ["mug"], [[0, 0, 10, 4]], [None]) == [-1]
    assert assigned([box, box], ["mug", "mug"], [box, [0, 0, 10, 6]], [None, None]) in ([0, 1], [1, 0])
    assert assigned([box, [0, 0, 10, 9]], ["mug"] * 2, [box], [None]) == [0, -1]
    # Both can be served only if the better fit goes to the second box.
    assert assigned([box, [0, 0, 10, 18]], ["mug"] * 2, [[0, 0, 10, 9.5], [0, 0, 6, 10]], [None, None]) == [1, 0]
    # A box name goes before a better fit of another; names are compared by meaning.
    assert assigned([box], ["trash cans"], [box, [0, 0, 10, 6]], ["laptop", "garbage can"]) == [1]
    assert assigned([box], ["mug"], [box], ["laptop"]) == [0]
    # Of equal overlaps, the one that lies inside.
    assert assigned([box], ["mug"], [[0, 0, 10, 20], [0, 0, 10, 5]], [None, None]) == [1]
    assert assigned([], [], [box], [None]) == []
    assert assigned([box], ["mug"], [], []) == [-1]
    assert assigned([[5, 5, 5, 5]], ["mug"], [[5, 5, 5, 5]], [None]) == [-1]


def test_a_detector_serves_as_a_segmenter() -> None:
    frame = scene()
    segmenter = DetectorSegmenter(AnnotationDetector())
    boxes = np.concatenate([boxes_of(frame)[::-1] + 1, [[0, 0, 20, 20]]]).astype(np.float32)
    masks, has_mask = segmenter.segment(frame, boxes, ["mug", "laptop", "mug", "mug"])
    assert has_mask.tolist() == [True, True, True, False]
    for mask, real in zip(masks, masks_of(frame)[::-1], strict=False):
        np.testing.assert_array_equal(mask, real)
    _, has_mask = segmenter.segment(bare(frame), boxes, ["mug"] * 4)
    assert not has_mask.any()
    assert not DetectorSegmenter(Boxes(boxes)).segment(frame, boxes, ["mug"] * 4)[1].any()


def played(path: Path, frame: Frame | None = None) -> tuple[np.ndarray, np.ndarray]:
    frame = frame or scene()
    return make_segmenter("recorded", model=path).segment(
        frame, boxes_of(scene()), [a.label for a in scene().annotations]
    )


def meets(found: tuple[np.ndarray, np.ndarray], at_least: float = 1.0) -> None:
    assert found[1].all()
    for mask, real in zip(found[0], masks_of(scene()), strict=True):
        assert iou(mask, real) >= at_least


@pytest.mark.parametrize("name", ["scene/0.jpg", "data/scene/rgb/0.png", "0.png"])
def test_coco_masks_come_to_their_boxes(tmp_path: Path, name: str) -> None:
    meets(played(coco_file(tmp_path, scene(), name)))


def test_coco_masks_may_be_polygons_and_lists_and_lack_boxes(tmp_path: Path) -> None:
    written = json.loads(coco_file(tmp_path, scene()).read_text())
    real = masks_of(scene())
    outlines = cv2.findContours(real[0].astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    written["annotations"][0]["segmentation"] = [c.ravel().tolist() for c in outlines]
    counts, flat = [], real[1].ravel(order="F")
    changes = np.concatenate([[0], np.flatnonzero(np.diff(flat)) + 1, [flat.size]])
    counts = ([0] if flat[0] else []) + np.diff(changes).tolist()
    written["annotations"][1]["segmentation"] = {"size": [240, 320], "counts": counts}
    written["images"][0] |= {"height": 240, "width": 320}
    for annotation in written["annotations"]:
        del annotation["bbox"], annotation["category_id"]
    path = tmp_path / "masks.json"
    path.write_text(json.dumps(written))
    meets(played(path), 0.95)


def test_a_recording_of_detections_gives_its_masks(tmp_path: Path) -> None:
    frame = scene()
    entries = [
        {"label": a.label, "score": 0.5, "bbox": a.bbox.tolist(), "mask": run_lengths(m)}
        for a, m in zip(frame.annotations, masks_of(frame), strict=True)
    ]
    path = tmp_path / "recording.json"
    path.write_text(json.dumps({"frames": {frame.id: entries}}))
    meets(played(path))
    folder = tmp_path / "npz"
    folder.mkdir()
    labels = np.array([a.label for a in frame.annotations])
    masks = np.stack(masks_of(frame))
    np.savez(folder / "scene__0.npz", boxes=boxes_of(frame), scores=np.full(3, 0.5), labels=labels, masks=masks)
    meets(played(folder))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_png_masks_come_to_their_boxes(tmp_path: Path, kind: Any) -> None:
    values = np.zeros((240, 320), kind)
    for k, mask in enumerate(masks_of(scene())):
        values[mask] = (k + 1) * (60 if kind == np.uint8 else 9000)
    (tmp_path / "scene").mkdir()
    cv2.imwrite(str(tmp_path / "scene" / "0.png"), values)
    meets(played(tmp_path))


def test_binary_png_masks_come_to_their_boxes(tmp_path: Path) -> None:
    folder = tmp_path / "scene" / "0"
    folder.mkdir(parents=True)
    for k, mask in enumerate(masks_of(scene())):
        cv2.imwrite(str(folder / f"{9 - k}.png"), mask.astype(np.uint8) * 255)
    meets(played(tmp_path))


def refused(path: Path, message: str, error: type[Exception] = InputError) -> None:
    with pytest.raises(error, match=message) as caught:
        played(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("segmentation", "message"),
    [
        ({"size": [10, 10], "counts": [100]}, "another size"),
        ({"size": [10**6, 10**6], "counts": [10**12]}, "impossible size"),
        ({"size": [240, 320], "counts": [5, 5]}, "do not fill"),
        ({"size": [240, 320], "counts": "ooooooo"}, "do not fill"),
        ([[1, 2, 3, 4]], "polygon"),
        ([[1, 2, 3, 4, 5, 6, 7]], "polygon"),
        ([["a"]], "segmentation"),
        ("text", "segmentation"),
    ],
)
def test_hostile_coco_masks_are_refused(tmp_path: Path, segmentation: Any, message: str) -> None:
    box = [0, 0, 300, 230]
    (tmp_path / "m.json").write_text("")
    path = coco_file(tmp_path, scene(), annotations=[{"image_id": 7, "segmentation": segmentation, "bbox": box}])
    frame = replace(scene(), annotations=(Annotation(0, "mug", np.array([0, 0, 300, 230])),))
    with pytest.raises(InputError, match=message) as caught:
        make_segmenter("recorded", model=path).segment(frame, boxes_of(frame), ["mug"])
    assert str(path) in str(caught.value)


def test_hostile_coco_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "masks.json"
    for text, message in (
        ("{", "not JSON"),
        ("[]", "not follow the format at the top"),
        ('{"images": []}', "not follow the format at the top"),
        ('{"images": [{"id": 1}], "annotations": [{"image_id": 1}]}', "images.0.file_name"),
        ('{"frames": 3}', "frames"),
    ):
        path.write_text(text)
        refused(path, message)
    refused(coco_file(tmp_path, scene(), "elsewhere.png"), "no detections for frame scene/0", FrameUnusable)
    twice = [{"id": k, "file_name": f"{k}/0.png"} for k in (7, 8)]
    refused(coco_file(tmp_path, scene(), images=twice), "two pictures may be frame", FrameUnusable)
    refused(tmp_path / "absent", "no recorded masks")


def test_hostile_png_folders_are_refused(tmp_path: Path) -> None:
    refused(tmp_path, "no detections for frame scene/0", FrameUnusable)
    file = tmp_path / "scene" / "0.png"
    file.parent.mkdir()
    cv2.imwrite(str(tmp_path / "scene" / "1.png"), np.zeros((240, 320), np.uint8))
    refused(tmp_path, "no recorded masks for frame scene/0", FrameUnusable)
    for image, message in (
        (np.zeros((10, 10), np.uint8), "another size"),
        (np.zeros((240, 320, 3), np.uint8), "one channel"),
    ):
        cv2.imwrite(str(file), image)
        refused(tmp_path, message, FrameUnusable)
    file.write_bytes(b"not a picture")
    refused(tmp_path, "cannot be read", FrameUnusable)
    with pytest.raises(FrameUnusable, match="outside the folder"):
        played(tmp_path, replace(scene(), id="../outside"))


def test_an_empty_label_image_gives_no_mask(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    cv2.imwrite(str(tmp_path / "scene" / "0.png"), np.zeros((240, 320), np.uint8))
    masks, has_mask = played(tmp_path)
    assert not masks.any()
    assert not has_mask.any()
