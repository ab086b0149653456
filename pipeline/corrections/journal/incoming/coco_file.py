"""Corrections in COCO files: what `export --format coco` wrote, edited by a person, a script or an annotation tool.

Tools such as CVAT write polygons for masks, round boxes, number annotations
anew and keep none of our keys. Pictures are told by `frame`, else by the file
name that the export gave them; annotations by `object`, also as an attribute.
Where no annotation of a file has it any more, by where they lie: by the greatest
overlap of 2D boxes in a picture, of one half at least, or within an object's box
and with its class name. What is left is new.

`refs.json` and `relations.json` name annotations: `instances.json` of the same
export must stand beside them, and say of which object each is. All three become
rows as those of JSON lines.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.frame_rows import BOX_COLUMNS, Row
from pipeline.corrections.journal.incoming.claims import Claims, no_number, take_row
from pipeline.corrections.journal.incoming.segmentation import (
    bounds_of,
    is_rectangle,
    mask_of,
    near,
    polygons_of,
    rectangle_of,
    same_outline,
)
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.masks import decode_run_length, encode_run_length, mask_box
from pipeline.labels.exports.row_provenance import ExportedFrom
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.segmenter import share_inside
from pipeline.system.errors import InputError, Shown, as_input_error, needed, require
from pipeline.system.safe_files import read_json

SAME_BOX = 0.5
WITHIN = 0.9
ROUNDED = 0.02
"""Pixels by which a 2D box may differ and be the same: tools write two decimals."""
_NAMED = re.compile(r"(?:.*[/\\])?(\d{6,})\.\w+")
Annotations = dict[int, tuple[str, int]]
"""Frame and object of annotations, by id."""


def load_coco(path: Path) -> Any:
    """Read a JSON file; InputError for a missing, too large or invalid file."""
    with as_input_error(
        "not a readable JSON file", OSError, ValueError, MemoryError, got=lambda e: str(e)[:100], path=path
    ):
        return read_json(path, parse_constant=no_number)


def listed(content: Any, key: str, name: str) -> list[Any]:
    """List in a file; InputError for none."""
    found: Any = content.get(key) if isinstance(content, dict) else None
    require(isinstance(found, list), f"{name} lacks the list {key!r}", cause="is it COCO?")
    return found


def entries(rows: list[Any], what: str, key: str = "id") -> Iterator[tuple[str, Any]]:
    """Rows of a list, each with a name for messages."""
    for index, row in enumerate(rows):
        yield f"{what} {row.get(key) if isinstance(row, dict) else index!r}", row


def base_of(content: Any) -> Any:
    """State named by a file; None for no name."""
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
    """Read `instances.json` into claims; InputError for no COCO at all.

    `reject_deleted` rejects objects that a listed picture lacks, `crowds` takes new annotations with `iscrowd` 1,
    `outline` is the tolerance of polygons in pixels.
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
        reader = _Reader(claims, claims.states.frame(frame, state), categories, outline)
        numbers = reader.matched_by_overlap(found) if bare else {}
        seen: set[int] = set()
        for index, (where, row) in enumerate(found):
            with claims.reading(where):
                number = numbers.get(index) if bare else number_of(row)
                require(number not in seen, f"a second annotation of object {number}")
                if number is not None:
                    # Also one that cannot be read was not deleted.
                    seen.add(number)
                if number is None and row.get("iscrowd") == 1 and not crowds:
                    claims.notes[
                        "new annotations with iscrowd 1 left out: they may be groups (--crowds takes them)"
                    ] += 1
                    continue
                take_row("objects", where, reader.row_of(row, number), frame, state, claims)
        if reject_deleted:
            claims.say_deleted(f"{name} image {image}", frame, seen, state)


def images_of(images: list[Any], name: str, claims: Claims) -> dict[int, str]:
    """Frames by image id; a wrong image is a problem of the file."""
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
    """Object of an annotation, also among attributes, as of tools."""
    attributes = row.get("attributes")
    if row.get("object") is not None or not isinstance(attributes, dict):
        return row.get("object")
    value = attributes.get("object")
    return int(value) if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 10 else value


def number_of(row: Row) -> int | None:
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
    outline: float

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
        box = _box3d(row["box3d"]) if "box3d" in row else {}
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
        return same_outline(before, pixels, self.outline) if polygons else bool((before == pixels).all())

    def _rectangle(self, row: Row, was: Row, drawn: np.ndarray | None) -> Row:
        """2D box changed on purpose, not by a new mask."""
        if "bbox" not in row:
            return {}
        box, before = rectangle_of(row["bbox"]), list(was["bbox"])
        slack, outline = max(self.outline, 1), row.get("segmentation")
        if near(box, before, ROUNDED) and was["mask"] is None and is_rectangle(outline):
            box = bounds_of(polygons_of(outline)[0])
        if near(box, before, ROUNDED):
            box = row.get("bbox_xyxy")
            if box is None or box == before:
                return {}
        # The box around the pixels that the file has follows from them, and was not moved.
        around: list[Sequence[float]] = [] if drawn is None else [list(mask_box(drawn))]
        if outline and isinstance(outline, list) and was["mask"] is not None:
            around += [before, bounds_of(np.concatenate(polygons_of(outline)))]
        return {} if any(near(box, other, slack) for other in around) else {"bbox": box}


