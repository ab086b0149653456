"""Reading exports of labels back, to check that nothing is lost in them; the program itself only writes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.labels.exports.base import extended_schema
from pipeline.labels.exports.coco import BOXES, EXPRESSION_KEYS, EXTENT, FRAME_KEYS, QUALITY
from pipeline.labels.exports.exporting import BLOCK, FORMATS, MARK
from pipeline.labels.exports.kitti import FIELDS
from pipeline.labels.reading import MANIFEST_FILE, arrow_schema, build_table, content_hash, read_table, table_of_rows
from pipeline.labels.schema import TABLES
from pipeline.system.arrow import pa, pj
from pipeline.system.errors import InputError, Shown, as_input_error, first_line, kind_and_text, needed, require
from pipeline.system.safe_files import parse_json, read_json, read_text


def load_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises InputError: missing or damaged.
    """
    with (
        as_input_error(
            "not a readable JSON file", ValueError, RecursionError, OSError, got=lambda e: str(e)[:120], path=path
        ),
        as_input_error("a file of the export is missing", FileNotFoundError, path=path),
    ):
        return read_json(path)


def import_labels(path: str | Path, format: str) -> dict[str, pa.Table]:
    """The tables of an export; of a lossless format checked against the hashes in its manifest."""
    root = Path(path).expanduser()
    read = needed(READERS.get(format), f"the format {format} holds no labels to read back", path=root)
    require(root.is_dir(), "there is no such export", expected="a folder", path=root)
    mark = _read_mark(root)
    stated = format if mark is None else mark.get("format")
    require(stated == format, "an export in another format", got=stated, expected=format, path=root)
    tables = dict(read(root))
    if FORMATS[format].lossless:
        _check_hashes(root, tables)
    return tables


def _check_hashes(root: Path, tables: Mapping[str, pa.Table]) -> None:
    manifest = load_json(root / MANIFEST_FILE)
    for name, table in tables.items():
        with as_input_error("the manifest is damaged", KeyError, TypeError, got=repr, path=root / MANIFEST_FILE):
            known = manifest["tables"][name]
            rows, known_hash = known["rows"], known["content_hash"]
        require(
            rows == table.num_rows,
            f"the table {name} is not whole",
            got=f"{table.num_rows} rows",
            expected=rows,
            path=root,
        )
        require(
            content_hash(table, name) == known_hash, f"the table {name} was changed after it was exported", path=root
        )


def _read_mark(folder: Path) -> dict[str, object] | None:
    """The record that an export left of itself, or None."""
    try:
        found = read_json(folder / MARK)
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def read_hub(root: Path) -> dict[str, pa.Table]:
    """The four tables, their files joined in order.

    Raises
    ------
    InputError
        Files are missing or damaged.
    """
    tables = {}
    for name in TABLES:
        paths = sorted((root / "data" / name).glob("train-*-of-*.parquet"))
        require(
            paths and paths[0].name.endswith(f"-of-{len(paths):05d}.parquet"),
            f"files of the table {name} are missing",
            path=root / "data" / name,
        )
        tables[name] = pa.concat_tables([read_table(path, name, arrow_schema(name).names) for path in paths])
    return tables


def read_rows(path: Path, name: str) -> pa.Table:
    """One table from its file of JSON lines.

    Raises
    ------
    InputError
        The file is missing, or a line of it is no row of that table.
    """
    schema = arrow_schema(name)
    with (
        as_input_error(f"not rows of {name}", pa.ArrowInvalid, pa.ArrowTypeError, OSError, got=first_line, path=path),
        as_input_error(f"the table {name} is missing", FileNotFoundError, path=path),
    ):
        if path.stat().st_size == 0:
            return schema.empty_table()
        found = pj.read_json(
            path,
            read_options=pj.ReadOptions(block_size=BLOCK),
            parse_options=pj.ParseOptions(
                explicit_schema=extended_schema(name).remove_metadata(), unexpected_field_behavior="error"
            ),
        )
    for field in schema:
        require(
            not (not field.nullable and found.column(field.name).null_count),
            f"a row of {name} lacks {field.name!r}",
            path=path,
        )
    return pa.Table.from_arrays([found.column(n) for n in schema.names], schema=schema)


NO_COLUMNS = ("image_id", "statuses", "provenance")
"""What an image has in `relations.json` that is no column of the table."""


