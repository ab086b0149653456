"""Tracer of a user's pipeline: every call appends an event to a file of predictions.

The file is one of predictions whose header says `events`; `import-run` reads it, also while it grows and after a kill.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from pipeline.answering.predictions import VERSION, PredictionWriter, parse_header, read_contents
from pipeline.geometry.masks import RunLength
from pipeline.system.errors import InputError, needed, require

Rows = Mapping[Any, float] | Iterable[Sequence[float]]
"""Numbers of objects: {(3, 7): 0.9} or rows [3, 7, 0.9]."""


class Tracer:
    """Tracer called by a pipeline as it runs; see `trace`. Threads and tasks may each have an expression open.

    `path`: the file.
    """

    def __init__(self, path: str | Path, append: bool, conventions: Mapping[str, Any]) -> None:
        path = Path(path)
        self.path = path if path.suffix else path.with_suffix(".jsonl")
        content = {"spatialviz_predictions": VERSION, "system": self.path.stem, **conventions, "events": True}
        self._writer = PredictionWriter(self.path, parse_header(content, self.path), append=append)
        self._open: ContextVar[tuple[str, str, set[int]]] = ContextVar("expression")
        self._ids: dict[str, dict[tuple[float, ...], int]] = {}
        for _, event in read_contents(self.path) if append else ():
            for found in chain.from_iterable(event.get("proposals", {}).values()):
                self._ids.setdefault(event["frame"], {})[tuple(found["box"])] = found["id"]

    def expression(
        self,
        frame: str,
        text: str,
        *,
        target: str | None = None,
        relation: str | None = None,
        reference: str | None = None,
    ) -> None:
        """Begin an expression on a frame, or begin anew.

        `frame`: id of the dataset's frame; `text`: as the labels have it; `target`, `relation`, `reference`: how the
        pipeline reads the words; else spatialviz reads them.
        """
        self._open.set((str(frame), text, set()))
        read = {"target": target, "relation": relation, "reference": reference}
        self._event((), **{part: word for part, word in read.items() if word is not None})

    def proposals(
        self,
        name: str,
        boxes: Sequence[Sequence[float] | np.ndarray] | np.ndarray,
        scores: Sequence[float] | np.ndarray,
        *,
        masks: Sequence[Any] | np.ndarray | None = None,
        ids: Sequence[int] | np.ndarray | None = None,
        names: Sequence[str] | None = None,
        dropped: Sequence[str | None] | None = None,
    ) -> list[int]:
        """Record the detections of a name.

        `name`: that was asked; `boxes`: (N, 4) float: as the header's `boxes` and `box_unit` say; `scores`: (N,) float:
        0..1; `masks`: N of (H, W) bool or of COCO's run-length code; `ids`: (N,) int: which objects of the frame they
        are; by default boxes are numbered, an equal box of the frame by one number; `names`: what the detector calls
        each; `dropped`: why one does not go on: "rank", "overlap" or "threshold". Returns the ids, by which `boxes`,
        `relations` and `answer` name the objects.
        """
        rows, frame = plain(boxes), self._expression()[0]
        numbers = self._numbered(frame, rows) if ids is None else plain(ids)
        parts = {"id": numbers, "score": plain(scores), "box": rows, "name": names, "dropped": dropped}
        parts["mask"] = None if masks is None else [_run_length(mask) for mask in masks]
        given = {part: list(values) for part, values in parts.items() if values is not None}
        lengths = {part: len(values) for part, values in given.items()}
        require(len(set(lengths.values())) == 1, f"proposals of {name!r} differ in number", got=lengths)
        rows = [dict(zip(given, values, strict=True)) for values in zip(*given.values(), strict=True)]
        self._event((), proposals={name: [{k: v for k, v in one.items() if v is not None} for one in rows]})
        self._expression()[2].update(numbers)
        return numbers

    def boxes(self, boxes: Mapping[int, Any]) -> None:
        """Record 3D boxes by id, in the header's `coordinates` and `length`.

        Each is (8, 3) corners in any order, a mapping of `center`, `size` and `rotation` (columns are the box's axes),
        an object with `center`, `size` and `R` such as `Box3D`, or None where an object has none.
        """
        self._event(boxes, boxes_3d={str(number): given_box(box) for number, box in boxes.items()})

    def relations(self, relations: Mapping[str, Rows]) -> None:
        """Record P("a RELATION b") by relation, of every ordered pair of candidates: {"left": {(3, 7): 0.93}}."""
        rows = {relation: _rows(found) for relation, found in relations.items()}
        self._event((i for found in rows.values() for row in found for i in row[:-1]), relations=rows)

    def attributes(self, attributes: Mapping[str, Rows]) -> None:
        """Record P(attribute | object) by attribute: {"red": {3: 0.8}}."""
        rows = {name: _rows(found) for name, found in attributes.items()}
        self._event((row[0] for found in rows.values() for row in found), attributes=rows)

    def pairs(self, scores: Rows) -> None:
        """Record the pipeline's own scores of pairs, higher is better: {(3, 7): 4.1}; with `ranking="pair_scores"`."""
        rows = _rows(scores)
        self._event((i for row in rows for i in row[:2]), pairs=rows)

    def answer(
        self,
        object: int | None = None,
        reference: int | None = None,
        *,
        box: Sequence[float] | np.ndarray | None = None,
        point: Sequence[float] | np.ndarray | None = None,
        mask: Any = None,
        yes: bool | None = None,
        problem: str | None = None,
    ) -> None:
        """Record the answer in a single form, with an object also its reference; or the problem."""
        parts = {"object": object, "reference": reference, "box": box, "point": point, "yes": yes}
        answer = {part: plain(value) for part, value in parts.items() if value is not None}
        if mask is not None:
            answer["mask"] = _run_length(mask)
        require(answer or problem, "neither an answer nor a problem", expected="an object, box, point, mask or yes")
        self._event(
            (i for i in (object, reference)), answer=answer or None, **({"problem": problem} if problem else {})
        )

    def close(self) -> None:
        """Close the file; expressions without an answer stay open."""
        self._writer.close()

    def __enter__(self) -> Tracer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _expression(self) -> tuple[str, str, set[int]]:
        return needed(self._open.get(None), "no expression is open", expected="expression(frame, text) first")

    def _event(self, named: Iterable[int | None], **fields: Any) -> None:
        """Append an event of the open expression; InputError for an object that was not proposed."""
        frame, text, known = self._expression()
        unknown = {number for number in named if number is not None} - known
        require(not unknown, f"{next(iter(fields), text)}: no such object among the proposals", got=_listed(unknown))
        self._writer.write_json(json.dumps({"frame": frame, "text": text, **fields}, default=plain))

    def _numbered(self, frame: str, boxes: Iterable[Sequence[float]]) -> list[int]:
        known = self._ids.setdefault(frame, {})
        return [known.setdefault(tuple(box), len(known)) for box in boxes]


def trace(path: str | Path, *, append: bool = False, **conventions: Any) -> Tracer:
    """Trace the predictions of a pipeline as it runs, for `spatialviz import-run`.

    Parameters
    ----------
    path : str or Path
        The file to write; ".jsonl" is added to a name without an ending.
    append : bool
        Go on with a file of the same conventions, after a kill too; else it must be new.
    conventions
        Fields of the header: `system`, `boxes`, `box_unit`, `coordinates`, `length`, `ranking`, ...

    Raises
    ------
    InputError
        The file exists, cannot be written or was begun with other conventions; no such convention.

    >>> import tempfile
    >>> from pipeline.answering import read_predictions
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with trace(f"{folder}/mine", system="mine") as tracer:
    ...         tracer.expression("kitchen/0", "mug left of the laptop")
    ...         mug, *_ = tracer.proposals("mug", [[10, 20, 50, 60]], [0.9])
    ...         tracer.answer(mug)
    ...     read_predictions(tracer.path).line("kitchen/0", "mug left of the laptop").answer.object
    0
    """
    return Tracer(path, append, conventions)


def plain(value: Any) -> Any:
    """JSON value of an array or number, of numpy or another library."""
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _rows(rows: Rows) -> list[list[Any]]:
    if isinstance(rows, Mapping):
        return [[*(key if isinstance(key, tuple) else (key,)), plain(value)] for key, value in rows.items()]
    return [list(plain(row)) for row in rows]


def given_box(box: Any) -> Any:
    """3D box of `Tracer.boxes` in the form of a line of predictions."""
    if box is None or isinstance(box, Mapping):
        parts = box
    elif hasattr(box, "center"):
        parts = {"center": box.center, "size": box.size, "rotation": box.R}
    else:
        parts = {"corners": box}
    if parts is None:
        return None
    record = {name: plain(value) for name, value in parts.items()}
    if "rotation" in record and len(record["rotation"]) == 3:
        record["rotation"] = [number for row in record["rotation"] for number in row]
    return record


def _run_length(mask: Any) -> Any:
    """Mask in COCO's code, as given or from an array."""
    if isinstance(mask, RunLength) or mask is None:
        return None if mask is None else asdict(mask)
    if isinstance(mask, Mapping):
        counts = mask["counts"]
        return {"size": mask["size"], "counts": counts.decode() if isinstance(counts, bytes) else counts}
    array = np.asarray(mask)
    if array.ndim != 2 or array.dtype.kind not in "bui":
        raise InputError(
            "a mask must be bool (H, W)", got=f"{array.dtype} {array.shape}", cause="is it to be cut at .5?"
        )
    return asdict(RunLength.of(array.astype(np.bool_)))


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(numbers)[:5]))
