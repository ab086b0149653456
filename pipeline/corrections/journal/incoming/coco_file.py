"""Corrections in COCO files: what `export --format coco` wrote, edited by a person, a script or an annotation tool.

Tools such as CVAT write polygons for masks, round boxes, number annotations
anew and keep none of our keys. Pictures are told by `frame`, else by the file
name that the export gave them; annotations by `object`, also as an attribute.
Where no annotation of a file has it any more, by where they lie: by the greatest
overlap of 2D boxes in a picture, of one half at least, or within an object's box
and with its class name. What is left is new. Annotations become rows as those of
JSON lines; sentences and relations come back by these alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import box_of, box_value
from pipeline.corrections.journal.frame_rows import BOX_COLUMNS, Row
from pipeline.corrections.journal.incoming.claims import Claims, no_number, take_row
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.masks import decode_run_length, encode_run_length, fill_polygons, mask_box
from pipeline.labels.exports.base import ExportedFrom
from pipeline.proposals.segmenter import share_inside
from pipeline.system.errors import InputError, Shown, as_input_error, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import read_json

SAME_BOX = 0.5
WITHIN = 0.9
ROUNDED = 0.02
"""Pixels by which a 2D box may differ and be the same: tools write two decimals."""
OUTLINE = 1.5
"""Pixels by which a polygon may leave the exported mask and be that mask."""
_NAMED = re.compile(r"(?:.*[/\\])?(\d{6,})\.\w+")


def load_coco(path: Path) -> Any:
    """Read a JSON file; InputError for a missing, too large or invalid file."""
    with as_input_error(
        "not a readable JSON file", OSError, ValueError, MemoryError, got=lambda e: str(e)[:100], path=path
    ):
        return read_json(path, parse_constant=no_number)


def read_instances(
    content: Any, name: str, claims: Claims, state_of: Callable[[Any], ExportedFrom], *, reject_deleted: bool
) -> None:
    """Read `instances.json` into claims; InputError for no COCO at all.

    `reject_deleted` rejects objects that a listed picture lacks.
    """
    info = content.get("info") if isinstance(content, dict) else None
    state = state_of(info.get("base") if isinstance(info, dict) else None)
    categories: dict[int, str] = {}
    for where, row in _listed(content, "categories", f"{name} category", claims):
        with claims.reading(where):
            require(isinstance(row.get("name"), str), "a category has a name")
            categories[row["id"]] = row["name"]
    frames: dict[str, int] = {}
    for where, row in _listed(content, "images", f"{name} image", claims):
        with claims.reading(where):
            frame = _frame_of(row, claims)
            require(frame not in frames, f"the second image of frame {frame}")
            frames[frame] = row["id"]
    by_image: dict[Any, list[tuple[str, Row]]] = {image: [] for image in frames.values()}
    for where, row in _listed(content, "annotations", f"{name} annotation", claims):
        with claims.reading(where):
            image = row.get("image_id")
            known = type(image) is int and image in by_image
            require(known, f"it is of image {image!r}, which the file does not list")
            by_image[image].append((where, row))
    bare = all(_stated(row) is None for found in by_image.values() for _, row in found)
    for frame, image in frames.items():
        found, seen = by_image[image], set[int]()
        reader = _Reader(claims, claims.states.frame(frame, state), categories)
        numbers = reader.matched_by_overlap(found) if bare else {}
        for index, (where, row) in enumerate(found):
            with claims.reading(where):
                number = numbers.get(index) if bare else _number_of(row)
                require(number not in seen, f"a second annotation of object {number}")
                if number is not None:
                    # Also one that cannot be read was not deleted.
                    seen.add(number)
                take_row("objects", where, reader.row_of(row, number), frame, state, claims)
        if reject_deleted:
            claims.say_deleted(f"{name} image {image}", frame, seen, state)


def _listed(content: Any, key: str, what: str, claims: Claims) -> Iterator[tuple[str, Row]]:
    """Rows of a list by their ids, each with a name for messages; a wrong row is a problem of the file."""
    rows: Any = content.get(key) if isinstance(content, dict) else None
    require(isinstance(rows, list), f"{what.partition(' ')[0]} lacks the list {key!r}", cause="is it COCO?")
    ids: set[int] = set()
    for index, row in enumerate(rows):
        where = f"{what} {row.get('id')!r}" if isinstance(row, dict) else f"{what} at {index}"
        with claims.reading(where):
            require(isinstance(row, dict), f"not an object of JSON, got {type(row).__name__}")
            own = type(row.get("id")) is int and row["id"] not in ids
            require(own, f"its id must be a whole number of its own, at {index}")
            ids.add(row["id"])
            yield where, row


def _frame_of(image: Row, claims: Claims) -> str:
    frame, file_name = image.get("frame"), image.get("file_name")
    if frame is None and isinstance(file_name, str):
        named = _NAMED.fullmatch(file_name)
        frame = claims.states.index.name_of.get(int(named[1])) if named else None
        require(frame is not None, "no file name of an export", got=Shown(file_name), expected="such as 000012.jpg")
    if not isinstance(frame, str) or frame not in claims.states.index.of_frame:
        raise InputError("the labels have no such frame", got=repr(frame)[:60])
    row = claims.states.frame(frame, claims.states.now).auto.row
    size, known = [image.get(key, row[key]) for key in ("width", "height")], [row["width"], row["height"]]
    require(size == known, "the picture has another size", got=size, expected=known)
    return frame


def _stated(row: Row) -> Any:
    """Object of an annotation, also among attributes, as of tools."""
    attributes = row.get("attributes")
    if row.get("object") is not None or not isinstance(attributes, dict):
        return row.get("object")
    value = attributes.get("object")
    return int(value) if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 10 else value


def _number_of(row: Row) -> int | None:
    """Object number of an annotation; None for a new object; InputError for no number."""
    value = _stated(row)
    require(
        value is None or (type(value) is int and 0 <= value < 2**31), "object must be a number", got=Shown(value, 40)
    )
    return value


@dataclass(frozen=True)
class _Reader:
    """Reader of the annotations of one picture."""

    claims: Claims
    base: EffectiveFrame
    categories: dict[int, str]

    def matched_by_overlap(self, found: list[tuple[str, Row]]) -> dict[int, int]:
        """Objects by the index of overlapping annotations; see the module."""
        from scipy.optimize import linear_sum_assignment

        boxes: dict[int, list[float]] = {}
        for index, (_, row) in enumerate(found):
            with suppress(InputError):
                boxes[index] = rectangle_of(row.get("bbox"))
        objects = self.base.objects
        if not boxes or not objects:
            return {}
        theirs, ours = np.array(list(boxes.values())), np.array([row["bbox"] for row in objects.values()])
        overlap = iou_2d(theirs, ours)
        names = [self.categories.get(found[p][1].get("category_id", -1)) for p in boxes]  # pyright: ignore
        same = np.array([[n == row["label"] for row in objects.values()] for n in names])
        # Tools drop thin parts of an object: what is left lies within its box, and is called as it was.
        within = same & (share_inside(theirs, ours) >= WITHIN)
        likely = np.where(overlap >= SAME_BOX, 1 + overlap + 0.01 * same, np.where(within, overlap, 0))
        rows, columns = linear_sum_assignment(likely, maximize=True)
        indices, numbers = list(boxes), list(objects)
        matched = {indices[r]: numbers[c] for r, c in zip(rows, columns, strict=True) if likely[r, c] > 0}
        self.claims.notes["annotations told by where they lie, for none says which object it is of"] += len(matched)
        return matched

    def row_of(self, row: Row, number: int | None) -> Row:
        """Convert an annotation to a row of objects; of an exported object only changes."""
        category: Any = row.get("category_id")
        require(type(category) is int and category in self.categories, "no such category", got=Shown(category, 40))
        label = self.categories[category]
        pixels = mask_of(row.get("segmentation"), self.base.size)
        box: Row = dict.fromkeys(BOX_COLUMNS) if "box3d" in row else {}
        if row.get("box3d") is not None:
            box |= box_value(box_of(row["box3d"]))
        if number is None:
            return {"label": label, **self._place(row, pixels, boxed=any(box.values())), **box}
        was = needed(
            self.base.object(number), f"frame {self.base.frame} had no object {number}", cause="a new one has no number"
        )
        found = {"object": number, "label": label, **{k: row[k] for k in ("status",) if k in row}, **box}
        drawn = None if pixels is None or self._same_pixels(row, pixels, was) else pixels
        if drawn is not None:
            require(drawn.any(), "the mask is empty")
            found["mask"] = encode_run_length(drawn)
        return found | self._rectangle(row, was, drawn)

    def _place(self, row: Row, pixels: np.ndarray | None, *, boxed: bool) -> Row:
        """Mask or 2D box of a new object."""
        require(pixels is None or pixels.any(), "the mask is empty")
        if pixels is not None and not is_rectangle(row["segmentation"]):
            return {"mask": encode_run_length(pixels)}
        return {"bbox": rectangle_of(row.get("bbox"))} if row.get("bbox") is not None or not boxed else {}

    def _same_pixels(self, row: Row, pixels: np.ndarray, was: Row) -> bool:
        if was["mask"] is None:
            # Exported as the corners of its 2D box: what moves them moves the box.
            return is_rectangle(row["segmentation"])
        before = decode_run_length(self.base.size, was["mask"])
        polygons = isinstance(row.get("segmentation"), list)
        return same_outline(before, pixels, OUTLINE) if polygons else bool((before == pixels).all())

    def _rectangle(self, row: Row, was: Row, drawn: np.ndarray | None) -> Row:
        """2D box changed on purpose, not by a new mask."""
        if "bbox" not in row:
            return {}
        box, before = rectangle_of(row["bbox"]), list(was["bbox"])
        outline = row.get("segmentation")
        if near(box, before, ROUNDED) and was["mask"] is None and is_rectangle(outline):
            box = bounds_of(polygons_of(outline)[0])
        if near(box, before, ROUNDED):
            return {}
        # The box around the pixels that the file has follows from them, and was not moved.
        around: list[Sequence[float]] = [] if drawn is None else [list(mask_box(drawn))]
        if outline and isinstance(outline, list) and was["mask"] is not None:
            around += [before, bounds_of(np.concatenate(polygons_of(outline)))]
        return {} if any(near(box, other, OUTLINE) for other in around) else {"bbox": box}


LONGEST_OUTLINE = 2e6
"""Pixels that all polygons of an object may run through: rasterising takes memory in proportion."""


def rectangle_of(value: Any) -> list[float]:
    """Corners x0, y0, x1, y1 of COCO's x, y, width, height; InputError for none."""
    sound = isinstance(value, list) and len(value) == 4 and all(type(x) in (int, float) for x in value)
    # Beyond 1e9 is no picture; NaN is not below it either.
    require(
        sound and all(abs(x) < 1e9 for x in value) and value[2] > 0 and value[3] > 0,
        "bbox is x, y, width, height above 0",
        got=Shown(value),
    )
    x, y, w, h = map(float, value)
    return [x, y, x + w, y + h]


