"""Detections in published formats, played back: each file written as its program writes it."""

from __future__ import annotations

import csv
import gzip
import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from concept_graph_maps import corners, map_object, write_map
from proposal_checks import _own_cache, frame  # noqa: F401
from segmenter_checks import run_lengths

from pipeline.geometry import Frame
from pipeline.geometry.masks import encode_run_length
from pipeline.proposals import Proposals, RecordedDetector, make_detector
from pipeline.system import FrameUnusable, InputError, UnknownClass
from pipeline.system.reading import read_content

FRAMES = ("scene/0", "scene/1", "other/000007")


def written(path: Path, content: Any) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def played(path: Path, frame: Frame, labels: list[str] | None = None, **more: Any) -> Proposals:
    return RecordedDetector(path, **{"frame_ids": FRAMES, **more}).detect(frame, labels)


def refused(path: Path, frame: Frame, message: str, **more: Any) -> None:
    with pytest.raises(InputError, match=message) as error:
        played(path, frame, **more)
    assert "\n" not in str(error.value)


# COCO.


def annotation_file(folder: Path) -> Path:
    images = [
        {"id": 397133, "file_name": "scene/rgb/0.jpg", "height": 240, "width": 320, "license": 1},
        {"id": 37777, "file_name": "1.jpg", "height": 240, "width": 320},
    ]
    categories = [{"id": 47, "name": "cup", "supercategory": "kitchen"}, {"id": 73, "name": "laptop"}]
    return written(
        folder / "instances.json", {"info": {}, "images": images, "annotations": [], "categories": categories}
    )


def results(frame: Frame) -> list[dict[str, Any]]:
    mask = frame.annotations[1].mask
    assert mask is not None
    return [
        {"image_id": 397133, "category_id": 47, "bbox": [10.5, 20, 50, 60.25], "score": 0.236},
        {"image_id": 397133, "category_id": 73, "segmentation": run_lengths(mask), "score": 0.9},
    ]


def test_results_of_coco_are_played_back(tmp_path: Path, frame: Frame) -> None:
    path, key = written(tmp_path / "results.json", results(frame)), annotation_file(tmp_path)
    found = make_detector("recorded", model=path, config=key, frame_ids=FRAMES).detect(frame, None)
    assert [found.label(i) for i in range(2)] == ["laptop", "cup"]
    np.testing.assert_allclose(found.scores, [0.9, 0.236])
    np.testing.assert_allclose(found.boxes[1], [10.5, 20, 60.5, 80.25])
    assert found.masks is not None
    np.testing.assert_array_equal(found.masks[0], frame.annotations[1].mask)
    # A box that is not given is its mask's.
    np.testing.assert_allclose(found.boxes[0], frame.annotations[1].bbox, atol=1)
    assert found.has_mask is not None
    assert found.has_mask.tolist() == [True, False]
    # A picture that the annotation file lists and nothing was found in is no gap.
    assert len(played(path, replace(frame, id="scene/1"), key=key)) == 0
    with pytest.raises(FrameUnusable, match="no detections for frame other/000007"):
        played(path, replace(frame, id="other/000007"), key=key)
    # Without the dataset's list of frames the same picture is found.
    assert len(played(path, frame, key=key, frame_ids=())) == 2


def test_annotations_of_coco_with_scores_name_their_pictures_themselves(tmp_path: Path, frame: Frame) -> None:
    whole = json.loads(annotation_file(tmp_path).read_text())
    polygon = [[100.0, 100.0, 140.0, 100.0, 140.0, 130.0, 100.0, 130.0]]
    row = {
        "id": 1,
        "image_id": 397133,
        "category_id": 47,
        "bbox": [100, 100, 40, 30],
        "segmentation": polygon,
        "iscrowd": 0,
    }
    whole["annotations"] = [{**row, "score": 0.5}]
    found = played(written(tmp_path / "all.json", whole), frame)
    assert found.masks is not None
    assert found.masks[0].sum() == pytest.approx(40 * 30, rel=0.1)
    # Without a mask there may be an empty list.
    whole["annotations"] = [{**row, "score": 0.5, "segmentation": []}]
    found = played(written(tmp_path / "all.json", whole), frame)
    assert found.has_mask is not None
    assert not found.has_mask[0]
    whole["annotations"] = [row]
    refused(written(tmp_path / "truth.json", whole), frame, "not follow the format at the top.*coco")


