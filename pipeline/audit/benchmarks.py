"""Benchmarks of statements about pictures and scans, read by the keys that they are published with.

VSR          cambridgeltl/visual-spatial-reasoning, data/splits/*.jsonl: image, caption, label (1 for true), relation
BLINK        BLINK-Benchmark/BLINK, Spatial_Relation: idx, sub_task, question, choices, answer ("(A)"), image_1
CV-Bench     nyu-visionx/CV-Bench, test.jsonl: idx, task, question, choices, answer ("(A)"), filename
What'sUp     amitakamath/whatsup_vlms: controlled_images_dataset.json of image_path and caption_options, the first of
             which is right; coco_qa_two_obj.json and vg_qa_two_obj.json of [picture, right, wrong]
SpatialScore and others: question, answer (yes or no), and a key that names the picture
ScanRefer    daveredrum/ScanRefer: scene_id, object_id, object_name, ann_id, description
Nr3D, Sr3D   referit3d.github.io, nr3d.csv: scan_id, target_id, instance_type, utterance
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.datasets.frame_names import Picture
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import Content, read_content
from pipeline.system.safe_files import parquet_columns, read_parquet

_LETTER = re.compile(r"\W*([A-Za-z])\W*")
_MARKED = re.compile(r"\s*\(annotated by the \w+ box\)")
_WHERE = re.compile(r"where is the (.+?) located with respect to the (.+?)\?", re.IGNORECASE)
_PICTURES = ("image", "filename", "image_path", "img_path", "img_paths", "images", "image_1", "img", "file_name")
_PIXELS = frozenset({"image", "image_1", "image_2", "image_3", "image_4", "images"})
"""Columns of published tables that hold the pictures themselves."""


NO_RELATION = "it is not whether one thing stands in a relation to another"


@dataclass(frozen=True)
class Statement:
    """An item: a statement, and whether it is said to be true."""

    id: str
    picture: Picture  # or the scan
    text: str
    true: bool
    truth: str  # what the benchmark says is right, in its words
    why_not: str = ""  # why geometry cannot judge it; empty where it may
    object: str = ""  # of a scan: the number of the object that is meant


Row = Mapping[str, Any]
Form = tuple[str, set[str], Callable[[Row, str], Iterator[Statement]]]


def _picture(row: Row, where: str) -> Picture:
    for name in _PICTURES:
        found = row.get(name)
        found = found[0] if isinstance(found, list) and found else found
        found = found.get("path") if isinstance(found, dict) else found
        if isinstance(found, str | int) and not isinstance(found, bool) and found != "":
            return found
    raise InputError(f"{where}: nothing names the picture", got=", ".join(row), expected=" | ".join(_PICTURES))


def _text(row: Row, name: str, where: str) -> str:
    value = row.get(name)
    require(isinstance(value, str) and value.strip(), f"{where}, {name}: no text", got=repr(value)[:60])
    return str(value).strip()


def _chosen(row: Row, where: str) -> str:
    """The right choice, in words."""
    choices, answer = row["choices"], str(row["answer"])
    require(isinstance(choices, list) and choices, f"{where}, choices: no list", got=repr(choices)[:60])
    letter = _LETTER.fullmatch(answer)
    place = ord(letter[1].upper()) - ord("A") if letter else -1
    require(
        0 <= place < len(choices) or answer in choices,
        f"{where}, answer: none of the choices",
        got=repr(answer),
        expected=f"(A) to ({chr(64 + len(choices))})",
    )
    return str(choices[place]) if answer not in choices else answer


def _vsr(row: Row, where: str) -> Iterator[Statement]:
    label = {"0": False, "1": True, "true": True, "false": False}.get(str(row["label"]).strip().lower())
    require(label is not None, f"{where}, label: neither true nor false", got=repr(row["label"]), expected="0 or 1")
    caption = _text(row, "caption", where)
    yield Statement(where, _picture(row, where), caption, bool(label), "true" if label else "false")


def _choices(row: Row, where: str) -> Iterator[Statement]:
    question, right = _text(row, "question", where), _chosen(row, where)
    own, picture = str(row.get("idx", where)), _picture(row, where)
    verdict = {"yes": True, "no": False}.get(right.strip(" .").lower())
    asked = _WHERE.search(_MARKED.sub("", question))
    if verdict is not None:
        yield Statement(own, picture, question, verdict, right)
    elif asked is not None:
        relation = {"left": "left of", "right": "right of"}.get(right.lower(), right)
        yield Statement(own, picture, f"the {asked[1]} is {relation} the {asked[2]}", True, right)
    else:
        kind = str(row.get("task") or row.get("sub_task") or "a choice")
        yield Statement(own, picture, question, True, right, f"{kind}: {NO_RELATION}")


def _whats_up(row: Row, where: str) -> Iterator[Statement]:
    options = row["caption_options"]
    told = isinstance(options, list) and len(options) > 0 and all(isinstance(option, str) for option in options)
    require(told, f"{where}, caption_options: no list of sentences", got=repr(options)[:60])
    for k, option in enumerate(options):
        own, truth = (where, "true") if k == 0 else (f"{where}, option {k}", "false")
        yield Statement(own, _picture(row, where), option, k == 0, truth)


def _question(row: Row, where: str) -> Iterator[Statement]:
    question, answer = _text(row, "question", where), str(row["answer"])
    verdict = {"yes": True, "no": False}.get(answer.strip(" .").lower())
    own = str(row.get("id", row.get("idx", where)))
    why = "" if verdict is not None else "its answer is neither yes nor no"
    yield Statement(own, _picture(row, where), question, verdict is not False, answer, why)


OF_A_SCAN = "it is about a whole scan, and frames are judged: lines of frame, sentence and targets would do"


def _scan_refer(row: Row, where: str) -> Iterator[Statement]:
    said, number = _text(row, "description", where), str(row["object_id"])
    own = f"{row['scene_id']}|{number}|{row.get('ann_id', where)}"
    yield Statement(own, str(row["scene_id"]), said, True, f"{row.get('object_name', '')} {number}", OF_A_SCAN, number)


def _nr3d(row: Row, where: str) -> Iterator[Statement]:
    said, number = _text(row, "utterance", where), str(row["target_id"])
    own = str(row.get("assignmentid") or where)
    yield Statement(own, str(row["scan_id"]), said, True, f"{row.get('instance_type', '')} {number}", OF_A_SCAN, number)


FORMS: tuple[Form, ...] = (
    ("VSR", {"caption", "label"}, _vsr),
    ("BLINK or CV-Bench", {"question", "choices", "answer"}, _choices),
    ("What'sUp", {"caption_options"}, _whats_up),
    ("ScanRefer", {"scene_id", "object_id", "description"}, _scan_refer),
    ("Nr3D", {"scan_id", "target_id", "utterance"}, _nr3d),
    ("questions", {"question", "answer"}, _question),
)
"""Forms with the keys that an item must have; the first that fits is taken."""


def is_benchmark(content: Content) -> bool:
    """Test for items of one of the forms."""
    return _is_listed(content) or any(keys <= content.first.keys() for _, keys, _ in FORMS)


def open_benchmark(path: Path) -> Content:
    """Content of a file of JSON, JSON lines, CSV, or a published table without its pictures."""
    if path.suffix != ".parquet":
        return read_content(path, "the benchmark")
    columns = [name for name in parquet_columns(path) if name not in _PIXELS]
    rows = read_parquet(path, columns).to_pylist()
    # Its pictures stand in the table: they go by their row.
    return Content([{"image": k, **row} for k, row in enumerate(rows)], path)


def read_benchmark(content: Content) -> tuple[str, list[Statement]]:
    """Name of a benchmark's form, and its items.

    Raises InputError: an item lacks what its form needs; it names the line and the field.
    """
    path = content.path
    if _is_listed(content):
        rows = [{"image": row[0], "caption_options": row[1:]} for row in content.value]
        content = Content(rows, path, content.numbers)
    found = next((form for form in FORMS if form[1] <= content.first.keys()), None)
    if found is None:
        known = "; ".join(f"{name} ({', '.join(sorted(keys))})" for name, keys, _ in FORMS)
        got = ", ".join(content.first)
        raise InputError("no published benchmark has these keys", got=got, expected=known, path=path)
    name, keys, read = found
    items: list[Statement] = []
    for k, row in enumerate(content.value if isinstance(content.value, list) else [content.value]):
        where = content.where(k)
        require(isinstance(row, dict), f"{where}: an object is asked for", path=path)
        missing = sorted(keys - row.keys())
        require(not missing, f"{where}, {', '.join(missing)}: not there, and {name} has it", path=path)
        try:
            items += read(row, where)
        except InputError as error:
            raise InputError(str(error), path=path) from error
    return name, items


def _is_listed(content: Content) -> bool:
    """Test for lists of a picture and captions, as What'sUp's coco_qa and vg_qa files have."""
    rows = content.value if isinstance(content.value, list) else []
    return bool(rows) and all(
        isinstance(row, list) and len(row) > 1 and all(isinstance(part, str) for part in row[1:]) for row in rows
    )
