"""Attributes as evidence: colours told apart in the demo and under other light, sizes and shapes by comparison."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest
from slow_cases import mostly_slow

from pipeline.datasets import demo_path, open_dataset
from pipeline.geometry import Box3D, Frame, viewer_axes
from pipeline.language import BASIC_COLORS, attribute
from pipeline.relations import attribute_probabilities, object_colors, size_keys

FOCI = {
    "black": "#101010",
    "blue": "#1f4fb5",
    "brown": "#6b4226",
    "gray": "#808080",
    "green": "#2e8b3a",
    "orange": "#f08020",
    "pink": "#f0a0b8",
    "purple": "#6a2c91",
    "red": "#c41e2a",
    "white": "#f6f6f6",
    "yellow": "#f0d020",
}
"""Good examples of each basic colour."""


def rgb_of(code: str) -> np.ndarray:
    return np.array([int(code[k : k + 2], 16) for k in (1, 3, 5)], np.uint8)


def patches(codes: list[str]) -> tuple[np.ndarray, list[np.ndarray]]:
    """A white picture with a patch of each colour, and the patches' masks."""
    rgb, masks = np.full((120, 60 * len(codes), 3), 250, np.uint8), []
    for k, code in enumerate(codes):
        mask = np.zeros(rgb.shape[:2], np.bool_)
        mask[30:90, 60 * k + 10 : 60 * k + 50] = True
        rgb[mask] = rgb_of(code)
        masks.append(mask)
    return rgb, masks


