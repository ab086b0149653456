"""The commands that browse a dataset and ask it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from spatialviz.options import (
    ALL_FRAMES,
    CPUS,
    CameraOptions,
    DatasetArg,
    Flag,
    FrameArg,
    JournalOptions,
    NewFolder,
    OneFrameArg,
    Output,
    SourceOptions,
    Truth,
    Workers,
)


@dataclass(frozen=True)
class View:
    """Open a dataset in the browser; without DATASET, the built-in demo."""

    dataset: Positional[str] = "demo"
    """Dataset folder; a folder of dataset folders, for all of them; or "demo": the built-in one, with a run of a
    simulated detector unless another is named. With --run, the run's own; with --state, the one that it names."""
    run_folder: Annotated[Path | None, arg(name="run")] = None
    """A run folder that `eval` wrote: its failures are listed, with its detector and relation scorer."""
    compare: Path | None = None
    """With --run: another run on the same dataset, whose answers are shown beside."""
    labels: Path | None = None
    """Labels that say what is true. Default: the run's, else the frame's annotations."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    author: str | None = None
    """Under whose name labels are corrected. Default: the name that the browser's tab used last, else that of the
    login."""
    state: str | None = None
    """A view as a string, "sv1:...", as the page copies it: what is opened, and what is looked at first. No link can
    carry it: the page's address has no room for it."""
    also: str | None = None
    """A second detector, NAME or NAME=MODEL, whose boxes are shown beside those of the first; it answers nothing."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    port: int = 8080
    """Port; if it is taken, the next free one is used."""
    host: str = "127.0.0.1"
    """Address to listen on. Anything but this machine's own is open to others: there is no password."""
    theme: Literal["dark", "light"] = "dark"
    """Colours of the page."""
    open_browser: bool = True
    """Open the page in the default browser."""


@dataclass(frozen=True)
class Ask(Output):
    """Answer expressions such as "mug left of the laptop" on a frame.

    Exit status: 0 where a pair stands in the relation that was asked, 1 where there is none: a name was not found, or
    the best pair has a probability below .5 and is told as the nearest; 2 for bad usage or input. Of several
    expressions or frames one that holds is enough for 0.
    """

    dataset: DatasetArg
    frame: FrameArg
    expressions: Positional[tuple[str, ...]]
    """TARGET RELATION REFERENCE, each in quotes."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    save: Path | None = None
    """Write the answer as a picture."""
    labels: Truth = None


@dataclass(frozen=True)
class Relations(Output):
    """Every pair of objects of a frame (or of all frames): each relation's state and probability."""

    dataset: DatasetArg
    frame: FrameArg = ALL_FRAMES
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    vocabulary: Literal["avd", "semantic-abstraction", "all"] = "all"
    """Which relations."""


@dataclass(frozen=True)
class Frames(Output):
    """List the frames of a dataset: what is in each, and what is broken."""

    dataset: DatasetArg
    camera: OmitArgPrefixes[CameraOptions] = CameraOptions()
    summary: Flag = False
    """Print only counts over all frames; with --json, as one JSON object."""
    remember: Flag = False
    """Keep --intrinsics, --depth-scale, --up and --level-at in spatialviz.toml beside the data."""


@dataclass(frozen=True)
class Context(Output):
    """Fuse the posed frames around a frame into a mesh, in its camera frame (extra: open3d)."""

    dataset: DatasetArg
    frame: OneFrameArg
    out: Positional[Path]
    """Mesh file to write: .ply, .obj or .glb."""
    camera: OmitArgPrefixes[CameraOptions] = CameraOptions()


@dataclass(frozen=True)
class Render:
    """Render synthetic annotated RGB-D rooms in BOP format."""

    out: Positional[NewFolder]
    rooms: int = 4
    """Number of rooms; each becomes one BOP scene."""
    views: int = 3
    """Pictures of each room."""
    seed: int = 0
    """The same seed gives the same files."""
    width: int = 640
    height: int = 480
    workers: Workers = CPUS
