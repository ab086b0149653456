"""Pixels by hand: shapes are exact, surfaces end at depth edges, parts of a mask never share a pixel."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pipeline.answering import PreparedFrame
from pipeline.corrections.draft import split_by_depth, split_by_line, split_by_polygon
from pipeline.drawing import Canvas, Gesture, read_gesture
from pipeline.drawing.depth_region import Surface, grown_region, surface_of
from pipeline.drawing.gestures import (
    THINNEST,
    applied,
    drawn,
    goes_around,
    polygon_mask,
    rectangle_mask,
    stroke_mask,
)
from pipeline.geometry import Camera, Frame, LiftConfig
from pipeline.system import InputError

HEIGHT, WIDTH = 60, 80
near_points = st.lists(st.tuples(st.floats(-20, WIDTH + 20), st.floats(-20, HEIGHT + 20)), min_size=1, max_size=8).map(
    np.array
)


def centres() -> np.ndarray:
    v, u = np.indices((HEIGHT, WIDTH))
    return np.stack([u + 0.5, v + 0.5], axis=-1)


def distance_to(line: np.ndarray) -> np.ndarray:
    """(H, W): of each pixel's centre to a polyline, by brute force."""
    found = np.full((HEIGHT, WIDTH), np.inf)
    for a, b in zip(line, np.vstack([line[1:], line[-1:]]), strict=True):
        length = float(np.dot(b - a, b - a))
        t = np.clip(((centres() - a) @ (b - a)) / length, 0, 1) if length > 1e-18 else np.zeros((HEIGHT, WIDTH))
        found = np.minimum(found, np.linalg.norm(centres() - (a + t[..., None] * (b - a)), axis=-1))
    return found


@settings(max_examples=25, deadline=None)
@given(line=near_points, radius=st.floats(0, 15))
def test_a_stroke_is_what_lies_within_its_radius(line: np.ndarray, radius: float) -> None:
    mask, far = stroke_mask(line, radius, HEIGHT, WIDTH), distance_to(line)
    radius = max(radius, THINNEST)
    assert mask[far < radius - 1e-6].all()
    assert not mask[far > radius + 1e-6].any()


@settings(max_examples=25, deadline=None)
@given(line=near_points, radius=st.floats(0, 12), seed=st.integers(0, 2**16))
def test_what_a_stroke_paints_the_same_stroke_erases(line: np.ndarray, radius: float, seed: int) -> None:
    mask = np.random.default_rng(seed).random((HEIGHT, WIDTH)) < 0.4
    covered = stroke_mask(line, radius, HEIGHT, WIDTH)
    assume(covered.any())
    painted = applied(mask, Gesture("stroke", line, True, radius))
    erased = applied(painted, Gesture("stroke", line, False, radius))
    assert painted[covered].all()
    assert not erased[covered].any()
    np.testing.assert_array_equal(erased[~covered], mask[~covered])
    np.testing.assert_array_equal(painted[~covered], mask[~covered])


@settings(max_examples=30, deadline=None)
@given(corners=st.lists(st.tuples(st.floats(-30, WIDTH + 30), st.floats(-30, HEIGHT + 30)), min_size=3, max_size=9))
def test_a_polygon_is_filled_as_point_in_polygon_has_it(corners: list[tuple[float, float]]) -> None:
    points = np.array(corners)
    mask = polygon_mask(points, HEIGHT, WIDTH)
    # The even-odd rule by another road: a ray to the right of each centre, edge by edge.
    inside = np.zeros((HEIGHT, WIDTH), np.bool_)
    x, y = centres()[..., 0], centres()[..., 1]
    for (ax, ay), (bx, by) in zip(points, np.roll(points, -1, axis=0), strict=True):
        crosses = (ay <= y) != (by <= y)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = ax + (y - ay) * (bx - ax) / (by - ay)
        inside ^= crosses & (at <= x)
    closed = np.vstack([points, points[:1]])
    off_edge = distance_to(closed) > 1e-6
    np.testing.assert_array_equal(mask[off_edge], inside[off_edge])


@settings(max_examples=30, deadline=None)
@given(
    x=st.floats(25, 55),
    y=st.floats(20, 40),
    radii=st.lists(st.floats(5, 18), min_size=5, max_size=12),
    turn=st.floats(0, 6),
)
def test_the_area_of_a_polygon_is_that_of_its_corners(x: float, y: float, radii: list[float], turn: float) -> None:
    angles = turn + np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    points = np.stack([x + np.array(radii) * np.cos(angles), y + np.array(radii) * np.sin(angles)], axis=1)
    around = float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())
    area = abs(cv2.contourArea(points.astype(np.float32)))
    assert abs(int(polygon_mask(points, HEIGHT, WIDTH).sum()) - area) <= around / 2 + 1
    # OpenCV fills the same, but for what its outline touches.
    filled = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.fillPoly(filled, [np.round((points - 0.5) * 256).astype(np.int32)], (1,), shift=8)
    differs = polygon_mask(points, HEIGHT, WIDTH) != filled.astype(np.bool_)
    assert not differs[distance_to(np.vstack([points, points[:1]])) > 1.2].any()