def probabilities(words: str, rgb: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    wanted = attribute(words)
    assert wanted is not None
    found = attribute_probabilities(wanted, rgb, masks, [None] * len(masks), np.eye(len(masks), dtype=np.bool_))
    assert found is not None
    return found


def named(rgb: np.ndarray, masks: list[np.ndarray]) -> list[str]:
    return [BASIC_COLORS[k] for k in object_colors(rgb, masks).shares[:, : len(BASIC_COLORS)].argmax(axis=1)]


def in_light(rgb: np.ndarray, gains: tuple[float, float, float]) -> np.ndarray:
    """The picture ((H, W, 3) uint8) as if its light had other strengths in red, green and blue."""
    return (np.clip((rgb / 255.0) ** 2.2 * gains, 0, 1) ** (1 / 2.2) * 255 + 0.5).astype(np.uint8)


@pytest.mark.parametrize("gains", [(1, 1, 1), (0.5, 0.5, 0.5), (1, 0.85, 0.6), (0.75, 0.9, 1)])
def test_good_examples_have_their_names_in_any_mild_light(gains: tuple[float, float, float]) -> None:
    rgb, masks = patches(list(FOCI.values()))
    assert named(in_light(rgb, gains), masks) == list(FOCI)


def test_each_colour_fits_its_own_example_best() -> None:
    rgb, masks = patches(list(FOCI.values()))
    for k, name in enumerate(FOCI):
        found = probabilities(name, rgb, masks)
        assert found.argmax() == k, name
        assert found[k] == pytest.approx(1)


def test_shading_does_not_change_a_colour() -> None:
    """Half of a thing in deep shade."""
    rgb, masks = patches([FOCI["red"], FOCI["blue"], FOCI["yellow"], FOCI["green"]])
    shaded = rgb.copy()
    shaded[60:] = in_light(rgb[60:], (0.3, 0.3, 0.3))
    assert named(shaded, masks) == ["red", "blue", "yellow", "green"]


def test_a_thing_of_two_colours_has_both_and_no_third() -> None:
    rgb, masks = patches([FOCI["red"], FOCI["white"], FOCI["blue"]])
    rgb[60:90, 10:50] = rgb_of(FOCI["white"])
    assert probabilities("white", rgb, masks)[0] > 0.35
    assert probabilities("red", rgb, masks)[0] > 0.9
    assert max(probabilities(third, rgb, masks)[0] for third in ("blue", "green", "yellow")) < 0.3


def test_light_and_dark_tell_shades_of_one_colour_apart() -> None:
    rgb, masks = patches(["#86b4e8", "#1f4fb5", "#0c1c48", "#e0e0e0", "#303030"])
    light, dark, blue = (probabilities(words, rgb, masks) for words in ("light blue", "dark blue", "blue"))
    assert light.argmax() == 0
    assert light[0] > 0.7 > 0.2 > light[2]
    assert dark.argmax() == 2
    assert dark[2] > 0.7 > 0.2 > dark[0]
    assert blue[:3].min() > 0.7
    assert probabilities("dark", rgb, masks)[4] > 0.8 > 0.1 > probabilities("dark", rgb, masks)[3]


def test_further_terms() -> None:
    codes = {"turquoise": "#30c0b8", "beige": "#dcc8a0", "gold": "#c8a030", "magenta": "#d01890", "red": FOCI["red"]}
    rgb, masks = patches(list(codes.values()))
    for k, name in enumerate(codes):
        assert probabilities(name, rgb, masks).argmax() == k, name
    assert probabilities("green", rgb, masks)[0] > 0.5
    assert probabilities("pink", rgb, masks)[3] > 0.5


@pytest.fixture(scope="module")
def demo() -> dict[str, Frame]:
    dataset = open_dataset(demo_path())
    return {key: dataset.load(key) for key in dataset.frame_ids}


COLOURED = [
    ("000001/000000", "yellow", 4, (3,)),
    ("000001/000000", "green", 7, (6, 8)),
    ("000002/000000", "red", 14, (22, 28)),
    ("000002/000000", "brown", 28, (22,)),
    ("000002/000000", "orange", 30, (15, 19)),
    ("000003/000000", "pink", 2, (1, 3)),
    ("000003/000001", "red", 16, (15, 26)),
    ("000003/000001", "beige", 15, (16, 26)),
    ("000003/000001", "gray", 26, (15, 16)),
    ("000004/000000", "white", 2, (1,)),
    ("000004/000000", "yellow", 1, (2,)),
    ("000004/000001", "green", 22, (4,)),
]


@pytest.mark.parametrize(
    ("frame", "words", "has", "lack"), mostly_slow(COLOURED, fast=range(0, len(COLOURED), 3), several=True)
)
def test_the_thing_of_the_colour_wins_against_its_like(
    demo: dict[str, Frame], frame: str, words: str, has: int, lack: tuple[int, ...]
) -> None:
    picture = demo[frame]
    things = [picture.annotations[k] for k in (has, *lack)]
    assert len({thing.label for thing in things}) == 1
    masks = [thing.mask for thing in things if thing.mask is not None]
    for gains in ((1, 1, 1), (0.6, 0.6, 0.6)):
        found = probabilities(words, in_light(picture.rgb, gains), masks)
        assert found[0] > found[1:].max() + 0.05, found


def test_masks_that_bleed_or_are_empty_or_few_pixels() -> None:
    rgb, masks = patches([FOCI["red"], FOCI["blue"]])
    wide = [cv2.dilate(mask.view(np.uint8), np.ones((5, 5), np.uint8)).view(np.bool_) for mask in masks]
    assert named(rgb, wide) == ["red", "blue"]
    dot = np.zeros_like(masks[0])
    dot[60, 30] = True
    found = probabilities("red", rgb, [np.zeros_like(dot), dot, masks[1]])
    assert found[0] == 0.5
    assert found[1] > 0.9 > 0.1 > found[2]
    assert probabilities("red", rgb, []).shape == (0,)


def test_fifty_objects_take_little_time(demo: dict[str, Frame]) -> None:
    frame = demo["000001/000001"]
    masks = ([a.mask for a in frame.annotations if a.mask is not None] * 3)[:50]
    spent = []
    for _ in range(3):
        start = time.process_time()
        object_colors(frame.rgb, masks)
        spent.append(time.process_time() - start)
    assert min(spent) < 0.25, "a tenth of a second is usual at most"


# Sizes and shapes.


def boxes(*sizes: tuple[float, float, float]) -> list[Box3D | None]:
    return [Box3D(np.array([0, 0, 2.0]), np.eye(3), np.array(size)) for size in sizes]


def judged(
    words: str, things: list[Box3D | None], alike: np.ndarray | None = None, masks: list[np.ndarray] | None = None
) -> np.ndarray:
    wanted = attribute(words)
    assert wanted is not None
    n = len(things)
    masks = masks if masks is not None else [np.zeros((8, 8), np.bool_)] * n
    alike = np.ones((n, n), np.bool_) if alike is None else alike
    found = attribute_probabilities(wanted, np.zeros((8, 8, 3), np.uint8), masks, things, alike)
    assert found is not None
    assert found.shape == (n,)
    assert ((found >= 0) & (found <= 1)).all()
    return found


def test_sizes_are_compared_among_the_like() -> None:
    things = boxes((0.2, 0.2, 0.2), (0.3, 0.3, 0.3), (0.1, 0.1, 0.1), (2, 2, 2))
    alike = np.zeros((4, 4), np.bool_)
    alike[:3, :3] = alike[3, 3] = True
    big, small = judged("big", things, alike), judged("little", things, alike)
    assert big[1] > 0.9 > 0.1 > big[2]
    assert big[0] == pytest.approx(0.5, abs=0.1)
    assert big[3] == 0.5, "the only one of its name"
    np.testing.assert_allclose(big + small, 1)


def test_equal_sizes_are_told_apart_softly() -> None:
    a, b = judged("big", boxes((0.2, 0.2, 0.2), (0.204, 0.2, 0.2)))
    assert 0.4 < a < 0.5 < b < 0.6


@pytest.mark.parametrize(
    ("words", "wins"), [("tall", 1), ("short", 0), ("wide", 0), ("narrow", 2), ("long", 0), ("thin", 2), ("thick", 1)]
)
def test_each_size_looks_at_its_own_extent(words: str, wins: int) -> None:
    """Sizes are along the camera's x (right), y (down) and z (forward)."""
    assert judged(words, boxes((1.0, 0.1, 0.4), (0.5, 0.9, 0.5), (0.2, 0.3, 0.05))).argmax() == wins


def test_height_goes_by_the_viewers_up() -> None:
    things = boxes((1.0, 0.1, 0.4))
    assert size_keys(things)["height"] == pytest.approx([0.1])
    tilted = size_keys(things, viewer_axes(np.array([1.0, 0, 0])))
    assert tilted["height"] == pytest.approx([1.0])


def test_boxes_that_are_not_known() -> None:
    things = [*boxes((0.2, 0.2, 0.2), (0.4, 0.4, 0.4)), None]
    assert judged("big", things)[2] == 0.5
    assert judged("big", things)[1] > 0.9
    assert judged("flat", things)[2] == judged("square", things)[2] == 0.5
    assert np.isnan(size_keys(things)["volume"][2])
    assert np.isfinite(judged("thin", boxes((0, 0.1, 0.1), (0.1, 0.1, 0.1)))).all()
    assert judged("big", []).shape == (0,)


def test_flat_square_and_rectangular_are_absolute() -> None:
    things = boxes((0.3, 0.02, 0.2), (0.2, 0.2, 0.2), (0.5, 0.2, 0.2))
    assert judged("flat", things)[0] > 0.9 > 0.1 > judged("flat", things)[1:].max()
    assert judged("square", things).argmax() == 1
    assert judged("rectangular", things)[2] > 0.5 > judged("rectangular", things)[1]


def test_round_is_a_disc_from_any_side() -> None:
    disc, oval, card, skew = (np.zeros((200, 200), np.uint8) for _ in range(4))
    cv2.circle(disc, (100, 100), 60, 1, -1)
    cv2.ellipse(oval, (100, 100), (80, 30), 20, 0, 360, 1, -1)
    card[60:140, 30:170] = 1
    cv2.fillPoly(skew, [np.array([[30, 60], [150, 20], [170, 120], [60, 180]], np.int32)], 1)
    masks = [mask.view(np.bool_) for mask in (disc, oval, card, skew)]
    found = judged("round", [None] * 4, masks=masks)
    assert found[:2].min() > 0.8 > 0.2 > found[2:].max()


@pytest.mark.parametrize("words", ["wooden", "plastic", "old", "empty", "striped", "triangular"])
def test_what_cannot_be_judged_is_none(words: str) -> None:
    wanted = attribute(words)
    assert wanted is not None
    rgb, masks = patches([FOCI["red"]])
    assert attribute_probabilities(wanted, rgb, masks, [None], np.eye(1, dtype=np.bool_)) is None
