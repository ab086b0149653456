"""Predictions of other pipelines: a documented file of JSON lines, read and written here.

The first line is a `Header`, each further one a `Prediction`: an expression on a frame with what was answered, and as
much of what led there as is known. `docs/predictions.md` is its description. Nothing here looks at a dataset.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property, partial
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from pydantic import TypeAdapter

from pipeline.answering.prediction_schema import (
    VERSION,
    Header,
    PredictedAnswer,
    PredictedBox,
    Prediction,
    Proposal,
    Weights,
    fields_beside,
    joined_events,
)
from pipeline.language.relation_names import RELATIONS
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked
from pipeline.system.safe_files import opened, parse_json, read_bytes
from pipeline.system.whole_files import sha256_of, whole_file

__all__ = [
    "VERSION",
    "Header",
    "PredictedAnswer",
    "PredictedBox",
    "Prediction",
    "PredictionWriter",
    "Predictions",
    "Proposal",
    "Weights",
    "as_json",
    "faults",
    "parse_header",
    "parse_line",
    "read_contents",
    "read_lines",
    "read_predictions",
    "write_predictions",
]
_HEADER, _LINE = TypeAdapter(Header), TypeAdapter(Prediction)


@dataclass(frozen=True)
class Predictions:
    """File of predictions, read and checked."""

    path: Path
    header: Header
    # dict of (str, str) to Prediction: by frame and text, boxes and masks filled in from earlier lines of the frame
    lines: dict[tuple[str, str], Prediction]
    # dict of (str, str) to int: the number of each line in the file, from 1, for messages
    numbers: dict[tuple[str, str], int]
    least: int | None = None  # The level of the file that these lines are some of
    cut_off: int | None = None  # The number of a last line that a killed writer left half, and that is not read

    @property
    def level(self) -> int:
        """Level of the file: the least of all lines with an answer; without answers the lines' highest."""
        if self.least is not None:
            return self.least
        most = max((p.level for p in self.lines.values()), default=0)
        return min((p.level for p in self.lines.values() if p.problem is None), default=most)

    @property
    def lacking(self) -> tuple[str, list[int]]:
        """Field missing for a higher level, and the numbers of the lines without; at level 3 none."""
        level, fields = self.level, ("proposals", "boxes_3d", "relations", "")
        found = {self.numbers[key]: p.problem for key, p in self.lines.items() if p.level == level < 3}
        return fields[level], [n for n, problem in found.items() if problem is None] or [*found]

    def record(self) -> dict[str, Any]:
        """JSON record of the system, for a run's manifest."""
        field_, lines = self.lacking
        lacks = {"field": field_, "line": min(lines), "lines": len(lines)} if lines else None
        record = {"system": self.header.system, "level": self.level, "lacks": lacks}
        return {**record, "lines": len(self.lines), "file": self.content_hash}

    @property
    def unread(self) -> str | None:
        """Warning about an unread line."""
        if not self.cut_off:
            return None
        return f"line {self.cut_off} is cut off, as a killed writer leaves it, and is not read"

    def line(self, frame: str, text: str) -> Prediction | None:
        """Line of an expression, ignoring spaces and capitals; None for none."""
        return self._by_words.get(_words_of(frame, text))

    def of_frame(self, frame: str) -> tuple[Prediction, ...]:
        """Lines of a frame, in order."""
        return tuple(self._by_frame.get(frame, ()))

    def box_of(self, frame: str, i: int) -> PredictedBox | None:
        """3D box of an object, by any line of its frame."""
        return self._boxes.get((frame, i))

    @cached_property
    def content_hash(self) -> str:
        """Hash of the file."""
        return sha256_of(self.path)

    @cached_property
    def _by_words(self) -> dict[tuple[str, str], Prediction]:
        return {_words_of(*key): line for key, line in self.lines.items()}

    @cached_property
    def _by_frame(self) -> dict[str, list[Prediction]]:
        found: dict[str, list[Prediction]] = {}
        for line in self.lines.values():
            found.setdefault(line.frame, []).append(line)
        return found

    @cached_property
    def _boxes(self) -> dict[tuple[str, int], PredictedBox | None]:
        return {(line.frame, i): box for line in self.lines.values() for i, box in (line.boxes_3d or {}).items()}

    def where(self, line: Prediction, field: str) -> str:
        """Field of a line in messages: "line 7, boxes_3d.3"."""
        return f"line {self.numbers[line.frame, line.text]}, {field}"