def test_a_rectangle_holds_the_centres_between_its_corners() -> None:
    mask = rectangle_mask(np.array([[10.4, 30.6], [20.6, 5.2]]), HEIGHT, WIDTH)
    rows, columns = np.nonzero(mask)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (10, 20, 5, 30)
    assert mask.sum() == 11 * 26


# ---- surfaces ---------------------------------------------------------------------------


def frame_of(depth: np.ndarray) -> Frame:
    height, width = depth.shape
    camera = Camera(np.array([[90.0, 0, width / 2], [0, 90.0, height / 2], [0, 0, 1]]), width, height)
    return Frame("f", np.full((height, width, 3), 120, np.uint8), depth.astype(np.float32), camera)


def steps(seed: int) -> np.ndarray:
    """(H, W): rectangles in front of a wall, each a depth edge away from all others, with holes."""
    rng = np.random.default_rng(seed)
    depth = np.full((HEIGHT, WIDTH), 4.0)
    for level in range(int(rng.integers(1, 5))):
        x, y = rng.integers(0, WIDTH - 20), rng.integers(0, HEIGHT - 16)
        depth[y : y + rng.integers(12, 30), x : x + rng.integers(14, 40)] = 1.0 + 0.4 * level
    depth[rng.random(depth.shape) < 0.002] = 0
    return depth


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    x=st.floats(0, WIDTH - 0.01),
    y=st.floats(0, HEIGHT - 0.01),
    tolerance=st.sampled_from([0.001, 0.005, 0.01, 0.03, 0.05]),
)
def test_a_region_never_crosses_a_depth_edge(seed: int, x: float, y: float, tolerance: float) -> None:
    depth = steps(seed)
    u, v = int(x), int(y)
    assume(depth[v, u] > 0)
    surface = surface_of(frame_of(depth))
    region = grown_region(surface, np.array([[x, y]]), tolerance)
    levels = np.unique(depth[region])
    assert len(levels) == 1
    assert levels[0] > 0
    # It is of one piece.
    count, _ = cv2.connectedComponents(region.astype(np.uint8), connectivity=4)
    assert count == 2
    # Where the pixel itself has a normal, the region is on its surface, and holds all of what is flat around.
    if surface.known[v, u]:
        assert region[v, u]
        _, whole = cv2.connectedComponents((depth == depth[v, u]).astype(np.uint8), connectivity=4)
        same = np.asarray(whole == whole[v, u])
        assert not (region & ~same).any()


def corner() -> tuple[np.ndarray, np.ndarray]:
    """Depth of a floor that meets a wall without any step, and where the floor is."""
    rows = np.arange(240)[:, None] - 120.0
    floor = 90.0 * 1.0 / np.maximum(rows, 1e-3)  # 1 m below the camera
    wall = np.full((240, 1), 2.0)
    depth = np.repeat(np.minimum(floor, wall), WIDTH, axis=1)
    return depth, np.repeat(floor < wall, WIDTH, axis=1)


def test_a_region_ends_at_a_crease_and_a_wide_tolerance_goes_on() -> None:
    depth, floor = corner()
    surface = surface_of(frame_of(depth))
    down, up = np.array([[40.0, 220.0]]), np.array([[40.0, 40.0]])
    for seed, own in ((down, floor), (up, ~floor)):
        region = grown_region(surface, seed, 0.01)
        assert region[own].mean() > 0.85
        assert (region & ~own).sum() < 0.12 * own.sum()
    both = grown_region(surface, down, 0.05)
    assert both.mean() > 0.95
    together = grown_region(surface, np.concatenate([down, up]), 0.01)
    np.testing.assert_array_equal(together, grown_region(surface, down, 0.01) | grown_region(surface, up, 0.01))


def test_a_region_grows_with_the_tolerance() -> None:
    rng = np.random.default_rng(3)
    depth = cv2.GaussianBlur(2 + 0.5 * rng.random((HEIGHT, WIDTH)), (0, 0), 5)
    surface = surface_of(frame_of(depth))
    sizes = [int(grown_region(surface, np.array([[40.5, 30.5]]), t).sum()) for t in (0.001, 0.005, 0.02, 0.05)]
    assert sizes[0] < sizes[-1] == HEIGHT * WIDTH


