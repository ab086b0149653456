"""Corrections in COCO files: what `export --format coco` wrote, edited by a person, a script or an annotation tool.

Tools such as CVAT write polygons for masks, round boxes, number annotations
anew and keep none of our keys. Pictures are told by `frame`, else by the file
name that the export gave them; annotations by `object`, also as an attribute.
Where no annotation of a file has it any more, by where they lie: by the greatest
overlap of 2D boxes in a picture, of one half at least, or within an object's box
and with its class name. What is left is new. Polygons and both kinds of
run-length codes are read without trust.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame, Row
from pipeline.corrections.journal.field_refs import object_ref
from pipeline.corrections.journal.incoming.states import Claims
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.masks import decode_run_length, encode_run_length, fill_polygons, mask_box
from pipeline.labels.exports.row_provenance import ExportedFrom
from pipeline.proposals.segmenter import share_inside
from pipeline.system.errors import InputError, Shown, as_input_error, needed, require
from pipeline.system.safe_files import read_json

SAME_BOX = 0.5
WITHIN = 0.9
ROUNDED = 0.02
"""Pixels by which a 2D box may differ and be the same: tools write two decimals."""
_NAMED = re.compile(r"(?:.*[/\\])?(\d{6,})\.\w+")
LONGEST_OUTLINE = 2e6
"""Pixels that all polygons of an object may run through: rasterising takes memory in proportion."""


def load_coco(path: Path) -> Any:
    """The content of a JSON file.

    Raises
    ------
    InputError
        Missing, too large, or no JSON.
    """
    with as_input_error(
        "not a readable JSON file", OSError, ValueError, MemoryError, got=lambda e: str(e)[:100], path=path
    ):
        return read_json(path, parse_constant=no_number)


def no_number(word: str) -> float:
    """Refuse NaN and infinity in JSON."""
    raise ValueError(f"{word} is no number")


def listed(content: Any, key: str, name: str) -> list[Any]:
    """A list in a file; InputError where it is none."""
    found: Any = content.get(key) if isinstance(content, dict) else None
    require(isinstance(found, list), f"{name} lacks the list {key!r}", cause="is it COCO?")
    return found


def entries(rows: list[Any], what: str, key: str = "id") -> Iterator[tuple[str, Any]]:
    """The rows of a list, each with what a message calls it: by its key, else by its index in the list."""
    for index, row in enumerate(rows):
        yield f"{what} {row.get(key) if isinstance(row, dict) else index!r}", row


def base_of(content: Any) -> Any:
    """What a file says of the state that it was exported from; None where it says nothing."""
    info = content.get("info") if isinstance(content, dict) else None
    return info.get("base") if isinstance(info, dict) else None


def read_instances(
    content: Any,
    name: str,
    claims: Claims,
    state_of: Callable[[Any], ExportedFrom],
    *,
    reject_deleted: bool,
    crowds: bool,
    outline: float,
) -> None:
    """Read `instances.json`; raises InputError where it is no COCO at all.

    Parameters
    ----------
    reject_deleted : bool
        An object that the file lacks, in a picture that it has, is rejected.
    crowds : bool
        New annotations with `iscrowd` 1 are objects too.
    outline : float
        Pixels by which a polygon may differ from the mask that was exported.
    """
    state = state_of(base_of(content))
    categories = _categories(listed(content, "categories", name), name, claims)
    frames = images_of(listed(content, "images", name), name, claims)
    by_image: dict[Any, list[tuple[str, Row]]] = {image: [] for image in frames}
    ids: set[Any] = set()
    for index, row in enumerate(listed(content, "annotations", name)):
        if not isinstance(row, dict):
            claims.problem(f"{name} annotation at {index}", f"not an object of JSON, got {type(row).__name__}")
            continue
        where = f"{name} annotation {row.get('id')!r}"
        image = row.get("image_id")
        if type(row.get("id")) is not int or row["id"] in ids:
            claims.problem(f"{where} at {index}", "its id must be a whole number of its own")
        elif type(image) is not int or image not in by_image:
            claims.problem(where, f"it is of image {image!r}, which the file does not list")
        else:
            by_image[image].append((where, row))
        if isinstance(row.get("id"), int):
            ids.add(row["id"])
    bare = all(_stated(row) is None for found in by_image.values() for _, row in found)
    for image, found in by_image.items():
        frame = frames[image]
        reader = _Reader(claims, claims.states.frame(frame, state), state, categories, crowds, outline)
        numbers = reader.matched_by_overlap(found) if bare else {}
        seen: set[int] = set()
        for index, (where, row) in enumerate(found):
            claims.compared += 1
            with claims.reading(where):
                number = numbers.get(index) if bare else number_of(row)
                require(number not in seen, f"a second annotation of object {number}")
                if number is not None:
                    # Also one that cannot be read was not deleted.
                    seen.add(number)
                reader.annotation(where, row, number)
        if reject_deleted:
            claims.say_deleted(f"{name} image {image}", frame, seen, state)


def images_of(images: list[Any], name: str, claims: Claims) -> dict[int, str]:
    """Frames by the id of their image; what is wrong with an image is a problem of the file."""
    found: dict[int, str] = {}
    taken: set[str] = set()
    for where, image in entries(images, f"{name} image"):
        with claims.reading(where):
            require(
                isinstance(image, dict) and type(image.get("id")) is int and image["id"] not in found,
                "an image has a whole number of its own as id",
            )
            frame = _frame_of(image, claims)
            require(frame not in taken, f"the second image of frame {frame}")
            taken.add(frame)
            found[image["id"]] = frame
    return found


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


def _categories(categories: list[Any], name: str, claims: Claims) -> dict[int, str]:
    found: dict[int, str] = {}
    for where, category in entries(categories, f"{name} category"):
        with claims.reading(where):
            require(
                isinstance(category, dict) and type(category.get("id")) is int and category["id"] not in found,
                "a category has a whole number of its own as id",
            )
            require(isinstance(category.get("name"), str), "a category has a name")
            found[category["id"]] = category["name"]
    return found


def _stated(row: Row) -> Any:
    """What an annotation says of its object: in the annotation, or among its attributes as tools keep it."""
    attributes = row.get("attributes")
    if row.get("object") is not None or not isinstance(attributes, dict):
        return row.get("object")
    value = attributes.get("object")
    return int(value) if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 10 else value


def number_of(row: Row) -> int | None:
    """The object that an annotation is of; None for a new one; InputError where it is no number."""
    value = _stated(row)
    require(
        value is None or (type(value) is int and 0 <= value < 2**31), "object must be a number", got=Shown(value, 40)
    )
    return value


def rectangle_of(value: Any) -> list[float]:
    """x0, y0, x1, y1 of COCO's x, y, width, height; InputError where it is none."""
    sound = isinstance(value, list) and len(value) == 4 and all(type(x) in (int, float) for x in value)
    # Beyond 1e9 is no picture; NaN is not below it either.
    require(
        sound and all(abs(x) < 1e9 for x in value) and value[2] > 0 and value[3] > 0,
        "bbox is x, y, width, height above 0",
        got=Shown(value),
    )
    x, y, w, h = map(float, value)
    return [x, y, x + w, y + h]


