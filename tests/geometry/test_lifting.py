"""Fitting boxes to points, and lifting masks: every pixel accounted for, nothing random, boxes that are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from lifting_checks import LEVEL, SEEDS
from scenes import Plane, camera_of, cast, filled_cloud, random_rotation, up_of, upright

from pipeline.geometry import (
    Box3D,
    LiftConfig,
    LiftedObject,
    Pixel,
    Quality,
    clean,
    depth_edges,
    extents,
    iou_3d,
    lift,
    pca_box,
    project,
    viewer_axes,
)
from pipeline.geometry.surface import plane_depth

WIDTH, HEIGHT = 640, 480
CAMERA = camera_of(WIDTH, HEIGHT, 500)


# Cleaning: one constructed frame in which every reason must arise where it should.


def flat_mask(y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[y0:y1, x0:x1] = True
    return mask


def codes_of(mask: np.ndarray, depth: np.ndarray, config: LiftConfig | None = None) -> tuple[np.ndarray, bool]:
    evidence, fallback = clean(mask, depth, depth_edges(depth, config), config)
    return evidence.full(HEIGHT, WIDTH), fallback


def test_every_pixel_ends_with_the_right_reason() -> None:
    mask = flat_mask(100, 200, 100, 300)
    mask[150:155, 320:325] = True
    depth = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth[120:130, 120:130] = 0
    depth[120:130, 150:160] = 15
    depth[120:130, 180:190] = 0.2
    depth[:, 260:] = 3.0
    codes, fallback = codes_of(mask, depth)
    assert not fallback
    assert (codes[~mask] == Pixel.OUTSIDE).all()
    assert (codes[mask] != Pixel.OUTSIDE).all()
    assert (codes[120:130, 120:130] == Pixel.NO_DEPTH).all()
    assert (codes[120:130, 150:160] == Pixel.OUT_OF_RANGE).all()
    assert (codes[120:130, 180:190] == Pixel.OUT_OF_RANGE).all()
    # The 3x3 window makes an edge one pixel wide on either side of a step ...
    assert (codes[100:200, 259:261] == Pixel.DEPTH_EDGE).all()
    assert (codes[140:160, 258] == Pixel.KEPT).all()
    assert (codes[140:160, 261] == Pixel.KEPT).all()
    # ... and none around missing depth, which takes no part.
    assert (codes[119, 120:130] == Pixel.KEPT).all()
    assert (codes[119, 150:160] == Pixel.DEPTH_EDGE).all()
    # At 640 pixels two are eroded; the third is kept.
    assert (codes[100:102, 100:259] == Pixel.MASK_BORDER).all()
    assert (codes[104:196, 100:102] == Pixel.MASK_BORDER).all()
    assert (codes[102, 102:258] == Pixel.KEPT).all()
    # The core of the 5x5 island is a part too small to belong to the object.
    assert codes[152, 322] == Pixel.SMALL_PART
    assert set(np.unique(codes)) == {int(p) for p in Pixel}


def test_the_strip_beyond_a_depth_edge_is_judged_by_its_size() -> None:
    depth = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth[:, 290:] = 3.0
    codes, _ = codes_of(flat_mask(100, 200, 100, 300), depth)
    assert (codes[110:190, 292:297] == Pixel.SMALL_PART).all()
    codes, _ = codes_of(flat_mask(100, 200, 100, 300), depth, LiftConfig(part=0.02))
    assert (codes[110:190, 292:297] == Pixel.KEPT).all()


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_counts_sum_to_the_mask_and_what_is_kept_has_depth(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.choice(np.array([0, 0.1, 1, 1.01, 2, 12], np.float32), (HEIGHT // 8, WIDTH // 8))
    depth = np.kron(depth, np.ones((8, 8), np.float32))
    mask = np.kron(rng.random((HEIGHT // 16, WIDTH // 16)) < rng.uniform(0, 0.6), np.ones((16, 16))).astype(bool)
    evidence, _ = clean(mask, depth, depth_edges(depth))
    assert sum(evidence.counts().values()) == mask.sum()
    kept = evidence.full(HEIGHT, WIDTH) == Pixel.KEPT
    assert (mask[kept]).all()
    assert ((depth[kept] > 0.3) & (depth[kept] < 10)).all()


def test_depth_edges_follow_the_relative_step() -> None:
    depth = np.full((20, 40), 4.0, np.float32)
    depth[:, 20:] += 0.23
    assert not depth_edges(depth).any()
    depth[:, 20:] += 0.04
    assert depth_edges(depth)[:, 19:21].all()
    assert not depth_edges(depth)[:, :19].any()
    near = np.full((20, 40), 0.5, np.float32)
    near[:, 20:] += 0.058
    assert not depth_edges(near).any()
    near[:, 20:] += 0.004
    assert depth_edges(near)[:, 19:21].all()
    assert not depth_edges(np.zeros((5, 5), np.float32)).any()


def test_a_slope_is_no_edge() -> None:
    floor = cast(CAMERA, [], [Plane((0, 1, 0), 1.2)], viewer_axes(up_of(40)))
    assert not depth_edges(floor.depth).any()


FLAT = np.full((HEIGHT, WIDTH), 2.0, np.float32)


@pytest.mark.parametrize(("wide", "left"), [(20, 16), (7, 3), (6, 4), (5, 3), (4, 2), (3, 3)])
def test_erosion_stops_before_less_than_40_percent_remains(wide: int, left: int) -> None:
    # A strip 100 high: one step leaves 98 x (wide - 2), a second 96 x (wide - 4), unless that is too little.
    mask = flat_mask(100, 200, 100, 100 + wide)
    codes, fallback = codes_of(mask, FLAT)
    assert not fallback
    kept = codes == Pixel.KEPT
    assert kept[150].sum() == left
    assert kept.sum() >= 0.4 * mask.sum()


def test_erosion_scales_with_the_width_of_the_image() -> None:
    for width, steps in ((160, 0), (320, 1), (640, 2), (1920, 6)):
        mask = np.zeros((200, width), bool)
        mask[50:150, 20:140] = True
        depth = np.full(mask.shape, 2, np.float32)
        evidence, _ = clean(mask, depth, depth_edges(depth))
        assert evidence.counts()["kept"] == (100 - 2 * steps) * (120 - 2 * steps)


@pytest.mark.parametrize(
    ("mask", "kept"),
    [
        (flat_mask(0, 100, 100, 200), (98, 96)),
        (flat_mask(HEIGHT - 100, HEIGHT, 100, 200), (98, 96)),
        (flat_mask(100, 200, 0, 100), (96, 98)),
        (flat_mask(100, 200, WIDTH - 100, WIDTH), (96, 98)),
        (flat_mask(0, HEIGHT, 0, WIDTH), (HEIGHT, WIDTH)),
    ],
)
def test_a_mask_is_not_eroded_where_the_image_ends(mask: np.ndarray, kept: tuple[int, int]) -> None:
    (found,) = lift(FLAT, CAMERA, [mask], LEVEL)
    assert found.quality.touches_border
    assert found.quality.points == kept[0] * kept[1]
    assert "cut by the image border" in found.quality.concerns


def test_a_mask_one_pixel_from_the_border_does_not_touch_it() -> None:
    (found,) = lift(FLAT, CAMERA, [flat_mask(1, HEIGHT - 1, 1, WIDTH - 1)], LEVEL)
    assert not found.quality.touches_border
    assert found.quality.concerns == ()


def test_a_small_mask_falls_back_to_all_its_valid_pixels() -> None:
    mask = flat_mask(100, 105, 100, 105)
    depth = FLAT.copy()
    depth[100, 100:103] = 0
    (found,) = lift(depth, CAMERA, [mask], LEVEL)
    assert found.quality.fallback
    assert found.quality.points == 22
    assert found.quality.mask_pixels == 25
    assert found.quality.depth_missing == pytest.approx(3 / 25)
    assert "too small to clean, raw mask used" in found.quality.concerns
    (large,) = lift(FLAT, CAMERA, [flat_mask(100, 106, 100, 110)], LEVEL)
    assert not large.quality.fallback


def test_both_parts_of_an_object_behind_a_post_are_kept() -> None:
    mask = flat_mask(100, 200, 100, 200) & ~flat_mask(0, HEIGHT, 140, 160)
    depth = FLAT.copy()
    depth[:, 140:160] = 1.2
    (found,) = lift(depth, CAMERA, [mask], LEVEL)
    u = project(found.points, CAMERA)[:, 0]
    assert u.min() == pytest.approx(102, abs=1)
    assert u.max() == pytest.approx(197, abs=1)
    assert found.lo[0] == pytest.approx((103 - CAMERA.cx) / CAMERA.fx * 2, abs=0.01)
    (largest,) = lift(depth, CAMERA, [mask], LEVEL, config=LiftConfig(part=1.0))
    np.testing.assert_array_equal(largest.points, found.points)  # equal halves are both the largest
    mask[:, 130:140] = False
    (one,) = lift(depth, CAMERA, [mask], LEVEL, config=LiftConfig(part=1.0))
    assert project(one.points, CAMERA)[:, 0].min() > 160


def test_parts_that_meet_at_a_corner_only_are_two_parts() -> None:
    large, small = flat_mask(100, 200, 100, 200), flat_mask(200, 215, 200, 215)
    codes, _ = codes_of(large | small, FLAT, LiftConfig(erode=0))
    assert (codes[large] == Pixel.KEPT).all()
    assert (codes[small] == Pixel.SMALL_PART).all()


# Lifting.


def noisy_scene(seed: int = 0) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """A box before a wall: depth with noise, holes and flying pixels, the exact mask and a mask that leaks."""
    import cv2

    seen = cast(CAMERA, [upright((0.1, 0.1, 1.5), (0.5, 0.4, 0.3), 15)], [Plane((0, 0, 1), 3.0)], LEVEL)
    exact = seen.ids == 0
    rng = np.random.default_rng(seed)
    kernel = np.ones((3, 3), np.uint8)
    rim = cv2.dilate(exact.view(np.uint8), kernel).astype(bool) & ~cv2.erode(exact.view(np.uint8), kernel).astype(bool)
    depth = seen.depth + rng.normal(size=exact.shape) * 0.0012 * (0.4 + seen.depth**2)
    flying = rim & (rng.random(exact.shape) < 0.35)
    depth[flying] = rng.uniform(1.4, 3.0, flying.sum())
    depth[rim & (rng.random(exact.shape) < 0.35)] = 0
    leaking = cv2.dilate(exact.view(np.uint8), kernel, iterations=2).astype(bool)
    return depth.astype(np.float32), [exact], [leaking]


def test_cleaning_beats_the_raw_mask_where_pixels_fly() -> None:
    raw_config = LiftConfig(edge=np.inf, edge_relative=0, erode=0, part=0)
    for seed in range(3):
        depth, exact, leaking = noisy_scene(seed)
        truth = cast(CAMERA, [upright((0.1, 0.1, 1.5), (0.5, 0.4, 0.3), 15)], [], LEVEL)
        (clear,) = lift(truth.depth, CAMERA, exact, LEVEL, config=raw_config)
        (cleaned,) = lift(depth, CAMERA, leaking, LEVEL)
        (raw,) = lift(depth, CAMERA, leaking, LEVEL, config=raw_config)

        def error(found: LiftedObject, clear: LiftedObject = clear) -> float:
            return float(np.abs(np.concatenate([found.lo - clear.lo, found.hi - clear.hi])).max())

        assert error(cleaned) < 0.02
        assert error(raw) > 5 * error(cleaned)


@pytest.mark.parametrize("mode", ["gravity", "pca", "pca-raw"])
def test_every_point_projects_to_its_own_pixel(mode) -> None:
    depth, exact, _ = noisy_scene()
    (found,) = lift(depth, CAMERA, exact, LEVEL, config=LiftConfig(box=mode, max_points=10**6))
    assert found.evidence is not None
    v, u = np.nonzero(found.evidence.full(HEIGHT, WIDTH) == Pixel.KEPT)
    np.testing.assert_allclose(project(found.points, CAMERA), np.stack([u, v], axis=1), atol=1e-2)
    np.testing.assert_array_equal(found.points[:, 2], depth[v, u])
    assert found.quality.distance == pytest.approx(np.median(depth[v, u]))


def test_thinning_is_even_and_keeps_at_most_8000() -> None:
    (found,) = lift(FLAT, CAMERA, [flat_mask(50, 450, 50, 600)], LEVEL)
    assert len(found.points) == 8000
    assert found.quality.points == 396 * 546
    uv = np.round(project(found.points, CAMERA)).astype(int)
    assert len(np.unique(uv, axis=0)) == 8000
    order = uv[:, 1] * WIDTH + uv[:, 0]
    assert (np.diff(order) > 0).all()
    counted = np.histogram2d(uv[:, 1], uv[:, 0], bins=(8, 8), range=((52, 448), (52, 598)))[0]
    assert counted.min() > 0.8 * 8000 / 64
    (small,) = lift(FLAT, CAMERA, [flat_mask(50, 54 + 80, 50, 54 + 100)], LEVEL)
    assert len(small.points) == small.quality.points == 8000


def test_lifting_twice_gives_the_same() -> None:
    depth, _, leaking = noisy_scene()
    (one,), (two,) = lift(depth, CAMERA, leaking, LEVEL), lift(depth.copy(), CAMERA, [leaking[0].copy()], LEVEL)
    assert one.points.tobytes() == two.points.tobytes()
    assert one.quality == two.quality
    assert one.box is not None
    assert two.box is not None
    np.testing.assert_array_equal(one.box.corners, two.box.corners)
    given_edges = lift(depth, CAMERA, leaking, LEVEL, edges=depth_edges(depth))[0]
    np.testing.assert_array_equal(given_edges.points, one.points)


@pytest.mark.parametrize(
    ("mask", "depth"),
    [
        (np.zeros((HEIGHT, WIDTH), bool), FLAT),
        (flat_mask(10, 60, 10, 60), np.zeros_like(FLAT)),
        (flat_mask(10, 60, 10, 60), np.full_like(FLAT, 11)),
    ],
)
def test_an_object_without_points_has_no_box_and_unknown_extents(mask: np.ndarray, depth: np.ndarray) -> None:
    (found,) = lift(depth, CAMERA, [mask], LEVEL)
    assert found.points.shape == (0, 3)
    assert found.box is None
    assert np.isnan(found.lo).all()
    assert np.isnan(found.hi).all()
    assert np.isnan(found.quality.distance)
    assert found.quality.mask_pixels == mask.sum()
    assert "no point has a valid depth" in found.quality.concerns


def test_no_masks_give_no_objects() -> None:
    assert lift(FLAT, CAMERA, [], LEVEL) == ()


def test_the_lifted_box_of_a_seen_box_is_about_right() -> None:
    viewer = viewer_axes(up_of(30))
    truth = upright((0.1, 0.6, 1.4), (0.5, 0.3, 0.25), 30)
    seen = cast(CAMERA, [truth], [Plane((0, 1, 0), 0.75)], viewer)
    (found,) = lift(seen.depth, CAMERA, [seen.ids == 0], viewer)
    assert found.box is not None
    level = Box3D(viewer.R_level_camera @ found.box.center, viewer.R_level_camera @ found.box.R, found.box.size)
    assert iou_3d(level, truth) > 0.6
    corners = seen.boxes[0].corners @ viewer.matrix.T
    lo, hi = corners.min(axis=0), corners.max(axis=0)
    np.testing.assert_allclose(found.lo, lo, atol=0.04)
    # Of the far end only the tip of the top face is seen, fewer than 1 % of the pixels.
    np.testing.assert_allclose(found.hi[:2], hi[:2], atol=0.04)
    assert hi[2] - 0.15 < found.hi[2] < hi[2] + 0.005


def test_where_the_mask_came_from_is_a_concern_only_for_a_box() -> None:
    (found,) = lift(FLAT, CAMERA, [flat_mask(50, 150, 50, 150)], LEVEL, mask_source="box")
    assert found.quality.concerns == ("no mask: the whole 2D box was lifted",)
    quality = replace(found.quality, points=50, depth_missing=0.6, mask_source="detector")
    assert isinstance(quality, Quality)
    assert quality.concerns == ("only 50 points", "60% of the mask has no depth")


# Extents and edits.


def test_extents_come_from_points_then_the_box_then_nowhere() -> None:
    viewer = viewer_axes(up_of(20))
    points = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32) + 3
    box = Box3D(np.array([0, 0, 2.0]), np.eye(3), np.ones(3))
    lo, hi = extents(points, box, viewer)
    expected = np.percentile(points @ viewer.matrix.T, [1, 99], axis=0)
    np.testing.assert_allclose(np.stack([lo, hi]), expected, atol=1e-4)
    lo, hi = extents(points[:0], box, viewer)
    np.testing.assert_allclose(lo, (box.corners @ viewer.matrix.T).min(axis=0))
    np.testing.assert_allclose(hi, (box.corners @ viewer.matrix.T).max(axis=0))
    lo, hi = extents(points[:0], None, viewer)
    assert np.isnan([lo, hi]).all()


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_points_move_with_an_edited_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    (found,) = lift(FLAT, CAMERA, [flat_mask(100, 200, 100, 200)], LEVEL)
    cloud = filled_cloud(Box3D(np.array([0, 0, 2.0]), random_rotation(rng), np.array([0.5, 0.4, 0.3])), rng, 2000)
    box, _ = pca_box(cloud)
    lo, hi = extents(cloud, box, LEVEL)
    found = replace(found, points=cloud.astype(np.float32), box=box, lo=lo, hi=hi)
    edited = Box3D(rng.normal(size=3), random_rotation(rng), rng.uniform(0.1, 2, 3))
    moved = found.moved_to(edited, LEVEL)
    assert moved.box is edited
    before = (cloud - box.center) @ box.R / box.size
    after = (moved.points - edited.center) @ edited.R / edited.size
    np.testing.assert_allclose(after, before, atol=1e-4)
    np.testing.assert_allclose(np.stack([moved.lo, moved.hi]), extents(moved.points, edited, LEVEL)[:2], atol=1e-6)
    back = moved.moved_to(box, LEVEL)
    np.testing.assert_allclose(back.points, cloud, atol=1e-4)
    still = found.moved_to(box, LEVEL)
    np.testing.assert_allclose(still.points, cloud, atol=1e-5)


def test_a_drawn_box_gives_an_object_without_points_its_extents() -> None:
    (found,) = lift(np.zeros_like(FLAT), CAMERA, [flat_mask(10, 60, 10, 60)], LEVEL)
    drawn = found.moved_to(Box3D(np.array([0, 0, 2.0]), np.eye(3), np.ones(3)), LEVEL)
    assert not len(drawn.points)
    np.testing.assert_allclose(drawn.lo, [-0.5, -0.5, 1.5])
    np.testing.assert_allclose(drawn.hi, [0.5, 0.5, 2.5])


def test_pixels_in_a_line_bear_no_plane() -> None:
    rng = np.random.default_rng(0)
    x, y = (np.arange(84) - 42) / 100.0, (np.arange(46) - 23) / 100.0
    for row, column in zip(rng.integers(5, 40, 100), rng.integers(5, 70, 100), strict=True):
        has = np.zeros((46, 84), np.bool_)
        has[row, column : column + 6] = True
        depth = np.where(has, 1.8 + 0.01 * rng.standard_normal(has.shape), 0).astype(np.float32)
        assert np.abs(plane_depth(depth, has, x, y, 3) - depth).max() < 0.2
