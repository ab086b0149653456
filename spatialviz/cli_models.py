"""Commands to run and calibrate detectors, and to train and compare relation networks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from pipeline.system.frozen import dataclass
from spatialviz.options import (
    CPUS,
    Batch,
    DatasetArg,
    Epochs,
    Features,
    Flag,
    FramesArg,
    FramesOptions,
    OnPictures,
    Output,
    Overwrite,
    PairFeatures,
    Split,
    Workers,
)


@dataclass(frozen=True)
class DetectCommand(Output):
    """Run a detector over a dataset and record its detections, for --detector recorded; --calibrate: fit the meaning
    of scores."""

    dataset: DatasetArg
    out: Path
    """A JSON file (NAME.json), or a folder, new or empty, for one NPZ file a frame: better for many frames."""
    source: FramesArg = FramesOptions()
    classes: tuple[str, ...] = ()
    """Names to ask for, each by itself. Default: the dataset's classes; without any, all that the detector knows."""


@dataclass(frozen=True)
class CalibrateCommand(Output):
    """Fit a detector's score calibration on annotated frames outside its training, and show the effect."""

    dataset: Positional[str]
    """Dataset folder with annotations, or "demo"."""
    out: Path
    """JSON file to write, for --score-calibration."""
    source: FramesArg = FramesOptions()
    names: Literal["frame", "dataset"] = "frame"
    """Ask each frame for the classes that are in it, as expressions about it do, or for all of the dataset's."""


@dataclass(frozen=True)
class ModelsCommand(Output):
    """List usable model files, and the installed ones; for a file, the option to read it, or the reason for none;
    --install: give a relation network a name."""

    files: Positional[tuple[Path, ...]] = ()
    """ONNX files. Default: list all that is known."""


@dataclass(frozen=True, kw_only=True)
class Training(Output):
    """Command training relation networks."""

    epochs: Epochs = 10
    batch: Batch = None
    seed: int = 0
    """The same seed gives the same networks."""
    workers: Workers = CPUS


@dataclass(frozen=True, kw_only=True)
class TrainCommand(Training):
    """Train a relation network on labels or on rendered rooms, or a network that completes boxes on rendered rooms,
    calibrate it, and measure it on unseen data."""

    labels: Positional[str]
    """Labels folder of `spatialviz label`; or the word "rooms", for rooms rendered on the spot; or "boxes", for the
    network of --boxes completed, from such rooms."""
    out: Path
    """ONNX file to write; its card goes beside it as JSON, and the class vectors of +lang as .vectors.npz."""
    features: Literal["2d", "2d+lang", "3d", "3d+lang", "canon", "rel14", "rel14+lang", "rel26", "rel32"] | None = None
    """What the network is given of a pair: 2D boxes | the paper's PCA boxes | these, canonical | relative extents |
    these, with sizes, places and cuts by the border | these, with how long things of each class are; +lang adds the
    vectors of both class names. Default: rel14 on labels, rel32 on rooms."""
    vocabulary: Literal["avd", "semantic-abstraction"] = "avd"
    """avd: six relations that may hold together (binary cross entropy, U masked); semantic-abstraction: six of which
    one fits (cross entropy; the class prior is divided out in ranking)."""
    vectors: Path | None = None
    """Text vectors for +lang: .vec, .vec.gz or .npz."""
    normalised: Flag = False
    """Divide word vectors by their lengths before a name's mean is taken."""
    split: Split = None
    pairs: int | None = None
    """Learn from at most so many pairs, drawn at random. Default: all."""
    rooms: int | None = None
    """Rooms, 400 (of boxes 230): 7 in 10 to learn from, 1 to calibrate, 2 to measure; rooms of two more makers are
    learnt from too."""
    views: int | None = None
    """Views of each room, 4."""
    width: int | None = None
    """Of the rooms' views, 480 pixels."""
    height: int | None = None
    """Of the rooms' views, 360 pixels."""
    members: int | None = None
    """Networks trained on rooms, 3, of which one is made that gives their mean."""


@dataclass(frozen=True, kw_only=True)
class RetrainCommand(Training, OnPictures):
    """Train relation networks on labels before and after the corrections of their journal, and compare both on held-out
    frames; with --run, the run is made again with the mended labels and the new network.
    """

    out: Path = Path("retrained")
    """A new folder, for the network with its card and comparison, the mended labels and the runs."""
    run_folder: Annotated[Path | None, arg(name="run")] = None
    """A run that `eval` wrote on these labels, made again."""
    features: PairFeatures = "rel14"
    split: Split = None


@dataclass(frozen=True)
class InstallCommand(Output):
    """Install a relation network under a name for --srm."""

    network: Positional[Path]
    """ONNX file that `train` or `retrain` wrote."""
    name: str
    """Letters, digits, and . _ -"""
    overwrite: Overwrite = False


@dataclass(frozen=True, kw_only=True)
class AblationCommand(Training):
    """Train relation networks on rendered rooms, and measure them in other rooms and from other cameras."""

    rooms: int = 120
    """One in three is measured on."""
    views: int = 2
    """Views of each room."""
    pairs: tuple[int, ...] = (1000, 0)
    """Numbers of pairs to learn from; 0 for all."""
    features: tuple[Features, ...] = ("2d", "3d", "rel14")
    """What the networks are given of a pair."""
    networks: int = 3
    """Networks of each kind, each with its own seed and its own draw of pairs."""


@dataclass(frozen=True)
class BenchCommand(Output):
    """Measure the speed of every part, each figure beside its peer or floor in the same run."""

    only: tuple[str, ...] = ()
    """Parts (label, lift, start, page, steps, eval, docs) or claims (label.packed). Default: all."""
    quick: Flag = False
    """Fewer passes; figures of large numbers are scaled up."""
    peers: Path | None = None
    """Folder of SpatialRGPT's and VQASynth's files, as docs/examples/bench_peers.sh fetches them."""
    before: Path | None = None
    """To compare with: a file of --out, or the folder of another checkout, which is measured in turns with this one."""
    out: Path | None = None
    """JSON file to write."""