@dataclass(frozen=True)
class _Reader:
    """Reads the annotations of one picture."""

    claims: Claims
    base: EffectiveFrame
    state: ExportedFrom
    categories: dict[int, str]
    crowds: bool
    outline: float

    def matched_by_overlap(self, found: list[tuple[str, Row]]) -> dict[int, int]:
        """Objects by the index of annotations that lie where they lay; see the module."""
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

    def annotation(self, where: str, row: Row, number: int | None) -> None:
        category: Any = row.get("category_id")
        require(type(category) is int and category in self.categories, "no such category", got=Shown(category, 40))
        label = self.categories[category]
        pixels = mask_of(row.get("segmentation"), self.base.size)
        box = _box3d(row["box3d"]) if "box3d" in row else None
        if number is None:
            self._new(where, row, label, pixels, box)
            return
        was = needed(
            self.base.object(number), f"frame {self.base.frame} had no object {number}", cause="a new one has no number"
        )
        self._say(where, number, "label", label)
        if "status" in row:
            self._say(where, number, "status", row["status"])
        if "box3d" in row:
            self._say(where, number, "box", box)
        drawn = None if pixels is None or self._same_pixels(row, pixels, was) else pixels
        if drawn is not None:
            require(drawn.any(), "the mask is empty")
            self._say(where, number, "mask", encode_run_length(drawn))
        self._rectangle(where, row, number, was, drawn)

    def _say(self, where: str, number: int, field: str, value: Any) -> None:
        self.claims.say(where, object_ref(self.base.frame, number, field), value, self.state)

    def _same_pixels(self, row: Row, pixels: np.ndarray, was: Row) -> bool:
        if was["mask"] is None:
            # Exported as the corners of its 2D box: what moves them moves the box.
            return is_rectangle(row["segmentation"])
        before = decode_run_length(self.base.size, was["mask"])
        polygons = isinstance(row.get("segmentation"), list)
        return same_outline(before, pixels, self.outline) if polygons else bool((before == pixels).all())

    def _rectangle(self, where: str, row: Row, number: int, was: Row, drawn: np.ndarray | None) -> None:
        """The 2D box, where it was changed on purpose: that of a new mask follows from it."""
        if "bbox" not in row:
            return
        box, before = rectangle_of(row["bbox"]), list(was["bbox"])
        slack, outline = max(self.outline, 1), row.get("segmentation")
        if _near(box, before, ROUNDED) and was["mask"] is None and is_rectangle(outline):
            box = bounds_of(polygons_of(outline)[0])
        if _near(box, before, ROUNDED):
            box = row.get("bbox_xyxy")
            if box is None or box == before:
                return
        # The box around the pixels that the file has follows from them, and was not moved.
        around: list[Sequence[float]] = [] if drawn is None else [list(mask_box(drawn))]
        if outline and isinstance(outline, list) and was["mask"] is not None:
            around += [before, bounds_of(np.concatenate(polygons_of(outline)))]
        if not any(_near(box, other, slack) for other in around):
            self._say(where, number, "bbox", box)

    def _new(self, where: str, row: Row, label: str, pixels: np.ndarray | None, box: Any) -> None:
        if row.get("iscrowd") == 1 and not self.crowds:
            self.claims.notes["new annotations with iscrowd 1 left out: they may be groups (--crowds takes them)"] += 1
            return
        seed: Row = {"label": label}
        require(pixels is None or pixels.any(), "the mask is empty")
        if pixels is not None and not is_rectangle(row["segmentation"]):
            seed["mask"] = encode_run_length(pixels)
        elif row.get("bbox") is not None or box is None:
            seed["bbox"] = rectangle_of(row.get("bbox"))
        if box is not None:
            seed["box"] = box
        self.claims.say_new(where, self.base.frame, seed, self.state)


