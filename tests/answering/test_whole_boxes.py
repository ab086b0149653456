"""Completed boxes: near faces stay, the seen box is contained, intervals are ordered, and hostile input is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from needs import needs

from pipeline.answering.answer_words import reading_notes
from pipeline.answering.ask import AskConfig
from pipeline.answering.json_records import object_record
from pipeline.answering.objects import all_objects, prepare_frame
from pipeline.answering.pipeline import open_pipeline
from pipeline.answering.whole_boxes import (
    COLUMNS,
    CONTRACT,
    BoxNetwork,
    CompletedBox,
    bounded,
    complete,
    describe,
    measured_sides,
    shipped_box_network,
    side_units,
)
from pipeline.datasets.demo import DEMO_NAME
from pipeline.geometry import IMAGE_UP, Camera, LiftConfig, LiftedObject, intrinsics, lift, viewer_axes
from pipeline.geometry.boxes import SIDES, Box3D
from pipeline.system.errors import InputError

HEIGHT, WIDTH = 120, 160
CAMERA = Camera(intrinsics(140, 140, 80, 60), WIDTH, HEIGHT)


class Told(BoxNetwork):
    """Network of given offsets."""

    def __init__(self, raw: np.ndarray) -> None:
        self.raw = raw

    def offsets(self, rows: np.ndarray) -> np.ndarray:
        return bounded(np.broadcast_to(self.raw, (len(rows), 3, 6)))


def front(u0: int, v0: int, u1: int, v1: int, z: float = 1.5) -> tuple[LiftedObject, np.ndarray]:
    """A front in the picture, before a wall, and the depth."""
    depth, mask = np.full((HEIGHT, WIDTH), 3, np.float32), np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[v0:v1, u0:u1] = True
    depth[mask] = z
    return lift(depth, CAMERA, [mask], viewer_axes(IMAGE_UP))[0], depth


def ends(box: Box3D, R: np.ndarray) -> np.ndarray:
    """(6,) metres outwards of SIDES."""
    center = box.center @ R
    return np.stack([box.size / 2 - center, box.size / 2 + center], axis=1).ravel()


PLACES = [(60, 40, 100, 90), (0, 40, 40, 90), (120, 60, 160, 120), (5, 5, 60, 50)]


@pytest.mark.parametrize("place", PLACES)
@settings(max_examples=25, deadline=None)
@given(raw=st.lists(st.floats(-50, 50), min_size=18, max_size=18))
def test_near_faces_stay_and_the_seen_box_is_contained(place: tuple[int, int, int, int], raw: list[float]) -> None:
    item, depth = front(*place)
    (found,) = complete([item], ["box"], depth, CAMERA, Told(np.reshape(raw, (3, 6))))
    assert found is not None
    assert item.box is not None
    moved = ends(found.box, item.box.R) - ends(item.box, item.box.R)
    kept = measured_sides(item)
    np.testing.assert_allclose(moved[kept], 0, atol=1e-9)
    assert (moved >= -1e-9).all()
    assert set(found.completed) == {SIDES[k] for k in range(6) if moved[k] > 1e-9}
    assert set(found.interval) == {SIDES[k] for k in range(6) if not kept[k]}
    for side, (low, high) in found.interval.items():
        k = SIDES.index(side)
        assert low <= high
        if side in found.completed:
            assert low <= moved[k] + 1e-9
            assert moved[k] <= high + 1e-9


def test_what_the_border_cuts_is_no_measured_side() -> None:
    item, _ = front(0, 40, 40, 90)
    assert item.open_sides is not None
    assert "left" in item.open_sides
    assert not measured_sides(item)[SIDES.index("left")]


def test_shipped_network_is_deterministic_and_blind_to_company() -> None:
    views = [front(*place) for place in PLACES]
    item, depth = views[0]
    alone = complete([item], ["box"], depth, CAMERA)[0]
    both = complete([item, item], ["box", "mug"], depth, CAMERA)
    assert alone is not None
    assert both[0] is not None
    np.testing.assert_allclose(both[0].box.size, alone.box.size, atol=1e-5)
    again = complete([item], ["box"], depth, CAMERA)[0]
    assert again is not None
    np.testing.assert_array_equal(again.box.size, alone.box.size)
    np.testing.assert_array_equal(again.box.center, alone.box.center)


def test_what_has_no_box_or_one_of_a_person_is_left_alone() -> None:
    item, depth = front(60, 40, 100, 90)
    assert item.box is not None
    drawn = item.moved_to(Box3D(item.box.center, item.box.R, item.box.size * 2), viewer_axes(IMAGE_UP))
    nothing = replace(item, box=None, points=item.points[:0], open_sides=None)
    found = complete([drawn, nothing], ["box", "box"], depth, CAMERA)
    assert found[1] is None
    assert found[0] == CompletedBox(drawn.box, drawn.box)  # pyright: ignore[reportArgumentType]
    assert complete([], [], depth, CAMERA) == ()


def test_names_and_objects_must_be_as_many() -> None:
    item, depth = front(60, 40, 100, 90)
    with pytest.raises(InputError, match="differ in number"):
        complete([item], [], depth, CAMERA)


@pytest.mark.parametrize("z", [0.31, 9.9])
def test_inputs_are_finite_at_the_ends_of_the_depth_and_without_any_beside(z: float) -> None:
    item, depth = front(60, 40, 100, 90, z)
    empty = np.where(depth == depth[50, 70], depth, 0).astype(np.float32)
    for picture in (depth, empty):
        rows = describe([item], ["\x00 no such thing"], picture, CAMERA)
        assert rows.shape == (1, len(COLUMNS))
        assert np.isfinite(rows).all()


def test_units_are_of_the_box() -> None:
    np.testing.assert_allclose(
        side_units(Box3D(np.zeros(3), np.eye(3), np.array([1, 0.5, 0.2]))), [1.1, 1.1, 0.6, 0.6, 0.3, 0.3]
    )


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({}, "does not complete boxes"),
        ({"box.contract": "spatialviz-box-0"}, "does not complete boxes"),
        ({"box.columns": "[]"}, "does not complete boxes"),
        ({"box.mean": "[1.0]"}, "does not fit"),
        ({"box.mean": "null"}, "does not fit"),
        ({"box.std": json.dumps([0.0] * len(COLUMNS))}, "does not fit"),
        ({"box.std": json.dumps(["x"] * len(COLUMNS))}, "does not fit"),
        ({"box.std": "{"}, "does not fit"),
        ({"box.mean": "7"}, "does not fit"),
    ],
)
@needs("onnx")
def test_foreign_networks_are_refused(tmp_path: Path, told: dict[str, str], words: str) -> None:
    from pipeline.training import write_onnx

    good = {"box.contract": CONTRACT, "box.columns": json.dumps(COLUMNS)}
    good |= {f"box.{name}": json.dumps([1.0] * len(COLUMNS)) for name in ("mean", "std")}
    layers = [(np.zeros((len(COLUMNS), 18), np.float32), np.zeros(18, np.float32))]
    write_onnx(tmp_path / "a.onnx", layers, good)
    assert BoxNetwork(tmp_path / "a.onnx").offsets(np.zeros((2, len(COLUMNS)))).shape == (2, 3, 6)
    write_onnx(tmp_path / "b.onnx", layers, {**good, **told} if told else {})
    with pytest.raises(InputError, match=words):
        BoxNetwork(tmp_path / "b.onnx")


def test_sides_are_unsure_by_centimetres_or_by_their_share_of_the_box() -> None:
    box = Box3D(np.array([0, 0, 2.0]), np.eye(3), np.array([0.1, 1.0, 1.0]))
    interval = {"left": (-0.01, 0.02), "top": (-0.02, 0.02), "far": (0.0, 0.2)}
    found = CompletedBox(box, box, ("far",), interval)  # type: ignore[arg-type]
    assert found.unsure == ("left", "far")
    assert found.within == 0.1
    assert (found.by, replace(found, views=3).by) == ("the network", "3 views")
    assert CompletedBox(box, box).within == 0


def test_configuration_gives_objects_whole_boxes_and_leaves_relations() -> None:
    seen, whole = (
        open_pipeline(DEMO_NAME, config=AskConfig(lift=LiftConfig(boxes=boxes))) for boxes in ("seen", "completed")
    )
    frame = seen.dataset.load(seen.dataset.frame_ids[0])
    found = [all_objects(prepare_frame(p.dataset, frame, p.config.lift), p.needed_detector()) for p in (seen, whole)]
    completed = 0
    for a, b in zip(*found, strict=True):
        assert a.whole is None
        assert "whole" not in object_record(a)
        np.testing.assert_array_equal(a.lifted.lo, b.lifted.lo)
        if b.whole is not None:
            assert b.whole.seen is b.box
            assert b.size_box is b.whole.box
            assert b.estimated is (b.whole if b.whole.completed else None)
            assert object_record(b)["whole"]["completed"] == list(b.whole.completed)
            completed += bool(b.whole.completed)
    assert completed
    assert shipped_box_network() is shipped_box_network()


def test_a_size_says_by_which_boxes_it_goes() -> None:
    asked = "the tallest potted plant left of the laptop"
    notes = {}
    for boxes in ("seen", "completed"):
        pipeline = open_pipeline(DEMO_NAME, config=AskConfig(lift=LiftConfig(boxes=boxes)))
        notes[boxes] = " ".join(reading_notes(pipeline.ask(pipeline.prepare(pipeline.dataset.frame_ids[0]), asked)))
    assert "goes by the part of each thing that is seen" in notes["seen"]
    assert "goes by whole boxes: 3 of 3 are estimated" in notes["completed"]
    assert "that is seen, not by the whole" not in notes["completed"]