def read_predictions(path: str | Path) -> Predictions:
    """Read a whole file, and check the lines against each other.

    Raises
    ------
    InputError
        The first fault: the number of its line, the field, what was got, and the likely cause.
    """
    path, cut = Path(path), list[int]()
    lines = read_lines(path, cut)
    header = next(lines)[1]
    assert isinstance(header, Header)
    seen: dict[tuple[str, int], tuple[int, Proposal]] = {}
    boxes: dict[tuple[str, int], tuple[int, PredictedBox | None]] = {}
    found: dict[tuple[str, str], Prediction] = {}
    numbers, asked = dict[tuple[str, str], int](), dict[tuple[str, str], int]()
    for number, line in lines:
        assert isinstance(line, Prediction)
        before = asked.setdefault(_words_of(line.frame, line.text), number)
        words = f"line {number}, text: the expression stands in the file already"
        require(before == number, words, got=repr(line.text), expected=f"line {before}", path=path)
        for name, field_, wrong in faults(line, header):
            raise InputError(f"line {number}, {name}: {field_}", cause=wrong or None, path=path)
        _agree(line, number, seen, boxes, path)
        found[line.frame, line.text], numbers[line.frame, line.text] = line, number
    expected = f"{'whole lines' if cut else 'a line for each expression'} after the first"
    require(found, "the file holds no predictions", expected=expected, path=path)
    # Only now: which line of a frame tells of an object does not matter.
    found = {key: _filled(line, numbers[key], seen, path) for key, line in found.items()}
    return Predictions(path, header, found, numbers, cut_off=next(iter(cut), None))


def _words_of(frame: str, text: str) -> tuple[str, str]:
    """Key of an expression, ignoring spaces and capitals."""
    return frame, " ".join(text.casefold().split())


def read_lines(path: Path, cut: list[int] | None = None) -> Iterator[tuple[int, Header | Prediction]]:
    """Header and each line, or joined events of an expression, with its number from 1.

    A last line without its end, no JSON, was left by a killed writer: skipped, and its number added to `cut`.
    """
    contents = read_contents(path, cut)
    header = parse_header(next(contents)[1], path)
    yield 1, header
    if header.events:
        contents = joined_events(contents, path)
    for number, content in contents:
        yield number, parse_line(content, number, path)


def read_contents(path: Path, cut: list[int] | None = None) -> Iterator[tuple[int, Any]]:
    """JSON of each line that is not empty, with its number from 1; `cut` as in `read_lines`."""
    unreadable = "the predictions cannot be read"
    with as_input_error(unreadable, OSError, got=str, path=path), opened(path, "unpacked") as file:
        number = 0
        for number, line in enumerate(file, 1):
            if not line.strip() and number > 1:
                continue
            try:
                text = line.decode("utf-8-sig" if number == 1 else "utf-8")
                content = parse_json(text, path, object_pairs_hook=partial(_each_once, number, path))
            except InputError:
                raise
            except ValueError as error:
                if number > 1 and not line.endswith(b"\n"):
                    if cut is not None:
                        cut.append(number)
                    return
                other = isinstance(error, UnicodeDecodeError)
                kind, expected = ("UTF-8", "the file saved as UTF-8") if other else ("JSON", None)
                raise InputError(f"line {number}: not {kind}", got=error, expected=expected, path=path) from error
            yield number, content
        require(number, "the file is empty", expected="a header and a line for each expression", path=path)


