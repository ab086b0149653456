"""Files of sentences with what is right: JSON lines, and benchmarks on SUN RGB-D as they are published.

SUN-Refer    `SUNREFER_v2.json`, a list of {"image_id", "object_id", "sentence", "ann_id", "object_name", ...}
             (https://github.com/HaolinLiu97/Refer-it-in-RGBD); its repository's `SUNSPOT_3D.pkl` has the same keys. An
             object is a line of VoteNet's label file, counted from 0; pictures below 3000 are the validation split.
SUN-Spot     `refs(boulder).p` of {"ref_id", "ann_id", "split", "sentences": [{"raw", "sent", "sent_id"}]} with
             `instances.json` (COCO) beside it (https://zenodo.org/records/14693339). Frames are those of SUN RGB-D
             itself, objects are 2D boxes.

Pickles are read with nothing but plain values in them: no code of theirs runs. The published metric of both is
Acc@IoU, `acc_iou`: the share of answers whose 3D box overlaps that of the right object by more than .25 and .5, both
boxes upright and taken along the axes of the viewer.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeInt, model_validator

from pipeline.answering.objects import SceneObject
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets.base import Dataset, resolve_frame
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, FrameCases
from pipeline.system.errors import InputError, Shown, as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.plain_pickle import read_plain_pickle
from pipeline.system.reading import checked
from pipeline.system.safe_files import read_bytes, read_json

ACC_AT = (0.25, 0.5)
SUFFIXES = (".json", ".p", ".pkl")
INSTANCES = "instances.json"
FIRST_TRAINING_PICTURE = 3000
ELSEWHERE, UNUSABLE = "pictures that are not here", "lines without an object or a sentence"


UNSORTED = "unsorted"
"""The kind of a sentence that names none."""
Point = tuple[FiniteFloat, FiniteFloat]
Corners = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _Line(BaseModel):
    """A line of the file; further keys are let be."""

    model_config = ConfigDict(strict=True, extra="ignore")
    frame: str | NonNegativeInt
    sentence: Annotated[str, Field(pattern=r"\S")]
    kind: str | None = None
    dataset: str | None = None
    targets: tuple[NonNegativeInt, ...] | None = None
    points: tuple[Point, ...] | None = None
    point: Point | None = None
    boxes: tuple[Corners, ...] | None = None

    @model_validator(mode="after")
    def _one_truth(self) -> _Line:
        given = [name for name in ("targets", "points", "point", "boxes") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"one of targets, points and boxes says what is right, not {' and '.join(given) or 'none'}"
            )
        if any(x1 <= x0 or y1 <= y0 for x0, y0, x1, y1 in self.boxes or ()):
            raise ValueError("a box is x0, y0, x1, y1 with x0 < x1 and y0 < y1")
        return self


@dataclass(frozen=True)
class Sentence:
    """A sentence with what is right. Of the last three one is given; empty, it says that nothing is right."""

    line: int  # of the file, from 1
    frame: str  # id of the frame
    text: str
    kind: str
    targets: tuple[int, ...] | None = None  # indices of the acceptable annotations
    points: tuple[Point, ...] | None = None  # pixels; a box that holds one is right
    boxes: tuple[Corners, ...] | None = None  # pixels; a box that overlaps one by half is right
    id: str = ""  # its own in a published benchmark; else empty

    @property
    def nothing(self) -> bool:
        """True where nothing is right, and a refusal therefore is."""
        return not (self.targets or self.points or self.boxes)

    def accepts(self, entry: SceneObject, truth: np.ndarray, exact: bool) -> bool:
        """Judge an object as an answer.

        `truth` (T, 4) float: boxes of the acceptable annotations, pixels. `exact`: the objects are the annotations
        themselves.
        """
        if self.points is not None:
            x0, y0, x1, y1 = entry.bbox
            return any(bool(x0 <= u < x1 and y0 <= v < y1) for u, v in self.points)
        if self.targets is not None and exact:
            return entry.id in self.targets
        right = truth if self.boxes is None else np.array(self.boxes, np.float64).reshape(-1, 4)
        return bool((iou_2d(entry.bbox[None], right) >= HIT).any())

    def among(self, truth: FrameCases) -> np.ndarray:
        """(K,) int64: indices of the right annotated objects; of several under a point the smallest."""
        if self.targets is not None:
            return np.flatnonzero(np.isin(truth.numbers, self.targets))
        if self.boxes is not None:
            right = np.array(self.boxes, np.float64).reshape(-1, 4)
            return np.flatnonzero((iou_2d(truth.boxes, right) >= HIT).any(axis=1))
        x0, y0, x1, y1 = truth.boxes.T
        area = (x1 - x0) * (y1 - y0)
        under = [(x0 <= u) & (u < x1) & (y0 <= v) & (v < y1) for u, v in self.points or ()]
        return np.unique([int(np.where(hit, area, np.inf).argmin()) for hit in under if hit.any()]).astype(np.int64)


@dataclass(frozen=True)
class SentenceFile:
    """The sentences of a file on one dataset, in their order; `skipped` counts those on each other dataset.

    `published` says that it is a benchmark in its own form, which has its own metric.
    """

    path: Path
    sentences: tuple[Sentence, ...]
    skipped: dict[str, int]
    published: bool = False


def read_sentence_file(path: Path, source: Pipeline, name: str | None = None) -> SentenceFile:
    """Read the sentences of a JSON-lines file about a dataset, named or unnamed in each line; or of a published
    benchmark, recognised by the file's ending.

    `name`: the dataset's name; by default that of its folder.

    Raises InputError: the file or a line of it cannot be read, a frame is not there, or no sentence is about this
    dataset.
    """
    if path.suffix in SUFFIXES:
        sentences, left_out = published_sentences(path, source.dataset)
        return SentenceFile(path, tuple(sentences), left_out, published=True)
    name = name or source.dataset.root.resolve().name
    try:
        lines = read_bytes(path, "text").removeprefix(b"\xef\xbb\xbf").split(b"\n")
    except OSError as error:
        raise InputError("the sentences cannot be read", got=error.strerror, path=path) from error
    found: list[Sentence] = []
    skipped: Counter[str] = Counter()
    for number, text in enumerate(lines, start=1):
        if not text.strip():
            continue
        line = checked(_Line.model_validate_json, text, f"line {number} cannot be used, at {{}}", path)
        if line.dataset is not None and line.dataset != name:
            skipped[line.dataset] += 1
            continue
        try:
            frame = resolve_frame(source.dataset, line.frame)
        except InputError as error:
            raise of_line(number, error, path) from error
        points = line.points if line.point is None else (line.point,)
        text_of, kind = line.sentence.strip(), (line.kind or "").strip() or UNSORTED
        found.append(Sentence(number, frame, text_of, kind, line.targets, points, line.boxes))
    others = ", ".join(f"{n} of {other!r}" for other, n in skipped.items())
    require(found, "the file has no sentence of this dataset", got=others or None, expected=repr(name), path=path)
    return SentenceFile(path, tuple(found), dict(skipped))


def of_line(number: int, error: InputError, path: Path) -> InputError:
    return InputError(f"line {number}: {error}", path=path)


def published_sentences(path: Path, dataset: Dataset) -> tuple[list[Sentence], dict[str, int]]:
    """Sentences of a published file about a dataset's frames, and the number left out, by reason.

    Raises InputError: the file cannot be read, or is none of the published forms.
    """
    rows = _rows(path)
    first = rows[0]
    if {"image_id", "object_id", "sentence"} <= first.keys():
        found = _sun_refer(rows, set(dataset.frame_ids), "SUN-Spot" if "classname" in first else "SUN-Refer")
    elif {"ref_id", "ann_id", "sentences"} <= first.keys():
        found = _sun_spot(rows, path, dataset.frame_ids)
    else:
        raise InputError(
            "no published benchmark has these keys",
            got=", ".join(first),
            path=path,
            expected="SUN-Refer (image_id, object_id, sentence) or SUN-Spot (ref_id, ann_id, sentences)",
        )
    kept: list[Sentence] = []
    skipped: dict[str, int] = {}
    with as_input_error("an entry of the benchmark is damaged", KeyError, TypeError, ValueError, got=Shown, path=path):
        for one in found:
            if isinstance(one, str):
                skipped[one] = skipped.get(one, 0) + 1
            else:
                kept.append(one)
    require(
        kept,
        "no sentence of the benchmark is about this dataset",
        got=dict(skipped),
        path=path,
        expected=f"frames such as {', '.join(dataset.frame_ids[:2])}",
        cause="SUN-Refer goes with VoteNet's export of SUN RGB-D, SUN-Spot with SUN RGB-D as published",
    )
    return kept, skipped


def _rows(path: Path) -> list[dict[str, Any]]:
    with as_input_error("the benchmark cannot be read", OSError, ValueError, got=str, path=path):
        rows = read_json(path) if path.suffix == ".json" else read_plain_pickle(path)
    require(
        isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows),
        "a benchmark is a list of entries",
        got=type(rows).__name__,
        path=path,
    )
    return rows


def _sun_refer(rows: Sequence[dict[str, Any]], frames: set[str], kind: str) -> Iterator[Sentence | str]:
    for number, row in enumerate(rows, start=1):
        frame, index, text = str(row["image_id"])[:6], str(row["object_id"]), str(row["sentence"]).strip()
        if not index.isdecimal() or len(text) < 2:
            yield UNUSABLE
        elif frame not in frames:
            yield ELSEWHERE
        else:
            split = "val" if int(frame) < FIRST_TRAINING_PICTURE else "train"
            own = str(row.get("ann_id") or f"{int(frame)}_{index}_{number}")
            yield Sentence(number, frame, text, f"{kind} {split}", (int(index),), id=own)


def _sun_spot(rows: Sequence[dict[str, Any]], path: Path, frames: Sequence[str]) -> Iterator[Sentence | str]:
    beside = path.with_name(INSTANCES)
    with as_input_error(f"the sentences of SUN-Spot need {INSTANCES}", OSError, ValueError, got=str, path=beside):
        coco = read_json(beside)
    folders = {image["id"]: str(image["file_name"]).split("/image/")[0].strip("/") for image in coco["images"]}
    annotations = {entry["id"]: entry for entry in coco["annotations"]}
    by_name: dict[str, list[str]] = {}
    for frame in frames:
        by_name.setdefault(frame.rpartition("/")[2], []).append(frame)
    number = 0
    for row in rows:
        entry = annotations.get(row["ann_id"])
        folder = "" if entry is None else folders[entry["image_id"]]
        likely = [f for f in by_name.get(folder.rpartition("/")[2], ()) if f.endswith(folder) or folder.endswith(f)]
        for sentence in row["sentences"]:
            number += 1
            text = str(sentence.get("raw") or sentence["sent"]).strip()
            if entry is None or len(text) < 2:
                yield UNUSABLE
            elif len(likely) != 1:
                yield ELSEWHERE
            else:
                x, y, w, h = (float(v) for v in entry["bbox"])
                kind = f"SUN-Spot {row.get('split') or ''}".strip()
                box, own = (x, y, x + w, y + h), str(sentence["sent_id"])
                yield Sentence(number, likely[0], text, kind, boxes=(box,), id=own)
