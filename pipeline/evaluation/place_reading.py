"""Meaning of numbers in answers: unit, order and kind, decided over all lines of a file together.

Every reading is scored by the logarithm of how likely the file is under it: whether each place lies in the picture and
on a labelled thing of the name that is asked for, against what chance would give (`_likely`), and by what was known
before (`_prior`): the maker's documentation of a known model, the words around the numbers, and what was asked for.
Which of the things of a name is the right one does not enter, so that a wrong answer counts like a right one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.evaluation.place_habits import QWEN_SERVED, far_edges, habit_of, suggested
from pipeline.evaluation.written_places import WrittenPlace
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT
from pipeline.language.counted import counted
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

KNOWN, ASKED, HINTED = 6.0, 8.0, 4.0
"""What the documentation of a model, the question, and the form of an answer count, in nats."""
SURE = 3.0
"""A reading is taken where it is more likely than any other by this, in nats: 20 to 1."""
TINY = 0.015
PAIR_OF_POINTS = 1.0
ALIKE = 0.02
"""Readings are one where their places differ by less, in shares of the picture."""
LOOKED_AT, FINALISTS = 200, 8
"""Lines, spread evenly, on which all readings are tried, and readings that are then tried on all lines."""
OUTSIDE = -3.0
SEVERAL_SIZES = -6.0
"""What a size of a resized picture counts, of which some seventy are tried."""
SHARE_ON = 0.6
"""A model's places lie on a thing of the asked name so often, where they are read as they were meant."""
_UNITS = ("pixels", "thousandths", "shares", "percent")
_SIDES = (224, 256, 336, 384, 448, 512, 560, 600, 640, 768, 800, 896, 980, 1008, 1024, 1092, 1280, 1333, 1344, 1536)
_SIDES += (1568, 1920, 2048)
"""Lengths that pictures are made of for networks: of the longer side, the shorter side, or both."""
_FRACTIONS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 3 / 2, 2.0)
_AROUND = tuple(1 + k / 100 for k in range(-12, 13))
PADDED = "padded"
_LESS_LIKELY = {PADDED: -5.0, "percent": -2.0, "1024ths": -6.0}
_ORDERS = {2: ("xy", "yx"), 4: ("xyxy", "yxyx", "xywh", "cxcywh")}
_BY_ORDER = {"xy": 4.0, "yx": 0.0, "xyxy": 4.0, "yxyx": 0.0, "xywh": 0.5, "cxcywh": -1.0}
_WORDS = {
    "xy": "x first",
    "yx": "y first",
    "xyxy": "x first, two corners",
    "yxyx": "y first, two corners",
    "xywh": "corner and size",
    "cxcywh": "centre and size",
}
OPTION = "--places"
_TOLD = re.compile(r"pixels:(qwen(-[1-9]\d{1,4})?|[1-9]\d{1,4}(x[1-9]\d{1,4})?)")


@dataclass(frozen=True)
class PlaceReading:
    """Meaning of two or four numbers; empty for what is not told."""

    unit: str = ""  # as of `far_edges`
    order: str = ""  # xy, yx; xyxy, yxyx, xywh, cxcywh

    def __str__(self) -> str:
        """As the option has it: "thousandths,yxyx"."""
        return ",".join(part for part in (self.unit, self.order) if part)

    @property
    def point(self) -> bool:
        return len(self.order) == 2

    @property
    def words(self) -> str:
        unit, _, resized = self.unit.partition(":")
        unit = "shares of the picture padded to a square" if unit == PADDED else unit
        of = {"": "", "qwen": " of the picture as Qwen2.5-VL resizes it"}.get(resized)
        if of is None:
            of = f" of the picture as Qwen2.5-VL resizes it to {resized.partition('-')[2]} tokens"
            if not resized.startswith("qwen"):
                of = (
                    f" of a picture of {resized}" if "x" in resized else f" of a picture whose longer side is {resized}"
                )
        return f"{unit}{of}, {_WORDS[self.order]}"

    def box(self, values: Sequence[float], size: tuple[int, int]) -> tuple[float, float, float, float]:
        """Left, top, right, bottom in shares of the picture; of a point twice the point."""
        a, b, c, d = (*values, *values) if self.point else values
        x0, y0, x1, y1 = {
            "xy": (a, b, a, b),
            "yx": (b, a, b, a),
            "xyxy": (a, b, c, d),
            "yxyx": (b, a, d, c),
            "xywh": (a, b, a + c, b + d),
            "cxcywh": (a - c / 2, b - d / 2, a + c / 2, b + d / 2),
        }[self.order]
        width, height = far_edges(self.unit, size)
        found = (x0 / width, y0 / height, x1 / width, y1 / height)
        if self.unit != PADDED:
            return found
        # The picture lies in the middle of the square.
        u, v = (max(size) / side for side in size)
        left, top, right, bottom = ((share - 0.5) * k + 0.5 for share, k in zip(found, (u, v, u, v), strict=True))
        return left, top, right, bottom