def bounds_of(corners: np.ndarray) -> list[float]:
    """Bounding rectangle of corners (N, 2)."""
    return [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()]


def near(one: Sequence[float], other: Sequence[float], slack: float) -> bool:
    return all(math.isclose(x, y, abs_tol=slack, rel_tol=0) for x, y in zip(one, other, strict=True))


def mask_of(segmentation: Any, size: tuple[int, int]) -> np.ndarray | None:
    """Mask (H, W) bool of COCO's `segmentation`; None if empty; InputError for no code or polygons of that
    size.
    """
    if segmentation in (None, [], {}):
        return None
    if isinstance(segmentation, dict):
        found, counts = segmentation.get("size"), segmentation.get("counts")
        require(found == list(size), "the mask has another size", got=repr(found)[:40], expected=list(size))
        if isinstance(counts, str) or (isinstance(counts, list) and all(type(n) is int for n in counts)):
            return decode_run_length(size, counts, "the mask")
        raise InputError("a run-length code is a text or a list of whole numbers", got=repr(counts)[:40])
    return polygon_mask(polygons_of(segmentation), size)


def polygons_of(segmentation: Any) -> list[np.ndarray]:
    """Corners (N, 2) float64 of each polygon, N >= 3; InputError for none."""
    require(
        isinstance(segmentation, list),
        "a segmentation is a run-length code or a list of polygons",
        got=Shown(segmentation, 40),
    )
    found = []
    for polygon in segmentation:
        numbers = isinstance(polygon, list) and all(type(x) in (int, float) and abs(x) < 1e9 for x in polygon)
        require(
            numbers and len(polygon) >= 6 and len(polygon) % 2 == 0 and all(map(math.isfinite, polygon)),
            "a polygon is x, y of three corners or more",
            got=Shown(polygon, 40),
        )
        found.append(np.array(polygon, np.float64).reshape(-1, 2))
    return found


