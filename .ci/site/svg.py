"""Pictures of the documents as SVG: one dark card in the program's colours, to be read on light and dark pages."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

import cv2
import numpy as np

from pipeline.geometry.palette import ON_DARK, hex_color
from pipeline.pictures.answer_card import AMBER, BACK, DIM, LINE, PANEL, WORDS
from pipeline.pictures.text import font, plain, width_of, wrapped

FONT = "Inter, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, 'Liberation Sans', system-ui, sans-serif"
WIDE = 1.1
"""Fonts that stand in are so much wider than the one that is measured, at most."""
TARGET, REFERENCE, TRUTH, BAD = (hex_color(ON_DARK[role]) for role in ("target", "reference", "truth", "bad"))
GROUND, SURFACE, EDGE, INK, QUIET, DOUBT = map(hex_color, (BACK, PANEL, LINE, WORDS, DIM, AMBER))
Point = Sequence[float]


def n(value: float) -> str:
    """Write a length with at most one decimal."""
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def measured(text: str, size: float, bold: bool = False) -> float:
    """Width of a text, pixels, with room for other fonts."""
    return WIDE * width_of(text, font(64, bold)) * size / 64


class Card:
    """A picture that is drawn, `width` x `height` pixels, on a card with round corners."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self.width, self.height, self.title = width, height, title
        self.parts: list[str] = []
        self._clips = 0
        self.box(0.5, 0.5, width - 1, height - 1, fill=GROUND, stroke=EDGE, radius=14)

    def add(self, part: str) -> None:
        self.parts.append(part)

    def box(
        self,
        x: float,
        y: float,
        width: float,
        height: float,
        *,
        fill: str = "none",
        stroke: str = "none",
        line: float = 1,
        radius: float = 0,
        dash: str = "",
        opacity: float = 1,
    ) -> None:
        """Draw a rectangle, with round corners where it has a radius."""
        more = (f' rx="{n(radius)}"' if radius else "") + (f' stroke-dasharray="{dash}"' if dash else "")
        more += f' fill-opacity="{opacity:g}"' if opacity != 1 else ""
        self.add(
            f'<rect x="{n(x)}" y="{n(y)}" width="{n(width)}" height="{n(height)}" fill="{fill}" stroke="{stroke}" '
            f'stroke-width="{line:g}"{more}/>'
        )

    def path(
        self, d: str, *, fill: str = "none", stroke: str = "none", line: float = 2, dash: str = "", opacity: float = 1
    ) -> None:
        """Draw a path."""
        more = (f' stroke-dasharray="{dash}"' if dash else "") + (
            f' fill-opacity="{opacity:g}"' if opacity != 1 else ""
        )
        self.add(
            f'<path d="{d}" fill="{fill}" fill-rule="evenodd" stroke="{stroke}" stroke-width="{line:g}" '
            f'stroke-linejoin="round" stroke-linecap="round"{more}/>'
        )

    def lines(self, points: Iterable[Point], *, close: bool = False, **look: object) -> None:
        """Draw a line through points."""
        d = "M" + "L".join(f"{n(x)} {n(y)}" for x, y in points) + ("Z" if close else "")
        self.path(d, **look)  # type: ignore[arg-type]

    def dot(self, x: float, y: float, radius: float, fill: str, stroke: str = "none") -> None:
        self.add(f'<circle cx="{n(x)}" cy="{n(y)}" r="{n(radius)}" fill="{fill}" stroke="{stroke}" stroke-width="2"/>')

    def text(
        self,
        x: float,
        y: float,
        words: str,
        size: float = 20,
        color: str = INK,
        *,
        bold: bool = False,
        anchor: str = "start",
        halo: bool = False,
    ) -> float:
        """Write words, y at their base line; returns their width."""
        more = ' font-weight="600"' if bold else ""
        more += f' text-anchor="{anchor}"' if anchor != "start" else ""
        more += f' paint-order="stroke" stroke="{GROUND}" stroke-width="5" stroke-linejoin="round"' if halo else ""
        self.add(f'<text x="{n(x)}" y="{n(y)}" font-size="{size:g}" fill="{color}"{more}>{escape(words)}</text>')
        return measured(words, size, bold)

    def spans(self, x: float, y: float, parts: Sequence[tuple[str, str]], size: float) -> float:
        """Write bold words, each stretch in its colour; returns their width."""
        words = "".join(f'<tspan fill="{color}">{escape(text)}</tspan>' for text, color in parts)
        self.add(
            f'<text x="{n(x)}" y="{n(y)}" font-size="{size:.3g}" font-weight="600" xml:space="preserve">{words}</text>'
        )
        return measured("".join(text for text, _ in parts), size, True)

    def paragraph(
        self,
        x: float,
        y: float,
        words: str,
        width: float,
        size: float = 20,
        color: str = INK,
        *,
        bold: bool = False,
        most: int = 9,
    ) -> float:
        """Write words in lines of a width; returns the base line of the next."""
        for line in wrapped(plain(words, WORDS), font(round(size * 4), bold), width * 4 / WIDE, most):
            self.text(x, y, str(line), size, color, bold=bold)
            y += round(size * 1.36)
        return y

    def chip(
        self, x: float, y: float, words: str, fill: str, ink: str, size: float = 18, *, anchor: str = "start"
    ) -> float:
        """Write words in a filled box whose middle is at y; returns its width."""
        width, height = measured(words, size, True) + 1.1 * size, 1.6 * size
        x -= {"start": 0.0, "middle": width / 2, "end": width}[anchor]
        self.box(x, y - height / 2, width, height, fill=fill, radius=6)
        self.text(x + width / 2, y + 0.35 * size, words, size, ink, bold=True, anchor="middle")
        return width

    def arrow(self, start: Point, end: Point, color: str = QUIET, line: float = 2.5, head: float = 10) -> None:
        """Draw an arrow."""
        a, b = np.array(start, float), np.array(end, float)
        way = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        side, foot = np.array([-way[1], way[0]]), b - way * head
        self.lines([a, foot + way * head * 0.3], stroke=color, line=line)
        self.lines([b, foot + side * head * 0.55, foot - side * head * 0.55], close=True, fill=color)

    def picture(self, rgb: np.ndarray, x: float, y: float, width: float, height: float, quality: int = 82) -> None:
        """Show a picture, (H, W, 3) uint8, with round corners."""
        _, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        self._clips += 1
        clip = f"c{self._clips}"
        where = f'x="{n(x)}" y="{n(y)}" width="{n(width)}" height="{n(height)}"'
        self.add(f'<clipPath id="{clip}"><rect {where} rx="8"/></clipPath>')
        href = "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
        self.add(f'<image {where} preserveAspectRatio="none" clip-path="url(#{clip})" href="{href}"/>')

    def svg(self) -> str:
        """The file."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" width="{self.width}" '
            f'height="{self.height}" font-family="{FONT}" role="img" aria-label="{escape(self.title)}">\n'
            f"<title>{escape(self.title)}</title>\n" + "\n".join(self.parts) + "\n</svg>\n"
        )


HATCH = (
    '<pattern id="hatch" width="12" height="12" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
    f'<rect width="12" height="12" fill="{TRUTH}" fill-opacity=".07"/>'
    f'<rect width="3" height="12" fill="{TRUTH}" fill-opacity=".5"/></pattern>'
)
"""The pattern of what is too close to call: put once into a card that uses `url(#hatch)`."""