def test_results_of_coco_are_read_as_they_are_in_the_wild(tmp_path: Path, frame: Frame) -> None:
    """Text ids, polygons, printed bytes (pycocotools' `encode` gives bytes), no score, boxes of no width."""
    key = json.loads(annotation_file(tmp_path).read_text())
    for of, names in (("images", ("id",)), ("categories", ("id",))):
        key[of] = [{**row, **{name: str(row[name]) for name in names}} for row in key[of]]
    mask = frame.annotations[1].mask
    assert mask is not None
    code = encode_run_length(mask).encode()
    rows = [
        {"image_id": "397133", "category_id": "73", "segmentation": {"size": [240, 320], "counts": str(code)}},
        {"image_id": 397133, "category_id": 47, "bbox": [10, 20, 0, 6], "score": 0.5},
        {"image_id": "397133", "category_id": 47, "bbox": [10, 20, 5, 6], "segmentation": [[10, 20, 15, 20, 15, 26]]},
        {"image_id": "397133", "category_id": 47, "bbox": [10, 20, 5, 6], "segmentation": [10, 20, 15, 20, 15, 26]},
    ]
    path, known = written(tmp_path / "results.json", rows), written(tmp_path / "text.json", key)
    found = played(path, frame, key=known)
    assert sorted(found.scores.tolist()) == [0.5, 1, 1, 1]
    assert found.masks is not None
    laptop = next(i for i in range(4) if found.label(i) == "laptop")
    np.testing.assert_array_equal(found.masks[laptop], mask)
    detector = RecordedDetector(path, key=known, frame_ids=FRAMES)
    assert detector.scoreless == (3, 4)
    rows[2]["image_id"] = "12"
    refused(written(tmp_path / "results.json", rows), frame, "entry 2: no picture has the id 12", key=known)


def test_classes_counted_from_zero_and_boxes_of_two_corners_are_read_and_told(tmp_path: Path, frame: Frame) -> None:
    """Ultralytics wrote its own index (ultralytics/ultralytics#18136); corners are open-mmlab/mmdetection#6997."""
    key = json.loads(annotation_file(tmp_path).read_text())
    key["categories"] = [{"id": 1, "name": "cup"}, {"id": 2, "name": "laptop"}]
    known = written(tmp_path / "from_one.json", key)
    rows = [
        {"image_id": 397133, "category_id": 0, "bbox": [200, 100, 260, 160], "score": 0.9},
        {"image_id": 397133, "category_id": 1, "bbox": [10, 20, 30, 60], "score": 0.5},
    ]
    detector = RecordedDetector(written(tmp_path / "results.json", rows), key=known, frame_ids=FRAMES)
    found = detector.detect(frame, None)
    assert [found.label(i) for i in range(2)] == ["cup", "laptop"]
    np.testing.assert_allclose(found.boxes, [row["bbox"] for row in rows])
    assert [words.split(":")[0] for words in detector.assumed()] == [
        "category_id counts from 0 in the file and from 1 in the annotation file",
        "bbox is read as two corners, not as corner and size",
    ]
    # Where corner and size fit, or neither does, nothing is assumed; nor where an id is none of either.
    rows[0] |= {"category_id": 1, "bbox": [200, 100, 60, 60]}
    assert RecordedDetector(written(tmp_path / "results.json", rows), key=known, frame_ids=FRAMES).assumed() == []
    rows[1]["category_id"] = 3
    refused(written(tmp_path / "results.json", rows), frame, "entry 1: no class has the id 3", key=known)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"category_id": 5}, "entry 1: no class has the id 5"),
        ({"image_id": 5}, "entry 1: no picture has the id 5"),
        ({"score": 1.5}, "entry 1, score: not a result of COCO; got 1.5; expected at most 1"),
        ({"bbox": [1, 2, 3]}, "entry 1, bbox.*: not a result of COCO"),
        ({"bbox": [10, 10, -5, 5]}, "entry 1: bbox is x, y, width, height"),
        ({"segmentation": None}, "entry 1: neither a box nor a mask.*keypoints"),
        ({"segmentation": {"size": [10**9, 10**9], "counts": [10**18]}}, "entry 1: a picture of impossible size"),
        ({"segmentation": {"size": [240, 320], "counts": "@@@"}}, "entry 1: the run lengths do not fill the mask"),
    ],
)
def test_wrong_results_of_coco_are_refused(tmp_path: Path, frame: Frame, change: dict[str, Any], message: str) -> None:
    rows = results(frame)
    rows[1] |= change
    refused(written(tmp_path / "results.json", rows), frame, message, key=annotation_file(tmp_path))


