"""Segmenters: masks by depth and colour against real ones, recorded masks, detectors as segmenters, the wiring."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import camera_of, frame_of, upright
from segmenter_checks import boxes_of, iou, masks_of, scene

from pipeline.datasets import demo_path, open_dataset
from pipeline.geometry import Camera, Frame, surface_normals
from pipeline.proposals import DepthSegmenter, box_mask
from pipeline.proposals.depth_segmenter import NEIGHBOURS, minimum_cut

SEEDS = st.integers(0, 2**32 - 1)


def segmented(frame: Frame, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return DepthSegmenter().segment(frame, boxes.astype(np.float32), ["thing"] * len(boxes))


# Depth and colour.


def grabcut(frame: Frame, box: np.ndarray) -> np.ndarray:
    """OpenCV's GrabCut by rectangle, on the box and its surroundings."""
    x0, y0, x1, y1 = (round(float(v)) for v in box)
    pad = max(8, int(0.4 * max(x1 - x0, y1 - y0)))
    left, top = max(x0 - pad, 0), max(y0 - pad, 0)
    crop = np.ascontiguousarray(frame.rgb[top : y1 + pad, left : x1 + pad, ::-1])
    trimap = np.zeros(crop.shape[:2], np.uint8)
    trimap[y0 - top : y1 - top, x0 - left : x1 - left] = cv2.GC_PR_FGD
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(crop, trimap, (0, 0, 1, 1), *models, 3, cv2.GC_INIT_WITH_MASK)
    mask = np.zeros(frame.depth.shape, np.bool_)
    mask[top : y1 + pad, left : x1 + pad] = np.isin(trimap, [cv2.GC_FGD, cv2.GC_PR_FGD])
    return mask