@dataclass(frozen=True)
class PlacedLine:
    """A place of the file, and what its picture holds."""

    where: str  # for messages: "line 3"
    place: WrittenPlace
    size: tuple[int, int]  # of the picture: width, height
    things: np.ndarray  # (N, 4) float: labelled boxes of what the line asks for, in shares; all where no name is known
    model: str = ""
    unit: str = ""  # that the question asks for; empty where it does not


@dataclass(frozen=True)
class Scored:
    """A reading with what speaks for it."""

    reading: PlaceReading
    score: float
    boxes: np.ndarray  # (N, 4) float64: shares of each line's picture
    inside: int
    on: int
    judged: int  # lines that have things to lie on

    @property
    def counts(self) -> str:
        of = len(self.boxes)
        told = f"{self.inside} of {of} in the picture"
        return f"{told}, {self.on} of {self.judged} on a thing of the asked name" if self.judged else told


def told_reading(text: str) -> PlaceReading:
    """Reading of the option: a unit, an order, or both with a comma.

    Raises InputError: neither.
    """
    unit = order = ""
    for part in filter(None, (p.strip().lower() for p in text.split(","))):
        if part in _WORDS and not order:
            order = part
        elif (part in (*_UNITS, PADDED, "1024ths") or _TOLD.fullmatch(part)) and not unit:
            unit = part
        else:
            raise InputError(
                f"{OPTION}: not how numbers are meant",
                got=repr(part),
                expected="pixels, thousandths, shares, percent, padded, pixels:LONGER_SIDE, pixels:WIDTHxHEIGHT or "
                "pixels:qwen; with xy, yx (points), xyxy, yxyx, xywh or cxcywh (boxes) after a comma",
            )
    return PlaceReading(unit, order)


@dataclass(frozen=True)
class ReadPlace:
    """A place, read."""

    box: tuple[
        float, float, float, float
    ]  # left, top, right, bottom in shares of the picture; of a point twice the point
    point: bool
    written: str  # the numbers as they stand, with what they are read as
    reading: PlaceReading


def read_places(
    lines: Sequence[PlacedLine], told: Sequence[PlaceReading] = (), path: Path | None = None
) -> tuple[list[ReadPlace], list[str]]:
    """Places of all lines, and a note for each way of writing.

    Raises InputError: two readings fit alike; it names the option that tells.
    """
    lines = list(lines)
    groups: dict[tuple[str, str, int, bool, str, str], list[int]] = {}
    decimal = _mostly_decimal(lines)
    # Two brackets of two numbers are the corners of a box only where a model writes nothing else so.
    single = {(line.model, line.place.form) for line in lines if len(line.place.values) == 2}
    for k, line in enumerate(lines):
        p, way = line.place, (line.model, line.place.form)
        if p.pair and way in single:
            p = replace(p, values=p.values[:2], pair=False)
            lines[k] = replace(line, place=p)
        shares = p.shares and way not in decimal
        groups.setdefault((*way, len(p.values), shares, p.fixed, p.order), []).append(k)
    found: dict[int, ReadPlace] = {}
    notes, units = list[str](), dict[str, str]()
    for key, members in sorted(groups.items(), key=lambda item: -len(item[1])):
        chosen, note = _decided([lines[k] for k in members], key[3], told, units.get(key[0], ""), path)
        if not key[3] and not key[4]:
            units.setdefault(key[0], chosen.reading.unit)
        notes.append(note)
        reading = chosen.reading
        for k in members:
            values = lines[k].place.values[: 2 if reading.point else 4]
            written = f"{', '.join(f'{v:g}' for v in values)} as {reading.words}"
            found[k] = ReadPlace(reading.box(values, lines[k].size), reading.point, written, reading)
    return [found[k] for k in range(len(lines))], notes


def _mostly_decimal(lines: Sequence[PlacedLine]) -> set[tuple[str, str]]:
    """Ways of writing whose numbers beyond 1 have decimal points too: their small ones need not be shares."""
    ways: dict[tuple[str, str], list[WrittenPlace]] = {}
    for line in lines:
        ways.setdefault((line.model, line.place.form), []).append(line.place)
    return {way for way, places in ways.items() if sum(p.decimal and not p.shares for p in places) > len(places) / 2}


