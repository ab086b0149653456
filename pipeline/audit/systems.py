"""What systems answered, read from their runs, and where they agree with each other against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.audit.suspicion import Evidence, agreement_weight
from pipeline.evaluation.records import read_records
from pipeline.evaluation.run_folder import RECORDS_FILE
from pipeline.evaluation.sentence_report import FILE
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT
from pipeline.system.errors import InputError, as_input_error, first_line
from pipeline.system.safe_files import parse_json, read_text

Key = tuple[str, str]
"""The frame, and of labels the expression's id, of sentences the text."""


@dataclass(frozen=True)
class SystemAnswers:
    """The boxes (x0, y0, x1, y1, pixels) that a system answered with; what it did not answer is left out."""

    name: str
    boxes: dict[Key, tuple[float, ...]]


def read_answers(folder: Path) -> SystemAnswers:
    """The answers of a run folder: of labels (`eval --labels`, `import-run`), or of sentences (`eval --sentences`).

    Raises InputError: it is no run folder, or damaged.
    """
    if (folder / RECORDS_FILE).is_file():
        rows = read_records(folder).select(["frame", "id", "text", "box"]).to_pylist()
        found = {
            (r["frame"], r[name]): tuple(r["box"]) for r in rows if r["box"] is not None for name in ("id", "text")
        }
        return SystemAnswers(folder.name, found)
    if not (folder / FILE).is_file():
        raise InputError("no run here", expected=f"a folder with {RECORDS_FILE} or {FILE}", path=folder)
    with as_input_error("the run is damaged", OSError, ValueError, KeyError, TypeError, got=first_line, path=folder):
        lines = [parse_json(line, folder) for line in read_text(folder / FILE).splitlines()]
        boxes = {(r["frame"], r["sentence"]): tuple(r["answer"]["bbox"]) for r in lines if r["answer"] is not None}
    return SystemAnswers(folder.name, boxes)


def system_evidence(
    systems: Sequence[SystemAnswers], key: Key, right: np.ndarray, named: Sequence[tuple[str, np.ndarray]] = ()
) -> tuple[Evidence, str | None] | None:
    """Evidence by systems' answers and the object meant by most; None without answers.

    `right` (K, 4) float: boxes that the truth accepts, pixels. `named` sequence of (str, (4,) float): the annotated
    objects by name, so that it can be told which one is meant.
    """
    answered = [(s.name, np.array(s.boxes[key], np.float64)) for s in systems if key in s.boxes]
    if not answered:
        return None
    boxes = np.stack([box for _, box in answered])
    agreeing = np.asarray((iou_2d(boxes, right) >= HIT).any(axis=1))
    others = boxes[~agreeing]
    together = iou_2d(others, others) >= HIT
    most = int(together.sum(axis=1).argmax()) if len(others) else -1
    against = int(together[most].sum()) if most >= 0 else 0
    weight = agreement_weight(against, int(agreeing.sum()))
    meant = _named(others[most], named) if most >= 0 else None
    names = _joined(name for (name, _), own in zip(answered, agreeing, strict=True) if not own)
    text = (
        f"{against} of {len(answered)} systems give the same other answer{'' if meant is None else f', {meant}'} "
        f"({names}); {int(agreeing.sum())} give the one that is said to be right"
    )
    figures = (("systems", float(len(answered))), ("against", float(against)), ("agreeing", float(agreeing.sum())))
    return Evidence("systems", weight, text, figures), meant if against > 1 else None


def _named(box: np.ndarray, named: Sequence[tuple[str, np.ndarray]]) -> str | None:
    overlaps = [float(iou_2d(box[None], other[None])[0, 0]) for _, other in named]
    best = int(np.argmax(overlaps)) if overlaps else -1
    return named[best][0] if best >= 0 and overlaps[best] >= HIT else None


def _joined(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"
