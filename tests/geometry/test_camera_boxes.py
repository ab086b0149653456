"""The camera, the frame and boxes: geometry against independent arithmetic, and input that must be refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import camera_of, random_rotation

from pipeline.geometry import (
    CORNER_SIGNS,
    EDGES,
    Annotation,
    Box3D,
    Camera,
    Frame,
    backproject,
    intrinsics,
    iou_2d,
    iou_3d,
    lift_pixels,
    project,
    to_world,
)
from pipeline.geometry.boxes import most_iou_3d, ray_entry
from pipeline.system import InputError

CAMERAS = st.builds(
    lambda fx, fy, cx, cy: Camera(intrinsics(fx, fy, cx, cy), 640, 480),
    st.floats(100, 2000),
    st.floats(100, 2000),
    st.floats(-50, 700),
    st.floats(-50, 500),
)
SEEDS = st.integers(0, 2**32 - 1)


@given(CAMERAS, SEEDS)
def test_a_projected_point_is_lifted_back_to_itself(camera: Camera, seed: int) -> None:
    points = np.random.default_rng(seed).uniform([-3, -3, 0.2], [3, 3, 9], (50, 3))
    uv = project(points, camera)
    lifted = lift_pixels(points[:, 2], camera, uv[:, 1], uv[:, 0])
    np.testing.assert_allclose(lifted, points, atol=1e-4, rtol=1e-4)


@given(CAMERAS, SEEDS)
def test_a_lifted_pixel_projects_to_itself(camera: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.3, 10, (camera.height, camera.width)).astype(np.float32)
    v, u = rng.integers(0, camera.height, 200), rng.integers(0, camera.width, 200)
    points = backproject(depth, camera, v, u)
    assert points.dtype == np.float32
    np.testing.assert_allclose(project(points, camera), np.stack([u, v], axis=1), atol=2e-3)
    np.testing.assert_array_equal(points[:, 2], depth[v, u])


def test_the_principal_point_is_straight_ahead_and_y_points_down() -> None:
    camera = Camera(intrinsics(500, 400, 320, 240), 640, 480)
    np.testing.assert_allclose(project(np.array([[0, 0, 2], [1, 1, 2.0]]), camera), [[320, 240], [570, 440]])


def test_nothing_behind_the_camera_has_a_pixel() -> None:
    behind = project(np.array([[0, 0, 0], [0.1, 0.2, -1.0], [0, 0, np.nan]]), camera_of())
    assert np.isnan(behind).all()
    assert np.isfinite(project(np.array([[[0, 0, 1.0]]]), camera_of())).all()


def test_pixels_without_depth_come_back_as_zeros() -> None:
    depth = np.zeros((240, 320), np.float32)
    assert not backproject(depth, camera_of(), np.array([3, 100]), np.array([7, 0])).any()


@given(SEEDS)
def test_points_in_the_world_keep_their_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.normal(size=3)
    points = rng.normal(size=(10, 3))
    expected = (T @ np.concatenate([points, np.ones((10, 1))], axis=1).T).T[:, :3]
    np.testing.assert_allclose(to_world(points, T), expected, atol=1e-12)


GOOD_K = intrinsics(500, 500, 320, 240)
LEFT_HANDED = np.diag([1.0, 1, -1, 1])


@pytest.mark.parametrize(
    ("K", "T", "up", "names"),
    [
        (np.where(GOOD_K == 320, np.nan, GOOD_K), None, None, "not finite"),
        (np.where(GOOD_K == 240, np.inf, GOOD_K), None, None, "not finite"),
        (intrinsics(-500, 500, 320, 240), None, None, "focal lengths must be positive.*fx=-500"),
        (intrinsics(500, 0, 320, 240), None, None, "focal lengths must be positive.*fy=0"),
        (GOOD_K.T, None, None, "last row.*column by column"),
        (np.eye(4), None, None, "3x3.*(4, 4)"),
        (GOOD_K, LEFT_HANDED, None, "not a rotation.*left-handed"),
        (GOOD_K, np.diag([1000.0, 1000, 1000, 1]), None, "not a rotation.*scaled"),
        (GOOD_K, np.full((4, 4), np.nan), None, "finite 4x4"),
        (GOOD_K, np.eye(3), None, "4x4"),
        (GOOD_K, None, np.zeros(3), "up vector"),
        (GOOD_K, None, np.array([0, np.nan, 1]), "up vector"),
        (GOOD_K, None, np.ones(2), "up vector"),
    ],
)
def test_a_hostile_camera_is_refused_with_its_cause(
    K: np.ndarray, T: np.ndarray | None, up: np.ndarray | None, names: str
) -> None:
    with pytest.raises(InputError) as caught:
        Camera(K, 640, 480, T, up)
    assert re.search(names.replace("(4, 4)", r"\(4, 4\)"), str(caught.value))
    assert "\n" not in str(caught.value)


def test_an_up_vector_is_made_a_unit_vector() -> None:
    camera = camera_of().with_up(np.array([0, -3.0, 4]), "imu")
    assert camera.up is not None
    np.testing.assert_allclose(camera.up, [0, -0.6, 0.8])


# Frames.


def frame_parts() -> tuple[np.ndarray, np.ndarray, Camera]:
    return np.zeros((240, 320, 3), np.uint8), np.full((240, 320), 1.5, np.float32), camera_of()


@pytest.mark.parametrize("factor", [1e-3, 1e3, 0.02])
def test_depth_of_the_wrong_unit_is_refused(factor: float) -> None:
    rgb, depth, camera = frame_parts()
    with pytest.raises(InputError, match=r"a/1: depth of the wrong unit.*depth scale"):
        Frame("a/1", rgb, depth * np.float32(factor), camera)


def test_a_unit_is_judged_by_the_measured_pixels_only() -> None:
    rgb, depth, camera = frame_parts()
    depth[:200] = 0
    assert Frame("a", rgb, depth, camera).height == 240


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.full((480, 640), 1.5, np.float32), "registered"),
        (np.full((240, 320), 1500, np.uint16), "float32 metres.*uint16"),
        (np.full((240, 320), 1.5), "float32 metres.*float64"),
        (np.zeros((240, 320), np.float32), "no usable depth.*only zeros"),
        (np.full((240, 320), np.inf, np.float32), "finite.*inf"),
        (np.full((240, 320), np.nan, np.float32), "finite.*nan"),
        (np.where(np.eye(240, 320, dtype=bool), np.nan, 1.5).astype(np.float32), "finite.*nan"),
        (np.where(np.eye(240, 320, dtype=bool), -1.0, 1.5).astype(np.float32), "at least 0.*-1"),
    ],
)
def test_a_frame_with_unusable_depth_is_refused(depth: np.ndarray, message: str) -> None:
    rgb, _, camera = frame_parts()
    with pytest.raises(InputError, match=message):
        Frame("a", rgb, depth, camera)


def test_sizes_that_disagree_are_refused() -> None:
    rgb, depth, camera = frame_parts()
    with pytest.raises(InputError, match=r"another image size.*160x120.*320x240"):
        Frame("a", rgb, depth, camera_of(160, 120))
    with pytest.raises(InputError, match="mask of annotation 3 has another size"):
        Frame("a", rgb, depth, camera, (Annotation(3, "mug", np.zeros(4), np.zeros((10, 10), bool)),))
    with pytest.raises(InputError, match="uint8"):
        Frame("a", rgb.astype(np.float32), depth, camera)
    with pytest.raises(InputError, match="colour"):
        Frame("a", rgb[..., 0], depth, camera)


def test_hostile_annotations_are_refused() -> None:
    with pytest.raises(InputError, match=r"annotation 2.*four finite"):
        Annotation(2, "mug", np.array([0, 0, np.nan, 1]))
    with pytest.raises(InputError, match=r"annotation 2.*bool \(H, W\).*uint8"):
        Annotation(2, "mug", np.zeros(4), np.zeros((4, 4), np.uint8))


def test_the_content_hash_is_that_of_the_picture() -> None:
    rgb, depth, camera = frame_parts()
    one = Frame("a", rgb, depth, camera)
    assert one.content_hash == Frame("b", rgb.copy(), depth * 2, camera).content_hash
    rgb = rgb.copy()
    rgb[100, 100, 1] = 1
    assert one.content_hash != Frame("a", rgb, depth, camera).content_hash


# Boxes in the image.

PIXEL_BOXES = st.lists(st.tuples(*[st.integers(0, 12)] * 4), min_size=1, max_size=5)


@given(PIXEL_BOXES, PIXEL_BOXES)
def test_iou_2d_counts_the_same_pixels_as_brute_force(a: list, b: list) -> None:
    grid = np.arange(12) + 0.5

    def covered(box: tuple) -> np.ndarray:
        x0, y0, x1, y1 = box
        return ((grid > y0) & (grid < y1))[:, None] & ((grid > x0) & (grid < x1))[None]

    expected = [[(covered(p) & covered(q)).sum() / max((covered(p) | covered(q)).sum(), 1) for q in b] for p in a]
    np.testing.assert_allclose(iou_2d(np.array(a), np.array(b)), expected, atol=1e-12)


def test_iou_2d_of_nothing_is_empty() -> None:
    assert iou_2d(np.zeros((0, 4)), np.ones((3, 4))).shape == (0, 3)


# Boxes in 3D.


def random_box(rng: np.random.Generator, spread: float = 0.4) -> Box3D:
    return Box3D(rng.uniform(-spread, spread, 3), random_rotation(rng), rng.uniform(0.3, 1.2, 3))


def inside(points: np.ndarray, box: Box3D) -> np.ndarray:
    return np.all(np.abs((points - box.center) @ box.R) <= box.size / 2, axis=1)


@pytest.mark.parametrize("seed", range(12))
def test_iou_3d_agrees_with_monte_carlo(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_box(rng), random_box(rng)
    points = a.center + (rng.uniform(-0.5, 0.5, (200_000, 3)) * a.size) @ a.R.T
    shared = inside(points, b).mean() * a.volume
    assert iou_3d(a, b) == pytest.approx(shared / (a.volume + b.volume - shared), abs=0.006)
    assert shared > 0, "the case says nothing"


@given(SEEDS)
@settings(max_examples=30)
def test_iou_3d_is_symmetric_bounded_and_rigid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_box(rng), random_box(rng)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.uniform(-5, 5, 3)
    overlap = iou_3d(a, b)
    assert 0 <= overlap <= 1
    assert iou_3d(b, a) == pytest.approx(overlap, abs=1e-9)
    assert iou_3d(a.transformed(T), b.transformed(T)) == pytest.approx(overlap, abs=1e-7)
    assert iou_3d(a, a) == pytest.approx(1, abs=1e-9)
    assert overlap <= most_iou_3d(a, b) <= 1 + 1e-8
    assert most_iou_3d(a, a) == pytest.approx(1, abs=1e-8)


@given(SEEDS)
@settings(max_examples=30)
def test_iou_3d_of_a_box_inside_another_is_the_ratio_of_volumes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outer = random_box(rng)
    small = outer.size.min() * 0.2
    inner = Box3D(outer.center + outer.R @ (outer.size * 0.1), random_rotation(rng), np.full(3, small))
    assert iou_3d(outer, inner) == pytest.approx(inner.volume / outer.volume, rel=1e-7)


@pytest.mark.parametrize("shift", [[1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 3, 0]])
@pytest.mark.parametrize("seed", [0, 1])
def test_boxes_that_only_touch_share_nothing(shift: list, seed: int) -> None:
    R = random_rotation(np.random.default_rng(seed))
    a = Box3D(np.zeros(3), R, np.ones(3))
    b = Box3D(R @ np.array(shift, float), R, np.ones(3))
    assert iou_3d(a, b) == pytest.approx(0, abs=1e-6)


def test_iou_3d_of_aligned_boxes_by_hand() -> None:
    a = Box3D(np.zeros(3), np.eye(3), np.array([2.0, 1, 1]))
    b = Box3D(np.array([1.0, 0, 0]), np.eye(3), np.array([2.0, 1, 1]))
    assert iou_3d(a, b) == pytest.approx(1 / 3)
    assert iou_3d(a, Box3D(np.zeros(3), np.eye(3), np.array([2.0, 0, 1]))) == 0


def test_corners_and_edges_are_those_of_a_box() -> None:
    box = random_box(np.random.default_rng(5))
    local = (box.corners - box.center) @ box.R
    np.testing.assert_allclose(local, CORNER_SIGNS * box.size / 2, atol=1e-12)
    lengths = np.linalg.norm(box.corners[EDGES[:, 0]] - box.corners[EDGES[:, 1]], axis=1)
    np.testing.assert_allclose(np.sort(lengths), np.sort(np.repeat(box.size, 4)))
    assert len({tuple(sorted(e)) for e in EDGES.tolist()}) == 12


@given(SEEDS)
def test_a_ray_enters_a_box_at_its_surface(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box, origin = random_box(rng), rng.normal(size=3) * 2
    direction = box.center + rng.normal(size=3) * 0.3 - origin
    t = ray_entry(box, origin, direction)
    along = origin + np.linspace(0, 5, 20_001)[:, None] * direction
    hits = np.flatnonzero(inside(along, box))
    if t is None:
        assert len(hits) <= 1
        return
    local = np.abs((origin + t * direction - box.center) @ box.R) / (box.size / 2)
    assert t == 0 or local.max() == pytest.approx(1, abs=1e-6)
    if len(hits):
        assert hits[0] * 5 / 20_000 == pytest.approx(t, abs=3e-4)
    assert ray_entry(box, box.center, direction) == 0
    assert ray_entry(box, box.center + box.size.sum() * direction / np.linalg.norm(direction), direction) is None


def test_a_ray_along_a_face_and_beside_it() -> None:
    box = Box3D(np.array([0, 0, 2.0]), np.eye(3), np.ones(3))
    ahead = np.array([0, 0, 1.0])
    assert ray_entry(box, np.zeros(3), ahead) == pytest.approx(1.5)
    assert ray_entry(box, np.zeros(3), 2 * ahead) == pytest.approx(0.75)
    assert ray_entry(box, np.array([0.6, 0, 0]), ahead) is None


@pytest.mark.parametrize(
    ("center", "R", "size", "message"),
    [
        (np.zeros(2), np.eye(3), np.ones(3), "needs center"),
        (np.array([0, 0, np.nan]), np.eye(3), np.ones(3), "finite"),
        (np.zeros(3), np.eye(3), np.array([1, 1, -1.0]), "at least 0"),
        (np.zeros(3), np.diag([1.0, 1, -1]), np.ones(3), "not a rotation"),
        (np.zeros(3), 2 * np.eye(3), np.ones(3), "not a rotation"),
    ],
)
def test_a_hostile_box_is_refused(center: np.ndarray, R: np.ndarray, size: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Box3D(center, R, size)
