"""Sentences of published benchmarks on SUN RGB-D, in the files as they are published.

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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import Dataset
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes
from pipeline.system.errors import InputError, Shown, as_input_error, require
from pipeline.system.plain_pickle import read_plain_pickle
from pipeline.system.safe_files import read_json

ACC_AT = (0.25, 0.5)
SUFFIXES = (".json", ".p", ".pkl")
INSTANCES = "instances.json"
FIRST_TRAINING_PICTURE = 3000
ELSEWHERE, UNUSABLE = "pictures that are not here", "lines without an object or a sentence"


@dataclass(frozen=True)
class PublishedSentence:
    """A sentence of a benchmark: its place from 1, its own id, and what is right, an annotation's index or a box."""

    line: int
    id: str
    frame: str
    text: str
    kind: str
    target: int | None = None
    box: tuple[float, float, float, float] | None = None


def published_sentences(path: Path, dataset: Dataset) -> tuple[list[PublishedSentence], dict[str, int]]:
    """The sentences of a published file that are about a dataset's frames, and how many were left out, by reason.

    Raises
    ------
    InputError
        The file cannot be read, or is none of the published forms.
    """
    rows = _rows(path)
    first = rows[0]
    if {"image_id", "object_id", "sentence"} <= first.keys():
        found = _sun_refer(rows, set(dataset.frame_ids), "SUN-Spot" if "classname" in first else "SUN-Refer")
    elif {"ref_id", "ann_id", "sentences"} <= first.keys():
        found = _sun_spot(rows, path, dataset.frame_ids)
    else:
        raise InputError(
            "no published benchmark has these keys", got=", ".join(first), path=path,
            expected="SUN-Refer (image_id, object_id, sentence) or SUN-Spot (ref_id, ann_id, sentences)",
        )  # fmt: skip
    kept: list[PublishedSentence] = []
    skipped: dict[str, int] = {}
    with as_input_error("an entry of the benchmark is damaged", KeyError, TypeError, ValueError, got=Shown, path=path):
        for one in found:
            if isinstance(one, str):
                skipped[one] = skipped.get(one, 0) + 1
            else:
                kept.append(one)
    require(
        kept, "no sentence of the benchmark is about this dataset", got=dict(skipped), path=path,
        expected=f"frames such as {', '.join(dataset.frame_ids[:2])}",
        cause="SUN-Refer goes with VoteNet's export of SUN RGB-D, SUN-Spot with SUN RGB-D as published",
    )  # fmt: skip
    return kept, skipped


def _rows(path: Path) -> list[dict[str, Any]]:
    with as_input_error("the benchmark cannot be read", OSError, ValueError, got=str, path=path):
        rows = read_json(path) if path.suffix == ".json" else read_plain_pickle(path)
    require(
        isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows),
        "a benchmark is a list of entries", got=type(rows).__name__, path=path,
    )  # fmt: skip
    return rows


def _sun_refer(rows: Sequence[dict[str, Any]], frames: set[str], kind: str) -> Iterator[PublishedSentence | str]:
    for number, row in enumerate(rows, start=1):
        frame, index, text = str(row["image_id"])[:6], str(row["object_id"]), str(row["sentence"]).strip()
        if not index.isdecimal() or len(text) < 2:
            yield UNUSABLE
        elif frame not in frames:
            yield ELSEWHERE
        else:
            split = "val" if int(frame) < FIRST_TRAINING_PICTURE else "train"
            own = str(row.get("ann_id") or f"{int(frame)}_{index}_{number}")
            yield PublishedSentence(number, own, frame, text, f"{kind} {split}", target=int(index))


def _sun_spot(rows: Sequence[dict[str, Any]], path: Path, frames: Sequence[str]) -> Iterator[PublishedSentence | str]:
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
                yield PublishedSentence(
                    number, str(sentence["sent_id"]), likely[0], text, kind, box=(x, y, x + w, y + h)
                )


def acc_iou(answer: Box3D | None, right: Sequence[Box3D], viewer: ViewerAxes) -> float:
    """The best IoU of a box with the right ones, each taken as upright along the viewer's axes; 0 without an answer."""
    if answer is None or not right:
        return 0.0
    corners = [box.corners @ viewer.R_level_camera.T for box in (answer, *right)]
    lo, hi = (np.array([f(c, axis=0) for c in corners]) for f in (np.min, np.max))
    both = np.prod(np.maximum(np.minimum(hi[0], hi[1:]) - np.maximum(lo[0], lo[1:]), 0), axis=1)
    volumes = np.prod(hi - lo, axis=1)
    return float((both / np.maximum(volumes[0] + volumes[1:] - both, 1e-12)).max())
