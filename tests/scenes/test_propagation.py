"""Masks carried from labelled views to others: patches before a wall, and the demo's rooms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.datasets import Dataset
from pipeline.geometry import Camera, intrinsics
from pipeline.geometry.masks import MaskCrop
from pipeline.scenes.propagation import LabelledObject, LabelledView, ProposedMask, propagate
from pipeline.scenes.views import PosedView

HEIGHT, WIDTH, FOCAL = 120, 160, 150.0
GREY, RED, BLUE = (150, 150, 150), (200, 40, 30), (30, 60, 200)
Patch = tuple[tuple[float, float, float, float], float, tuple[int, int, int]]
"""x0, y0, x1, y1 at a distance z, metres, in a colour; all face the cameras, which look along z."""
WALL: Patch = ((-9, -9, 9, 9), 2.0, GREY)
BOX: Patch = ((-0.2, -0.2, 0.2, 0.2), 1.5, RED)


def seen_from(x: float, patches: Sequence[Patch], name: str = "") -> tuple[PosedView, np.ndarray]:
    """PosedView of patches, and the index of the patch that each pixel shows."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth, shown = np.full((HEIGHT, WIDTH), np.inf), np.full((HEIGHT, WIDTH), -1)
    for k, ((x0, y0, x1, y1), z, _) in enumerate(patches):
        at_x, at_y = x + (u - WIDTH / 2) * z / FOCAL, (v - HEIGHT / 2) * z / FOCAL
        hit = (at_x >= x0) & (at_x < x1) & (at_y >= y0) & (at_y < y1) & (z < depth)
        depth[hit], shown[hit] = z, k
    T = np.eye(4)
    T[0, 3] = x
    rgb = np.array([color for *_, color in patches], np.uint8)[shown]
    camera = Camera(intrinsics(FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), WIDTH, HEIGHT, T)
    return PosedView(name or f"at {x:g}", rgb, depth.astype(np.float32), camera, T), shown


def labelled(view: PosedView, **masks: np.ndarray) -> LabelledView:
    """A view with objects "o7" of the world's number 7, which the frame calls 107."""
    found = {int(name[1:]): MaskCrop.of(mask) for name, mask in masks.items()}
    return LabelledView(view, tuple(LabelledObject(k, 100 + k, mask) for k, mask in found.items()))


def iou(found: ProposedMask, truth: np.ndarray) -> float:
    mask = found.mask.of_picture(truth.shape)
    return float((mask & truth).sum() / (mask | truth).sum())


def test_a_mask_moves_with_its_object() -> None:
    (view, shown), (target, truth) = (seen_from(x, (WALL, BOX)) for x in (0.0, 0.15))
    (found,) = propagate([labelled(view, o7=shown == 1)], target)
    assert found.object_id == 7
    assert iou(found, truth == 1) > 0.97
    assert found.seen > 0.8
    assert found.confidence > 0.7
    assert found.area == found.mask.area
    assert [(o.frame_id, o.number) for o in found.sightings] == [("at 0", 107)]


@pytest.mark.parametrize(
    ("x", "more"),
    [(0.0, ((-0.5, -0.5, 0.5, 0.5), 1.0, BLUE)), (1.5, WALL)],
    ids=["hidden", "out of the picture"],
)
def test_what_is_not_seen_is_not_proposed(x: float, more: Patch) -> None:
    view, shown = seen_from(0.0, (WALL, BOX))
    target, truth = seen_from(x, (WALL, BOX, more))
    assert not (truth == 1).any()
    assert propagate([labelled(view, o7=shown == 1)], target) == ()


def test_an_occluder_in_front_takes_its_part() -> None:
    view, shown = seen_from(0.0, (WALL, BOX))
    target, truth = seen_from(0.05, (WALL, BOX, ((0.0, -0.5, 0.5, 0.5), 1.0, BLUE)))
    (found,) = propagate([labelled(view, o7=shown == 1)], target)
    assert iou(found, truth == 1) > 0.95