@pytest.mark.parametrize(
    ("x", "y", "tolerance", "said"),
    [
        (-1, 5, 0.01, "outside"),
        (5, 60, 0.01, "outside"),
        (40, 30, 0.01, "no depth"),
        (5, 5, 0.5, "tolerance"),
        (5, 5, float("nan"), "tolerance"),
    ],
)
def test_seeds_that_mean_nothing_are_refused(x: float, y: float, tolerance: float, said: str) -> None:
    depth = np.full((HEIGHT, WIDTH), 2.0)
    depth[20:40, 30:50] = 0
    surface: Surface = surface_of(frame_of(depth))
    with pytest.raises(InputError, match=said):
        grown_region(surface, np.array([[x, y]]), tolerance)


# ---- parts ------------------------------------------------------------------------------


def check_parts(mask: np.ndarray, parts: tuple[np.ndarray, ...]) -> None:
    assert len(parts) > 1
    assert np.array(parts).sum(axis=0).max() == 1
    np.testing.assert_array_equal(np.logical_or.reduce(parts), mask)
    sizes = [int(p.sum()) for p in parts]
    assert min(sizes) > 0
    assert sizes[0] == max(sizes)


@settings(max_examples=30, deadline=None)
@given(
    line=st.lists(st.tuples(st.floats(0, WIDTH), st.floats(0, HEIGHT)), min_size=2, max_size=12).map(np.array),
    seed=st.integers(0, 2**16),
)
def test_cut_parts_share_no_pixel_and_leave_none_out(line: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = stroke_mask(rng.uniform([5, 5], [WIDTH - 5, HEIGHT - 5], (3, 2)), rng.uniform(3, 15), HEIGHT, WIDTH)
    for cut in (split_by_line, split_by_polygon):
        try:
            parts = cut(mask, line)
        except InputError:
            continue
        check_parts(mask, parts)


@settings(max_examples=25, deadline=None)
@given(angle=st.floats(0, 2 * np.pi), offset=st.floats(-12, 12), wobble=st.floats(0, 1.5))
def test_a_straight_cut_has_each_half_on_its_side(angle: float, offset: float, wobble: float) -> None:
    """A short line in the middle of a disc cuts all of it: its ends go on."""
    mask = stroke_mask(np.array([[40.0, 30.0]]), 25, HEIGHT, WIDTH)
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    t = np.linspace(-8, 8, 9)[:, None]
    line = np.array([40.0, 30.0]) + t * along + (offset + wobble * np.sin(t)) * across
    one, other = split_by_line(mask, line)
    check_parts(mask, (one, other))
    side = (centres() - np.array([40.0, 30.0])) @ across - offset
    # The ends run on along their last quarter, which the wobble may turn.
    clear = np.abs(side) > 3 + 14 * wobble
    assert len(np.unique(one[mask & clear & (side > 0)])) <= 1
    assert len(np.unique(one[mask & clear & (side < 0)])) <= 1


def test_a_mask_comes_apart_where_its_depth_does() -> None:
    depth = np.full((HEIGHT, WIDTH), 3.0)
    depth[10:50, 10:30] = 1.0
    depth[10:50, 30:50] = 1.5
    depth[20:24, 12:16] = 0
    depth[40:42, 40:42] = 0.7
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[12:48, 12:48] = True
    parts = split_by_depth(mask, depth.astype(np.float32))
    check_parts(mask, parts)
    assert len(parts) == 2
    near = mask & (np.arange(WIDTH) < 30)
    assert sorted(int(p.sum()) for p in parts) == sorted((int(near.sum()), int((mask & ~near).sum())))
    with pytest.raises(InputError, match="one piece"):
        split_by_depth(near, depth.astype(np.float32))


# ---- what a hand has done ---------------------------------------------------------------


HOSTILE: list[tuple[Any, str]] = [
    (None, "movement"),
    ([], "movement"),
    ({"do": "stroke", "at": [[0.5, 0.5]], "evil": 1}, "movement"),
    ({"do": "rm -rf", "at": [[0.5, 0.5]]}, "expected 'stroke'"),
    ({"do": ["stroke"], "at": [[0.5, 0.5]]}, "expected 'stroke'"),
    ({"do": "stroke", "at": []}, "points of a stroke"),
    ({"do": "stroke", "at": [[0.5]]}, "at least 2"),
    ({"do": "stroke", "at": [[0.5, 0.5, 0.5]]}, "at most 2"),
    ({"do": "stroke", "at": "0.5,0.5"}, "a list"),
    ({"do": "stroke", "at": [[0.5, "x"]]}, "a number"),
    ({"do": "stroke", "at": [[0.5, 0.5], [0.1]]}, "at least 2"),
    ({"do": "stroke", "at": [[float("nan"), 0.5]]}, "finite"),
    ({"do": "stroke", "at": [[float("inf"), 0.5]]}, "finite"),
    ({"do": "stroke", "at": [[1e300, 0.5]]}, "outside"),
    ({"do": "stroke", "at": [[10**400, 0.5]]}, "a number"),
    ({"do": "stroke", "at": [[1.5, 1.5]], "radius": 0.01}, "no pixel"),
    ({"do": "stroke", "at": [[0.5, 0.5]], "radius": float("nan")}, "radius"),
    ({"do": "stroke", "at": [[0.5, 0.5]], "radius": -1}, "radius"),
    ({"do": "stroke", "at": [[0.5, 0.5]], "radius": 50}, "larger"),
    ({"do": "stroke", "at": [[0.5, 0.5]], "radius": "2"}, "number"),
    ({"do": "stroke", "at": [[0.5, 0.5]], "radius": True}, "number"),
    ({"do": "stroke", "at": [[0.5, 0.5]], "add": "yes"}, "true or false"),
    ({"do": "stroke", "at": [[0.5, 0.5]] * 100_000}, "at most 5000"),
    ({"do": "polygon", "at": [[0.1, 0.1], [0.2, 0.2]]}, "points of a polygon"),
    ({"do": "polygon", "at": [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]]}, "no pixel"),
    ({"do": "rectangle", "at": [[0.1, 0.1]]}, "two corners"),
    ({"do": "rectangle", "at": [[0.1, 0.1], [0.1, 0.9]]}, "no pixel"),
    ({"do": "depth", "at": [[0.5, 0.5]], "tolerance": 9}, "tolerance"),
    ({"do": "depth", "at": [[1.5, 0.5]]}, "outside"),
    ({"do": "cut", "at": [[0.5, 0.5], [0.6, 0.6]]}, "no pixels"),
]


