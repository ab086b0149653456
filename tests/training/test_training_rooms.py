"""What the shipped network learns from and is calibrated on: scattered rooms and roaming cameras."""

from __future__ import annotations

import numpy as np
import pytest
from needs import needs

from pipeline.geometry import viewer_axes
from pipeline.synthetic import Room, exact_view, make_scattered, roaming_cameras
from pipeline.synthetic.layout import Instance, overlaps, part_boxes
from pipeline.synthetic.scattered import NEAR_SHARE, NEAREST_M, SCATTERED, TABLE_TOP
from pipeline.training import make_samples

pytestmark = needs("embreex")


WIDTH, HEIGHT = 160, 120


@pytest.fixture(scope="module")
def rooms() -> list[Room]:
    return [make_scattered(seed) for seed in range(12)]


def boxes_of(instance: Instance) -> np.ndarray:
    return part_boxes(instance.model, instance.position, instance.yaw)


def test_scattered_rooms_are_repeatable_and_of_both_kinds(rooms: list[Room]) -> None:
    assert {room.kind for room in rooms} == {SCATTERED, TABLE_TOP}
    again = make_scattered(3)
    assert [i.model.key for i in again.instances] == [i.model.key for i in rooms[3].instances]
    np.testing.assert_array_equal([i.position for i in again.instances], [i.position for i in rooms[3].instances])
    assert len({len(room.instances) for room in rooms}) > 4


def test_scattered_things_reach_into_each_other_only_where_they_lean(rooms: list[Room]) -> None:
    leaning = 0
    for room in rooms:
        boxes = [boxes_of(i) for i in room.instances]
        for k, a in enumerate(boxes):
            for j in range(k):
                if overlaps(a, boxes[j]).any():
                    assert "board" in (room.instances[k].model.label, room.instances[j].model.label)
                    leaning += 1
    assert leaning


def test_some_things_stand_on_others_and_some_lie_beside_them(rooms: list[Room]) -> None:
    supported = [i for room in rooms for i in room.instances if i.support >= 0]
    assert len(supported) > 40
    assert sum(i.model.label == "board" for room in rooms for i in room.instances) > 5


@pytest.mark.slow
def test_roaming_cameras_are_low_and_high_steep_and_rolled(rooms: list[Room]) -> None:
    heights, pitches, rolls, cut = [], [], [], 0
    for room in rooms:
        cameras = roaming_cameras(room, 3, np.random.default_rng(room.seed), WIDTH, HEIGHT)
        for camera in cameras:
            assert camera.T_world_camera is not None
            assert camera.up is not None
            depth, ids = exact_view(room, camera)
            assert ((depth > 0) & (depth < NEAREST_M)).mean() < 2 * NEAR_SHARE + 0.01
            edge = np.concatenate([ids[0], ids[-1], ids[:, 0], ids[:, -1]])
            cut += (edge >= 0).any()
            if room.kind == SCATTERED:
                heights.append(camera.T_world_camera[2, 3])
            pitches.append(np.rad2deg(viewer_axes(camera.up).pitch))
            rolls.append(np.rad2deg(np.arctan2(camera.up[0], -camera.up[1])))
    assert min(heights) < 0.8
    assert max(heights) > 1.7
    assert max(pitches) > 40
    assert np.ptp(rolls) > 10
    assert cut > len(pitches) / 2


@pytest.mark.slow
@pytest.mark.parametrize("maker", ["varied", "scattered"])
def test_samples_of_every_maker_see_less_than_there_is(maker: str) -> None:
    frames = make_samples([700_001], views=3, width=480, height=360, maker=maker)  # pyright: ignore
    seen = np.concatenate([f.seen_hi - f.seen_lo for f in frames])
    exact = np.concatenate([f.exact_hi - f.exact_lo for f in frames])
    assert len(seen) > 10
    assert np.median(seen / exact) < 1
    assert np.mean(seen < exact + 0.1) > 0.8
