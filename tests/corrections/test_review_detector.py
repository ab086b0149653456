"""A second detector against the objects of labels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.corrections import ItemKey, QueueConfig, detector_evidence, item_keys, review_queue
from pipeline.corrections.review.detector_evidence import compared
from pipeline.corrections.review.evidence import DISPUTED, UNMATCHED, WARNED
from pipeline.corrections.review.items import missing_object
from pipeline.datasets import Dataset
from pipeline.labels import Labels
from pipeline.proposals import Proposals, make_detector
from pipeline.system import InputError


class Named:
    """What is compared of a detector: its name, and what it knows."""

    name = "second"
    exact = False

    def __init__(self, vocabulary: tuple[str, ...] | None) -> None:
        self.vocabulary = vocabulary


def proposals(*found: tuple[str, float, list[float]]) -> Proposals:
    names = tuple(dict.fromkeys(n for n, _, _ in found))
    return Proposals(
        np.array([b for _, _, b in found], np.float32).reshape(-1, 4),
        np.array([s for _, s, _ in found], np.float32),
        np.array([names.index(n) for n, _, _ in found], np.int64),
        names,
        None,
        np.arange(len(found)),
    )


BOXES = np.array([[0, 0, 10, 10], [20, 0, 30, 10], [40, 0, 50, 10], [60, 0, 70, 10]], np.float64)
NAMES = np.array(["mug", "book", "lamp", "trash can"], object)
NUMBERS = np.array([3, 5, 8, 9])


def against(found: Proposals, vocabulary: tuple[str, ...] | None) -> dict[ItemKey, tuple[float, str]]:
    items = compared("f", NUMBERS, NAMES, BOXES, found, Named(vocabulary))  # pyright: ignore[reportArgumentType]
    return {item.key: (item.weight, item.reason) for item in items}


def key(number: int) -> ItemKey:
    return ItemKey("f", "object", number, None, "")


def test_what_it_sees_otherwise_is_told_in_words() -> None:
    found = against(
        proposals(
            ("mug", 0.9, [0, 0, 10, 10]),
            ("box", 0.8, [0, 0, 10, 10]),
            ("tray", 0.7, [20, 0, 30, 9]),
            ("bin", 0.6, [60, 0, 70, 10]),
            ("chair", 0.9, [100, 0, 120, 20]),
            ("stool", 0.6, [100, 0, 120, 19]),
            ("sofa", 0.2, [200, 0, 220, 20]),
        ),
        None,
    )
    place = missing_object("f", [100, 0, 120, 20])
    assert set(found) == {key(5), key(8), place}, "one of several names at a place is enough; synonyms are no dispute"
    assert found[key(5)] == (DISPUTED, "the detector second calls it 'tray' (score 0.70)")
    assert found[key(8)] == (UNMATCHED, "the detector second sees no object here")
    weight, reason = found[place]
    assert weight == pytest.approx(0.9 * UNMATCHED)
    assert "'chair'" in reason


def test_a_detector_speaks_of_what_it_knows() -> None:
    found = against(proposals(("tray", 0.7, [20, 0, 30, 9])), ("tray", "mug"))
    assert set(found) == {key(3), key(5)}
    assert found[key(5)][0] == WARNED
    assert "knows no 'book'" in found[key(5)][1]
    assert set(against(proposals(("tray", 0.3, [20, 0, 30, 9])), ("tray",))) == set(), "too unsure to speak"


def test_frames_without_anything() -> None:
    assert set(against(proposals(), None)) == {key(n) for n in (3, 5, 8, 9)}
    none = compared("f", NUMBERS[:0], NAMES[:0], BOXES[:0], proposals(), Named(None))  # pyright: ignore[reportArgumentType]
    assert list(none) == []


def test_a_recording_speaks_in_the_queue(demo_labels: Labels, demo_dataset: Dataset, tmp_path: Path) -> None:
    rows = demo_labels.objects.to_pylist()
    frames: dict[str, list[dict]] = {}
    for row in rows:
        frames.setdefault(row["frame"], []).append({"label": row["label"], "score": 0.9, "bbox": list(row["bbox"])})
    first = next(iter(frames))
    gone = frames[first].pop(0)
    other = frames[first][0]["label"]
    frames[first][0]["label"] = "zebra"
    numbers = [row["object"] for row in rows if row["frame"] == first]
    recording = tmp_path / "recording.json"
    recording.write_text(json.dumps({"frames": frames}))
    detector = make_detector("recorded", model=recording, class_names=demo_dataset.class_names)
    told: list[tuple[int, int]] = []
    found = detector_evidence(demo_labels, demo_dataset, detector, progress=lambda *n: told.append(n))
    assert found.skipped == {}
    assert found.frames == len(frames) == told[-1][0]
    expected = {ItemKey(first, "object", n, None, ""): text for n, text in zip(
        numbers, ("sees no object here", "'zebra'"), strict=False)}  # fmt: skip
    by_key = {item.key: item.reason for item in found.items}
    assert set(by_key) == set(expected), (gone, other)
    assert all(expected[k] in reason for k, reason in by_key.items())
    config = QueueConfig(doubts=None, linter=False, margins=False, undecided=False)
    queue = review_queue(demo_labels, config, found_elsewhere=found.items)
    assert set(item_keys(queue)) == set(expected)


def test_what_is_missing_has_a_row_of_its_own(demo_labels: Labels, demo_dataset: Dataset, tmp_path: Path) -> None:
    frame = demo_labels.frames.column("frame")[0].as_py()
    recording = tmp_path / "recording.json"
    more = {"label": "zebra", "score": 0.8, "bbox": [1, 2, 9, 8]}
    recording.write_text(json.dumps({"frames": {frame: [more]}}))
    detector = make_detector("recorded", model=recording, class_names=demo_dataset.class_names)
    found = detector_evidence(demo_labels, demo_dataset, detector)
    config = QueueConfig(doubts=None, linter=False, margins=False, undecided=False)
    queue = review_queue(demo_labels, config, found_elsewhere=found.items)
    (row,) = [r for r in queue.to_pylist() if r["place"] is not None]
    assert (row["frame"], row["kind"], row["a"], row["b"], row["label"]) == (frame, "object", -1, None, "zebra")
    assert row["place"] == "1,2,9,8"
    assert row["score"] == pytest.approx(0.8 * UNMATCHED)
    assert missing_object(frame, more["bbox"]) in item_keys(queue)


def test_the_simulated_detector_looks_too(demo_labels: Labels, demo_dataset: Dataset) -> None:
    detector = make_detector("simulated", class_names=demo_dataset.class_names)
    found = detector_evidence(demo_labels, demo_dataset, detector)
    assert found.frames == demo_labels.frames.num_rows
    assert len({item.key for item in found.items if item.key.a >= 0}) >= 1
    exact = make_detector("annotations", class_names=demo_dataset.class_names)
    assert detector_evidence(demo_labels, demo_dataset, exact).items == (), "the labels are made of these"


def test_a_detector_that_saw_none_of_the_frames_is_told(
    demo_labels: Labels, demo_dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    detector = make_detector("annotations", class_names=demo_dataset.class_names)

    problems = [
        (InputError("the picture is damaged"), r"none of the labelled frames.*damaged"),
        # A network's own words.
        (RuntimeError("[ONNXRuntimeError] : 1\nat line 7"), r"detector mine could .*; got RuntimeError: \[ONNX.* : 1$"),
    ]
    for problem, said in problems:

        def broken(self: Dataset, frame: str, problem: Exception = problem) -> None:
            raise problem

        monkeypatch.setattr(type(demo_dataset), "load", broken)
        with pytest.raises(InputError, match=said):
            detector_evidence(demo_labels, demo_dataset, detector, name="mine")
