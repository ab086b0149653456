"""What an export format offers and its writer is given: labels frame by frame, pictures, origins of values, JSON text.

Every row of every table has, whether anything was corrected or not:

* `base`: which state of the labels was exported, see `ExportedFrom`; null where it is not known.
* `made_by`: detector and rule profile, of all values that `provenance` does not list: those are "auto".
* `provenance`: a list with an entry for each value that is not the labeller's: `column`, `source` (human, recomputed,
  stale), `author`, `time` (ISO 8601, UTC), `event` (ULID in the journal), `reason`, `was` (the labeller's value, JSON).
* `status` (frames, objects, expressions): accepted, corrected, rejected, unsure; null is unreviewed. Of relations
  `statuses`: a list of {relation, status}. What one reviewer said for themselves alone is in the journal only.
* `note` (frames), `mark` (expressions): BAD_LABEL, BAD_BOX or null.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from itertools import repeat
from pathlib import Path
from typing import Any, TextIO

import cv2

from pipeline.datasets import Dataset
from pipeline.labels.frame_stream import by_frame, frame_tables, table_batches
from pipeline.labels.reading import MARKS_FILE, STATUSES_FILE, Labels, arrow_schema, provenance_rows
from pipeline.labels.schema import Manifest, labels_version
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import InputError, Shown, as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import read_json

ENTRY = ("column", "source", "author", "time", "event", "reason", "was")
REVIEWED: dict[str, tuple[str, ...]] = {
    "frames": ("status", "note"),
    "objects": ("status",),
    "relations": ("statuses",),
    "expressions": ("status", "mark"),
}
"""What reviewers said, by table."""
_TABLE = {"object": "objects", "relation": "relations", "expression": "expressions", "frame": "frames"}
_KEY = {"frames": (), "objects": ("object",), "relations": ("a", "b"), "expressions": ("id",)}
NO_EVENT = "0"


@dataclass(frozen=True)
class ExportedFrom:
    """Which state of the labels an export is of: what somebody changed in it is told by comparing with that state."""

    labels: str
    """Version of the automatic labels, see `pipeline.labels.schema.labels_version`."""
    event: str | None
    """ULID of the newest correction that is in it."""
    relifted: bool
    """What follows from corrected pixels and boxes was computed, from the dataset."""

    def __str__(self) -> str:
        return f"{self.labels}.{self.event or NO_EVENT}.{int(self.relifted)}"

    @classmethod
    def parse(cls, text: Any) -> ExportedFrom:
        """Parse the text of a state; InputError for anything else."""
        parts = text.split(".") if isinstance(text, str) and len(text) <= 100 and text.isascii() else []
        require(
            len(parts) == 3 and len(parts[0]) == 16 and parts[1].isalnum() and parts[2] in ("0", "1"),
            "not the state of labels that an export names",
            got=Shown(text),
        )
        return cls(parts[0], None if parts[1] == NO_EVENT else parts[1], parts[2] == "1")


def exported_from(manifest: Manifest) -> ExportedFrom | None:
    """State of labels; None of corrected labels of an early release."""
    made = manifest.corrections
    if made is None:
        return ExportedFrom(labels_version(manifest), None, False)
    return ExportedFrom(str(made["automatic"]), made["last"], bool(made.get("relifted"))) if "last" in made else None


def made_by(manifest: Manifest) -> str:
    """Detector and rule profile, as `pipeline.corrections.journal.replay.Origin.made_by`."""
    return ", ".join(filter(None, (str(manifest.models.get("detector", "")), str(manifest.profile.get("name", "")))))


@dataclass(frozen=True)
class Provenance:
    """What is known of the rows of labels beside their values."""

    base: str | None
    made_by: str
    """`base` is None where it is not known."""
    entries: dict[tuple[str, str, str], list[dict[str, Any]]] = field(default_factory=dict)
    """Of rows with a value that is not the labeller's; keys of dicts as ENTRY."""
    reviewed: dict[tuple[str, str, str], dict[str, Any]] = field(default_factory=dict)
    """Fields as in the journal: "status", "left.status", "mark", "note"."""
    frames: dict[str, set[str]] = field(default_factory=dict)
    """By table, the frames that are in either."""

    def of(self, table: str, frame: str, key: str) -> list[dict[str, Any]]:
        """The entries of a row."""
        return self.entries.get((table, frame, key), [])

    def known(self, table: str, frame: str, key: str) -> dict[str, Any]:
        """Reviews of a row (columns of REVIEWED) and `provenance`."""
        found = self.reviewed.get((table, frame, key), {})
        entries = {"provenance": self.of(table, frame, key)}
        if table == "relations":
            statuses = [{"relation": name.removesuffix(".status"), "status": status} for name, status in found.items()]
            return {"statuses": statuses, **entries}
        return {**{name: found.get(name) for name in REVIEWED[table]}, **entries}

    def row(self, table: str, frame: str, key: str) -> dict[str, Any]:
        """Further columns of a row."""
        return {"base": self.base, "made_by": self.made_by, **self.known(table, frame, key)}

    def rows(self, table: str, rows: pa.Table) -> Iterator[dict[str, Any]]:
        """Further columns of each row of a table; the same dict for all untouched frames."""
        plain, touched = self.row(table, "", ""), self.frames.get(table)
        if not touched:
            yield from repeat(plain, rows.num_rows)
            return
        for frame, *key in zip(*(rows.column(name).to_pylist() for name in ("frame", *_KEY[table])), strict=True):
            yield self.row(table, frame, ",".join(map(str, key))) if frame in touched else plain

    def line_ends(self, table: str, rows: pa.Table) -> Iterator[str]:
        """End of each row's JSON line, from the first comma after the table's columns."""
        last, end = None, ""
        for row in self.rows(table, rows):
            if row is not last:
                last, end = row, f", {json_line(row)[1:]}\n"
            yield end

    def extend(self, table: str, rows: pa.Table) -> pa.Table:
        """The rows with the further columns, of the schema `extended_schema`."""
        found = list(self.rows(table, rows))
        added = [pa.array([row[f.name] for row in found], f.type) for f in _fields(table)]
        return pa.Table.from_arrays([*rows.columns, *added], schema=extended_schema(table))