def bounds_of(corners: np.ndarray) -> list[float]:
    """The rectangle around corners, (N, 2)."""
    return [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()]


def _near(one: Sequence[float], other: Sequence[float], slack: float) -> bool:
    return all(math.isclose(x, y, abs_tol=slack, rel_tol=0) for x, y in zip(one, other, strict=True))


def _box3d(value: Any) -> Any:
    """As a cell keeps it: R row by row in one list."""
    if value is None:
        return None
    require(isinstance(value, dict), "box3d is center, size and R", got=repr(value)[:40])
    R = value.get("R")
    flat = [x for line in R for x in line] if isinstance(R, list) and all(isinstance(x, list) for x in R) else R
    found = {"center": value.get("center"), "R": flat, "size": value.get("size")}
    for name, numbers in found.items():
        require(
            isinstance(numbers, list) and all(type(x) in (int, float) and abs(x) < 1e9 for x in numbers),
            f"{name} of box3d is a list of numbers",
            got=Shown(numbers, 40),
        )
    return found


def mask_of(segmentation: Any, size: tuple[int, int]) -> np.ndarray | None:
    """(H, W) bool of COCO's `segmentation`; None where it is empty or absent.

    Raises
    ------
    InputError
        It is neither a run-length code of that size nor a list of polygons.
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
    """(N, 2) float64 corners of each polygon, N >= 3; InputError where it is none."""
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
    """(H, W) bool: the pixels inside any of the polygons, as the COCO API has them."""
    clipped = [np.clip(p, 0, np.array(size[::-1], np.float64)) for p in polygons]
    length = sum(float(np.abs(np.diff(p, axis=0, append=p[:1])).max(axis=1).sum()) + len(p) for p in clipped)
    require(
        length <= LONGEST_OUTLINE, "the polygons are too long", got=f"{length:.3g} pixels",
        expected=f"{LONGEST_OUTLINE:.3g}",
    )  # fmt: skip
    return fill_polygons(size, clipped)


def same_outline(mask: np.ndarray, other: np.ndarray, tolerance: float) -> bool:
    """Whether a mask made from polygons is another mask, but for rounding.

    Polygons know no holes, and what draws them moves edges by up to a pixel:
    what one has beyond the other, holes filled, must lie within `tolerance`
    pixels of the other's edge.
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
    """Whether it is one polygon, an upright rectangle: how a 2D box is exported where there is no mask."""
    if not isinstance(segmentation, list) or len(segmentation) != 1:
        return False
    (corners,) = polygons_of(segmentation)
    if len(corners) == 5 and (corners[0] == corners[4]).all():
        corners = corners[:4]
    sides = [len(np.unique(line)) for line in corners.T]
    return len(corners) == 4 and sides == [2, 2] and len(np.unique(corners, axis=0)) == 4
