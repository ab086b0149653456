"""Colour schemes that make a room hang together, and the materials mixed from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.datasets.synthetic.model import Material, rgb

WOODS = {"oak": "#c59a6b", "walnut": "#7d5638", "birch": "#dcbf94", "teak": "#a66f42", "ash": "#cdb492"}


@dataclass(frozen=True)
class Palette:
    """One scheme.

    Attributes
    ----------
    wall, feature : str
        sRGB of the walls and of the one wall that differs.
    floor : str
        Texture of the floor: planks, herringbone or tiles.
    floor_tint : str
    wood : str
        A key of WOODS.
    painted : str
        Painted furniture.
    seat : str
        The large upholstered piece.
    accents : tuple of str
        Cushions, mugs, pictures, books.
    rug : tuple of (str, str, str)
        Ground, figure, accent.
    metal : str
    """

    wall: str
    feature: str
    floor: str
    floor_tint: str
    wood: str
    painted: str
    seat: str
    accents: tuple[str, ...]
    rug: tuple[str, str, str]
    metal: str = "#2f3136"


PALETTES = (
    Palette(
        "#efe6d8",
        "#8ea394",
        "planks",
        "#c49a6c",
        "oak",
        "#f3efe6",
        "#c9b79c",
        ("#c8643c", "#e0a94a", "#5f7f73", "#2f4b57", "#e7d3bd"),
        ("#e9dfcd", "#8c5b43", "#c8843c"),
    ),
    Palette(
        "#f1ebe1",
        "#3f6470",
        "herringbone",
        "#b98a5c",
        "walnut",
        "#2f4b57",
        "#3d6f78",
        ("#d9903d", "#e7c27d", "#b5532f", "#84a59d", "#f2e3cf"),
        ("#ece0cb", "#2f5a66", "#d1803a"),
    ),
    Palette(
        "#f3e7dc",
        "#d8a48f",
        "planks",
        "#d6b48a",
        "birch",
        "#f6f0e8",
        "#a9b5a2",
        ("#bb6b58", "#d9ae94", "#7d8f78", "#e3c58c", "#4f5d57"),
        ("#f0e6da", "#bb7c68", "#8fa08a"),
    ),
    Palette(
        "#ece9e1",
        "#c99f5f",
        "tiles",
        "#d8cdbd",
        "teak",
        "#53685f",
        "#b8673f",
        ("#39605a", "#e3b458", "#a8452d", "#87a6a2", "#efe1c6"),
        ("#e6d8be", "#a8452d", "#39605a"),
    ),
    Palette(
        "#e8e6df",
        "#6d7f93",
        "planks",
        "#a97c53",
        "ash",
        "#e9e4da",
        "#68788a",
        ("#d4815b", "#edc88f", "#3e5568", "#9bb0a5", "#8a4b3c"),
        ("#dfdcd2", "#54687c", "#d08c5a"),
    ),
)


def pick(rng: np.random.Generator, options: tuple[str, ...]) -> str:
    """One of `options`."""
    return options[int(rng.integers(len(options)))]


def wood(palette: Palette, rng: np.random.Generator, span: float = 0.7) -> Material:
    """The room's wood, a shade lighter or darker from piece to piece."""
    return Material(shade(rgb(WOODS[palette.wood]), rng, 0.06), ("wood",), span, gloss=0.12)


def paint(code: str, gloss: float = 0.12) -> Material:
    """Smooth painted or plastic surface."""
    return Material(rgb(code), None, gloss=gloss)


def cloth(code: str, span: float = 0.22) -> Material:
    """Woven upholstery."""
    return Material(rgb(code), ("fabric",), span)


def metal(palette: Palette) -> Material:
    """Dark powder-coated metal."""
    return Material(rgb(palette.metal), None, gloss=0.35)


BRASS = Material(rgb("#c8a155"), None, gloss=0.7)
STEEL = Material(rgb("#b9bcc0"), None, gloss=0.7)
WHITE = Material(rgb("#f4f1ea"), None, gloss=0.25)
BLACK = Material(rgb("#1d1e21"), None, gloss=0.35)
PAPER = Material(rgb("#f1eadb"), ("plaster",), 0.05)


def shade(color: tuple[float, float, float], rng: np.random.Generator, deviation: float) -> tuple[float, float, float]:
    """The colour scaled at random, staying below white."""
    factor = float(np.clip(1 + deviation * rng.standard_normal(), 0.75, 1.2))
    r, g, b = (min(0.95, c * factor) for c in color)
    return (r, g, b)
