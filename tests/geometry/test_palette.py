"""The colours of roles: told apart without one kind of cone, and black or white is read on each."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

from pipeline.geometry import RGB, depth_colors, hex_color, ink, instance_colors
from pipeline.geometry.cleaning import Pixel
from pipeline.geometry.palette import DROPPED, ON_DARK, SATURATION, TOWARD, VERDICTS, dimming, palette

LEAST = 19.0
"""Of the distances in CIE Lab (CIE76): some eight times what two patches that touch need to be told apart."""
HUES = {"as it is": 19.0, "without L cones": 10.0, "without M cones": 10.0, "without S cones": 10.0}
"""Least CIEDE2000 between the hue of a verdict and any other, or a role."""
SEEN = {
    "as it is": np.eye(3),
    "without L cones": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "without M cones": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "without S cones": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
"""What is seen of linear RGB: Machado, Oliveira and Fernandes, IEEE TVCG 15 (2009), 1291-1298, at severity 1."""
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = XYZ.sum(axis=1)


def linear(color: RGB) -> np.ndarray:
    c = np.array(color) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    x = XYZ @ np.clip(rgb, 0, 1) / WHITE
    x, y, z = np.where(x > 0.008856, np.cbrt(x), 7.787 * x + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def ciede2000(one: np.ndarray, other: np.ndarray) -> float:
    """Distance of two colours in CIE Lab, as in Sharma, Wu and Dalal (2005)."""
    (l1, a1, b1), (l2, a2, b2) = one, other
    chroma = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    stretch = 1.5 - 0.5 * np.sqrt(chroma**7 / (chroma**7 + 25**7))
    c1, c2 = np.hypot(a1 * stretch, b1), np.hypot(a2 * stretch, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a * stretch)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + 180) % 360 - 180 if c1 * c2 else 0.0
    hue, c, light = (h1 + turn / 2) % 360 if c1 * c2 else h1 + h2, (c1 + c2) / 2, ((l1 + l2) / 2 - 50) ** 2
    waves = ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.2, 4, -63))
    tone = 1 + sum(w * np.cos(np.radians(k * hue + by)) for w, k, by in waves)
    dl = (l2 - l1) / (1 + 0.015 * light / np.sqrt(20 + light))
    dc = (c2 - c1) / (1 + 0.045 * c)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * c * tone)
    bend = np.sin(np.radians(60 * np.exp(-(((hue - 275) / 25) ** 2)))) * 2 * np.sqrt(c**7 / (c**7 + 25**7))
    return float(np.sqrt(dl**2 + dc**2 + dh**2 - bend * dc * dh))


def luminance(color: RGB) -> float:
    return float(XYZ[1] @ linear(color))


@pytest.mark.parametrize("seen", SEEN)
@pytest.mark.parametrize("dark", [True, False])
def test_roles_stay_apart_however_they_are_seen(dark, seen):
    colors = {role: lab(np.array(SEEN[seen]) @ linear(color)) for role, color in palette(dark).items()}
    # What failed is text and edges beside what is right, never a box of the scene.
    pairs = [p for p in combinations(colors, 2) if "bad" not in p or "truth" in p]
    apart = {pair: float(np.linalg.norm(colors[pair[0]] - colors[pair[1]])) for pair in pairs}
    nearest = min(apart, key=lambda pair: apart[pair])
    assert apart[nearest] >= LEAST, (nearest, apart[nearest])


def test_the_simulation_is_of_known_confusions():
    red, green = (200, 0, 0), (100, 100, 0)
    apart = {
        name: np.linalg.norm(np.subtract(*(lab(np.array(m) @ linear(c)) for c in (red, green))))
        for name, m in SEEN.items()
    }
    assert apart["without M cones"] < apart["as it is"] / 2 > apart["without L cones"]
    assert np.allclose(lab(linear((255, 255, 255))), (100, 0, 0), atol=0.01)
    grey = linear((128, 128, 128))
    assert all(np.allclose(np.array(m) @ grey, grey, atol=1e-5) for m in SEEN.values())


@pytest.mark.parametrize("dark", [True, False])
def test_a_name_is_read_on_the_colour_of_its_role(dark):
    for color in palette(dark).values():
        inks = {"#000000": (luminance(color) + 0.05) / 0.05, "#ffffff": 1.05 / (luminance(color) + 0.05)}
        assert inks[ink(hex_color(color))] == max(inks.values()) >= 4.5


DEPTH_APART = 40.0
"""CIE76 between any colour of depth and those of a target, a reference, a labelled and an edited box."""


def test_depth_leaves_the_colours_of_roles_free() -> None:
    colors = depth_colors(np.linspace(1, 4, 256, dtype=np.float32)[None])[0]
    painted = np.array([lab(linear(tuple(c))) for c in colors.tolist()])
    for role in ("target", "reference", "truth", "edited"):
        apart = np.linalg.norm(painted - lab(linear(ON_DARK[role])), axis=1).min()
        assert apart >= DEPTH_APART, (role, apart)
    assert (np.diff(painted[:, 0]) < 0.5).all(), "near is light, far is dark"


def test_a_small_part_is_no_violet() -> None:
    seen = lab(linear(DROPPED[Pixel.SMALL_PART]))
    for accent in ((122, 80, 208), (189, 163, 255)):
        assert np.linalg.norm(seen - lab(linear(accent))) > 40
    others = [lab(linear(color)) for reason, color in DROPPED.items() if reason is not Pixel.SMALL_PART]
    assert min(np.linalg.norm(seen - other) for other in others) > 30


@pytest.mark.parametrize("dark", [True, False])
def test_what_is_beside_the_point_is_dimmed(dark: bool) -> None:
    before, (kept, grey) = np.array([200, 80, 40]) / 255, TOWARD[dark]
    after, luma = dimming(dark) @ [*before, 1], np.array([0.2126, 0.7152, 0.0722])
    assert after @ luma == pytest.approx(kept * (before @ luma) + (1 - kept) * grey)
    assert np.ptp(after) == pytest.approx(kept * SATURATION * np.ptp(before))


@pytest.mark.parametrize("dark", [True, False])
def test_roles_stand_out_of_what_is_dimmed(dark: bool) -> None:
    shades = (dimming(dark) @ [*color, 1] for color in product(np.linspace(0, 1, 5), repeat=3))
    seen = [lab(linear(tuple(255 * shade))) for shade in shades]
    for role in ("target", "reference", "truth"):
        assert min(ciede2000(lab(linear(ON_DARK[role])), one) for one in seen) > 10, role


@pytest.mark.parametrize("seen", SEEN)
def test_a_verdict_is_no_role_and_no_other_verdict(seen):
    roles = {role: ON_DARK[role] for role in ("target", "reference", "truth", "bad")}
    colors = {name: lab(np.array(SEEN[seen]) @ linear(color)) for name, color in (roles | VERDICTS).items()}
    pairs = [p for p in combinations(colors, 2) if p[1] in VERDICTS]
    apart = {pair: ciede2000(colors[pair[0]], colors[pair[1]]) for pair in pairs}
    nearest = min(apart, key=lambda pair: apart[pair])
    assert apart[nearest] >= HUES[seen], (nearest, apart[nearest])


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ],
)
def test_distances_are_those_of_the_published_table(one, other, apart):
    assert ciede2000(np.array(one), np.array(other)) == pytest.approx(apart, abs=1e-4)


def test_objects_have_colours_of_their_own() -> None:
    assert hex_color((255, 138, 51)) == "#ff8a33"
    colors = instance_colors(20)
    assert colors.shape == (20, 3)
    assert len(np.unique(colors, axis=0)) == 20
    assert instance_colors(0).shape == (0, 3)


def test_depth_colours_darken_from_near_to_far() -> None:
    depth = np.linspace(1, 3, 100, dtype=np.float32).reshape(10, 10)
    depth[0, 0] = 0
    colors = depth_colors(depth)
    assert colors.shape == (10, 10, 3)
    assert colors[0, 0].tolist() == [40, 42, 46]
    assert (np.diff(colors.ravel().reshape(-1, 3)[1:].astype(int).sum(axis=1)) <= 0).all()
    assert depth_colors(np.zeros((2, 2), np.float32)).shape == (2, 2, 3)