def test_what_results_of_coco_leave_open_must_be_given(tmp_path: Path, frame: Frame) -> None:
    path = written(tmp_path / "results.json", results(frame))
    refused(path, frame, "no class has the id 47; expected the annotation file beside it")
    refused(path, frame, "cannot be read", key=tmp_path / "none.json")
    elsewhere = annotation_file(tmp_path)
    refused(
        path, frame, "no picture of the recording is a frame.*scene/rgb/0.jpg.*a/b", key=elsewhere, frame_ids=("a/b",)
    )
    two = ("scene/0", "x/scene/0")
    refused(path, frame, "the picture '1.jpg' may be of several", key=elsewhere, frame_ids=("a/1", "b/1", *two))
    (tmp_path / "broken.json").write_text('[{"image_id": 1,')
    refused(tmp_path / "broken.json", frame, "the recording is not JSON")


# supervision.


def sink_rows() -> list[dict[str, Any]]:
    row = {
        "x_min": 10.0,
        "y_min": 20.0,
        "x_max": 60.0,
        "y_max": 80.0,
        "class_id": 1,
        "confidence": 0.75,
        "tracker_id": "",
    }
    return [
        {**row, "class_name": "mug", "image_path": "data/scene/0.png"},
        {**row, "class_name": "laptop", "confidence": 0.5, "image_path": "data/scene/0.png"},
    ]