def test_of_nested_masks_the_smaller_lies_on_top() -> None:
    patches = (WALL, BOX, ((-0.06, -0.06, 0.06, 0.06), 1.49, BLUE))
    (view, shown), (target, truth) = (seen_from(x, patches) for x in (0.0, 0.15))
    outer, inner = propagate([labelled(view, o1=shown >= 1, o2=shown == 2)], target)
    assert iou(outer, truth == 1) > 0.95
    assert iou(inner, truth == 2) > 0.9


def test_a_thing_without_an_edge_is_doubtful() -> None:
    """A label on a bare wall: neither its surface nor its colours end where it ends."""
    (view, shown), (target, _) = (seen_from(x, (WALL,)) for x in (0.0, 0.15))
    sheet = np.zeros(shown.shape, np.bool_)
    sheet[40:70, 60:100] = True
    (found,) = propagate([labelled(view, o7=sheet)], target)
    assert found.outline == 0
    assert found.doubtful


def test_missing_depth_costs_confidence() -> None:
    (view, shown), (target, truth) = (seen_from(x, (WALL, BOX)) for x in (0.0, 0.1))
    (whole,) = propagate([labelled(view, o7=shown == 1)], target)
    target.depth[:60] = 0
    holed = PosedView(target.frame_id, target.rgb, target.depth, target.camera, target.T_world_camera)
    (found,) = propagate([labelled(view, o7=shown == 1)], holed)
    assert iou(found, truth == 1) > 0.9
    assert found.measured < 0.6
    assert found.confidence < 0.7 * whole.confidence


def test_several_views_vote_and_are_named() -> None:
    views = [seen_from(x, (WALL, BOX)) for x in (0.0, 0.1, 0.2)]
    target, truth = seen_from(0.12, (WALL, BOX))
    masks = [shown == 1 for _, shown in views]
    # One of them is labelled in the wrong place.
    masks[2] = np.roll(masks[2], 25, axis=0)
    sources = [labelled(view, o7=mask) for (view, _), mask in zip(views, masks, strict=True)]
    (found,) = propagate(sources, target)
    assert iou(found, truth == 1) > 0.95
    assert {o.frame_id for o in found.sightings} == {"at 0", "at 0.1", "at 0.2"}
    assert [o.pixels for o in found.sightings] == sorted((o.pixels for o in found.sightings), reverse=True)


def test_nothing_labelled_gives_nothing() -> None:
    view, _ = seen_from(0.0, (WALL, BOX))
    assert propagate([], view) == ()
    assert propagate([labelled(view)], view) == ()


def test_objects_of_a_room_are_found_from_the_other_side(demo_dataset: Dataset) -> None:
    """Objects are one where their exact boxes are at one place of the world."""
    frames = [demo_dataset.load(f"000002/00000{k}") for k in range(3)]
    places = [[a.box.transformed(f.camera.T_world_camera).center for a in f.annotations] for f in frames]  # pyright: ignore
    known = places[0]

    def world_id(place: np.ndarray) -> int:
        near = [k for k, other in enumerate(known) if np.abs(other - place).max() < 0.002]
        return near[0] if near else -1

    source = labelled(PosedView.of(frames[0]), **{f"o{k}": a.mask for k, a in enumerate(frames[0].annotations)})  # pyright: ignore
    overlaps, wrong = [], 0
    for frame, centers in zip(frames[1:], places[1:], strict=True):
        truth = {world_id(p): a.mask for p, a in zip(centers, frame.annotations, strict=True)}
        found = {p.object_id: p for p in propagate([source], PosedView.of(frame))}
        wrong += sum(k not in truth for k, p in found.items() if p.area >= 100)
        overlaps += [iou(p, truth[k]) for k, p in found.items() if k in truth and truth[k].sum() >= 100]  # pyright: ignore
    assert len(overlaps) > 25
    assert np.median(overlaps) > 0.85
    assert np.mean(np.array(overlaps) >= 0.8) > 0.7
    assert wrong == 0
