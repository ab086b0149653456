"""The JSON that other programs read: stable keys, strict JSON, and places that mean what they say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import frame_of, upright

from pipeline.answering import (
    FrameRelations,
    PreparedFrame,
    all_objects,
    open_pipeline,
    relate_frames,
    relation_records,
    trace_record,
    why_no_answer,
)
from pipeline.answering.ask import ask
from pipeline.answering.json_records import object_record
from pipeline.datasets import frame_record, open_dataset, survey
from pipeline.geometry import Frame
from pipeline.language import PAIRWISE
from pipeline.proposals import AnnotationDetector, Proposals
from pipeline.relations import make_scorer

TRUTH = AnnotationDetector(("mug", "laptop", "lamp"))
OBJECT_KEYS = {"id", "label", "score", "bbox", "center", "size", "R", "quality"}
DOCUMENTED = {"expression", "frame", "answer", "pairs", "proposals", "relations", "timings_ms"}


@pytest.fixture(scope="module")
def row() -> Frame:
    things = [upright((x, 0.9, 2), (0.3, 0.4, 0.3)) for x in (-0.6, 0.0, 0.6)]
    return frame_of(things, ["mug", "laptop", "mug"])


def strict(record: Any) -> Any:
    """The record as another program reads it."""
    return json.loads(json.dumps(record, allow_nan=False))


def test_an_answer_has_the_documented_keys(row: Frame) -> None:
    record = strict(trace_record(ask(row, "mug left of the laptop", TRUTH)))
    assert set(record) == DOCUMENTED | {"detector", "scorer", "viewer", "ranking"}
    assert record["frame"] == "scene/0"
    assert set(record["expression"]) == {"text", "target", "relation", "reference", "tree", "asked"}
    assert (record["expression"]["target"], record["expression"]["relation"]) == ("mug", "left")
    answer = {"target", "reference", "probability", "p_relation", "product", "holds", "relation_probability"}
    assert set(record["answer"]) == answer
    assert set(record["answer"]["target"]) == set(record["answer"]["reference"]) == OBJECT_KEYS
    assert record["answer"]["target"]["label"] == "mug"
    for pair in record["pairs"]:
        assert set(pair) == {
            "target",
            "reference",
            "p_target",
            "p_reference",
            "p_relation",
            "product",
            "probability",
            "log_factors",
            "holds",
            "relation_probability",
        }
    assert all(set(p) == OBJECT_KEYS | {"index"} for p in record["proposals"])
    assert set(record["timings_ms"]) == {"parse", "frame", "opm", "lift", "srm", "prm"}
    assert record["viewer"]["up_source"] == "declared"
    assert set(record["ranking"]) == {"reading", "margin", "log_margin", "entropy", "degenerate"}


def test_the_parts_of_an_answer_agree(row: Frame) -> None:
    trace = ask(row, "mug left of the laptop", TRUTH)
    record = strict(trace_record(trace))
    assert [p["index"] for p in record["proposals"]] == list(range(3))
    assert sum(p["probability"] for p in record["pairs"]) == pytest.approx(1, abs=1e-5)
    best = record["pairs"][0]
    assert record["answer"]["probability"] == best["probability"]
    for role in ("target", "reference"):
        there = {k: v for k, v in record["proposals"][best[role]].items() if k != "index"}
        assert record["answer"][role] == there
    assert record["answer"]["target"]["id"] == 0
    for pair in record["pairs"]:
        key = f"{pair['target']},{pair['reference']}"
        assert record["relations"][key]["left"] == pair["p_relation"]
        assert set(record["relations"][key]) == set(PAIRWISE)
    box = record["answer"]["target"]
    lifted = trace.objects[best["target"]].lifted.box
    assert lifted is not None
    np.testing.assert_allclose(box["center"], lifted.center, atol=1e-4)
    np.testing.assert_allclose(box["R"], lifted.R, atol=1e-6)
    np.testing.assert_allclose(box["size"], lifted.size, atol=1e-4)
    x0, y0, x1, y1 = box["bbox"]
    assert 0 <= x0 < x1 <= row.width
    assert 0 <= y0 < y1 <= row.height


def test_more_relations_have_links_readings_and_a_second_reference(row: Frame) -> None:
    nested = strict(trace_record(ask(row, "mug left of the laptop left of the mug", TRUTH)))
    assert len(nested["expression"]["readings"]) == 2
    assert all(len(p["links"]) == 2 for p in nested["pairs"])
    between = strict(trace_record(ask(row, "laptop between mug and mug", TRUTH)))
    assert between["expression"]["second_reference"] == "mug"
    assert between["answer"]["second_reference"]["label"] == "mug"
    assert {between["answer"]["reference"]["id"], between["answer"]["second_reference"]["id"]} == {0, 2}


def test_a_missing_class_is_null_with_a_reason(row: Frame) -> None:
    trace = ask(row, "lamp left of the mug", TRUTH)
    record = strict(trace_record(trace))
    assert record["answer"] is None
    assert record["pairs"] == []
    assert record["relations"] == {}
    assert record["reason"] == why_no_answer(trace) == "no 'lamp' found in frame scene/0"
    assert set(record) == DOCUMENTED | {"detector", "scorer", "viewer", "reason"}
    alone = strict(trace_record(ask(row, "laptop left of the laptop", TRUTH)))
    assert alone["answer"] is None
    assert "not enough different objects" in alone["reason"]
    assert alone["pairs"][0]["reference"] is None
    assert why_no_answer(ask(row, "mug left of the laptop", TRUTH)) is None


def test_an_object_without_depth_is_strict_json(row: Frame) -> None:
    mask = row.annotations[0].mask
    assert mask is not None
    depth = np.where(mask, 0, row.depth).astype(np.float32)
    blind = Frame("blind", row.rgb, depth, row.camera, row.annotations)
    record = strict(trace_record(ask(blind, "mug left of the laptop", TRUTH)))
    one = next(p for p in record["proposals"] if p["id"] == 0)
    assert one["center"] is one["size"] is one["R"] is None
    assert one["quality"]["distance"] is None
    assert one["quality"]["concerns"]


def test_a_relation_record_names_annotations_by_their_place(row: Frame) -> None:
    context = PreparedFrame(row)
    objects = all_objects(context, TRUTH)
    scores = make_scorer().score([o.lifted for o in objects], context.viewer)
    # Out of order, as a dataset's own list may be.
    order = [2, 0, 1]
    shuffled = tuple(objects[k] for k in order)
    again = make_scorer().score([o.lifted for o in shuffled], context.viewer)
    records = [strict(r) for r in relation_records(FrameRelations(row.id, shuffled, again, True))]
    assert len(records) == 6
    for record in records:
        assert set(record) == {"frame", "a", "b", "states", "probabilities"}
        assert set(record["a"]) == set(record["b"]) == {"index", "label"}
        a, b = record["a"]["index"], record["b"]["index"]
        assert a != b
        assert record["a"]["label"] == row.annotations[a].label
        assert set(record["states"]) == set(record["probabilities"]) == set(PAIRWISE)
        for relation in PAIRWISE:
            state = scores.states[a, b, PAIRWISE.index(relation)]
            assert record["states"][relation] == {1: "T", 0: "U", -1: "F"}[int(state)]
            assert record["probabilities"][relation] == {1: 0.95, 0: 0.5, -1: 0.05}[int(state)]
    first = next(r for r in records if (r["a"]["index"], r["b"]["index"]) == (0, 1))
    assert first["states"]["left"] == "T"


def test_a_detectors_relations_are_named_by_their_place_in_its_list(row: Frame) -> None:
    class Guess:
        name, exact, vocabulary = "guess", False, None

        def fingerprint(self) -> str:
            return "guess"

        def detect(self, frame: Frame, labels: Any) -> Proposals:
            found = TRUTH.detect(frame, labels)
            return Proposals(found.boxes, found.scores, found.label_index, found.labels, found.masks, found.ids + 40)

    context = PreparedFrame(row)
    objects = all_objects(context, Guess())
    scores = make_scorer().score([o.lifted for o in objects], context.viewer)
    records = list(relation_records(FrameRelations(row.id, objects, scores, Guess.exact), ("left", "on")))
    assert {r["a"]["index"] for r in records} == {0, 1, 2}
    assert set(records[0]["states"]) == {"left", "on"}


@pytest.mark.slow
def test_every_record_of_real_frames_is_strict_json(shared_data: Path) -> None:
    source = open_pipeline(shared_data / "real" / "ycbv-bop")
    pairs = 0
    for found in relate_frames(source, "all"):
        frame = source.dataset.load(found.frame_id)
        for record in map(strict, relation_records(found)):
            assert record["frame"] == found.frame_id
            assert frame.annotations[record["a"]["index"]].label == record["a"]["label"]
            inverse = record["states"]
            assert not (inverse["left"] == "T" and inverse["right"] == "T")
            pairs += 1
    assert pairs == 2 * (3 * 2 + 4 * 3 + 6 * 5)


def test_a_frame_record_says_what_is_in_it(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real" / "ycbv-bop")
    records = [strict(frame_record(r)) for r in survey(dataset)]
    assert [r["frame"] for r in records] == list(dataset.frame_ids)
    for record in records:
        assert set(record) == {
            "index",
            "frame",
            "ok",
            "problem",
            "width",
            "height",
            "annotations",
            "labels",
            "depth_valid",
            "median_depth",
            "has_pose",
            "up_source",
            "up",
            "notes",
            "decoded",
            "dataset_notes",
        }
        assert record["ok"]
        assert record["problem"] is None
        assert record["annotations"] == len(record["labels"])
        assert 0.3 < record["median_depth"] < 3


def test_an_object_record_rounds_and_explains(row: Frame) -> None:
    (first, *_) = all_objects(PreparedFrame(row), TRUTH)
    record = strict(object_record(first))
    assert set(record["quality"]) == {
        "mask_pixels",
        "points",
        "kept",
        "depth_missing",
        "touches_border",
        "distance",
        "yaw_confidence",
        "open_sides",
        "mask_source",
        "concerns",
    }
    assert record["quality"]["mask_source"] == "annotation"
    assert record["score"] == 1
    np.testing.assert_allclose(np.array(record["R"]) @ np.array(record["R"]).T, np.eye(3), atol=1e-5)
