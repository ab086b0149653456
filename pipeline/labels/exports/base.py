"""What an export format offers and its writer is given: labels frame by frame, and pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from pipeline.datasets import Dataset
from pipeline.labels.exports.row_provenance import Provenance
from pipeline.labels.frame_stream import by_frame, frame_tables, table_batches
from pipeline.labels.reading import Labels, arrow_schema
from pipeline.system.arrow import pa
from pipeline.system.errors import require

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
class ExportReport(Written):
    """A finished export: what was written, and where."""

    folder: Path = Path()


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
