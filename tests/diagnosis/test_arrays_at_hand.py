"""Arrays at hand, opened for questions: what is given of boxes and relations stands, and what is wrong is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pipeline
from pipeline.diagnosis import open_case, save_case
from pipeline.diagnosis.opened import open_arrays
from pipeline.geometry import Box3D

K = np.array([[75.0, 0, 39.5], [0, 75, 29.5], [0, 0, 1]])
QUESTION = "cup left of the box"


def arrays() -> dict[str, Any]:
    """A wall, and before it a cup and to its right a box."""
    rgb, depth = np.full((60, 80, 3), 150, np.uint8), np.full((60, 80), 2.5)
    masks = np.zeros((2, 60, 80), np.bool_)
    masks[0, 27:38, 17:26] = masks[1, 22:40, 45:65] = True
    for mask, metres in zip(masks, (1.5, 1.6), strict=True):
        depth[mask] = metres
    return {"rgb": rgb, "depth": depth, "K": K, "masks": masks, "names": ["cup", "box"], "up": (0, -1, 0)}


def ask(text: str = QUESTION, **given: Any) -> pipeline.Answer:
    return open_arrays(**arrays() | given).ask(0, text)


def test_without_more_all_is_made_here() -> None:
    answer = ask()
    assert answer.holds
    assert answer.needed_trace().scorer == "rel32"


def test_relations_that_are_given_rank_and_the_rest_is_made_here() -> None:
    answer = ask(relations={"left": {(0, 1): 0.03}})
    assert answer.relation_probability == 0.03
    assert not answer.holds
    assert answer.needed_trace().scores.scored_by["left"] == "given"
    table = np.array([[np.nan, 0.7], [0.4, np.nan]])
    right = ask("box right of the cup", relations={"right": table})
    assert right.relation_probability == 0.4
    assert (
        ask("cup above the box", relations={"right": table}).relation_probability
        == ask("cup above the box").relation_probability
    )


BOX = {"center": [0.5, 0.1, 1.5], "size": [0.1, 0.2, 0.3]}
SIGNS = np.array([[x, y, z] for x in (-1, 1) for z in (-1, 1) for y in (-1, 1)])


@pytest.mark.parametrize(
    "box",
    [
        BOX,
        Box3D(np.array(BOX["center"]), np.eye(3), np.array(BOX["size"])),
        np.array(BOX["center"]) + SIGNS * np.array(BOX["size"]) / 2,
    ],
    ids=["mapping", "Box3D", "corners"],
)
def test_a_box_that_is_given_stands_and_its_points_go_with_it(box: Any) -> None:
    answer = ask("cup right of the box", boxes=[box, None])
    assert answer.target is not None
    assert answer.target.box is not None
    assert answer.target.box.center == pytest.approx(BOX["center"])
    assert sorted(answer.target.box.size) == pytest.approx(sorted(BOX["size"]))
    lifted = answer.target.lifted
    away = np.abs(np.median(lifted.points, axis=0) - BOX["center"])
    assert (away <= np.array(BOX["size"]) / 2 + 1e-5).all()
    assert answer.reference is not None
    fitted = ask().reference
    assert fitted is not None
    assert fitted.box is not None
    assert answer.reference.box is not None
    assert np.array_equal(answer.reference.box.center, fitted.box.center)


def test_boxes_without_masks_are_objects_of_the_pixels_inside() -> None:
    boxes = [
        {"center": [-0.36, 0.05, 1.5], "size": [0.4, 0.4, 0.3]},
        {"center": [0.33, 0.03, 1.6], "size": [0.6, 0.6, 0.3]},
    ]
    answer = ask(boxes=boxes, masks=None)
    assert answer.holds
    assert answer.target is not None
    assert answer.target.mask.sum() == arrays()["masks"][0].sum()


def test_a_box_that_stands_is_kept_with_a_case(tmp_path: Path) -> None:
    opened = open_arrays(**arrays(), boxes=[BOX, None])
    context = opened.pipeline.prepare(0)
    answer = save_case(tmp_path / "case", opened.pipeline, context, "cup right of the box")
    again = open_case(tmp_path / "case").answer()
    assert again.target is not None
    assert again.target.box is not None
    assert again.target.box.center == pytest.approx(BOX["center"])
    assert again.sentence == answer.sentence


Given = Callable[[dict[str, Any]], dict[str, Any]]
WRONG: dict[str, tuple[Given, str]] = {
    "float colours": (lambda a: {"rgb": a["rgb"] / 255}, r"uint8 \(H, W, 3\).*255 \* rgb"),
    "channels first": (lambda a: {"rgb": a["rgb"].transpose(2, 0, 1)}, r"channels first"),
    "grey": (lambda a: {"rgb": a["rgb"][..., 0]}, r"got uint8 \(60, 80\)"),
    "depth in mm": (
        lambda a: {"depth": a["depth"] * 1000},
        "wrong unit; got a median depth of 2.5e.03 m; .*millimetres",
    ),
    "depth in integers": (lambda a: {"depth": (a["depth"] * 1000).astype(np.uint16)}, "got uint16 .*depth / 1000"),
    "depth of another size": (lambda a: {"depth": a["depth"][::2, ::2]}, "registered to the picture"),
    "a ragged list": (lambda a: {"depth": [[1.0], [1.0, 2.0]]}, "depth is no array"),
    "K of four numbers": (lambda a: {"K": [75, 75, 40, 30]}, r"3x3 matrix; got shape \(4,\)"),
    "probabilities for masks": (lambda a: {"masks": a["masks"] * 0.7}, "mask of 'cup' must be bool .*mask > 0.5"),
    "masks of another size": (lambda a: {"masks": a["masks"][:, :30]}, r"shape \(60, 80\); got bool \(30, 80\)"),
    "one mask": (lambda a: {"masks": a["masks"][0], "names": None}, r"got bool \(80,\)"),
    "an empty mask": (lambda a: {"masks": a["masks"] * [[[1]], [[0]]]}, "mask of 'box' is empty"),
    "a word for names": (lambda a: {"names": "ab"}, "a name for each mask.*'ab'"),
    "too few boxes": (lambda a: {"boxes": [BOX]}, "2 masks, 2 names, 1 boxes"),
    "a box in mm": (lambda a: {"boxes": [{"center": [10, 0, 1500], "size": [9, 9, 9]}, None]}, "'cup' is not in view"),
    "a box behind": (lambda a: {"boxes": [None, {"center": [0, 0, -2], "size": [1, 1, 1]}]}, "'box' is not in view"),
    "half a box": (lambda a: {"boxes": [{"center": [0, 0, 1]}, None]}, r"boxes\[0\]: no 3D box; got 'size'"),
    "corners of nothing": (lambda a: {"boxes": [np.zeros((8, 3)), None]}, r"boxes\[0\]: .*not those of a box"),
    "no such relation": (lambda a: {"relations": {"lefft": {}}}, "no such relation; got 'lefft'; expected one of left"),
    "a table too large": (lambda a: {"relations": {"left": np.zeros((3, 3))}}, r"must be \(2, 2\); got \(3, 3\)"),
    "no probability": (lambda a: {"relations": {"left": {(0, 1): 7}}}, r"no such row; got \(0, 1, 7\)"),
    "no such object": (lambda a: {"relations": {"left": {(0, 2): 0.5}}}, "two objects of 0 to 1"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_in_one_line(name: str) -> None:
    change, words = WRONG[name]
    given = arrays()
    with pytest.raises(pipeline.InputError, match=words) as raised:
        open_arrays(**given | change(given))
    assert "\n" not in str(raised.value)