@pytest.mark.slow
def test_real_masks_are_met_better_than_by_grabcut_and_by_the_bare_box(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real" / "ycbv-bop")
    ours, compared, cut, box, alone = [], [], [], [], []
    for number, frame_id in enumerate(dataset.frame_ids):
        frame = dataset.load(frame_id)
        boxes, real = boxes_of(frame), masks_of(frame)
        segmenter = DepthSegmenter()
        masks, has_mask = segmenter.segment(frame, boxes, [a.label for a in frame.annotations])
        assert has_mask.all()
        ours += [iou(m, r) for m, r in zip(masks, real, strict=True)]
        box += [iou(box_mask(b, *frame.depth.shape), r) for b, r in zip(boxes, real, strict=True)]
        if number % 2 == 0:  # One of the two nearly equal frames of each scene is enough for the slow ones.
            alone += [iou(segmenter.segment(frame, b[None], ["x"])[0][0], r) for b, r in zip(boxes, real, strict=True)]
            cut += [iou(grabcut(frame, b), r) for b, r in zip(boxes, real, strict=True)]
            compared += ours[-len(real) :]
    assert len(ours) == 26
    assert len(cut) == len(compared) == len(alone) == 13
    assert np.mean(ours) >= 0.80
    assert np.mean(alone) >= 0.75
    assert np.mean(ours) > np.mean(box) + 0.12
    assert np.mean(compared) > np.mean(cut) + 0.08
    assert min(ours) > 0.4


@pytest.mark.slow
def test_rendered_rooms_are_met_too() -> None:
    dataset = open_dataset(demo_path())
    ours, box = [], []
    for frame_id in dataset.frame_ids[::5]:
        frame = dataset.load(frame_id)
        masks, _ = segmented(frame, boxes_of(frame))
        ours += [iou(m, r) for m, r in zip(masks, masks_of(frame), strict=True)]
        bare_boxes = [box_mask(b, *frame.depth.shape) for b in boxes_of(frame)]
        box += [iou(b, r) for b, r in zip(bare_boxes, masks_of(frame), strict=True)]
    assert len(ours) > 50
    assert np.mean(ours) > 0.76
    assert np.mean(ours) > np.mean(box) + 0.15


def test_depth_alone_tells_things_from_the_floor() -> None:
    frame = scene()
    masks, has_mask = segmented(frame, boxes_of(frame))
    assert has_mask.all()
    for mask, real in zip(masks, masks_of(frame), strict=True):
        assert iou(mask, real) > 0.85


@pytest.mark.parametrize("missing", [False, True])
def test_colour_alone_tells_a_picture_from_the_wall(missing: bool) -> None:
    v, u = np.mgrid[0:240, 0:320]
    disc = ((u - 150) / 60) ** 2 + ((v - 110) / 40) ** 2 < 1
    rgb = np.where(disc[..., None], np.array([180, 60, 40]), np.array([170, 170, 160])).astype(np.uint8)
    depth = np.full((240, 320), 2.0, np.float32)
    if missing:
        depth[60:160, 80:220] = 0
    box = np.array([[u[disc].min(), v[disc].min(), u[disc].max() + 1, v[disc].max() + 1]], np.float32)
    masks, has_mask = segmented(Frame("1", rgb, depth, camera_of()), box)
    assert has_mask.all()
    assert iou(masks[0], disc) > 0.93


@pytest.mark.slow
def test_a_mask_does_not_depend_on_the_run_or_on_boxes_elsewhere() -> None:
    frame = scene()
    boxes = boxes_of(frame)
    first, _ = segmented(frame, boxes)
    segmenter = DepthSegmenter()
    for _ in range(2):
        np.testing.assert_array_equal(segmenter.segment(frame, boxes, [""] * 3)[0], first)
    back, _ = segmented(frame, boxes[::-1])
    np.testing.assert_array_equal(back[::-1], first)
    for k in range(3):
        np.testing.assert_array_equal(segmented(frame, boxes[k : k + 1])[0][0], first[k])


@pytest.mark.slow
def test_another_picture_of_the_same_colours_is_another_picture() -> None:
    frame = scene()
    flat = replace(frame, depth=np.full_like(frame.depth, 2.0), annotations=())
    segmenter = DepthSegmenter()
    first, _ = segmenter.segment(frame, boxes_of(frame), [""] * 3)
    second, _ = segmenter.segment(flat, boxes_of(frame), [""] * 3)
    np.testing.assert_array_equal(second, segmented(flat, boxes_of(frame))[0])
    assert not np.array_equal(first, second)


def test_a_flipped_frame_gives_flipped_masks() -> None:
    frame = scene()
    K = frame.camera.K.copy()
    K[0, 2] = frame.width - 1 - K[0, 2]
    camera = Camera(K, frame.width, frame.height)
    other = Frame("f", frame.rgb[:, ::-1].copy(), frame.depth[:, ::-1].copy(), camera)
    boxes = boxes_of(frame)
    turned = boxes.copy()
    turned[:, [0, 2]] = frame.width - boxes[:, [2, 0]]
    masks, _ = segmented(frame, boxes)
    for mask, flipped in zip(masks, segmented(other, turned)[0], strict=True):
        assert iou(mask, flipped[:, ::-1]) > 0.95


def test_overlapping_boxes_share_no_pixel_and_only_lose_by_it() -> None:
    things = [upright((0.0, 1.0, 2.4), (0.9, 0.5, 0.3)), upright((0.2, 1.05, 1.9), (0.3, 0.4, 0.2))]
    frame = frame_of(things, ["cabinet", "bin"], pitch=20)
    boxes = boxes_of(frame)
    together, _ = segmented(frame, boxes)
    assert not (together[0] & together[1]).any()
    for k in range(2):
        alone, _ = segmented(frame, boxes[k : k + 1])
        assert not (together[k] & ~alone[0]).any()
        assert iou(together[k], masks_of(frame)[k]) > 0.8


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_a_mask_stays_in_its_box_and_is_never_empty(seed: int) -> None:
    frame = scene()
    rng = np.random.default_rng(seed)
    low = rng.uniform(-40, [320, 240], (3, 2))
    boxes = np.concatenate([low, low + rng.choice([0.4, 3, 12, 90, 500], (3, 2))], axis=1).astype(np.float32)
    masks, has_mask = segmented(frame, boxes)
    for mask, has, (x0, y0, x1, y1) in zip(masks, has_mask, boxes, strict=True):
        v, u = np.nonzero(mask)
        inside = x1 > 0 and y1 > 0 and x0 < 320 and y0 < 240
        assert len(v) > 0 if inside else len(v) == 0
        assert not has or inside
        if len(v):
            assert u.min() >= np.floor(x0)
            assert v.min() >= np.floor(y0)
            assert u.max() < np.ceil(x1)
            assert v.max() < np.ceil(y1)


@pytest.mark.parametrize(
    ("box", "pixels"),
    [
        ([0, 0, 320, 240], 320 * 240),
        ([-50, -50, 900, 900], 320 * 240),
        ([100, 100, 102, 140], 2 * 40),
        ([100.2, 50.7, 101.9, 51.2], 2 * 2),
        ([400, 10, 500, 60], 0),
        ([50, 50, 50, 50], 0),
        ([np.nan, 10, 50, 60], 0),
        ([10, 10, np.inf, 60], 0),
    ],
)
def test_boxes_that_nothing_can_be_said_of_stay_boxes(box: list[float], pixels: int) -> None:
    masks, has_mask = segmented(scene(), np.array([box], np.float32))
    assert not has_mask.any()
    assert masks.sum() == pixels


def test_no_box_gives_no_mask_and_a_box_of_three_pixels_is_not_lost() -> None:
    masks, has_mask = segmented(scene(), np.zeros((0, 4)))
    assert masks.shape == (0, 240, 320)
    assert has_mask.shape == (0,)
    masks, _ = segmented(scene(), np.array([[150, 130, 153, 133]]))
    assert 0 < masks.sum() <= 9
    assert masks[0, 130:133, 150:153].any()


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(1, 4))
def test_normals_of_a_plane_are_its_own(a: float, b: float, z: float) -> None:
    camera = camera_of(80, 60, 70)
    normal = np.array([a, b, -1.0]) / np.linalg.norm([a, b, -1.0])
    v, u = np.mgrid[0:60, 0:80]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    depth = (-z / (rays @ normal)).astype(np.float32)
    depth[20:23, 30:33] = 0
    found, known = surface_normals(depth, camera)
    assert not known[20:23, 30:33].any()
    assert known[4:-4, 4:-4].sum() == 52 * 72 - 9
    assert (found[known] @ normal > 0.9999).all()


def test_there_are_no_normals_at_depth_edges() -> None:
    depth = np.full((60, 80), 2.0, np.float32)
    depth[:, 40:] = 2.5
    _, known = surface_normals(depth, camera_of(80, 60, 70))
    assert known[4:-4, 4:35].all()
    assert known[4:-4, 45:-4].all()
    assert not known[:, 38:42].any()


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_the_cut_has_the_least_energy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    evidence = rng.integers(-4, 5, (3, 3)).astype(float)
    links = [rng.integers(0, 4, evidence[a].shape).astype(float) for a, _, _ in NEIGHBOURS]

    def energy(mask: np.ndarray) -> float:
        borders = sum((k * (mask[a] != mask[b])).sum() for k, (a, b, _) in zip(links, NEIGHBOURS, strict=True))
        return float(borders - evidence[mask].sum())

    every = ((np.arange(512)[:, None] >> np.arange(9)) & 1).astype(bool).reshape(-1, 3, 3)
    least = min(energy(m) for m in every)
    found = minimum_cut(evidence, links)
    assert energy(found) == least
    assert found.sum() == min(int(m.sum()) for m in every if energy(m) == least)