def open_provenance(labels: Labels) -> Provenance:
    """Read provenance and reviews beside the tables of corrected labels; others have none.

    Raises InputError: a file is damaged.
    """
    state = exported_from(labels.manifest)
    found = Provenance(None if state is None else str(state), made_by(labels.manifest))
    if labels.manifest.corrections is None:
        return found
    for row in provenance_rows(labels.root):
        when = row["time"]
        entry = {**row, "source": row["origin"], "time": None if when is None else when.isoformat()}
        named = found.entries.setdefault((row["table"], row["frame"], row["key"]), [])
        named.append({key: entry[key] for key in ENTRY})
    damaged = KeyError, TypeError, AttributeError, ValueError, RecursionError, OSError
    with as_input_error("what reviewers said of the labels is damaged", *damaged, got=repr, path=labels.root):
        for mark in _listed(labels.root / MARKS_FILE):
            found.reviewed.setdefault(("expressions", mark["frame"], mark["id"]), {})["mark"] = mark["mark"]
        for status in _listed(labels.root / STATUSES_FILE):
            if status["kind"] == "review":
                # A person's own judgement is no value of the labels, and an import takes none over.
                continue
            name = _TABLE[status["kind"]], status["frame"], status["key"]
            found.reviewed.setdefault(name, {})[status["field"]] = status["value"]
    for table, frame, _ in (*found.entries, *found.reviewed):
        found.frames.setdefault(table, set()).add(frame)
    return found


def _listed(path: Path) -> list[dict[str, Any]]:
    return read_json(path) if path.exists() else []


def _fields(table: str) -> list[pa.Field]:
    text, entry = pa.string(), pa.struct([pa.field(name, pa.string()) for name in ENTRY])
    statuses = pa.list_(pa.struct([pa.field("relation", text), pa.field("status", text)]))
    reviewed = [pa.field(name, statuses if name == "statuses" else text) for name in REVIEWED[table]]
    return [pa.field("base", text), pa.field("made_by", text), *reviewed, pa.field("provenance", pa.list_(entry))]


