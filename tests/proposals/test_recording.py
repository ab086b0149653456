"""Recordings of what a detector finds: written whole or not at all, and played back as it was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shelf import NAMES, SHELF, H, W, rows_of

from pipeline.answering import AskConfig, Pipeline, frame_range, open_pipeline, record_detections
from pipeline.answering.ask import ask
from pipeline.datasets import demo_path
from pipeline.geometry import decode_crop, decode_run_length, encode_run_length
from pipeline.proposals import RecordedDetector, SimulatedDetector, recorded, top_k
from pipeline.system import InputError

SEEDS = st.integers(0, 2**32 - 1)
OTHER = replace(SHELF, id="scene/1")


# Masks.


@given(SEEDS, st.integers(1, 40), st.integers(1, 40), st.floats(0, 1))
@settings(max_examples=30, deadline=None)
def test_a_mask_comes_back_from_its_code(seed: int, height: int, width: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random((height, width)) < share
    mask[rng.integers(0, height + 1) :] = False
    code = encode_run_length(mask)
    np.testing.assert_array_equal(decode_run_length(mask.shape, code), mask)
    crop = decode_crop(mask.shape, code)
    if mask.any():
        v, u = np.nonzero(mask)
        assert crop.box == (u.min(), v.min(), u.max() + 1, v.max() + 1)
        assert crop.mask.shape == (v.max() + 1 - v.min(), u.max() + 1 - u.min())


# Recordings.


@pytest.fixture(scope="module")
def demo() -> Pipeline:
    return open_pipeline(demo_path(), detector="simulated", srm="rule")


@pytest.mark.parametrize("name", ["found.json", "found"])
def test_a_recording_answers_as_the_detector_did(tmp_path: Path, demo: Pipeline, name: str) -> None:
    ids, names = demo.dataset.frame_ids[:2], demo.dataset.class_names
    seen: list[tuple[int, int]] = []
    out = tmp_path / "new" / name
    report = record_detections(demo, out, names, lambda *at: seen.append(at), frame_ids=ids)
    assert seen == [(1, 2), (2, 2)]
    assert (report.frames, report.skipped, report.unknown) == (2, {}, ())
    assert [p.name for p in out.parent.iterdir()] == [name]
    played = RecordedDetector(out)
    assert demo.detector is not None
    count = 0
    for frame_id in ids:
        frame = demo.dataset.load(frame_id)
        for label in played.vocabulary or ():
            live = top_k(demo.detector.detect(frame, [label]), 10)
            assert rows_of(top_k(played.detect(frame, [label]), 10)) == rows_of(live)
            count += len(live)
        everything = played.detect(frame, None)
        assert len(set(everything.ids.tolist())) == len(everything)
    assert count == report.detections
    frame = demo.dataset.load(ids[0])
    traces = [ask(frame, "mug left of the laptop", d, config=AskConfig()) for d in (demo.detector, played)]
    assert traces[0].ranking is not None
    assert traces[0].ranking == traces[1].ranking


def test_the_files_of_a_recording_are_looked_at_when_the_recording_changed(
    tmp_path: Path, demo: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_detections(demo, tmp_path / "found", ("mug",), frame_ids=demo.dataset.frame_ids[:1])
    looked, hashed = list[Path](), recorded.contents_hash
    monkeypatch.setattr(recorded, "contents_hash", lambda path: looked.append(path) or hashed(path))
    played = RecordedDetector(tmp_path / "found")
    first = played.fingerprint()
    assert played.fingerprint() == first
    assert len(looked) == 1
    one = next((tmp_path / "found").glob("*.npz"))
    one.rename(one.with_name("other.npz"))
    assert played.fingerprint() != first


def test_a_detector_that_is_asked_once_gives_each_thing_once(tmp_path: Path, demo: Pipeline) -> None:
    record_detections(demo, tmp_path / "a.json", None, frame_ids=demo.dataset.frame_ids[:1])
    (entries,) = json.loads((tmp_path / "a.json").read_text())["frames"].values()
    assert len({e["id"] for e in entries}) == len(entries) > 5


def test_nothing_half_written_is_left(tmp_path: Path, demo: Pipeline) -> None:
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    (tmp_path / "old.json").write_text("old")
    for name in ("old.json", "new.json", "folder"):
        with pytest.raises(KeyboardInterrupt):
            record_detections(demo, tmp_path / name, ["mug"], stop, frame_ids=demo.dataset.frame_ids[:1])
    assert [p.name for p in tmp_path.iterdir()] == ["old.json"]
    assert (tmp_path / "old.json").read_text() == "old"
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("")
    with pytest.raises(InputError, match="not empty"):
        record_detections(demo, tmp_path / "full", ["mug"])
    (tmp_path / "d.json").mkdir()
    with pytest.raises(InputError, match="replace a folder"):
        record_detections(demo, tmp_path / "d.json", ["mug"])


def test_names_that_the_detector_does_not_know_are_told(tmp_path: Path, demo: Pipeline) -> None:
    ids = demo.dataset.frame_ids[:1]
    report = record_detections(demo, tmp_path / "a.json", ["mug", "zebra"], frame_ids=ids)
    assert report.unknown == ("zebra",)
    with pytest.raises(InputError, match=r"knows none of the names.*zebra"):
        record_detections(demo, tmp_path / "b.json", ["zebra"], frame_ids=ids)
    assert not (tmp_path / "b.json").exists()
    with pytest.raises(InputError, match="no usable frame"):
        record_detections(demo, tmp_path / "c.json", ["mug"], frame_ids=["absent"])


def test_one_id_under_two_names_is_one_thing(tmp_path: Path) -> None:
    box = [10, 20, 60, 80]
    entries = [
        {"label": "mug", "score": 0.4, "bbox": box, "id": 3},
        {"label": "cup", "score": 0.6, "bbox": box, "id": 3},
        {"label": "lamp", "score": 0.2, "bbox": box, "id": 8},
    ]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"frames": {"scene/0": entries, "scene/1": [*entries, {**entries[0], "id": None}]}}))
    detector = RecordedDetector(path)
    found = detector.detect(SHELF, None)
    assert [(found.label(i), int(found.ids[i])) for i in range(len(found))] == [("cup", 3), ("lamp", 8)]
    # Where one has none, none has.
    assert sorted(detector.detect(OTHER, None).ids.tolist()) == [0, 1, 2, 3]
    assert detector.detect(SHELF, ["lamp"]) is detector.detect(SHELF, ["lamp"])


@pytest.mark.parametrize("bad", [-1, 2**63, "three", 1.5])
def test_a_hostile_id_is_refused(tmp_path: Path, bad: Any) -> None:
    path = tmp_path / "a.json"
    entry = {"label": "mug", "score": 0.4, "bbox": [1, 2, 3, 4], "id": bad}
    path.write_text(json.dumps({"frames": {"scene/0": [entry]}}))
    with pytest.raises(InputError, match=r"frames\.scene/0\.0\.id"):
        RecordedDetector(path)


@pytest.mark.parametrize(
    "change",
    [
        {"mask_size": None},
        {"mask_size": np.array([H])},
        {"mask_size": np.array([10, 10])},
        {"mask_counts": np.array([b"0", b"0"])},
        {"mask_counts": np.array([b"oooo"])},
        {"mask_counts": np.array([[b"0"]])},
        {"ids": np.array([[1]])},
        {"ids": np.array(["a"])},
    ],
)
def test_hostile_codes_in_arrays_are_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    good = {
        "boxes": np.array([[1, 2, 30, 40.0]]),
        "scores": np.array([0.5]),
        "labels": np.array(["mug"]),
        "mask_counts": np.array([encode_run_length(np.ones((H, W), np.bool_)).encode()]),
        "mask_size": np.array([H, W]),
    }
    np.savez(tmp_path / "scene__1.npz", **good)
    assert len(RecordedDetector(tmp_path).detect(OTHER, None)) == 1
    np.savez(tmp_path / "scene__0.npz", **{k: v for k, v in (good | change).items() if v is not None})
    with pytest.raises(InputError) as caught:
        RecordedDetector(tmp_path).detect(SHELF, None)
    assert "\n" not in str(caught.value)


def test_taking_some_by_a_mask_is_not_taking_all() -> None:
    found = SimulatedDetector(None, NAMES).detect(SHELF, ["mug"])
    assert found.take(np.arange(len(found))) is found
    some = np.zeros(len(found), np.bool_)
    some[1] = True
    assert found.take(some).ids.tolist() == [found.ids[1]]
    assert found.take(np.arange(2)).ids.tolist() == found.ids[:2].tolist()
    two = found.take(np.arange(2))
    assert two.take(np.array([False, True])).ids.tolist() == [found.ids[1]]


def test_ranges_of_frames(demo: Pipeline) -> None:
    ids = demo.dataset.frame_ids
    assert frame_range(demo.dataset, "all") == frame_range(demo.dataset, ":") == ids
    assert frame_range(demo.dataset, "1:3") == ids[1:3]
    assert frame_range(demo.dataset, "2") == (ids[2],)
    for bad in ("3:3", "500:", "-1:2", "zebra"):
        with pytest.raises(InputError):
            frame_range(demo.dataset, bad)
