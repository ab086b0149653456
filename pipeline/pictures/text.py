"""Text on pictures, in a font of the package's own: measured, broken into lines, and drawn.

The font has the letters of Latin, Greek and Cyrillic; any other letter is drawn as a box.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from PIL import ImageFont

from pipeline.geometry.palette import RGB
from pipeline.system.frozen import dataclass

FILES = Path(__file__).with_name("font")
MOST = 400
"""Characters of a text; nothing longer fits any picture."""
ELLIPSIS = "…"


@cache
def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Font of a size, pixels."""
    return ImageFont.truetype(FILES / f"Inter-{'SemiBold' if bold else 'Regular'}.otf", size)


def on_one_line(text: str) -> str:
    """Text without line breaks, control characters and halves of characters, at most MOST long."""
    shown = text[: 4 * MOST].encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return " ".join("".join(c if c.isprintable() else " " for c in shown).split())[:MOST]


@dataclass(frozen=True)
class Text:
    """Text on one line, each stretch in a colour."""

    parts: tuple[tuple[str, RGB], ...]

    def __str__(self) -> str:
        return "".join(text for text, _ in self.parts)

    def __getitem__(self, where: slice) -> Text:
        letters = [(letter, color) for text, color in self.parts for letter in text]
        return Text(tuple(letters[where]))

    def joined(self) -> Iterator[tuple[str, RGB]]:
        """Stretches of one colour each, as long as they can be, so that letters are set beside each other well."""
        kept, paint = "", None
        for text, color in self.parts:
            if paint is not None and color != paint:
                yield kept, paint
                kept = ""
            kept, paint = kept + text, color
        if paint is not None:
            yield kept, paint


def plain(text: str, color: RGB) -> Text:
    """Text in one colour."""
    return Text(((on_one_line(text), color),))


def width_of(text: Text | str, face: ImageFont.FreeTypeFont) -> float:
    """Width of a text, pixels."""
    return face.getlength(text) if isinstance(text, str) else sum(face.getlength(t) for t, _ in text.joined())


def shortened(text: Text, face: ImageFont.FreeTypeFont, width: float) -> Text:
    """Text that fits a width, with an ellipsis in place of what does not."""
    if width_of(text, face) <= width:
        return text
    color = text.parts[-1][1]
    low, high = 0, len(str(text))
    while low < high:  # As many letters as fit.
        middle = (low + high + 1) // 2
        low, high = (middle, high) if width_of(_ended(text, middle, color), face) <= width else (low, middle - 1)
    return _ended(text, low, color)


def _ended(text: Text, length: int, color: RGB) -> Text:
    length = len(str(text)[:length].rstrip(" ,;:"))
    return Text((*text[:length].parts, (ELLIPSIS, color)))


def wrapped(text: Text, face: ImageFont.FreeTypeFont, width: float, most: int) -> list[Text]:
    """Lines of a text that fit a width, at most so many; the last ends with an ellipsis where words are left."""
    letters, lines, start = str(text), list[Text](), 0
    while start < len(letters):
        if len(lines) == most - 1:
            return [*lines, shortened(text[start:], face, width)]
        end, at = start, start
        while at < len(letters):
            stop = letters.find(" ", at)
            stop = len(letters) if stop < 0 else stop
            if width_of(letters[start:stop], face) > width:
                break
            end, at = stop, stop + 1
        if end == start:  # A word that is too long is cut.
            ends = range(len(letters), start + 1, -1)
            end = next((k for k in ends if width_of(letters[start:k], face) <= width), start + 1)
        lines.append(text[start:end])
        start = end + (letters[end : end + 1] == " ")
    return lines


def fitted(
    text: Text, sizes: Sequence[int], bold: bool, width: float, most: int
) -> tuple[ImageFont.FreeTypeFont, list[Text]]:
    """Largest of some sizes at which a text fits whole in so many lines, or the last, shortened."""
    tries = ((face, wrapped(text, face, width, most)) for face in (font(size, bold) for size in sizes))
    found = font(sizes[-1], bold), list[Text]()
    for found in tries:
        if [word for line in found[1] for word in str(line).split()] == str(text).split():
            break
    return found


def draw_text(image: np.ndarray, text: Text, at: tuple[float, float], face: ImageFont.FreeTypeFont) -> float:
    """Draw a text from (x, y), y at its base line, and return where it ends; what lies outside is left out."""
    x, y = at
    for part, color in text.joined():
        mask, (left, top) = face.getmask2(part, "L", anchor="ls")
        if mask.size[0] and mask.size[1]:
            cover = np.array(mask, np.uint8).reshape(mask.size[::-1])
            _blend(image, cover, round(x) + left, round(y) + top, color)
        x += face.getlength(part)
    return x


def _blend(image: np.ndarray, cover: np.ndarray, x: int, y: int, color: RGB) -> None:
    x0, y0 = max(x, 0), max(y, 0)
    x1, y1 = min(x + cover.shape[1], image.shape[1]), min(y + cover.shape[0], image.shape[0])
    if x0 >= x1 or y0 >= y1:
        return
    share = cover[y0 - y : y1 - y, x0 - x : x1 - x, None].astype(np.float32) / 255
    part = image[y0:y1, x0:x1]
    part[:] = np.round(part * (1 - share) + np.array(color, np.float32) * share).astype(np.uint8)
