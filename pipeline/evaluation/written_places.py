"""Places as a model wrote them: two or four numbers and how they stand, before anything is said of their unit."""

from __future__ import annotations

import re
from dataclasses import replace

from pipeline.evaluation.model_answers import box_numbers, named_numbers
from pipeline.system.frozen import dataclass

_NUMBER = r"-?\d+(?:\.\d+)?"
_PAIR = re.compile(rf"[(\[]\s*({_NUMBER})\s*,\s*({_NUMBER})\s*[)\]]")
_ATTRIBUTES = re.compile(rf'x\d*="\s*({_NUMBER})"\s+y\d*="\s*({_NUMBER})"')
_COORDS = re.compile(rf'coords="[\d.]+\s+\d+\s+({_NUMBER})\s+({_NUMBER})((?:\s+{_NUMBER})*)')
_KEYED = re.compile(rf'"(\w*(?:point|box|bbox)\w*)"\s*:\s*\[+\s*((?:{_NUMBER}\s*,\s*)+{_NUMBER})\s*\]')
_BOX_MARKS = re.compile(r"<\|?/?(?:box|box_start|bbox|det|begin_of_box)\|?>")
_BY_NAME = (
    (("x", "y", "w", "h"), "xywh"),
    (("x", "y", "width", "height"), "xywh"),
    (("left", "top", "width", "height"), "xywh"),
    (("x", "y"), "xy"),
)
_LABEL = re.compile(r'"label"\s*:\s*"([^"]{1,80})"')


LARGEST = 1e6


@dataclass(frozen=True)
class WrittenPlace:
    """A place in an answer."""

    values: tuple[float, ...]  # two numbers of a point, four of a box, as they were written
    form: str  # how it was written: the key of JSON, "coords", "x= y=", "(a, b)", "<box>", "named", "four numbers"
    fixed: str = ""  # the unit, where signs or tokens say it; empty where they do not
    decimal: bool = False
    several: bool = False  # more places follow
    pair: bool = False  # two brackets of two numbers, and no more: two points, or the corners of a box
    label: str = ""  # the name that the model gave it
    order: str = ""  # that names or tokens tell, as of `PlaceReading`; empty where they do not

    @property
    def shares(self) -> bool:
        """True for numbers that look like shares of the picture: with a decimal point, up to 1 or slightly beyond."""
        return self.decimal and max(self.values) < 2


def written_place(text: str) -> WrittenPlace | None:
    """First place in the spoken part of an answer; None for none, or one of numbers that no picture has.

    Read are Molmo's `x="61.5" y="40.4"` and Molmo2's `coords="1 1 386 645"`, JSON keys with point or box in their name,
    location tokens, boxes between marks such as <box>, (x, y), and what `box_numbers` finds.
    """
    found = _first_place(text)
    return None if found is None or max(map(abs, found.values)) > LARGEST else found


def _first_place(text: str) -> WrittenPlace | None:
    label = _LABEL.search(text)
    named = "" if label is None else label[1]
    if found := _COORDS.search(text):
        return WrittenPlace((float(found[1]), float(found[2])), "coords", several=bool(found[3]), label=named)
    if places := _ATTRIBUTES.findall(text):
        return _of_numbers(places[0], "x= y=", len(places) > 1, named)
    keyed = [(key, re.findall(_NUMBER, values)) for key, values in _KEYED.findall(text)]
    keyed = [(key, values) for key, values in keyed if len(values) in (2, 4)]
    if keyed:
        key, values = keyed[0]
        return _of_numbers(values, key, len(keyed) > 1, named)
    marked = _BOX_MARKS.search(text) is not None
    pairs = [] if marked else _PAIR.findall(text)
    if len(pairs) == 2:
        a, b = pairs
        return _of_numbers((*a, *b), "(a, b)", True, named, pair=True)
    if pairs:
        return _of_numbers(pairs[0], "(a, b)", len(pairs) > 1, named)
    rows = named_numbers(text.lower())
    for keys, order in _BY_NAME:
        # Two corners, which have x and y too, are read below.
        if all(key in rows for key in keys) and not (order == "xy" and len(rows) > 2):
            corners = order == "xy" and [len(values) for values in rows.values()] == [2, 2]
            written = [rows[key][k] for k in range(1 + corners) for key in keys]
            if all(re.fullmatch(_NUMBER, value) for value in written):
                place = _of_numbers(written, "named", len(rows[keys[0]]) > 1, named, pair=corners)
                return place if corners else replace(place, order=order)
    if len(re.findall(r"\d+", text)) < 4:
        return None
    found_box = box_numbers(text)
    if isinstance(found_box, str):
        return None
    fixed = {"%": "percent", "px": "pixels"}.get(found_box.unit, "")
    if found_box.scale is not None and not marked:
        fixed = "1024ths" if found_box.scale == 1024 else "thousandths"
    form = "<box>" if marked else "named" if found_box.named else "four numbers"
    order = "xyxy" if found_box.named or fixed in ("1024ths", "thousandths") else ""
    return WrittenPlace(found_box.values, form, fixed, found_box.decimal, found_box.boxes > 1, label=named, order=order)


def _of_numbers(
    values: tuple[str, ...] | list[str], form: str, several: bool, label: str, *, pair: bool = False
) -> WrittenPlace:
    decimal = any("." in value for value in values)
    return WrittenPlace(tuple(map(float, values)), form, "", decimal, several, pair, label)
