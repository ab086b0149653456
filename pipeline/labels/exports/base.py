"""What an export format offers, and what its writer is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.datasets import Dataset
from pipeline.labels.exports.images import ImageCopy
from pipeline.labels.exports.provenance import Provenance
from pipeline.labels.reading import Labels

if TYPE_CHECKING:
    import pyarrow as pa

Progress = Callable[[int, int], None]
"""Called with (frames done, frames in all)."""


@dataclass(frozen=True)
class Job:
    """One export on its way.

    Attributes
    ----------
    labels : Labels
    folder : Path
        Where files are written; it appears under its final name when all are.
    images : ImageCopy or None
        Given where the pictures are to be copied too.
    tell : callable
        Progress.
    options : object
        The format's own options, of the type it declares.
    dataset : callable
        Opens the dataset that was labelled; InputError where it cannot be.
    provenance : Provenance
        Where values come from, and what reviewers said.
    """

    labels: Labels
    folder: Path
    images: ImageCopy | None
    tell: Progress
    options: Any
    provenance: Provenance
    dataset: Callable[[], Dataset] | None = None


@dataclass(frozen=True)
class Written:
    """What a writer wrote.

    Attributes
    ----------
    files : tuple of str
        Below the folder; a folder of one file a frame stands as one entry, with a slash.
    rows : dict of str to int
        How many of what.
    notes : tuple of str
        What the format could not carry in this case.
    """

    files: tuple[str, ...]
    rows: dict[str, int]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ExportReport(Written):
    """A finished export: what was written, and where.

    Attributes
    ----------
    folder : Path
    """

    folder: Path = Path()


@dataclass(frozen=True)
class ExportFormat:
    """One export format.

    Attributes
    ----------
    write : callable
        Writes all files of a job below its folder.
    read : callable or None
        The tables in an exported folder, by name; None where the format holds no labels.
    description : str
        One line.
    lossless : bool
        Whether reading gives every row and value back. If not, the tables that
        `read` gives have the columns that survive, and no others.
    options : type or None
        Dataclass of the format's options; all have defaults.
    """

    write: Callable[[Job], Written]
    read: Callable[[Path], Mapping[str, pa.Table]] | None
    description: str
    lossless: bool = True
    options: type | None = field(default=None)
