"""Segmenters: masks by depth and colour against real ones, recorded masks, detectors as segmenters, the wiring."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pycocotools import mask as coco
from scenes import camera_of, frame_of, upright

from pipeline.answering.objects import PreparedFrame, all_objects
from pipeline.answering.opening import open_pipeline, relate_frames
from pipeline.datasets import open_dataset
from pipeline.datasets.demo import demo_path
from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.normals import surface_normals
from pipeline.proposals import AnnotationDetector, CachedDetector, Proposals, Segmented, Segmenter, make_segmenter
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.depth_segmenter import NEIGHBOURS, DepthSegmenter, minimum_cut
from pipeline.proposals.recorded_masks import open_recorded_masks
from pipeline.proposals.segmenter import DetectorSegmenter, Segments, assign
from pipeline.system.errors import FrameUnusable, InputError

SEEDS = st.integers(0, 2**32 - 1)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def boxes_of(frame: Frame) -> np.ndarray:
    return np.stack([a.bbox for a in frame.annotations])


def masks_of(frame: Frame) -> list[np.ndarray]:
    masks = [a.mask for a in frame.annotations if a.mask is not None]
    assert len(masks) == len(frame.annotations)
    return masks


def bare(frame: Frame) -> Frame:
    """The frame with boxes only."""
    return replace(frame, annotations=tuple(replace(a, mask=None, box=None) for a in frame.annotations))


@lru_cache(maxsize=1)
def scene() -> Frame:
    """Three boxes on a floor, of random colours in every pixel: only the depth tells them apart."""
    things = [upright((x, 1.0, 1.9 + 0.2 * k), (0.35, 0.4, 0.3), 25 * k) for k, x in enumerate((-0.65, 0.0, 0.65))]
    return frame_of(things, ["mug", "laptop", "mug"], pitch=25)


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
        alone += [iou(segmenter.segment(frame, b[None], ["x"])[0][0], r) for b, r in zip(boxes, real, strict=True)]
        box += [iou(box_mask(b, *frame.depth.shape), r) for b, r in zip(boxes, real, strict=True)]
        if number % 2 == 0:  # One of the two nearly equal frames of each scene is enough for the slow one.
            cut += [iou(grabcut(frame, b), r) for b, r in zip(boxes, real, strict=True)]
            compared += ours[-len(real) :]
    assert len(ours) == 26
    assert len(cut) == len(compared) == 13
    assert np.mean(ours) >= 0.80
    assert np.mean(alone) >= 0.75
    assert np.mean(ours) > np.mean(box) + 0.12
    assert np.mean(compared) > np.mean(cut) + 0.08
    assert min(ours) > 0.4


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


@settings(max_examples=40, deadline=None)
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


# Behind a detector.


class Stub:
    """A segmenter that remembers what it was asked and gives the left half of each box."""

    name = "stub"

    def __init__(self) -> None:
        self.asked: list[list[str]] = []

    def fingerprint(self) -> str:
        return "stub:1"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        self.asked.append(list(labels))
        half = boxes.copy()
        half[:, 2] = (boxes[:, 0] + boxes[:, 2]) / 2
        masks = [box_mask(b, frame.height, frame.width) for b in half]
        return np.stack(masks), np.array([label != "laptop" for label in labels])


class Boxes:
    """A detector that is not exact and gives boxes only."""

    name = "boxes"
    exact = False
    vocabulary = None

    def __init__(self, boxes: np.ndarray) -> None:
        self.boxes = boxes.astype(np.float32)

    def fingerprint(self) -> str:
        return "boxes:1"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        n = len(self.boxes)
        scores = np.linspace(0.2, 0.9, n).astype(np.float32)
        return Proposals(self.boxes, scores, np.zeros(n, np.int64), ("mug",), None, np.arange(n))


def test_only_boxes_without_masks_are_segmented() -> None:
    frame = scene()
    mixed = replace(frame, annotations=(frame.annotations[0], *bare(frame).annotations[1:]))
    stub = Stub()
    detector = Segmented(AnnotationDetector(("mug", "laptop")), stub)
    found = detector.detect(mixed, None)
    assert stub.asked == [["laptop", "mug"]]
    assert found.masks is not None
    assert found.has_mask is not None
    assert found.segmented is not None
    assert found.has_mask.tolist() == [True, False, True]
    assert found.segmented.tolist() == [False, False, True]
    assert found.ids.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(found.masks[0], frame.annotations[0].mask)
    np.testing.assert_array_equal(found.masks[1], box_mask(frame.annotations[1].bbox, 240, 320))
    assert 0 < found.masks[2].sum() < box_mask(frame.annotations[2].bbox, 240, 320).sum()
    assert found.take(np.array([2])).segmented is not None
    objects = all_objects(PreparedFrame(mixed), detector)
    assert [o.lifted.quality.mask_source for o in objects] == ["annotation", "box", "segmenter"]
    assert objects[1].lifted.quality.concerns == ("no mask: the whole 2D box was lifted",)
    assert objects[2].lifted.quality.concerns == (), "a segmenter's mask is no reason to doubt by itself"


def test_the_detector_behind_stays_what_it_is() -> None:
    inner = AnnotationDetector(("mug", "laptop"))
    detector = Segmented(inner, Stub())
    assert detector.exact
    assert detector.vocabulary == inner.vocabulary
    assert detector.name == "annotations+stub"
    assert inner.fingerprint() in detector.fingerprint()
    assert detector.fingerprint() != Segmented(inner, DepthSegmenter()).fingerprint()
    assert isinstance(Stub(), Segmenter)
    whole = detector.detect(scene(), ["mug"])
    assert whole.segmented is None
    assert len(detector.detect(bare(replace(scene(), annotations=())), None)) == 0


def test_exact_masks_do_not_depend_on_the_question() -> None:
    frame = bare(scene())
    stub = Stub()
    detector = Segmented(AnnotationDetector(("mug", "laptop")), stub)
    some = detector.detect(frame, ["mug"])
    everything = detector.detect(frame, None)
    assert some.masks is not None
    assert everything.masks is not None
    np.testing.assert_array_equal(some.masks, everything.masks[[0, 2]])
    assert stub.asked == [["mug", "laptop", "mug"]]
    detector.detect(replace(frame, depth=frame.depth.copy()), None)
    assert len(stub.asked) == 2


def test_guesses_at_a_thing_are_segmented_one_by_one_and_the_best_first() -> None:
    boxes = boxes_of(scene())[[0, 0, 2]] + np.array([[0], [1], [0]])
    stub = Stub()
    found = Segmented(Boxes(boxes), stub).detect(scene(), ["mug"])
    assert stub.asked == [["mug"]] * 3
    assert found.segmented is not None
    assert found.segmented.all()
    assert found.masks is not None
    assert (found.masks[0] & found.masks[1]).any()
    many = np.repeat(boxes, 25, axis=0)
    found = Segmented(Boxes(many), Stub()).detect(scene(), None)
    assert found.segmented is not None
    assert found.segmented.tolist() == [False] * 25 + [True] * 50


def test_a_segmenter_that_breaks_the_contract_is_named() -> None:
    class Bad(Stub):
        def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros((len(boxes), 5, 5), np.uint8), np.ones(len(boxes), bool)

    with pytest.raises(InputError, match="'stub' must give masks bool"):
        Segmented(AnnotationDetector(), Bad()).detect(bare(scene()), None)


def test_an_exact_3d_box_goes_before_the_segmenter() -> None:
    frame = scene()
    known = tuple(replace(a, mask=None, box=a.box if a.index else None) for a in frame.annotations)
    objects = all_objects(PreparedFrame(replace(frame, annotations=known)), Segmented(AnnotationDetector(), Stub()))
    assert [o.lifted.quality.mask_source for o in objects] == ["segmenter", "box3d", "box3d"]


def test_the_cache_keeps_whose_masks_they_are(tmp_path: Path) -> None:
    frame = bare(scene())
    for _ in range(2):
        found = CachedDetector(Segmented(AnnotationDetector(), Stub()), tmp_path).detect(frame, None)
        assert found.segmented is not None
        assert found.segmented.tolist() == [True, False, True]


def test_lifted_boxes_gain_by_the_masks() -> None:
    frame = scene()
    plain = all_objects(PreparedFrame(bare(frame)), AnnotationDetector())
    better = all_objects(PreparedFrame(bare(frame)), Segmented(AnnotationDetector(), DepthSegmenter()))
    for box, mask, real in zip(plain, better, all_objects(PreparedFrame(frame), AnnotationDetector()), strict=True):
        off = [np.abs(o.lifted.hi - real.lifted.hi).max() for o in (box, mask)]
        assert off[1] < 0.06
        assert off[1] < off[0]


# Assignment.


def assigned(boxes: Any, labels: Sequence[str], rectangles: Any, names: Sequence[str | None]) -> list[int]:
    segments = Segments(np.array(rectangles, float).reshape(-1, 4), tuple(names), lambda i: np.zeros((1, 1), bool))
    return assign(np.array(boxes, float).reshape(-1, 4), labels, segments).tolist()


def test_each_segment_goes_once_to_the_box_that_it_fits() -> None:
    box = [0, 0, 10, 10]
    assert assigned([box], ["mug"], [[0, 0, 10, 4], [0, 0, 10, 6]], [None, None]) == [1]
    assert assigned([box], ["mug"], [[0, 0, 10, 4]], [None]) == [-1]
    assert assigned([box, box], ["mug", "mug"], [box, [0, 0, 10, 6]], [None, None]) in ([0, 1], [1, 0])
    assert assigned([box, [0, 0, 10, 9]], ["mug"] * 2, [box], [None]) == [0, -1]
    # Both can be served only if the better fit goes to the second box.
    assert assigned([box, [0, 0, 10, 18]], ["mug"] * 2, [[0, 0, 10, 9.5], [0, 0, 6, 10]], [None, None]) == [1, 0]
    # A box name goes before a better fit of another; names are compared by meaning.
    assert assigned([box], ["trash cans"], [box, [0, 0, 10, 6]], ["laptop", "garbage can"]) == [1]
    assert assigned([box], ["mug"], [box], ["laptop"]) == [0]
    # Of equal overlaps, the one that lies inside.
    assert assigned([box], ["mug"], [[0, 0, 10, 20], [0, 0, 10, 5]], [None, None]) == [1]
    assert assigned([], [], [box], [None]) == []
    assert assigned([box], ["mug"], [], []) == [-1]
    assert assigned([[5, 5, 5, 5]], ["mug"], [[5, 5, 5, 5]], [None]) == [-1]


def test_a_detector_serves_as_a_segmenter() -> None:
    frame = scene()
    segmenter = DetectorSegmenter(AnnotationDetector())
    boxes = np.concatenate([boxes_of(frame)[::-1] + 1, [[0, 0, 20, 20]]]).astype(np.float32)
    masks, has_mask = segmenter.segment(frame, boxes, ["mug", "laptop", "mug", "mug"])
    assert has_mask.tolist() == [True, True, True, False]
    for mask, real in zip(masks, masks_of(frame)[::-1], strict=False):
        np.testing.assert_array_equal(mask, real)
    _, has_mask = segmenter.segment(bare(frame), boxes, ["mug"] * 4)
    assert not has_mask.any()
    assert not DetectorSegmenter(Boxes(boxes)).segment(frame, boxes, ["mug"] * 4)[1].any()


# Recorded masks.


def run_lengths(mask: np.ndarray) -> dict[str, Any]:
    encoded: Any = coco.encode(np.asfortranarray(mask.astype(np.uint8)))
    return {"size": list(mask.shape), "counts": encoded["counts"].decode()}


def coco_file(folder: Path, frame: Frame, name: str = "scene/0.jpg", **change: Any) -> Path:
    annotations = []
    for k, a in enumerate(frame.annotations):
        assert a.mask is not None
        x0, y0, x1, y1 = a.bbox.tolist()
        annotations.append(
            {
                "id": k,
                "image_id": 7,
                "category_id": 1 + (a.label == "laptop"),
                "bbox": [x0, y0, x1 - x0, y1 - y0],
                "segmentation": run_lengths(a.mask),
                "iscrowd": 0,
            }
        )
    content = {
        "info": {},
        "images": [{"id": 7, "file_name": name}, {"id": 8, "file_name": "other.jpg"}],
        "annotations": annotations,
        "categories": [{"id": 1, "name": "mug"}, {"id": 2, "name": "laptop"}],
    } | change
    path = folder / "masks.json"
    path.write_text(json.dumps(content))
    return path


def played(path: Path, frame: Frame | None = None) -> tuple[np.ndarray, np.ndarray]:
    frame = frame or scene()
    return open_recorded_masks(path).segment(frame, boxes_of(scene()), [a.label for a in scene().annotations])


def meets(found: tuple[np.ndarray, np.ndarray], at_least: float = 1.0) -> None:
    assert found[1].all()
    for mask, real in zip(found[0], masks_of(scene()), strict=True):
        assert iou(mask, real) >= at_least


@pytest.mark.parametrize("name", ["scene/0.jpg", "data/scene/rgb/0.png", "0.png", "whatever.png"])
def test_coco_masks_come_to_their_boxes(tmp_path: Path, name: str) -> None:
    frame = scene()
    if name == "whatever.png":
        frame = replace(frame, id="scene/000007")
    meets(played(coco_file(tmp_path, scene(), name), frame))


def test_coco_masks_may_be_polygons_and_lists_and_lack_boxes(tmp_path: Path) -> None:
    written = json.loads(coco_file(tmp_path, scene()).read_text())
    real = masks_of(scene())
    outlines = cv2.findContours(real[0].astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    written["annotations"][0]["segmentation"] = [c.ravel().tolist() for c in outlines]
    counts, flat = [], real[1].ravel(order="F")
    changes = np.concatenate([[0], np.flatnonzero(np.diff(flat)) + 1, [flat.size]])
    counts = ([0] if flat[0] else []) + np.diff(changes).tolist()
    written["annotations"][1]["segmentation"] = {"size": [240, 320], "counts": counts}
    for annotation in written["annotations"]:
        del annotation["bbox"], annotation["category_id"]
    path = tmp_path / "masks.json"
    path.write_text(json.dumps(written))
    meets(played(path), 0.95)


def test_a_recording_of_detections_gives_its_masks(tmp_path: Path) -> None:
    frame = scene()
    entries = [
        {"label": a.label, "score": 0.5, "bbox": a.bbox.tolist(), "mask": run_lengths(m)}
        for a, m in zip(frame.annotations, masks_of(frame), strict=True)
    ]
    path = tmp_path / "recording.json"
    path.write_text(json.dumps({"frames": {frame.id: entries}}))
    meets(played(path))
    folder = tmp_path / "npz"
    folder.mkdir()
    labels = np.array([a.label for a in frame.annotations])
    masks = np.stack(masks_of(frame))
    np.savez(folder / "scene__0.npz", boxes=boxes_of(frame), scores=np.full(3, 0.5), labels=labels, masks=masks)
    meets(played(folder))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_png_masks_come_to_their_boxes(tmp_path: Path, kind: Any) -> None:
    values = np.zeros((240, 320), kind)
    for k, mask in enumerate(masks_of(scene())):
        values[mask] = (k + 1) * (60 if kind == np.uint8 else 9000)
    (tmp_path / "scene").mkdir()
    cv2.imwrite(str(tmp_path / "scene" / "0.png"), values)
    meets(played(tmp_path))


def test_binary_png_masks_come_to_their_boxes(tmp_path: Path) -> None:
    folder = tmp_path / "scene" / "0"
    folder.mkdir(parents=True)
    for k, mask in enumerate(masks_of(scene())):
        cv2.imwrite(str(folder / f"{9 - k}.png"), mask.astype(np.uint8) * 255)
    meets(played(tmp_path))


def refused(path: Path, message: str, error: type[Exception] = InputError) -> None:
    with pytest.raises(error, match=message) as caught:
        played(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("segmentation", "message"),
    [
        ({"size": [10, 10], "counts": [100]}, "another size"),
        ({"size": [10**6, 10**6], "counts": [10**12]}, "another size"),
        ({"size": [240, 320], "counts": [5, 5]}, "do not fill"),
        ({"size": [240, 320], "counts": "ooooooo"}, "do not fill"),
        ([[1, 2, 3, 4]], "polygon"),
        ([[1, 2, 3, 4, 5, 6, 7]], "polygon"),
        ([["a"]], "annotations.0.segmentation"),
        ("text", "annotations.0.segmentation"),
        (None, "annotations.0.segmentation"),
    ],
)
def test_hostile_coco_masks_are_refused(tmp_path: Path, segmentation: Any, message: str) -> None:
    box = [0, 0, 300, 230]
    (tmp_path / "m.json").write_text("")
    path = coco_file(tmp_path, scene(), annotations=[{"image_id": 7, "segmentation": segmentation, "bbox": box}])
    frame = replace(scene(), annotations=(Annotation(0, "mug", np.array([0, 0, 300, 230])),))
    with pytest.raises(InputError, match=message) as caught:
        open_recorded_masks(path).segment(frame, boxes_of(frame), ["mug"])
    assert str(path) in str(caught.value)


def test_hostile_coco_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "masks.json"
    for text, message in (
        ("{", "not JSON"),
        ("[]", "neither COCO"),
        ('{"images": []}', "annotations"),
        ('{"images": [{"id": 1}], "annotations": []}', "images.0.file_name"),
        ('{"frames": 3}', "frames"),
    ):
        path.write_text(text)
        refused(path, message)
    refused(coco_file(tmp_path, scene(), "elsewhere.png"), "no recorded masks for frame scene/0", FrameUnusable)
    twice = [{"id": k, "file_name": f"{k}/0.png"} for k in (7, 8)]
    refused(coco_file(tmp_path, scene(), images=twice), "several images", FrameUnusable)
    sized = [{"id": 7, "file_name": "0.png", "height": 480, "width": 640}]
    refused(coco_file(tmp_path, scene(), images=sized), "another size")
    refused(tmp_path / "absent", "no recorded masks")


def test_hostile_png_folders_are_refused(tmp_path: Path) -> None:
    refused(tmp_path, "holds no masks")
    file = tmp_path / "scene" / "0.png"
    file.parent.mkdir()
    cv2.imwrite(str(tmp_path / "scene" / "1.png"), np.zeros((240, 320), np.uint8))
    refused(tmp_path, "no recorded masks for frame scene/0", FrameUnusable)
    for image, message in (
        (np.zeros((10, 10), np.uint8), "another size"),
        (np.zeros((240, 320, 3), np.uint8), "one channel"),
    ):
        cv2.imwrite(str(file), image)
        refused(tmp_path, message, FrameUnusable)
    file.write_bytes(b"not a picture")
    refused(tmp_path, "cannot be read", FrameUnusable)
    with pytest.raises(FrameUnusable, match="outside the folder"):
        played(tmp_path, replace(scene(), id="../outside"))


def test_an_empty_label_image_gives_no_mask(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    cv2.imwrite(str(tmp_path / "scene" / "0.png"), np.zeros((240, 320), np.uint8))
    masks, has_mask = played(tmp_path)
    assert not masks.any()
    assert not has_mask.any()


# Wiring.


def test_segmenters_by_name(tmp_path: Path) -> None:
    assert isinstance(make_segmenter("depth"), DepthSegmenter)
    assert isinstance(make_segmenter("recorded", model=coco_file(tmp_path, scene())), Segmenter)
    with pytest.raises(InputError, match=r"no segmenter 'magic'.*depth or recorded or yolo-seg"):
        make_segmenter("magic")
    for name in ("recorded", "yolo-seg"):
        with pytest.raises(InputError, match="needs --segmenter-model"):
            make_segmenter(name)
    with pytest.raises(InputError, match="takes no model"):
        make_segmenter("depth", model=tmp_path)
    with pytest.raises(InputError, match="--segmenter-model needs --segmenter"):
        open_pipeline("demo", segmenter_model=tmp_path)


def test_jobs_use_the_segmenter(tmp_path: Path) -> None:
    plain = open_pipeline("demo")
    frame = plain.dataset.load(plain.dataset.frame_ids[0])
    entries = [{"label": a.label, "score": 0.9, "bbox": a.bbox.tolist()} for a in frame.annotations[:8]]
    recording = tmp_path / "boxes.json"
    recording.write_text(json.dumps({"frames": {frame.id: entries}}))
    names = [e["label"] for e in entries]
    sources = {}
    for segmenter in (None, "depth"):
        source = open_pipeline("demo", detector="recorded", model=recording, segmenter=segmenter)
        (related,) = relate_frames(source, frame.id)
        sources[segmenter] = {o.lifted.quality.mask_source for o in related.objects}
        trace = source.ask(source.prepare(frame.id), f"{names[0]} left of the {names[1]}")
        assert trace.detector == ("recorded" if segmenter is None else "recorded+depth")
    assert sources[None] == {"box"}
    assert "segmenter" in sources["depth"]
    assert {"segmenter", "box"} >= sources["depth"]


def test_a_real_network_serves_as_a_segmenter(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path))
    segmenter = make_segmenter("yolo-seg", model=shared_data / "onnx" / "yolov8n_seg_480x640.onnx")
    dataset = open_dataset(shared_data / "real" / "ycbv-bop")
    overlaps = []
    for frame_id in dataset.frame_ids[:2]:
        frame = bare(dataset.load(frame_id))
        detector = Segmented(AnnotationDetector(), segmenter)
        real_masks = masks_of(dataset.load(frame_id))
        for found, real in zip(all_objects(PreparedFrame(frame), detector), real_masks, strict=True):
            assert found.lifted.quality.mask_source in ("segmenter", "box")
            if found.lifted.quality.mask_source == "segmenter":
                overlaps.append(iou(found.mask, real))
    assert overlaps
    assert np.mean(overlaps) > 0.7