def _decided(
    lines: Sequence[PlacedLine], shares: bool, told: Sequence[PlaceReading], unit: str, path: Path | None
) -> tuple[Scored, str]:
    """The reading of lines that are written alike, and words of it; `unit`: that of this model's other answers."""

    def scored_by(readings: Iterable[PlaceReading], some: Sequence[PlacedLine]) -> list[Scored]:
        tried = list(readings)
        priors = [_prior(lines[0], r, shares, unit) for r in tried]
        return sorted(_scored(some, tried, priors), key=lambda s: -s.score)

    spread = np.unique(np.linspace(0, len(lines) - 1, min(LOOKED_AT, len(lines))).astype(int))
    first = scored_by(_readings(lines, told, shares), [lines[k] for k in spread])
    # Of many lines the likely readings alone are looked at on all of them.
    scored = first if len(spread) == len(lines) else scored_by((s.reading for s in first[:FINALISTS]), lines)
    best = scored[0]
    others = [s for s in scored[1:] if not _alike(best, s)]
    form = lines[0].place.form
    these = f"{lines[0].where}: the numbers of {counted(len(lines), 'answer')} written as {form}"
    if others and best.score - others[0].score < SURE:
        raise InputError(
            f"{these} may be meant in two ways: "
            f"{best.reading.words} ({best.counts}) or {others[0].reading.words} ({others[0].counts})",
            expected=f"{OPTION} {best.reading} or {OPTION} {others[0].reading}",
            path=path,
        )
    side = best.reading.unit.partition(":")[2]
    if side.isdecimal() and not any(t.unit for t in told):
        near = [replace(best.reading, unit=f"pixels:{round(int(side) * part)}") for part in _AROUND]
        nearer = max(_scored(lines, near, [0.0] * len(near)), key=lambda s: s.score)
        require(
            nearer.score - _scored(lines, [best.reading], [0.0])[0].score < SURE or _alike(nearer, best),
            f"{these} fit no usual size of a picture: best {nearer.reading.words} ({nearer.counts})",
            expected=f"{OPTION} pixels:WIDTHxHEIGHT, of the picture as the model saw it",
            path=path,
        )
    habit = habit_of(lines[0].model)
    why = ""
    if habit is not None and (best.reading.unit.startswith(habit[0]) or _same_unit(lines, best, habit[0])):
        why = f", as {lines[0].model} writes ({habit[2]})"
    elif habit is not None and not lines[0].place.fixed and not shares:
        why = f", though {lines[0].model} writes {habit[0]} ({habit[2]})"
    are = "is" if len(lines) == 1 else "are"
    words = f"{counted(len(lines), 'answer')} written as {form} {are} {best.reading.words}: {best.counts}{why}"
    rival = next((s for s in others if s.reading.unit in _UNITS or s.score > best.score - 2 * SURE), None)
    return best, f"{words}; as {rival.reading.words} {rival.counts}" if rival else words


def _same_unit(lines: Sequence[PlacedLine], best: Scored, unit: str) -> bool:
    """True for a unit that gives the same places as the chosen reading."""
    return _alike(best, _scored(lines, [PlaceReading(unit, best.reading.order)], [0.0])[0])


def _readings(lines: Sequence[PlacedLine], told: Sequence[PlaceReading], shares: bool) -> Iterator[PlaceReading]:
    place = lines[0].place
    units: Sequence[str] = (*_UNITS, PADDED, *_resized(lines[0].size))
    if place.fixed:
        units = (place.fixed,)
    given = [t.unit for t in told if t.unit]
    if given and not place.fixed:
        # A model that counts in thousandths may write shares once.
        units = (*given, "shares") if shares else given
    orders = ("xy", "yx", "xyxy", "yxyx") if place.pair else _ORDERS[len(place.values)]
    if place.order:
        orders = (place.order,)
    allowed = [t.order for t in told if t.order and t.order in orders]
    for unit in units:
        for order in allowed or orders:
            yield PlaceReading(unit, order)


def _resized(size: tuple[int, int]) -> list[str]:
    """Units in pixels of a picture that was made smaller or larger by one of the usual rules."""
    longer, shorter = max(size), min(size)
    sides = [*_SIDES, *(longer * part for part in _FRACTIONS), *(side * longer / shorter for side in _SIDES)]
    whole = sorted({round(side) for side in sides if side <= 3000})
    squares = (f"pixels:{side}x{side}" for side in _SIDES)
    of_qwen = (f"pixels:qwen-{tokens}" for tokens in QWEN_SERVED)
    return ["pixels:qwen", *of_qwen, *(f"pixels:{side}" for side in whole), *squares]


