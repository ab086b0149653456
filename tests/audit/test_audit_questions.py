"""RoboSpatial-Home in both published forms: frames, questions, its metric and ours, and items whose answer is wrong."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from scenes import frame_of, upright

from pipeline.answering import open_pipeline
from pipeline.audit import AuditReport
from pipeline.audit.report import audit, audit_questions
from pipeline.datasets import InMemoryDataset, open_dataset
from pipeline.evaluation import Question, published_right, read_question_answers, read_questions
from pipeline.evaluation.robospatial import inside, own_right
from pipeline.system import InputError

SQUARE = "[(0.2, 0.2), (0.6, 0.2), (0.6, 0.6), (0.2, 0.6)]"
VACANT = (
    "In the image, there is a bowl. Pinpoint several points within the vacant space situated to the left of the bowl."
)
ITEMS = [
    ("configuration", "Is the chair left of the lamp? Answer yes or no.", "Yes"),
    ("configuration", "Is the lamp right of the chair? Answer yes or no.", "No"),
    ("configuration", "Is the picture above the desk? Answer yes or no.", "Yes"),
    ("compatibility", "Can the cup fit above the counter? Answer yes or no.", "No"),
    ("context", VACANT, SQUARE),
    ("context", f"{VACANT} Again.", "[(0.7, 0.7), (0.9, 0.7), (0.9, 0.9)]"),
]
"""The first two are of one picture and say opposite things; the last one's points lie outside its mask."""
CAMERA: Any = {"intrinsics": (50.0, 50.0, 19.5, 29.5), "depth_scale": 1000.0}


def pictures(row: int) -> tuple[Image.Image, Image.Image, Image.Image]:
    """Colour of the phone, its smaller depth, and the mask of the square; the first two items share a picture."""
    rgb = np.random.default_rng(max(row, 1)).integers(0, 255, (120, 80, 3), np.uint8)
    mask = np.zeros((120, 80), np.uint8)
    mask[int(0.2 * 119) : int(0.6 * 119) + 1, int(0.2 * 79) : int(0.6 * 79) + 1] = 255
    return Image.fromarray(rgb), Image.fromarray(np.full((60, 40), 1500, np.uint16)), Image.fromarray(mask)


def named() -> list[str]:
    counts: dict[str, int] = {}
    names = []
    for category, _, _ in ITEMS:
        names.append(f"{category}_{counts.setdefault(category, 0)}")
        counts[category] += 1
    return names


@pytest.fixture(scope="module")
def downloaded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As download_benchmark.py writes it."""
    root = tmp_path_factory.mktemp("home") / "RoboSpatial-Home"
    (root / "images").mkdir(parents=True)
    entries = []
    for row, (name, (category, question, answer)) in enumerate(zip(named(), ITEMS, strict=True)):
        files = {}
        for key, prefix, image in zip(
            ("img", "depth_image", "mask"), ("img", "depth", "mask"), pictures(row), strict=True
        ):
            files[key] = f"images/{prefix}_{name}.png"
            image.save(root / files[key])
        entries.append({"category": category, "question": question, "answer": answer, **files})
    (root / "annotations.json").write_text(json.dumps(entries, indent=2))
    return root


@pytest.fixture(scope="module")
def hosted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As the tables on the hub: data/SPLIT-00000-of-00001.parquet with structs of bytes."""
    root = tmp_path_factory.mktemp("hub")
    (root / "data").mkdir()

    def cell(image: Image.Image) -> dict[str, Any]:
        out = io.BytesIO()
        image.save(out, "png")
        return {"bytes": out.getvalue(), "path": None}

    for split in dict.fromkeys(category for category, _, _ in ITEMS):
        rows = [
            {
                "category": c,
                "question": q,
                "answer": a,
                **dict(zip(("img", "depth_image", "mask"), map(cell, pictures(row)), strict=True)),
            }
            for row, (c, q, a) in enumerate(ITEMS)
            if c == split
        ]
        pq.write_table(pa.Table.from_pylist(rows), root / "data" / f"{split}-00000-of-00001.parquet")
    return root


def test_frames_ask_for_the_camera_and_the_unit(downloaded: Path, hosted: Path) -> None:
    for root in (downloaded, hosted):
        with pytest.raises(InputError, match=r"--intrinsics .* and --depth-scale"):
            open_dataset(root)
        dataset = open_dataset(root, **CAMERA)
        questions = read_questions(root)
        assert set(dataset.frame_ids) == {q.frame for q in questions}
        frame = dataset.load(questions[0].frame)
        assert frame.rgb.shape == (60, 40, 3)
        assert float(frame.depth.max()) == 1.5
    assert open_dataset(downloaded, **CAMERA).format == "robospatial"


def test_both_forms_hold_the_same_questions(downloaded: Path, hosted: Path) -> None:
    one, other = (sorted(read_questions(root), key=lambda q: q.id) for root in (downloaded, hosted))
    assert [q.id for q in one] == sorted(named())
    for a, b in zip(one, other, strict=True):
        assert (a.id, a.category, a.text, a.answer) == (b.id, b.category, b.text, b.answer)
        if a.category == "context":
            first, second = a.region(), b.region()
            assert first is not None
            assert second is not None
            assert np.array_equal(first, second)


