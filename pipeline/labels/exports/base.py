"""What an export format offers, what its writer is given, and the pictures of an export."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from pipeline.datasets import Dataset
from pipeline.labels.exports.provenance import Provenance
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError

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


JPEG_QUALITY = 95


def image_name(frame_index: int, folder: str = "images", suffix: str = "jpg") -> str:
    """The name of a frame's picture below the export's folder, whether it is copied or not."""
    return f"{folder}/{frame_index:06d}.{suffix}"


@dataclass(frozen=True)
class ImageCopy:
    """Copies pictures of the dataset that was labelled."""

    dataset: Dataset

    def write(self, frame: Mapping[str, Any], path: Path) -> None:
        """Write one frame's colour image, as JPEG of quality 95 or, by the suffix of `path`, as PNG.

        Raises
        ------
        InputError
            The dataset lacks the frame, or has another picture under its name.
        """
        loaded = self.dataset.load(frame["frame"])
        if frame["rgb_hash"] is not None and loaded.content_hash != frame["rgb_hash"]:
            raise InputError(
                f"frame {frame['frame']}: another picture than the one that was labelled",
                cause="has the dataset changed, or is it another one?",
                path=self.dataset.root,
            )
        path.parent.mkdir(exist_ok=True)
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
        done, data = cv2.imencode(path.suffix, cv2.cvtColor(loaded.rgb, cv2.COLOR_RGB2BGR), quality)
        if not done:
            raise InputError(f"frame {frame['frame']}: the picture cannot be encoded as {path.suffix}")
        path.write_bytes(data.tobytes())
