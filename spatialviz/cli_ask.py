"""Commands to browse a dataset and to ask questions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from pipeline.system.frozen import dataclass
from spatialviz.options import (
    ALL_FRAMES,
    CPUS,
    DatasetArg,
    Flag,
    FrameArg,
    JournalArg,
    JournalOptions,
    NewFolder,
    OfCamera,
    OnFrame,
    Output,
    SourceArg,
    SourceOptions,
    Truth,
    Workers,
)


@dataclass(frozen=True)
class ViewCommand:
    """Open a dataset in the browser; without DATASET, the built-in demo."""

    dataset: Positional[str] = "demo"
    """Dataset folder; a folder of dataset folders, for all of them; a case that `save-case` wrote; or "demo": the
    built-in one, with a run of a simulated detector unless another is named. With --run, the run's own; with --state,
    the one that it names."""
    run_folder: Annotated[Path | None, arg(name="run")] = None
    """A run folder that `eval` wrote: its failures are listed, with its detector and relation scorer."""
    compare: Path | None = None
    """With --run: another run on the same dataset, whose answers are shown beside."""
    labels: str | None = None
    """Labels that say what is true. Default: the run's, else the frame's annotations."""
    journal: JournalArg = JournalOptions()
    author: str | None = None
    """Under whose name labels are corrected. Default: the name that the browser's tab used last, else that of the
    login."""
    state: str | None = None
    """A view as a string, "sv1:...", as the page copies it: what is opened, and what is looked at first. It holds
    edits, too, which the page's address does not."""
    source: SourceArg = SourceOptions()
    port: int = 8080
    """Port; if it is taken, the next free one is used."""
    host: str = "127.0.0.1"
    """Address to listen on. One that others reach needs the token that is printed."""
    outer_address: UseAppendAction[tuple[str, ...]] = ()
    """Address at which a proxy serves the page, "https://host/path/" ({port} stands for the port); can be given again.
    Only these and this machine's get in then, and everybody needs the token that is printed."""
    tokens: Path | None = None
    """A file with a line NAME TOKEN for each person who may open the page; corrections are by that name."""
    max_clients: int = 24
    """Pages that may be open at once."""
    theme: Literal["dark", "light"] | None = None
    """Colours of the page, until others are chosen on it. Default: those of the system."""
    open_browser: bool = True
    """Open the page in the default browser."""


@dataclass(frozen=True)
class AskCommand(Output):
    """Answer expressions such as "mug left of the laptop" on a frame; --world: by all posed frames of its scene;
    --confirm: confirm a pair of the answer as right; --glossary: explain a word.

    Exit status: 0 where a pair stands in the relation that was asked, 1 where there is none: a name was not found, or
    the best pair has a probability below .5 and is told as the nearest; 2 for bad usage or input. Of several
    expressions or frames one that holds is enough for 0.
    """

    dataset: DatasetArg
    frame: FrameArg
    expressions: Positional[tuple[str, ...]]
    """TARGET RELATION REFERENCE, each in quotes."""
    source: SourceArg = SourceOptions()
    run_folder: Annotated[Path | None, arg(name="run")] = None
    """A run folder: its detector, relation scorer and labels answer and judge, as in `view --run`. "demo" is the run of
    the built-in demo, which `view` opens."""
    save: Path | None = None
    """Picture to write: 1200 by 630, .png or .jpg; as .gif or .webp a film of two seconds, before and after the change
    that would mend it."""
    try_mend: Annotated[Flag, arg(name="try")] = False
    """Try what would make a wrong answer right; with --run also what a setting of its kind does to the whole run."""
    labels: Truth = None
    map: Path | None = None
    """Folder of object maps that `map` wrote, for the verdict NOT-SEEN: the frame does not show what is asked for, and
    others do. Default: the run's."""