def test_the_sinks_of_supervision_are_played_back(tmp_path: Path, frame: Frame) -> None:
    (tmp_path / "rows.json").write_text(json.dumps(sink_rows(), indent=4))
    with (tmp_path / "rows.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(sink_rows()[0])
        writer.writerows(row.values() for row in sink_rows())
    for name in ("rows.json", "rows.csv"):
        found = played(tmp_path / name, frame, ["mug"])
        np.testing.assert_allclose(found.boxes, [[10, 20, 60, 80]])
        assert found.scores.tolist() == [0.75]
    rows = [
        {k: v for k, v in row.items() if k not in ("class_name", "image_path")} | {"frame_index": 7}
        for row in sink_rows()
    ]
    path, names = written(tmp_path / "numbers.json", rows), tmp_path / "names.txt"
    names.write_text("person\nmug\n")
    assert len(played(path, replace(frame, id="other/000007"), ["mug"], key=names)) == 2
    refused(path, frame, "entry 0: no name for the class 1; expected class_name")
    refused(path, frame, "the picture 7 may be of several", key=names, frame_ids=("a/7", "b/7"))
    del rows[0]["frame_index"]
    refused(written(path, rows), frame, "no column names the picture.*image_path", key=names)
    refused(written(path, [{**sink_rows()[0], "confidence": ""}]), frame, "entry 0, confidence: not a row")
    reversed_box = {**sink_rows()[0], "x_max": 1}
    refused(written(path, [reversed_box]), frame, r"frame scene/0: proposal boxes must be x0, .*numbers.json\]$")
    refused(written(path, [{**sink_rows()[0], "x_max": 1e300}]), frame, "frame scene/0: proposal boxes must be finite")
    refused(written(path, [{**sink_rows()[0], "image_path": None}]), frame, "entry 0, image_path: names no picture")


@pytest.mark.parametrize(
    "columns", ["x1,y1,x2,y2,score,name", "x0,y0,x1,y1,conf,label", "xmin,ymin,xmax,ymax,confidence,class_name"]
)
def test_tables_of_boxes_are_played_back(tmp_path: Path, frame: Frame, columns: str) -> None:
    path = tmp_path / "boxes.csv"
    path.write_text(f"frame,{columns}\nscene/0,10,20,60,80,0.75,mug\nscene/1,1,2,3,4,0.5,cup\n")
    found = played(path, frame)
    np.testing.assert_allclose(found.boxes, [[10, 20, 60, 80]])
    assert (found.scores.tolist(), found.labels) == ([0.75], ("mug",))
    path.write_text(path.read_text().replace("0.75", "high"))
    refused(path, frame, rf'line 2, {columns.split(",")[4]}: not a row .*; got "high"; expected a number')


def listed(**change: Any) -> dict[str, Any]:
    """As the results of Grounding DINO in transformers are, with the picture beside them."""
    found = {"image": "scene/0.jpg", "boxes": [[10, 20, 60, 80], [1, 2, 3, 4]], "scores": [0.75, 0.5]}
    return {**found, "labels": [0, 1], "text_labels": ["mug", "cup"], **change}


def test_boxes_of_a_picture_in_lists_are_played_back(tmp_path: Path, frame: Frame) -> None:
    phrases = {k: v for k, v in listed(phrases=["mug", "cup"]).items() if not k.endswith("labels")}
    lines = tmp_path / "found.jsonl"
    lines.write_text("".join(json.dumps(row) + "\n" for row in (phrases, listed(image="scene/1.jpg"))))
    for path in (written(tmp_path / "one.json", listed()), written(tmp_path / "list.json", [listed()]), lines):
        found = played(path, frame, ["mug"])
        np.testing.assert_allclose(found.boxes, [[10, 20, 60, 80]])
        assert found.scores.tolist() == [0.75]
    path = tmp_path / "wrong.json"
    for change, message in (
        ({"scores": [0.75]}, "entry 1: lists of one length are asked for; got 2 boxes, 1 scores, 2 labels"),
        ({"text_labels": [3, "cup"]}, "entry 1, text_labels.0: not boxes, .*; got 3; expected text"),
        ({"boxes": [[10, 20, 60], [1, 2, 3, 4]]}, r"entry 1, boxes.0: .*; got \[10, 20, 60\]; expected 4 values"),
        ({"image": ""}, "entry 1, image: names no picture"),
    ):
        refused(written(path, [listed(), listed(image="scene/1.jpg") | change]), frame, message)
    refused(written(path, [listed(boxes=[[0, 0, 0.5, 1], [0, 0, 1, 1]])]), frame, "in pixels; got none above 1")


# Grounded SAM.


def test_results_of_grounded_sam_are_played_back(tmp_path: Path, frame: Frame) -> None:
    mask = frame.annotations[0].mask
    assert mask is not None
    thing = {"class_name": "mug", "bbox": [10.0, 20.0, 60.0, 80.0], "segmentation": run_lengths(mask), "score": [1.003]}
    result = {
        "image_path": "pictures/scene/0.jpg",
        "annotations": [thing],
        "box_format": "xyxy",
        "img_width": 320,
        "img_height": 240,
    }
    path = written(tmp_path / "results" / "grounded_sam2_local_image_demo_results.json", result)
    other = result | {"image_path": "pictures/scene/1.jpg"}
    written(tmp_path / "results" / "second.json", other)
    for place in (path, path.parent):
        found = played(place, frame, ["mug"])
        assert found.masks is not None
        np.testing.assert_array_equal(found.masks[0], mask)
        assert found.scores.tolist() == [1.0]
    assert len(played(path.parent, replace(frame, id="scene/1"))) == 1
    written(tmp_path / "results" / "third.json", other)
    refused(path.parent, frame, "'pictures/scene/1.jpg' stands in two files")
    refused(written(path, result | {"box_format": "xywh"}), frame, "box_format")
    first = {"value": 0, "label": "background"}
    values = [first, {"value": 1, "label": "mug", "logit": 0.42, "box": [10.0, 20.0, 60.0, 80.0]}]
    for place, content in (("0/mask.json", values), ("000007/label.json", {"caption": "a mug", "mask": values})):
        found = played(
            written(tmp_path / place, content), replace(frame, id=FRAMES[0 if place[1] == "/" else 2]), ["mug"]
        )
        np.testing.assert_allclose(found.scores, [0.42])
        np.testing.assert_allclose(found.boxes, [[10, 20, 60, 80]])


# ConceptGraphs.


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_maps_of_concept_graphs_are_played_back(tmp_path: Path, frame: Frame, protocol: int) -> None:
    mask, other = frame.annotations[0].mask, frame.annotations[1].mask
    assert mask is not None
    assert other is not None
    mug = map_object(
        ["cup", "mug", "mug"],
        [(f"/data/Replica/scene/results/{k}.jpg", mask, 0.25 * k + 0.25) for k in (0, 1, 2)],
        corners((0, 0, 2), (0.3, 0.4, 0.3)),
    )
    tagged = {"id": 1, "response": {"summary": "a computer", "object_tag": "laptop"}}
    laptop = map_object(
        ["item"],
        [("/data/Replica/scene/results/0.jpg", other, 0.5)],
        corners((1, 0, 2), (1, 1, 1)),
        caption_dict=tagged,
    )
    path = write_map(tmp_path / "full_pcd_ram_exp.pkl.gz", [mug, laptop], protocol)
    detector = RecordedDetector(path, frame_ids=FRAMES)
    assert detector.vocabulary == ("laptop", "mug")
    found = detector.detect(frame, None)
    assert [(found.label(i), int(found.ids[i]), float(found.scores[i])) for i in range(2)] == [
        ("laptop", 1, 0.5),
        ("mug", 0, 0.25),
    ]
    assert found.masks is not None
    np.testing.assert_array_equal(found.masks, [other, mask])
    np.testing.assert_allclose(detector.corners[0], corners((0, 0, 2), (0.3, 0.4, 0.3)))
    assert detector.detect(replace(frame, id="scene/1"), None).scores.tolist() == [0.5]
    # A map without what is asked for, and one without objects.
    gap = {key: value for key, value in mug.items() if key != "conf"}
    sure = mug | {"conf": [np.float32(1.5)] * 3}
    wrong = "object 0: not as ConceptGraphs writes it"
    for content, message in (
        ([gap], f"{wrong}; got no 'conf'"),
        ([], "no map"),
        ([sure], f"{wrong}, at score; got 1.5; expected at most 1"),
    ):
        refused(write_map(path, content, 4), frame, message)


def test_the_pruned_map_of_concept_graphs_is_the_list_alone(tmp_path: Path, frame: Frame) -> None:
    mask = frame.annotations[0].mask
    assert mask is not None
    mug = map_object(["mug"], [("scene/0.jpg", mask, 0.5)], corners((0, 0, 2), (1, 1, 1)))
    path = tmp_path / "scene_map_cfslam_pruned.pkl.gz"
    with gzip.open(path, "wb") as file:
        pickle.dump([mug], file)
    assert len(played(path, frame, ["mug"])) == 1
    # As the branch ali-dev writes it: one name, pictures as paths, numbers of uuid, the edges beside the objects.
    latest = mug | {"id": uuid4(), "class_name": "mug", "color_path": [Path("/data/scene/0.jpg")]}
    edges = {"edges": [{"obj1_index": 0, "obj2_index": 0, "rel_type": "on top of"}], "objects": [latest]}
    path = tmp_path / "pcd_r_mapping_stride10.pkl.gz"
    with gzip.open(path, "wb") as file:
        pickle.dump({"objects": [latest], "class_colors": {"0": [0.1, 0.2, 0.3]}, "edges": edges}, file)
    assert RecordedDetector(path, frame_ids=FRAMES).vocabulary == ("mug",)
    assert len(played(path, frame, ["mug"])) == 1
    small = mug | {"mask": [mask[:100]]}
    refused(write_map(path, [small]), frame, "frame scene/0, detection 0: the mask has another size")


# Files without scores, and names that were cut.


def test_boxes_of_each_picture_are_read_without_scores(tmp_path: Path, frame: Frame) -> None:
    thing = {"label": "mug", "box": [1, 2, 30, 40]}
    for content in (
        {"scene/0": [thing], "scene/1": []},
        {"scene/0": {"boxes": [thing["box"]], "labels": ["mug"]}},
        [{"image": "scene/0.png", "boxes": [thing["box"]], "labels": ["mug"]}],
        {"scene/0": [{"name": "mug", "bbox": thing["box"]}]},
    ):
        path = written(tmp_path / "boxes.json", content)
        found = played(path, frame)
        assert (found.scores.tolist(), found.boxes.tolist(), found.label(0)) == ([1], [[1, 2, 30, 40]], "mug")
        assert RecordedDetector(path, frame_ids=FRAMES).scoreless == (1, 1)
    wrong = {"scene/0": [thing, {"label": "mug", "box": [1, 2, "wide", 4]}]}
    refused(
        written(path, wrong), frame, r'scene/0, entry 1.box.2: not a box and a label; got "wide"; expected a number'
    )
    swapped = {"scene/0": [{"label": "mug", "box": [100, 100, 30, 40]}]}
    refused(written(path, swapped), frame, r"boxes.0: right or bottom lies before left or top.*x, y, width, height")


def test_a_name_that_was_cut_is_found_with_its_pieces(tmp_path: Path, frame: Frame) -> None:
    """Grounding DINO's phrases are tokens above a threshold (get_phrases_from_posmap), and lose parts of words."""
    labels = ["potted pl", "potted plant", "pot ##ted plant", "table"]
    content = [{"image": "scene/0", "boxes": [[1, 2, 30, 40]] * 4, "scores": [0.9, 0.8, 0.7, 0.6], "labels": labels}]
    detector = RecordedDetector(written(tmp_path / "cut.json", content), frame_ids=FRAMES)
    assert detector.detect(frame, ["potted plant"]).scores.tolist() == pytest.approx([0.9, 0.8, 0.7])
    assert detector.cut == {"potted plant": ("potted pl",)}
    with pytest.raises(UnknownClass):
        detector.detect(frame, ["tablet"])


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("frame,name,x1,y1,x2,y2\na,mug,1,2,3,4\na,mug,1,2,3,4,5\n", "line 3 has more cells than the first line"),
        (",".join(f"c{k}" for k in range(1_000_000)) + "\n" + "1\n" * 20, "too many columns"),
    ],
)
def test_tables_with_more_cells_than_names(tmp_path: Path, text: str, wrong: str) -> None:
    path = tmp_path / "found.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=wrong):
        read_content(path)
