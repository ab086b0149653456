"""SUN-Refer and SUN-Spot in their published forms on SUN RGB-D, and Acc@IoU beside our own figures."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writers import write_votenet
from scenes import frame_of, upright

from pipeline.answering import Pipeline, open_pipeline
from pipeline.datasets import InMemoryDataset
from pipeline.evaluation import evaluate_sentences, read_sentence_file
from pipeline.evaluation.sentences import acc_iou
from pipeline.geometry import Box3D
from pipeline.system import InputError

CHAIR = (0.4, 0.6, 0.4)
BOXES = [upright((-0.6, 0.9, 2.5), CHAIR), upright((0.6, 0.9, 2.5), CHAIR), upright((0, 0.8, 3.4), (0.6, 0.8, 0.5))]
LABELS = ["chair", "chair", "desk"]
REFER = [
    {
        "image_id": "000104",
        "object_id": "0",
        "sentence": "the chair left of the desk",
        "ann_id": "104_0_0",
        "object_name": "chair",
        "tokens": ["the", "chair"],
    },
    {"image_id": "000104.jpg", "object_id": 1, "sentence": "the chair left of the desk", "ann_id": "104_1_0"},
    {"image_id": "000105", "object_id": "1", "sentence": "the chair right of the desk", "ann_id": "105_1_0"},
    {"image_id": "000104", "object_id": "", "sentence": "the desk", "ann_id": "104_2_0"},
]
"""The second says that the right chair is on the left; the third is of a picture that is not here; the last is none."""


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline(InMemoryDataset([frame_of(BOXES, LABELS, name="000104")]))


def test_sun_refer_names_lines_of_the_label_file(source: Pipeline, tmp_path: Path) -> None:
    path = tmp_path / "SUNREFER_v2.json"
    path.write_text(json.dumps(REFER))
    found = read_sentence_file(path, source)
    assert [(s.id, s.frame, s.targets, s.kind) for s in found.sentences] == [
        ("104_0_0", "000104", (0,), "SUN-Refer val"),
        ("104_1_0", "000104", (1,), "SUN-Refer val"),
    ]
    assert found.skipped == {"pictures that are not here": 1, "lines without an object or a sentence": 1}
    report = evaluate_sentences(path, source)
    assert [j.right for j in report.judged] == [True, False]
    assert report.judged[0].iou_3d is not None
    assert report.judged[0].iou_3d > 0.5
    assert report.judged[1].iou_3d == 0
    n, at_quarter, at_half = report.published["SUN-Refer val"]
    assert (n, at_quarter.value, at_half.value) == (2, 0.5, 0.5)
    assert report.tables[-1].columns == ("sentences", "Acc@0.25", "Acc@0.5")
    assert report.record()["published"]["all"]["acc@0.25"]["value"] == 0.5


def test_their_processed_sun_spot_is_a_pickle_of_plain_values(source: Pipeline, tmp_path: Path) -> None:
    path = tmp_path / "SUNSPOT_3D.pkl"
    row = {
        "ann_id": "104_2_1",
        "image_id": "000104",
        "sentence": "the desk behind the chair",
        "object_id": "2",
        "tokens": ["the", "desk"],
        "classname": "desk",
    }
    path.write_bytes(pickle.dumps([row], protocol=3))
    (sentence,) = read_sentence_file(path, source).sentences
    assert (sentence.kind, sentence.targets) == ("SUN-Spot val", (2,))


def spot(folder: Path, **change: Any) -> Path:
    """refs(boulder).p and instances.json as on Zenodo."""
    refs = [
        {
            "ref_id": 7,
            "ann_id": 31,
            "image_id": 4,
            "category_id": 2,
            "split": "test",
            "sent_ids": [12],
            "file_name": "kv2/kinect2data/000104/image/0000103.jpg",
            "sentences": [
                {
                    "sent_id": 12,
                    "raw": "The desk behind the chair",
                    "sent": "the desk behind the chair",
                    "tokens": ["the", "desk", "behind", "the", "chair"],
                }
            ],
        }
    ]
    coco = {
        "images": [{"id": 4, "file_name": "kv2/kinect2data/000104/image/0000103.jpg"}],
        "annotations": [{"id": 31, "image_id": 4, "category_id": 2, "bbox": [10.0, 20.0, 30.0, 40.0]}],
        "categories": [{"id": 2, "name": "desk"}],
        **change,
    }
    (folder / "instances.json").write_text(json.dumps(coco))
    path = folder / "refs(boulder).p"
    path.write_bytes(pickle.dumps(refs, protocol=2))
    return path


def test_sun_spot_comes_with_boxes_of_its_instances(source: Pipeline, tmp_path: Path) -> None:
    (sentence,) = read_sentence_file(spot(tmp_path), source).sentences
    assert (sentence.id, sentence.frame, sentence.kind) == ("12", "000104", "SUN-Spot test")
    assert sentence.boxes == ((10.0, 20.0, 40.0, 60.0),)
    assert sentence.text == "The desk behind the chair"


def test_objects_are_lines_of_votenets_labels(tmp_path: Path) -> None:
    root = tmp_path / "sunrgbd_trainval"
    write_votenet(root, ["000104"])
    label = root / "label" / "000104.txt"
    label.write_text("desk 2 2 5 5 0.5 2.5 -0.4 0.3 0.5 0.4 0.6 -0.8\n" + label.read_text())
    own = open_pipeline(root)
    path = tmp_path / "SUNREFER_v2.json"
    path.write_text(json.dumps([{**REFER[0], "object_id": "1", "sentence": "the chair"}]))
    (sentence,) = read_sentence_file(path, own).sentences
    (right,) = [a for a in own.dataset.load("000104").annotations if a.index in (sentence.targets or ())]
    assert right.label == "chair"
    assert right.box is not None
    (judged,) = evaluate_sentences(path, own).judged
    assert judged.right
    assert judged.iou_3d is not None


class _Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return print, ("run",)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", b"[1, 2]", "a list of entries"),
        ("a.json", b"{", "cannot be read"),
        ("a.json", b'[{"question": 1}]', "no published benchmark has these keys"),
        ("a.json", json.dumps(REFER[2:]).encode(), "no sentence of the benchmark is about this dataset"),
        ("a.json", b'[{"image_id": "000104", "object_id": "0", "sentence": "the chair"}, {"image_id": 1}]', "damaged"),
        ("a.pkl", pickle.dumps([{"image_id": _Evil()}]), "names what is not read|print"),
        ("a.p", b"", "not a pickle that can be read"),
    ],
)
def test_files_that_cannot_be_used(
    source: Pipeline, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_sentence_file(tmp_path / name, source)
    assert not capsys.readouterr().out


def test_sun_spot_without_its_instances_says_so(source: Pipeline, tmp_path: Path) -> None:
    path = spot(tmp_path)
    (tmp_path / "instances.json").unlink()
    with pytest.raises(InputError, match=r"need instances\.json"):
        read_sentence_file(path, source)


def test_acc_iou_is_that_of_upright_boxes_along_the_axes(source: Pipeline) -> None:
    viewer = source.prepare("000104").viewer
    R = viewer.R_level_camera.T
    one = Box3D(R @ np.array([0.0, 0, 2]), R, np.array([2.0, 1, 1]))
    moved = Box3D(R @ np.array([1.0, 0, 2]), R, np.array([2.0, 1, 1]))
    assert acc_iou(one, [moved], viewer) == pytest.approx(1 / 3)
    a = np.deg2rad(45)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    turned = Box3D(one.center, R @ turn, np.array([1.0, 1, 1]))
    # Turned by 45 degrees it is as wide and as deep as its diagonal.
    assert acc_iou(turned, [Box3D(one.center, R, np.array([2**0.5, 1, 2**0.5]))], viewer) == pytest.approx(1)
    assert acc_iou(None, [one], viewer) == 0