@dataclass(frozen=True)
class WorldCommand(Output):
    """Answer expressions by the objects of all posed frames of the frame's scene: also by what it does not show.

    Exit status as of `ask`.
    """

    dataset: DatasetArg
    frame: Positional[str]
    """The frame whose scene is asked, and from whose camera."""
    expressions: Positional[tuple[str, ...]]
    """TARGET RELATION REFERENCE, each in quotes."""
    source: SourceArg = SourceOptions()
    map: Path | None = None
    """Folder of object maps that `map` wrote. Default: the scene is mapped for the question."""
    standing_at: str | None = None
    """Answer for somebody who stands at this object ("door"), and not for the frame's camera. A sentence may say so
    itself: "from the door, facing the window: ...", "..., as seen from the sofa"."""
    facing: str | None = None
    """With --standing-at: the object that one faces ("window")."""


@dataclass(frozen=True)
class RelationsCommand(Output):
    """Every pair of objects of a frame (or of all frames): each relation's state and probability; --measure: how far
    apart two pixels' surfaces are."""

    dataset: DatasetArg
    frame: FrameArg = ALL_FRAMES
    source: SourceArg = SourceOptions()
    vocabulary: Literal["avd", "semantic-abstraction", "all"] = "all"
    """Which relations."""


@dataclass(frozen=True)
class GlossaryCommand(Output):
    """Explain a word of the page or the shell; without one, all of them."""

    word: Positional[str | None] = None
    """As the page or the shell has it, such as OPM-CONF."""
    markdown: Flag = False
    """Print all as a document."""


@dataclass(frozen=True, kw_only=True)
class MeasureCommand(OnFrame, OfCamera):
    """Measure the distance of two surface points of a frame, and its parts to the right, up and forward; in metres."""

    first: Positional[Annotated[str, arg(help="U,V (column, row) of a pixel.")]]
    second: Positional[Annotated[str, arg(help="U,V of another.")]]


@dataclass(frozen=True, kw_only=True)
class FramesCommand(OfCamera):
    """List a dataset's contents and faults: counts, and each note once with its number of frames."""

    dataset: Positional[str]
    """Dataset folder or capture; a folder of dataset folders, for all of them; or "demo"."""
    all: Flag = False
    """List every frame too. --json lists them without it."""
    summary: Flag = False
    """With --json: one JSON object of the counts, in place of a line for each frame."""
    decode: Flag = False
    """Decode every frame. By default 60 are, evenly spread; of the others files, headers and poses are looked at."""
    remember: Flag = False
    """Keep --intrinsics, --depth-scale, --up and --level-at in spatialviz.toml beside the data."""


@dataclass(frozen=True, kw_only=True)
class DoctorCommand(OfCamera):
    """Find what is wrong with a recording: unit and kind of depth, camera, poses, registration, mirrored pictures, up.

    It compares the depth of posed frames that overlap, outlines of depth with edges of colour, and level planes. Exit
    status: 0 where nothing was found wrong, or what was is mended with --apply; 1 where something is wrong.
    """

    dataset: DatasetArg
    apply: Flag = False
    """Keep what mends it in spatialviz.toml beside the data, where readers find it."""
    overlay: Path | None = None
    """Picture to write: colour with the outlines of depth on it, as read and with what mends it."""


@dataclass(frozen=True, kw_only=True)
class ContextCommand(OnFrame, OfCamera):
    """Fuse the posed frames around a frame into a mesh, in the frame's camera coordinates (extra: open3d)."""

    out: Positional[Path]
    """Mesh file to write: .ply, .obj or .glb."""


@dataclass(frozen=True)
class RenderCommand:
    """Render synthetic annotated RGB-D rooms in BOP format."""

    out: Positional[NewFolder]
    rooms: int = 4
    """Number of rooms; each becomes one BOP scene."""
    views: int = 3
    """Pictures of each room."""
    seed: int = 0
    """The same seed gives the same files."""
    width: int = 640
    """Of the pictures, pixels."""
    height: int = 480
    """Of the pictures, pixels."""
    workers: Workers = CPUS