def extended_schema(table: str) -> pa.Schema:
    """The Arrow schema of a table with the further columns."""
    own = arrow_schema(table)
    return pa.schema([*own, *_fields(table)], metadata=own.metadata)


def extended_json_schemas(folder: Path) -> None:
    """Add the further keys to the JSON Schemas of the four tables in a folder; they may also be absent."""
    text = {"type": ["string", "null"]}
    entry = {"type": "object", "properties": dict.fromkeys(ENTRY, text), "additionalProperties": False}
    status = {"type": "object", "properties": {"relation": text, "status": text}, "additionalProperties": False}
    for table, names in REVIEWED.items():
        path = folder / f"{table}.json"
        schema = read_json(path)
        reviewed = {n: {"type": "array", "items": status} if n == "statuses" else text for n in names}
        schema["properties"] |= {
            "base": text,
            "made_by": text,
            **reviewed,
            "provenance": {"type": "array", "items": entry},
        }
        path.write_text(json.dumps(schema, indent=1, ensure_ascii=False) + "\n", encoding="utf-8", newline="\n")


_LINE_ENDS = {ord(c): f"\\u{ord(c):04x}" for c in "\x85\u2028\u2029"}
"""JSON lets these stand, but many readers split lines at them."""


def json_line(content: Any) -> str:
    """Line of JSON, lossless for floats.

    Raises InputError: a number that JSON has no word for.
    """
    try:
        text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(", ", ": "))
    except ValueError as error:
        raise InputError("the labels hold a number that JSON cannot carry", got=str(error)) from error
    return text.translate(_LINE_ENDS)


def json_lines(table: pa.Table) -> Iterator[str]:
    """Rows of a table as lines of JSON, each with a line end; raises as `json_line`.

    Tables without lists are put together by Arrow, column by column: the pairs
    of a large set are many.
    """
    if any(pa.types.is_nested(field.type) for field in table.schema) or not table.num_rows:
        return (json_line(row) + "\n" for row in table.to_pylist())
    return _flat_lines(table)


def _flat_lines(table: pa.Table) -> Iterator[str]:
    parts: list[Any] = []
    for name in table.column_names:
        parts += [f"{', ' if parts else '{'}{json_line(name)}: ", _texts(table.column(name).combine_chunks())]
    join = pc.binary_join_element_wise  # pyright: ignore[reportAttributeAccessIssue]
    return iter(join(*(pa.scalar(p) if isinstance(p, str) else p for p in (*parts, "}\n")), "").to_pylist())


def _texts(column: Any) -> Any:
    """Each value as JSON text; floats as the shortest decimal of the same double."""
    if pa.types.is_string(column.type):
        coded = column.dictionary_encode()
        texts = pa.array([json_line(text) for text in coded.dictionary.to_pylist()], pa.string()).take(coded.indices)
    elif pa.types.is_floating(column.type):
        finite = pc.all(pc.is_finite(column)).as_py() or column.null_count == len(column)  # pyright: ignore[reportAttributeAccessIssue]
        require(finite, "the labels hold a number that JSON cannot carry", got="an infinity or NaN")
        texts = column.cast(pa.float64()).cast(pa.string())
    else:
        texts = column.cast(pa.string())
    return texts.fill_null("null")