def read_coco(root: Path) -> dict[str, pa.Table]:
    """The four tables of an export in COCO format.

    Raises
    ------
    InputError
        A file is missing, damaged, or lacks what the export wrote.
    """
    instances = load_json(root / "instances.json")
    refs, relations = load_json(root / "refs.json"), load_json(root / "relations.json")
    with as_input_error(
        "not a COCO export of labels",
        KeyError,
        TypeError,
        IndexError,
        ValueError,
        AttributeError,
        got=kind_and_text,
        cause="was it edited?",
        path=root,
    ):
        images = sorted(instances["images"] + instances["unusable_frames"], key=lambda image: image["id"])
        names = {image["id"]: image["frame"] for image in images}
        categories = {c["id"]: c["name"] for c in instances["categories"]}
        annotations = sorted(instances["annotations"], key=lambda a: a["id"])
        numbers = {a["id"]: a["object"] for a in annotations}
        return {
            "frames": table_of_rows("frames", [_frame(image) for image in images]),
            "objects": table_of_rows("objects", [_object(a, names[a["image_id"]], categories) for a in annotations]),
            "relations": _pairs(relations["images"], names, numbers),
            "expressions": table_of_rows("expressions", [_expression(r, names[r["image_id"]], numbers) for r in refs]),
        }


def _frame(image: dict[str, Any]) -> dict[str, Any]:
    return {
        "frame": image["frame"],
        "frame_index": image["id"],
        "width": image["width"],
        "height": image["height"],
        **{key: image["spatialviz"][key] for key in FRAME_KEYS},
    }


def _object(annotation: dict[str, Any], frame: str, categories: dict[int, str]) -> dict[str, Any]:
    segmentation = annotation["segmentation"]
    row = {
        "frame": frame,
        "frame_index": annotation["image_id"],
        "object": annotation["object"],
        "label": categories[annotation["category_id"]],
        "score": annotation["score"],
        "instance": annotation["instance"],
        "bbox": annotation["bbox_xyxy"],
        "mask": segmentation["counts"] if isinstance(segmentation, dict) else None,
        "mask_pixels": annotation["area"],
    }
    for key, prefix in BOXES.items():
        box = annotation[key] or {"center": None, "size": None, "R": None}
        R = box["R"]
        row |= {f"{prefix}center": box["center"], f"{prefix}size": box["size"]}
        row[f"{prefix}R"] = None if R is None else [x for line in R for x in line]
    row |= {key: annotation["extent"][key] for key in EXTENT}
    return row | {key: annotation["quality"][key] for key in QUALITY}


def _expression(ref: dict[str, Any], frame: str, numbers: dict[int, int]) -> dict[str, Any]:
    row = {
        "frame": frame,
        "frame_index": ref["image_id"],
        "text": ref["sentences"][0]["raw"],
        "target_object": numbers[ref["ann_id"]],
        "reference_object": numbers[ref["reference_ann_id"]],
        "targets": [numbers[n] for n in ref["target_ann_ids"]],
        "acceptable": [numbers[n] for n in ref["acceptable_ann_ids"]],
    }
    return row | {key: ref[key] for key in EXPRESSION_KEYS}


def _pairs(images: Iterable[dict[str, Any]], names: dict[int, str], numbers: dict[int, int]) -> pa.Table:
    found = []
    for image in images:
        columns = {key: values for key, values in image.items() if key not in NO_COLUMNS}
        columns |= {key: [numbers[n] for n in columns[key]] for key in ("a", "b")}
        frames, index = [names[image["image_id"]]] * len(columns["a"]), [image["image_id"]] * len(columns["a"])
        found.append(build_table("relations", {"frame": frames, "frame_index": index, **columns}))
    return pa.concat_tables(found) if found else arrow_schema("relations").empty_table()


SURVIVING = {
    "frames": ("frame", "frame_index", "ok", "width", "height", "K", "up"),
    "objects": ("frame", "frame_index", "object", "label", "score", "bbox", "touches_border", "center", "R", "size"),
}
"""The columns that reading gives back."""


