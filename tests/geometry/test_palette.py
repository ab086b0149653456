"""The colours of roles: told apart without one kind of cone, and black or white is read on each."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pipeline.geometry import RGB, hex_color, ink
from pipeline.geometry.palette import palette

LEAST = 19.0
"""Of the distances in CIE Lab (CIE76): some eight times what two patches that touch need to be told apart."""
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