def _box3d(value: Any) -> Row:
    """Columns of a 3D box, R row by row; null for none."""
    if value is None:
        return dict.fromkeys(BOX_COLUMNS)
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


def annotated(instances: Any, name: str, claims: Claims) -> tuple[dict[int, str], Annotations, Any]:
    """Frames by image, objects by annotation, and the stated base; InputError for no COCO."""
    frames = images_of(listed(instances, "images", name), name, claims)
    found: Annotations = {}
    for row in listed(instances, "annotations", name):
        number = number_of(row) if isinstance(row, dict) else None
        whole = isinstance(row, dict) and all(type(row.get(key)) is int for key in ("id", "image_id"))
        if number is not None and whole and row["image_id"] in frames:
            found[row["id"]] = frames[row["image_id"]], number
    return frames, found, base_of(instances)


def read_refs(
    refs: Any, name: str, frames: dict[int, str], annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    """Read `refs.json`: sentences, answers, marks and statuses."""
    require(isinstance(refs, list), f"{name} is a list", got=type(refs).__name__)
    seen: set[tuple[str, Any]] = set()
    for where, ref in entries(refs, f"{name} ref", "ref_id"):
        with claims.reading(where):
            listed_image = isinstance(ref, dict) and type(ref.get("image_id")) is int and ref["image_id"] in frames
            require(listed_image, "it is of no image that instances.json lists")
            frame, own = frames[ref["image_id"]], str(ref.get("id"))
            require((frame, own) not in seen, "the second one of its expression")
            seen.add((frame, own))
            row = {key: ref[key] for key in ("id", "ambiguous", "mark", "status") if key in ref}
            if "sentences" in ref:
                first: Any = ref["sentences"][0] if isinstance(ref["sentences"], list) and ref["sentences"] else None
                require(isinstance(first, dict), "sentences is a list of sentences", got=Shown(ref["sentences"], 40))
                row["text"] = first.get("raw")
            for key, field in (("target_ann_ids", "targets"), ("acceptable_ann_ids", "acceptable")):
                if key in ref:
                    row[field] = _objects(ref[key], frame, annotations, key)
            take_row("expressions", where, row, frame, state, claims)


def _objects(ids: Any, frame: str, annotations: Annotations, what: str) -> list[int]:
    sound = isinstance(ids, list) and all(type(n) is int for n in ids)
    require(sound, f"{what} is a list of annotations", got=Shown(ids, 40))
    for n in ids:
        require(
            annotations.get(n, ("", 0))[0] == frame,
            f"{what} names annotation {n}, which instances.json does not give an object of this image",
        )
    return [annotations[n][1] for n in ids]


def read_relations(
    content: Any, name: str, frames: dict[int, str], annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    """Read `relations.json`: columns of states, and statuses."""
    seen: set[int] = set()
    for where, image in entries(listed(content, "images", name), f"{name} image", "image_id"):
        with claims.reading(where):
            require(isinstance(image, dict) and type(image.get("image_id")) is int, "it has no image_id")
            known = image["image_id"] in frames and image["image_id"] not in seen
            require(known, "it is of no image that instances.json lists, or of one a second time")
            seen.add(image["image_id"])
            frame = frames[image["image_id"]]
            for (a, b), row in _pairs(image, claims.states.frame(frame, state), annotations).items():
                take_row("relations", f"{where}, pair {a},{b}", {"a": a, "b": b, **row}, frame, state, claims)


def _pairs(image: Row, base: EffectiveFrame, annotations: Annotations) -> dict[tuple[int, int], Row]:
    """Convert the columns of an image to rows by pair."""
    a, b = (_objects(image.get(end), base.frame, annotations, end) for end in ("a", "b"))
    columns = {r: image[r] for r in PAIRWISE if r in image}
    for relation, states in columns.items():
        sound = isinstance(states, list) and len(states) == len(a)
        require(sound, f"the column {relation!r} has not one state a pair")
    found: dict[tuple[int, int], Row] = {
        pair: {r: states[at] for r, states in columns.items()} for at, pair in enumerate(zip(a, b, strict=False))
    }
    require(len(a) == len(b) == len(found), "the columns a and b do not give each pair once")
    if "statuses" in image:
        # One that was exported and is not listed any more was taken off.
        for pair in [ref.numbers for ref in base.statuses if ref.kind == "relation"]:
            found.setdefault(pair, {})  # pyright: ignore[reportArgumentType]
        for row in found.values():
            row["statuses"] = []
        listed_here: list[Any] = image["statuses"] if isinstance(image["statuses"], list) else [None]
        for entry in listed_here:
            sound = isinstance(entry, dict) and entry.get("relation") in base.setting.relations
            require(sound, "statuses is a list of {a, b, relation, status}", got=Shown(entry))
            m, n = _objects([entry.get("a"), entry.get("b")], base.frame, annotations, "statuses")
            found.setdefault((m, n), {}).setdefault("statuses", []).append(entry)
    return found