def _each_once(number: int, path: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """JSON object; InputError for a repeated key, of which only the last would count."""
    if len(found := dict(pairs)) < len(pairs):
        twice = next(name for k, (name, _) in enumerate(pairs) if name in dict(pairs[:k]))
        raise InputError(f"line {number}: the key {twice!r} stands twice in one object", path=path)
    return found


def parse_header(content: Any, path: Path) -> Header:
    """Parse the first line; InputError for a foreign header, or a later version."""
    version = content.get("spatialviz_predictions") if isinstance(content, dict) else None
    require(
        version is not None,
        "line 1, spatialviz_predictions: the file does not begin with a header",
        expected=f'{{"spatialviz_predictions": {VERSION}, "system": "NAME", …}}',
        cause="is it a published format? then name it with --format",
        path=path,
    )
    require(
        version == VERSION and not isinstance(version, bool),
        "line 1, spatialviz_predictions: another version of the schema",
        got=repr(version),
        expected=str(VERSION),
        path=path,
    )
    wrong = "line 1, {}: the header is not well formed"
    return checked(_HEADER.validate_python, content, wrong, path, keys=partial(fields_beside, Header))


def parse_line(content: Any, number: int, path: Path) -> Prediction:
    """Parse a further line; InputError for a violation of the schema."""
    wrong = f"line {number}, {{}}: not as the schema has it"
    return checked(_LINE.validate_python, content, wrong, path, keys=partial(fields_beside, Prediction))


def faults(line: Prediction, header: Header) -> Iterator[tuple[str, str, str]]:
    """Contradictions within a line: field, fault, and likely cause or nothing."""
    known = line.objects
    answer = line.answer
    kinds = ("object", "box", "point", "mask", "yes")
    given = [kind for kind in kinds if answer is not None and getattr(answer, kind) is not None]
    ranked = line.relations is not None and header.ranking != "none"
    if answer is None and line.problem is None and not ranked:
        yield "answer", "neither an answer nor a problem", 'where there is no answer "problem" says why'
    if answer is not None and len(given) != 1:
        yield "answer", f"one answer is asked for; got {' and '.join(given) or 'none'}", ""
    if line.proposals is None:
        yield from (
            (n, "needs proposals", "") for n in ("boxes_3d", "relations", "pairs") if getattr(line, n) is not None
        )
        if answer is not None and answer.object is not None:
            yield "answer.object", "an id without proposals; expected a box, point or mask", ""
        return
    for name, found in line.proposals.items():
        ids = [p.id for p in found]
        for k, i in enumerate(ids):
            if i in ids[:k]:
                yield f"proposals.{name}.{k}.id", f"the id {i} stands twice under one name", ""
    used: list[tuple[str, int | None]] = []
    if answer is not None:
        used += [("answer.object", answer.object), ("answer.reference", answer.reference)]
    for relation, rows in (line.relations or {}).items():
        if relation not in RELATIONS:
            yield f"relations.{relation}", f"no such relation; expected one of {', '.join(RELATIONS)}", ""
        used += [(f"relations.{relation}.{k}", i) for k, row in enumerate(rows) for i in row[:-1]]  # type: ignore[misc]
        yield from _twice(f"relations.{relation}", [row[:-1] for row in rows])
    for attribute, rows in (line.attributes or {}).items():
        used += [(f"attributes.{attribute}.{k}", i) for k, (i, _) in enumerate(rows)]
        yield from _twice(f"attributes.{attribute}", [row[:-1] for row in rows])
    used += [(f"pairs.{k}", i) for k, row in enumerate(line.pairs or ()) for i in row[:2]]
    yield from _twice("pairs", [row[:-1] for row in line.pairs or ()])
    for field_, i in used:
        if i is not None and i not in known:
            yield field_, f"the id {i} is not among the proposals that went on", ""
    every = {p.id for found in line.proposals.values() for p in found}
    for i in (line.boxes_3d or {}).keys() - every:
        yield f"boxes_3d.{i}", f"the id {i} is not among the proposals", ""
    for i, box in (line.boxes_3d or {}).items():
        if box is not None and (box.corners is None) == (box.center is None or box.size is None):
            yield f"boxes_3d.{i}", "a box is center and size, or its eight corners", ""
        if box is not None and box.size is not None and min(box.size) < 0:
            yield (
                f"boxes_3d.{i}.size",
                f"an edge is shorter than 0; got {list(box.size)}",
                "are center and size swapped?",
            )
    if header.ranking == "pair_scores" and line.relations is not None and line.pairs is None:
        yield "pairs", "the header says that pairs have scores of their own, and this line has none", ""
    if line.relation is not None and line.relation not in RELATIONS:
        yield "relation", f"no such relation; got {line.relation!r}; expected one of {', '.join(RELATIONS)}", ""


def _twice(field_: str, ids: Sequence[tuple[Any, ...]]) -> Iterator[tuple[str, str, str]]:
    """First row repeating the ids of an earlier row."""
    if len(set(ids)) < len(ids):
        k = next(k for k, one in enumerate(ids) if one in ids[:k])
        yield f"{field_}.{k}", f"{', '.join(map(str, ids[k]))} stands in two rows", "which of the two counts?"


def _agree(
    line: Prediction,
    number: int,
    seen: dict[tuple[str, int], tuple[int, Proposal]],
    boxes: dict[tuple[str, int], tuple[int, PredictedBox | None]],
    path: Path,
) -> None:
    """Add a line's statements on objects to those of its frame; InputError for a contradiction."""
    for name, found in (line.proposals or {}).items():
        for k, p in enumerate(found):
            before, known = seen.setdefault((line.frame, p.id), (number, p))
            for part in ("box", "mask"):
                mine, theirs = getattr(p, part), getattr(known, part)
                require(
                    mine is None or theirs is None or mine == theirs,
                    f"line {number}, proposals.{name}.{k}.{part}: the object {p.id} of frame {line.frame} has another "
                    f"{part} than in line {before}",
                    cause="an id is one object in all lines of a frame",
                    path=path,
                )
            seen[line.frame, p.id] = before, replace(known, box=known.box or p.box, mask=known.mask or p.mask)
    for i, box in (line.boxes_3d or {}).items():
        before, known = boxes.setdefault((line.frame, i), (number, box))
        words = f"line {number}, boxes_3d.{i}: another 3D box than in line {before}"
        require(box == known, words, cause="an id is one object in all lines of a frame", path=path)


def _filled(
    line: Prediction, number: int, seen: Mapping[tuple[str, int], tuple[int, Proposal]], path: Path
) -> Prediction:
    """Line with boxes and masks filled in from any line of its frame; InputError for none."""
    if line.proposals is None:
        return line
    proposals = {name: list(found) for name, found in line.proposals.items()}
    for name, found in proposals.items():
        for k, p in enumerate(found):
            known = seen[line.frame, p.id][1]
            words = f"line {number}, proposals.{name}.{k}.box: no line of the frame gives the box of the object {p.id}"
            require(known.box is not None, words, path=path)
            found[k] = replace(p, box=known.box, mask=known.mask)
    return replace(line, proposals={name: tuple(found) for name, found in proposals.items()})


class PredictionWriter:
    """Writer of predictions as they come; each line is whole on the disk before the next begins.

    `append`: go on with a file that has this very header; else the file must be new.
    """

    def __init__(self, path: str | Path, header: Header, *, append: bool = False) -> None:
        self.path = Path(path)
        there = self.path.exists() and self.path.stat().st_size > 0
        require(append or not there, "the file exists", expected="append=True, or another name", path=path)
        if there:
            known = next(read_lines(self.path))[1]
            require(known == header, "the file was begun with another header", path=self.path)
        unwritable = "the predictions cannot be written"
        with as_input_error(unwritable, OSError, got=lambda error: error.strerror, path=self.path):
            self._file: IO[bytes] = open(self.path, "ab")  # noqa: SIM115
            if there:
                # What a killed writer left of a line must not become the beginning of the next one.
                self._file.truncate(read_bytes(self.path, "unpacked").rfind(b"\n") + 1)
        if not there:
            self._write(as_json(header))

    def write(self, line: Prediction) -> None:
        """Append a line; InputError for a violation of the schema (arrays of 3 instead of 4 numbers, NaN, …)."""
        self.write_json(as_json(line))

    def write_json(self, content: str) -> None:
        """Append a line of JSON; raises as `write`."""
        parse_line(parse_json(content), 0, self.path)
        self._write(content)

    def _write(self, content: str) -> None:
        self._file.write(f"{content}\n".encode())
        self._file.flush()

    def close(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def __enter__(self) -> PredictionWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def write_predictions(path: str | Path, header: Header, lines: Iterable[Prediction]) -> None:
    """Write a new file.

    >>> import tempfile
    >>> from pipeline.answering.predictions import Header, PredictedAnswer, Prediction
    >>> line = Prediction(frame="kitchen/0", text="the mug", answer=PredictedAnswer(box=(1, 2, 5, 6)))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_predictions(f"{folder}/mine.jsonl", Header(system="mine"), [line])
    ...     read_predictions(f"{folder}/mine.jsonl").level
    0
    """
    require(not Path(path).exists(), "the file exists", expected="another name", path=path)
    with whole_file(Path(path), "the predictions") as temporary, PredictionWriter(temporary, header) as writer:
        for line in lines:
            writer.write(line)


def as_json(thing: Header | Prediction) -> str:
    """JSON line, without absent fields."""
    record = _without_nothing(asdict(thing))
    if isinstance(thing, Prediction) and thing.answer is None:
        record["answer"] = None
    return json.dumps(record, ensure_ascii=False, separators=(",", ":"))


def _without_nothing(content: Any) -> Any:
    if isinstance(content, dict):
        boxes = {k: None for k, v in content.items() if v is None and isinstance(k, int)}
        return {k: _without_nothing(v) for k, v in content.items() if v is not None and v != ""} | boxes
    if isinstance(content, Sequence) and not isinstance(content, str):
        return [_without_nothing(v) for v in content]
    return content