def test_answers_score_as_published_and_as_they_mean(downloaded: Path) -> None:
    of = {q.id: q for q in read_questions(downloaded)}
    yes, point = of["configuration_0"], of["context_0"]
    # Only the first word counts there; here what is said.
    for text, published, ours in (("Yes.", True, 1), ("no", False, 0), ("The answer is yes", False, 1)):
        assert (published_right(yes, text), own_right(yes, text)) == (published, ours), text
    cases = (
        ("(0.3, 0.3)", True, 1.0),
        ("The spot [0.3, 0.3].", True, 1.0),
        ("[(0.3, 0.3), (0.9, 0.9)]", True, 0.5),
        ("[(0.9, 0.9), (0.3, 0.3)]", False, 0.5),
        ("nowhere", False, 0.0),
    )
    for text, published, ours in cases:
        assert (published_right(point, text), own_right(point, text)) == (published, ours), text
    assert not inside(np.zeros((0, 2)), (0.5, 0.5))


@pytest.fixture(scope="module")
def answers(downloaded: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three systems, which all say that the cup fits; one says nothing else."""
    entries = json.loads((downloaded / "annotations.json").read_text())
    folder = tmp_path_factory.mktemp("answers")
    paths = []
    for k in range(3):
        said = {"compatibility": "yes", "context": "(0.3, 0.3) or (0.1, 0.9)"}
        told = [{**e, "answer": said.get(e["category"], e["answer"])} for e in entries]
        told[-1]["answer"] = "(0.1, 0.1)"
        told = told if k else [e for e in told if e["category"] == "compatibility"]
        paths.append(folder / f"system{k}.json")
        paths[-1].write_text(json.dumps(told))
    return paths


def test_what_is_wrong_comes_first_with_its_evidence(downloaded: Path, answers: list[Path], tmp_path: Path) -> None:
    report = audit(downloaded, runs=answers)
    scores = {item.id: item.score for item in report.items}
    assert {item.id for item in report.items[:4]} == {
        "context_1",
        "compatibility_0",
        "configuration_0",
        "configuration_1",
    }
    assert scores["context_0"] < 0.02 < scores["context_1"]
    by_id = {item.id: {e.kind: e for e in item.reasons} for item in report.items}
    assert dict(by_id["context_1"]["region"].figures)["outside"] == 1
    assert "configuration_1 of the same picture says No" in by_id["configuration_0"]["contradiction"].text
    assert "3 of 3 systems" in by_id["compatibility_0"]["systems"].text
    assert report.systems is not None
    row = {r.name: dict(zip(report.systems.columns, r.cells, strict=True)) for r in report.systems.rows}["system1"]
    published = [row[name] for name in ("configuration", "compatibility", "VQA", "context", "total")]
    assert published == [1.0, 0.0, 0.5, 0.5, 0.5]
    # Half of its points in the first mask, none in the second; without doubted items only the first of them is left.
    assert row["ours"] == pytest.approx((1 + 0 + 0.25) / 3)
    assert row["ours, undoubted"] == pytest.approx((1 + 0 + 0.5) / 3)
    check_files(report, tmp_path)


@pytest.mark.parametrize(
    ("text", "answer", "kind", "wrong"),
    [
        ("Is the mug left of the vase? Answer yes or no.", "Yes", None, False),
        ("Is the mug left of the vase? Answer yes or no.", "No", "geometry", True),
        ("Is the mug right of the vase? Answer yes or no.", "Yes", "geometry", True),
        ("Is the mug left of the chair? Answer yes or no.", "No", "frame", True),
        ("Is the zebra left of the chair? Answer yes or no.", "No", "frame", False),
    ],
)
def test_detected_objects_judge_yes_and_no(downloaded: Path, text: str, answer: str, kind: str, wrong: bool) -> None:
    boxes = [upright((x, 1.0, 2.5), (0.2, 0.2, 0.2)) for x in (-0.7, 0.1, 0.6)]
    source = open_pipeline(InMemoryDataset([frame_of(boxes, ["mug", "vase", "chair"], name="room")]), srm="rule")
    picture = downloaded / "images" / "img_context_0.png"
    question = Question("configuration_0", "room", "configuration", text, answer, picture)
    (item,) = audit_questions([question], (), source)
    assert [e.kind for e in item.reasons] == ([] if kind is None else [kind])
    assert (item.score >= 0.5) == wrong


def check_files(report: AuditReport, folder: Path) -> None:
    report.write(folder / "a.jsonl")
    rows = [json.loads(line) for line in (folder / "a.jsonl").read_text().splitlines()]
    assert [r["rank"] for r in rows] == list(range(1, len(ITEMS) + 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"answer": None}, "item 0 lacks its answer"),
        ({"img": "../../etc/x.png"}, "no path in the folder"),
        ({"mask": "/etc/passwd"}, "no path in the folder"),
    ],
)
def test_damaged_items_are_told(downloaded: Path, tmp_path: Path, change: dict[str, Any], message: str) -> None:
    entries = json.loads((downloaded / "annotations.json").read_text())
    (tmp_path / "annotations.json").write_text(json.dumps([{**entries[0], **change}]))
    with pytest.raises(InputError, match=message):
        read_questions(tmp_path)


def test_answers_to_other_items_are_refused(downloaded: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(
        json.dumps([{"category": "context", "question": "?", "answer": "yes", "img": "images/img_x_0.png"}])
    )
    with pytest.raises(InputError, match="answers none of the items"):
        read_question_answers(path, read_questions(downloaded))