def _prior(line: PlacedLine, reading: PlaceReading, shares: bool, unit: str) -> float:
    """Log odds of a reading before any place is looked at, nats."""
    habit, (hinted, y_hinted) = habit_of(line.model), suggested(line.place.form)
    y_first = reading.order.startswith("y")
    score = _BY_ORDER[reading.order] + PAIR_OF_POINTS * (line.place.pair and reading.point)
    if habit is None or reading.unit != habit[0]:
        score += _LESS_LIKELY.get(reading.unit, SEVERAL_SIZES if ":" in reading.unit else 0.0)
    if shares:
        known = KNOWN * (habit is not None and reading.unit == habit[0])
        return score + known + 10.0 * (reading.unit in ("shares", PADDED)) + HINTED * (y_first == bool(y_hinted))
    if habit is not None:
        score += KNOWN * (reading.unit == habit[0]) + KNOWN / 2 * (y_first == habit[1])
        # Some set how many pixels are kept, and some scale them back to the picture at hand.
        score += KNOWN / 2 * reading.unit.startswith(f"{habit[0]}-")
        score += (KNOWN - SURE) * (reading.unit == "pixels" and habit[0].startswith("pixels"))
    score += HINTED * (reading.unit == hinted and (habit is None or habit[0] == hinted))
    score += HINTED * (y_hinted is not None and y_first == y_hinted)
    score += ASKED * (reading.unit == line.unit) + HINTED * (reading.unit == unit)
    return score


def _scored(lines: Sequence[PlacedLine], readings: Sequence[PlaceReading], priors: Sequence[float]) -> list[Scored]:
    """The places and the score of each reading, in order."""
    boxes = np.array(
        [[r.box(line.place.values[: 2 if r.point else 4], line.size) for line in lines] for r in readings], np.float64
    ).reshape(len(readings), len(lines), 4)
    points = np.array([r.point for r in readings])
    low, high = boxes[:, :, :2], boxes[:, :, 2:]
    inside = np.all((low >= -ALIKE) & (high <= 1 + ALIKE) & (high >= low), axis=2)
    # Where all numbers of a file are in the first hundredth of a picture they are of a larger unit.
    impossible = (boxes < TINY).all(axis=(1, 2)) | ~inside.any(axis=1)
    score = np.array(priors) - 20.0 * impossible + OUTSIDE * (~inside).sum(axis=1)
    on, judged = np.zeros(len(readings), int), 0
    for k, line in enumerate(lines):
        if not len(line.things):
            continue
        judged += 1
        value, hit = _likely(boxes[:, k], line.things, points)
        score += np.where(inside[:, k], value, 0.0)
        on += hit & inside[:, k]
    rows = zip(readings, score.tolist(), boxes, inside.sum(axis=1).tolist(), on.tolist(), strict=True)
    return [Scored(r, total, places, within, hits, judged) for r, total, places, within, hits in rows]


def _likely(boxes: np.ndarray, things: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log likelihood ratios (R,) of a line's places ((R, 4)) against one anywhere, and (R,) bool: is it on a thing."""
    x, y = boxes[:, None, 0], boxes[:, None, 1]
    within = (things[:, 0] <= x) & (x <= things[:, 2]) & (things[:, 1] <= y) & (y <= things[:, 3])
    covered = min(max(_covered(things.tobytes(), len(things)), 0.01), 0.9)
    hit = within.any(axis=1)
    of_point = np.where(hit, math.log(SHARE_ON / covered), math.log((1 - SHARE_ON) / (1 - covered)))
    overlap = iou_2d(boxes, things).max(axis=1)
    # Of a box anywhere the overlap is seldom above .2; of one that is meant it is mostly above .5.
    of_box = np.log(1 - SHARE_ON + SHARE_ON * (overlap / 0.35) ** 5)
    return np.where(points, of_point, of_box), np.where(points, hit, overlap >= HIT)


@lru_cache(maxsize=4096)
def _covered(things: bytes, count: int) -> float:
    """Share of the picture that boxes cover, on a grid."""
    boxes = np.frombuffer(things, np.float64).reshape(count, 4)
    at = (np.arange(50) + 0.5) / 50
    across = (boxes[:, None, 0] <= at) & (at <= boxes[:, None, 2])
    down = (boxes[:, None, 1] <= at) & (at <= boxes[:, None, 3])
    return float((across[:, None, :] & down[:, :, None]).any(axis=0).mean())


def _alike(a: Scored, b: Scored) -> bool:
    """True for two readings of the same places."""
    return a.reading.point == b.reading.point and bool((np.abs(a.boxes - b.boxes).max(axis=1) <= ALIKE).mean() >= 0.9)
