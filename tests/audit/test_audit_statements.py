"""Benchmarks of statements, each item written as its makers publish it: see `pipeline.audit.benchmarks`."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.audit.benchmarks import open_benchmark, read_benchmark
from pipeline.audit.report import audit
from pipeline.labels import SourceSpec, label_dataset, open_labels, read_cases
from pipeline.system import InputError


def lines(path: Path, *rows: Any) -> Path:
    path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    return path


def vsr(image: str, caption: str, label: int) -> dict[str, Any]:
    link = f"http://images.cocodataset.org/train2017/{image}"
    rest = {"annotator_id": 31, "vote_true_validator_id": [2, 6], "vote_false_validator_id": []}
    return {"image": image, "image_link": link, "caption": caption, "label": label, "relation": "behind", **rest}


BLINK = {
    "idx": "val_Spatial_Relation_1",
    "sub_task": "Spatial_Relation",
    "question": "Is the car beneath the cat?",
    "image_1": "val_Spatial_Relation_1_1.jpg",
    "choices": ["yes", "no"],
    "answer": "(A)",
    "prompt": "…",
}
CV_BENCH = {
    "idx": 7,
    "type": "2D",
    "task": "Relation",
    "question": "Considering the relative positions of the mug (annotated by the red box) and the laptop in the image "
    "provided, where is the mug located with respect to the laptop?",
    "choices": ["left", "right"],
    "answer": "(B)",
    "filename": "img/2D/relation/coco_1.png",
    "source": "COCO",
}


def items(path: Path) -> tuple[str, list[Any]]:
    name, found = read_benchmark(open_benchmark(path))
    return name, [(i.picture, i.text, i.true, i.truth, i.why_not[:20]) for i in found]


def test_items_are_read_by_their_published_keys(tmp_path: Path) -> None:
    path = tmp_path / "items.jsonl"
    assert items(lines(path, vsr("1.jpg", "The cat is behind the laptop.", 0))) == (
        "VSR",
        [("1.jpg", "The cat is behind the laptop.", False, "false", "")],
    )
    depth = CV_BENCH | {"task": "Depth", "question": "Which object is closer?", "choices": ["mug", "laptop"]}
    assert items(lines(path, BLINK, CV_BENCH, depth)) == (
        "BLINK or CV-Bench",
        [
            ("val_Spatial_Relation_1_1.jpg", "Is the car beneath the cat?", True, "yes", ""),
            ("img/2D/relation/coco_1.png", "the mug is right of the laptop", True, "right", ""),
            ("img/2D/relation/coco_1.png", "Which object is closer?", True, "laptop", "Depth: it is not whe"),
        ],
    )
    whole = tmp_path / "whatsup.json"
    whole.write_text(json.dumps([{"image_path": "mug_on_table.jpeg", "caption_options": ["A mug on a table", "A b"]}]))
    assert [(text, true) for _, text, true, _, _ in items(whole)[1]] == [("A mug on a table", True), ("A b", False)]
    whole.write_text(json.dumps([[139, "A vase to the left of a tv", "A vase to the right of a tv"]]))
    assert [(i[0], i[2]) for i in items(whole)[1]] == [(139, True), (139, False)]
    scan = {
        "scene_id": "scene0000_00",
        "object_id": "4",
        "object_name": "chair",
        "ann_id": "0",
        "description": "It is.",
    }
    whole.write_text(json.dumps([scan | {"token": ["it"]}]))
    assert items(whole) == ("ScanRefer", [("scene0000_00", "It is.", True, "chair 4", "it is about a whole ")])
    table = tmp_path / "nr3d.csv"
    with table.open("w", newline="") as file:
        row = {
            "assignmentid": 1,
            "scan_id": "scene0525_00",
            "target_id": 9,
            "instance_type": "plant",
            "utterance": "It.",
        }
        writer = csv.DictWriter(file, list(row))
        writer.writeheader()
        writer.writerow(row)
    assert items(table)[0] == "Nr3D"
    columns = {"image": [{"bytes": b"x", "path": None}], **{k: [v] for k, v in BLINK.items() if k != "image_1"}}
    pq.write_table(pa.table(columns), tmp_path / "val.parquet")
    assert items(tmp_path / "val.parquet")[1][0][0] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"label": "perhaps"}, "line 2, label: neither true nor false; got 'perhaps'; expected 0 or 1"),
        ({"caption": ""}, "line 2, caption: no text"),
        ({"image": None, "image_link": None}, "line 2: nothing names the picture"),
    ],
)
def test_a_bad_item_is_named_by_line_and_field(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    good = vsr("1.jpg", "The cat is behind the laptop.", 1)
    with pytest.raises(InputError, match=message):
        audit(lines(tmp_path / "vsr.jsonl", good, good | change))
    del good["label"]
    with pytest.raises(InputError, match="line 2, label: not there, and VSR has it"):
        audit(lines(tmp_path / "vsr.jsonl", vsr("1.jpg", "x", 1), good))
    with pytest.raises(InputError, match=r"no published benchmark has these keys; got image, words; expected VSR"):
        audit(lines(tmp_path / "odd.jsonl", {"image": "1.jpg", "words": "x"}))
    with pytest.raises(InputError, match=r"answer: none of the choices; got '\(C\)'; expected \(A\) to \(B\)"):
        audit(lines(tmp_path / "blink.jsonl", BLINK | {"answer": "(C)"}))


def test_statements_are_audited_on_annotated_pictures(tmp_path: Path) -> None:
    """True captions of the demo's labels, one with its label turned round, and two that say opposite things."""
    label_dataset(SourceSpec("demo"), tmp_path / "labels", limit=3)
    rows: list[dict[str, Any]] = []
    for truth in read_cases(open_labels(tmp_path / "labels"), 0, 3):
        for case in truth.cases:
            alone = all(truth.labels.count(name) == 1 for name in (case.target, case.reference))
            words = {"above": "above", "below": "below", "behind": "behind"}.get(case.relation)
            if alone and words:
                rows.append(vsr(f"{truth.frame}.png", f"The {case.target} is {words} the {case.reference}.", 1))
    assert len(rows) >= 4
    wrong = rows[1] | {"label": 0}
    report = audit(
        lines(tmp_path / "vsr.jsonl", wrong, *rows[2:], vsr("none.jpg", "The cat is behind the dog.", 1)), "demo"
    )
    assert report.suspicious[0].id == "line 1"
    assert "annotated objects say yes" in report.suspicious[0].reasons[0].text
    assert all(item.score < 0.1 for item in report.suspicious[1:])
    record = report.record()
    assert sum("no dataset holds the picture" in why for why in record["unjudged_because"]) == 1
    # Without the pictures items are held against each other.
    opposite = vsr("1.jpg", "The cat is in front of the dog.", 1), vsr("1.jpg", "The cat is behind the dog.", 1)
    plain = audit(lines(tmp_path / "two.jsonl", *opposite, vsr("2.jpg", "The cat is behind the dog.", 1)))
    assert [item.id for item in plain.suspicious] == ["line 1", "line 2"]
    assert plain.look(plain.items[0]) == ""


def test_a_misspelt_name_is_weak_evidence(tmp_path: Path) -> None:
    said = ("the mouse is left of the laptop", "the mousse is left of the laptop", "the mouse is left of the lapptop")
    path = lines(tmp_path / "items.jsonl", *(vsr("000001/000000", text, 1) for text in said))
    report = {item.text: item for item in audit(path, "demo").items}
    assert report[said[0]].score > 0.5
    for text in said[1:]:
        assert report[text].score < 0.31
        assert "is read as" in "".join(e.text for e in report[text].evidence) or report[text].unjudged