class JsonList:
    """A JSON list written item by item, one a line.

    `file`: open for writing; the list begins where it stands.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self.length = 0
        file.write("[")

    def add(self, item: Any) -> None:
        self._file.write((",\n" if self.length else "\n") + json_line(item))
        self.length += 1

    def close(self) -> None:
        self._file.write("\n]")


Progress = Callable[[int, int], None]
"""Called with (frames done, frames in all)."""


@dataclass(frozen=True)
class Job:
    """One export on its way."""

    labels: Labels
    folder: Path
    """Where files are written; it appears under its final name when all are."""
    images: Dataset | None
    """Given where its pictures are to be copied too."""
    tell: Progress
    """Progress."""
    options: Any
    """The format's own options, of the type it declares."""
    provenance: Provenance
    """Where values come from, and their reviews."""
    dataset: Callable[[], Dataset] | None = None
    """Opens the dataset that was labelled; InputError where it cannot be."""

    def copy_picture(self, rows: ExportFrame, folder: str = "images", suffix: str = "jpg") -> None:
        """Write a usable frame's colour image, as JPEG of quality 95 or as PNG, where pictures are copied.

        Raises InputError: the dataset lacks the frame, or has another picture under its name.
        """
        frame = rows.frame
        if self.images is None or not frame["ok"]:
            return
        loaded = self.images.load(frame["frame"])
        require(
            frame["rgb_hash"] is None or loaded.content_hash == frame["rgb_hash"],
            f"frame {frame['frame']}: another picture than the one that was labelled",
            cause="has the dataset changed, or is it another one?",
            path=self.images.root,
        )
        path = self.folder / image_name(rows.index, folder, suffix)
        path.parent.mkdir(exist_ok=True)
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if suffix == "jpg" else []
        done, data = cv2.imencode(path.suffix, cv2.cvtColor(loaded.rgb, cv2.COLOR_RGB2BGR), quality)
        require(done, f"frame {frame['frame']}: the picture cannot be encoded as {path.suffix}")
        path.write_bytes(data.tobytes())


@dataclass(frozen=True)
class Written:
    """Files and rows of an export.

    >>> Written(("relations.txt",), {"relations": 380}).notes
    ()
    """

    files: tuple[str, ...]
    """Below the folder; a folder of one file a frame stands as one entry, with a slash."""
    rows: dict[str, int]
    """Number of rows by what they are."""
    notes: tuple[str, ...] = ()
    """Values without a place in the format."""


@dataclass(frozen=True)
class ExportFormat:
    """One export format.

    >>> def write(job: Job) -> Written:
    ...     (job.folder / "frames.txt").write_text("\\n".join(job.labels.frames.column("frame").to_pylist()))
    ...     return Written(("frames.txt",), {"frames": job.labels.frames.num_rows})
    >>> ExportFormat(write, description="ids of frames", lossless=False).description
    'ids of frames'
    """

    write: Callable[[Job], Written]
    """Writes all files of a job below its folder."""
    read: Callable[[Path], Mapping[str, pa.Table]] | None = None
    """Reading an export back, for plugins that offer it; the program only writes."""
    description: str = ""
    """One line."""
    lossless: bool = True
    """Every row and value is in the export."""
    options: type | None = None
    """Dataclass of the format's options; all have defaults."""


JPEG_QUALITY = 95


def image_name(frame_index: int, folder: str = "images", suffix: str = "jpg") -> str:
    """Name of a frame's picture below the export's folder, copied or not."""
    return f"{folder}/{frame_index:06d}.{suffix}"


@dataclass(frozen=True)
class ExportFrame:
    """All rows of one frame."""

    frame: dict[str, Any]
    """Its row of the table `frames`."""
    objects: list[dict[str, Any]]
    relations: pa.Table
    expressions: list[dict[str, Any]]

    @property
    def index(self) -> int:
        return self.frame["frame_index"]


def label_names(labels: Labels) -> list[str]:
    """The class names of all objects, sorted."""
    batches = table_batches(labels, "objects", ["label"])
    return sorted({name for batch in batches for name in batch.column("label").unique().to_pylist()})


def iterate_frames(labels: Labels, tell: Progress | None = None) -> Iterator[ExportFrame]:
    """Stream all frames with all rows, even broken frames; memory does not grow with the number.

    Raises InputError: a table is damaged, out of order, or has rows of a frame that is not listed.
    """
    names = "frames", "objects", "relations", "expressions"
    frames = by_frame(*(frame_tables(labels, name) for name in names))
    for done, (index, rows) in enumerate(frames, start=1):
        require(
            "frames" in rows,
            f"the table {min(rows)} has rows of frame_index {index}, which is not among the frames",
            path=labels.root,
        )
        listed = rows["frames"].to_pylist()
        require(len(listed) == 1, f"frame_index {index} is listed {len(listed)} times", path=labels.root)
        objects, relations, expressions = (rows.get(n, arrow_schema(n).empty_table()) for n in names[1:])
        yield ExportFrame(listed[0], objects.to_pylist(), relations, expressions.to_pylist())
        if tell is not None:
            tell(done, labels.manifest.tables["frames"].rows)