def read_kitti(root: Path) -> dict[str, pa.Table]:
    """Frames and objects, with the columns of SURVIVING.

    Raises
    ------
    InputError
        A file is missing, or a line of it is no KITTI label.
    """
    names = {str(token): str(name) for token, name in load_json(root / "classes.json").items()}
    usable = set(_lines(root / "ImageSets" / "train.txt"))
    frames: list[dict[str, Any]] = []
    objects: list[dict[str, Any]] = []
    for line in _lines(root / "index.txt"):
        with as_input_error("not a line of index.txt", ValueError, got=Shown(line, 80), path=root / "index.txt"):
            number, width, height, written = line.split(" ", 3)
            frame = {
                "frame": parse_json(written) if written.startswith('"') else written,
                "frame_index": int(number),
                "ok": number in usable,
                "width": int(width),
                "height": int(height),
                "K": None,
                "up": None,
            }
        if frame["ok"]:
            P, level = _read_calibration(root / "calib" / f"{number}.txt")
            frame |= {"K": (P[:, :3] @ level).ravel().tolist(), "up": (-level[1]).tolist()}
            objects += _read_objects(root, number, frame, level, names)
        frames.append(frame)
    return {name: _surviving(name, rows) for name, rows in (("frames", frames), ("objects", objects))}


def _lines(path: Path) -> list[str]:
    with as_input_error(
        "a file of the export is missing or damaged", OSError, UnicodeDecodeError, got=lambda e: str(e)[:120], path=path
    ):
        return [line for line in read_text(path).split("\n") if line]


def _read_calibration(path: Path) -> tuple[np.ndarray, np.ndarray]:
    try:
        found = dict(line.split(": ", 1) for line in _lines(path))
        P, level = (np.array(found[key].split(), np.float64) for key in ("P2", "R0_rect"))
        return P.reshape(3, 4), level.reshape(3, 3)
    except (KeyError, ValueError) as error:
        raise InputError("not a KITTI calibration", got=str(error)[:80], path=path) from error


def _read_objects(
    root: Path, number: str, frame: Mapping[str, Any], level: np.ndarray, names: Mapping[str, str]
) -> Iterator[dict[str, Any]]:
    path, ids_path = root / "label_2" / f"{number}.txt", root / "object_ids" / f"{number}.txt"
    lines, ids = _lines(path), _lines(ids_path)
    require(
        len(lines) == len(ids),
        "another number of objects than of labels",
        got=len(ids),
        expected=len(lines),
        path=ids_path,
    )
    for k, (line, own) in enumerate(zip(lines, ids, strict=True), start=1):
        with as_input_error(f"line {k} is no label", ValueError, KeyError, got=lambda e: str(e)[:80], path=path):
            token, *rest = line.split(" ")
            values = [float(x) for x in rest]
            if len(values) != FIELDS - 1:
                raise ValueError(f"{len(values) + 1} fields")
            row = {
                "frame": frame["frame"],
                "frame_index": frame["frame_index"],
                "object": int(own),
                "label": names[token],
                "score": values[14],
                "bbox": values[3:7],
                "touches_border": values[0] > 0,
                "center": None,
                "R": None,
                "size": None,
            }
        if values[7] >= 0:
            box = from_kitti(np.array(values[7:10]), np.array(values[10:13]), values[13], level)
            row |= {key: part.ravel().tolist() for key, part in zip(("center", "R", "size"), box, strict=True)}
        yield row


def _surviving(name: str, rows: list[dict[str, Any]]) -> pa.Table:
    schema = arrow_schema(name)
    fields = [schema.field(column) for column in SURVIVING[name]]
    return pa.Table.from_arrays(
        [pa.array([row[f.name] for row in rows], f.type) for f in fields],
        schema=pa.schema(fields, metadata=schema.metadata),
    )


def from_kitti(
    dimensions: np.ndarray, location: np.ndarray, rotation_y: float, R_level_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(center, R, size) in the camera frame: the inverse of `to_kitti`."""
    h, w, length = dimensions
    c, s = np.cos(rotation_y), np.sin(rotation_y)
    own = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    center = R_level_camera.T @ (location - np.array([0.0, h / 2, 0.0]))
    return center, R_level_camera.T @ own, np.array([length, h, w])


READERS: dict[str, Callable[[Path], Mapping[str, pa.Table]]] = {
    "jsonl": lambda root: {name: read_rows(root / f"{name}.jsonl", name) for name in TABLES},
    "coco": read_coco,
    "kitti": read_kitti,
    "parquet": read_hub,
}
