"""What the shipped network learns from and is calibrated on: scattered rooms, roaming cameras, rooms of solids."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from needs import needs

from pipeline.geometry import lift_pixels, viewer_axes
from pipeline.synthetic import Room, assembled_view, exact_view, make_scattered, roaming_cameras, solid_view
from pipeline.synthetic.layout import Instance, overlaps, part_boxes
from pipeline.synthetic.scattered import NEAR_SHARE, NEAREST_M, SCATTERED, TABLE_TOP
from pipeline.synthetic.solids import Solid, solid
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


@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from(["box", "cylinder", "ball"]),
    seed=st.integers(0, 1000),
)
def test_a_solids_reach_is_that_of_its_surface(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    made = Solid(kind, rng.normal(size=(3, 3)) + 2 * np.eye(3), rng.normal(size=3))  # pyright: ignore[reportArgumentType]
    unit = rng.normal(size=(20_000, 3))
    if kind == "ball":
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    elif kind == "box":
        unit /= 2 * np.abs(unit).max(axis=1, keepdims=True)
    else:
        unit[:, :2] /= np.linalg.norm(unit[:, :2], axis=1, keepdims=True)
        unit[:, 2] = rng.choice([-0.5, 0.5], len(unit))
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    along = (unit @ made.A.T) @ axes.T
    reach = made.reach(axes)
    assert (along.max(axis=0) <= reach + 1e-9).all()
    assert (along.max(axis=0) >= 0.9 * reach).all()


@pytest.mark.parametrize("kind", ["box", "cylinder", "ball"])
def test_rays_meet_a_solid_on_its_surface(kind: str) -> None:
    made = solid(kind, (0.4, 0.4, 0.6), np.array([0.1, 2.0, 0.3]), 0.5, lean=0.3)  # pyright: ignore[reportArgumentType]
    low = made.t - made.reach(np.eye(3))
    assert low[2] == pytest.approx(0.3)
    aim = made.t + np.random.default_rng(0).normal(0, 0.15, (500, 3))
    met = made.met(np.zeros(3), aim)
    hit = np.isfinite(met)
    assert hit.sum() > 100
    unit = (met[hit, None] * aim[hit] - made.t) @ np.linalg.inv(made.A).T
    radius = np.linalg.norm(unit[:, :2], axis=1)
    if kind == "box":
        on = 2 * np.abs(unit).max(axis=1)
    elif kind == "ball":
        on = np.linalg.norm(unit, axis=1)
    else:
        on = np.maximum(radius, 2 * np.abs(unit[:, 2]))
    np.testing.assert_allclose(on, 1, atol=1e-9)


def test_views_of_solids_show_what_is_there() -> None:
    errors = []
    for seed in range(6):
        view = solid_view(seed, 0, WIDTH, HEIGHT)
        assert view.camera.up is not None
        viewer = viewer_axes(view.camera.up)
        exact = view.exact(viewer.matrix)
        assert len(exact) == len(view.masks) == len(view.things)
        for mask, (lo, hi) in zip(view.masks, exact, strict=True):
            v, u = np.nonzero(mask & (view.depth > 0))
            along = lift_pixels(view.depth[v, u], view.camera, v, u) @ viewer.matrix.T
            if len(along):
                errors.append(np.maximum(lo - np.median(along, axis=0), np.median(along, axis=0) - hi).max())
    assert len(errors) > 8
    # The middle of what a mask shows lies within the thing, but for noise.
    assert np.mean(np.array(errors) < 0.05) > 0.9
    again = solid_view(3, 0, WIDTH, HEIGHT)
    np.testing.assert_array_equal(again.depth, solid_view(3, 0, WIDTH, HEIGHT).depth)


def test_assembled_views_show_what_is_there() -> None:
    views = [view for seed in range(12) if (view := assembled_view(seed, 160, 120, 60)) is not None]
    assert len(views) >= 8
    errors, names = [], set()
    for view in views:
        assert view.camera.up is not None
        assert len(view.masks) == len(view.labels) == len(view.exact)
        axes = viewer_axes(view.camera.up).matrix.T
        names |= set(view.labels)
        for mask, (lo, hi) in zip(view.masks, view.exact, strict=True):
            v, u = np.nonzero(mask & (view.depth > 0))
            middle = np.median(lift_pixels(view.depth[v, u], view.camera, v, u) @ axes, axis=0) if len(v) else lo
            errors.append(np.maximum(lo - middle, middle - hi).max())
    assert np.mean(np.array(errors) < 0.05) > 0.9
    assert len(names) > 8
    again = assembled_view(3, 160, 120, 60)
    assert again is not None
    np.testing.assert_array_equal(again.depth, assembled_view(3, 160, 120, 60).depth)  # pyright: ignore


@pytest.mark.slow
@pytest.mark.parametrize("maker", ["varied", "scattered", "assembled", "solids"])
def test_samples_of_every_maker_see_less_than_there_is(maker: str) -> None:
    seeds = range(700_001, 700_009 if maker == "assembled" else 700_002)
    frames = make_samples(seeds, views=3, width=480, height=360, maker=maker)  # pyright: ignore
    seen = np.concatenate([f.seen_hi - f.seen_lo for f in frames])
    exact = np.concatenate([f.exact_hi - f.exact_lo for f in frames])
    assert len(seen) > 10
    assert np.median(seen / exact) < 1
    assert np.mean(seen < exact + 0.1) > 0.8