def polygon_mask(polygons: list[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """Mask (H, W) bool of the pixels inside any polygon, as in the COCO API."""
    clipped = [np.clip(p, 0, np.array(size[::-1], np.float64)) for p in polygons]
    length = sum(float(np.abs(np.diff(p, axis=0, append=p[:1])).max(axis=1).sum()) + len(p) for p in clipped)
    require(
        length <= LONGEST_OUTLINE,
        "the polygons are too long",
        got=f"{length:.3g} pixels",
        expected=f"{LONGEST_OUTLINE:.3g}",
    )
    return fill_polygons(size, clipped)


def same_outline(mask: np.ndarray, other: np.ndarray, tolerance: float) -> bool:
    """Compare a mask made from polygons with another, but for rounding.

    Polygons know no holes, and drawing moves edges by up to a pixel: differences, holes filled, must lie within
    `tolerance` pixels of the other's edge.
    """
    rows, columns = np.nonzero(mask | other)
    if not len(rows):
        return True
    index = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    # The picture ends where its pixels do: beyond it is outside.
    one, two = (np.pad(m[index], 1) for m in (mask, other))
    more, less = two & ~_filled(one), one & ~_filled(two)
    beyond = cv2.distanceTransform((~one).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    within = cv2.distanceTransform(one.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return bool((beyond[more] <= tolerance).all() and (within[less] <= tolerance).all())


def _filled(mask: np.ndarray) -> np.ndarray:
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(found, outlines, -1, 1, cv2.FILLED)
    return found.astype(np.bool_)


def is_rectangle(segmentation: Any) -> bool:
    """True for a single upright rectangular polygon: the export of a 2D box without a mask."""
    if not isinstance(segmentation, list) or len(segmentation) != 1:
        return False
    (corners,) = polygons_of(segmentation)
    if len(corners) == 5 and (corners[0] == corners[4]).all():
        corners = corners[:4]
    sides = [len(np.unique(line)) for line in corners.T]
    return len(corners) == 4 and sides == [2, 2] and len(np.unique(corners, axis=0)) == 4