@pytest.mark.parametrize(("message", "said"), HOSTILE)
def test_messages_that_mean_nothing_are_refused_in_one_line(message: Any, said: str) -> None:
    canvas = Canvas(PreparedFrame(frame_of(np.full((HEIGHT, WIDTH), 2.0))))
    with pytest.raises(InputError, match=said) as caught:
        drawn(read_gesture(message, HEIGHT, WIDTH), HEIGHT, WIDTH, canvas)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


def test_fractions_are_of_the_picture() -> None:
    message = {"do": "stroke", "at": [[0.25, 0.5], [0.5, 0.5]], "radius": 0.05, "add": False}
    found = read_gesture(message, HEIGHT, WIDTH)
    np.testing.assert_allclose(found.points, [[20, 30], [40, 30]])
    assert (found.radius, found.adds) == (4.0, False)


class AtPoints:
    """Finds what is as deep as a point."""

    name, takes_points = "points", True

    def fingerprint(self) -> str:
        return "points"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Any) -> tuple[np.ndarray, np.ndarray]:
        np.testing.assert_array_equal(boxes[:, :2], boxes[:, 2:])
        masks = np.stack([frame.depth == frame.depth[int(y), int(x)] for x, y, *_ in boxes])
        return masks, np.asarray(masks.any(axis=(1, 2)))


def test_a_click_asks_the_segmenter_that_is_open() -> None:
    depth = np.full((HEIGHT, WIDTH), 3.0)
    depth[20:45, 30:60] = 1.5
    context = PreparedFrame(frame_of(depth), LiftConfig())
    click = read_gesture({"do": "segment", "at": [[40, 30]]}, HEIGHT, WIDTH, fractions=False)
    np.testing.assert_array_equal(drawn(click, HEIGHT, WIDTH, Canvas(context, AtPoints())), depth == 1.5)
    with pytest.raises(InputError, match="no segmenter is open that takes points"):
        drawn(click, HEIGHT, WIDTH, Canvas(context))


def test_what_follows_the_depth_needs_the_picture() -> None:
    seed = read_gesture({"do": "depth", "at": [[40, 30]]}, HEIGHT, WIDTH, fractions=False)
    with pytest.raises(InputError, match="pictures"):
        drawn(seed, HEIGHT, WIDTH)
    depth = np.full((HEIGHT, WIDTH), 3.0)
    depth[20:45, 30:60] = 1.5
    canvas = Canvas(PreparedFrame(frame_of(depth), LiftConfig()))
    region = drawn(seed, HEIGHT, WIDTH, canvas)
    np.testing.assert_array_equal(region, depth == 1.5)
    corners = [[27, 17], [63, 48]]
    surface = read_gesture({"do": "surface", "at": corners}, HEIGHT, WIDTH, fractions=False)
    found = drawn(surface, HEIGHT, WIDTH, canvas)
    assert (found & region).sum() / (found | region).sum() > 0.85
    bare = drawn(Gesture("rectangle", np.array(corners, float)), HEIGHT, WIDTH)
    assert bare.sum() == 36 * 31


def test_a_cut_that_comes_back_to_its_start_goes_around() -> None:
    angles = np.linspace(0, 2 * np.pi, 20)
    assert goes_around(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    assert not goes_around(np.array([[0.0, 0.0], [1, 0], [2, 0.1], [3, 0]]))
