"""Options shared by commands, arguments of equal meaning everywhere, and output."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, arg

from pipeline.system.detector_setup import DetectorSetup, with_files
from pipeline.system.errors import InputError, require
from pipeline.system.execution import Provider, ProviderWarning, use_execution
from pipeline.system.frozen import dataclass
from spatialviz.plain_text import one_line

if TYPE_CHECKING:
    from pipeline.answering.pipeline import Pipeline
    from pipeline.corrections.journal.journal import Journal
    from pipeline.datasets import Dataset
    from pipeline.labels.check.other_masks import OtherMasks
    from pipeline.labels.plan import SourceSpec
    from pipeline.labels.reading import Labels

FINE, NO, BAD, INTERRUPTED, UNREAD = 0, 1, 2, 130, 141
"""Exit statuses; of the last two, Ctrl-C and a pipe that nobody reads, as the shell counts signals."""

Flag = FlagCreatePairsOff[bool]
"""Off by default, so that there is nothing for --no-x to say; what is on by default is a plain bool: --x and --no-x."""
Features = Literal["2d", "3d", "canon", "rel14", "rel26", "rel32"]
DatasetArg = Positional[Annotated[str, arg(help='Dataset folder, or "demo".')]]
FrameArg = Positional[Annotated[str, arg(help='Frame id, its index, or "all".')]]
OneFrameArg = Positional[Annotated[str, arg(help="Frame id, or its index.")]]
ExpressionArg = Positional[Annotated[str, arg(help="TARGET RELATION REFERENCE, in quotes.")]]
LabelsArg = Positional[Annotated[str, arg(help="Labels folder, or a URL that fsspec knows (extra: remote).")]]
RunArg = Positional[Annotated[Path, arg(help="Run folder of `spatialviz eval`.")]]
NewFolder = Annotated[Path, arg(help="Folder to write; it must not exist, or be empty.")]
Truth = Annotated[str | None, arg(help="Labels that say what is true. Default: the frame's annotations.")]
Box = Annotated[
    Literal["upright", "gravity", "pca"],
    arg(
        help="How 3D boxes are fitted: upright, with the sides along the outline; gravity, the fit of before 0.2; pca, "
        "the paper's."
    ),
]
Boxes = Annotated[
    Literal["seen", "completed"],
    arg(
        help="By which boxes sizes are compared (the tallest): of what is seen, or completed by a small network to the "
        "whole object. Relations stay by what is seen."
    ),
]
Batch = Annotated[
    int | None,
    arg(
        help="Pairs in a step. Default: 256, less where there are few pairs, so that there are at least 290 steps an "
        "epoch."
    ),
]
Epochs = Annotated[int, arg(help="The learning rate, 1e-3, is halved every 3.")]
Split = Annotated[
    Literal["scene", "blocks"] | None,
    arg(help="Default: scene where there are at least three, else blocks of camera positions."),
]
PairFeatures = Annotated[Features, arg(help="What the networks are given of a pair.")]
Workers = Annotated[int, arg(help="Processes at once. What comes out does not depend on it.")]
Overwrite = Annotated[Flag, arg(help="Replace what an earlier run of this command wrote there.")]
CPUS = os.cpu_count() or 1
ALL_FRAMES = "all"


@dataclass(frozen=True, kw_only=True)
class Output:
    """Command with output for people, or as JSON."""

    json: Flag = False
    """Print JSON in place of text: one object, or one a line for each of several."""

    def write(self, record: dict[str, Any] | Iterator[dict[str, Any]], show: Callable[..., object], *of: Any) -> None:
        """Print a JSON object or several; or `show` the same to a person, called with `of` or else the record."""
        if not self.json:
            show(*(of or (record,)))
            return
        for one in record if isinstance(record, Iterator) else (record,):
            print_json(one)


@dataclass(frozen=True, kw_only=True)
class OnLabels(Output):
    """Command on a labels folder."""

    labels: LabelsArg


def print_json(record: dict[str, Any]) -> None:
    """Print a JSON object on a line."""
    print(json.dumps(record, ensure_ascii=False, allow_nan=False))


def warn(*texts: object) -> None:
    """Print a line each beside the output."""
    for text in texts:
        print(f"spatialviz: {one_line(str(text))}", file=sys.stderr)


def warn_skipped(frame_id: str, reason: str) -> None:
    """Report a frame left out."""
    warn(f"skipped frame {frame_id}: {reason}")


def one_line_warnings() -> None:
    """Print warnings as single lines, without the place in the code."""
    shown = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, ProviderWarning):
            warn(message)
        else:
            shown(message, category, *where, **more)

    warnings.showwarning = show


def numbers(text: str, form: str, kind: Callable[[str], Any], problem: str, example: str = "") -> tuple[Any, ...]:
    """Numbers of a text in the form "A,B" or "k/N"; InputError of `problem` otherwise."""
    between = "/" if "/" in form else ","
    try:
        found = tuple(kind(part) for part in text.split(between))
    except ValueError:
        found = ()
    require(len(found) == len(form.split(between)), problem, got=repr(text), expected=form + example)
    return found


def task_of(text: str | None) -> tuple[int, int] | None:
    """Shard k/N, both from 1."""
    if text is None:
        return None
    k, n = numbers(text, "k/N", int, "--shard must be two numbers", ", such as 1/8")
    require(1 <= k <= n, "no such shard", got=text, expected=f"1/{max(n, 1)} to {max(n, 1)}/{max(n, 1)}")
    return k, n


def one_frame(ids: Sequence[str], text: str, root: Path) -> str:
    """Frame id meant by FRAME, its id or its index, among all ids in order."""
    from pipeline.datasets.base import named_frame

    require(
        not (text == ALL_FRAMES and text not in ids),
        "one frame is needed",
        got=text,
        expected="a frame's id, or its index",
        path=root,
    )
    return named_frame(ids, text, root)


@dataclass(frozen=True)
class CameraOptions:
    """Known facts on the camera of a recording, and on up."""

    intrinsics: str | None = None
    """fx,fy,cx,cy in pixels, for recordings without a camera file; a fifth number stands for --depth-scale."""
    depth_scale: float | None = None
    """Depth units in one metre (1000 for millimetres), for recordings without a camera file."""
    up: str | None = None
    """Against gravity, X,Y,Z: in the world of the poses; in a dataset without poses in the camera frame (OpenCV: x
    right, y down, z forward; a level camera has 0,-1,0). world:X,Y,Z and camera:X,Y,Z say which. It wins over what the
    dataset declares."""
    level_at: str | None = None
    """U,V (column, row): the surface at this pixel of the frame that is asked, else of the first one, is level;
    FRAME:U,V says which frame. The poses carry it to the whole scene."""
    poses: str | None = None
    """What the pose files mean, such as "world-to-camera opencv"; `spatialviz doctor` finds it."""
    registration: str | None = None
    """fx,fy,cx,cy,tx,ty,tz: the colour camera as the depth camera sees it, pixels and metres, where both are not one;
    `spatialviz doctor` finds it."""
    depth_model: str | None = None
    """Estimate depth of the colour, where there is none or in place of it: NAME, NAME=FILE.onnx, FILE.onnx or an id of
    the model hub; `spatialviz models` lists the names."""

    def camera(self, frame: str | None = None) -> dict[str, Any]:
        """Arguments of `open_dataset`; `frame` is that of a bare --level-at."""
        from pipeline.datasets.settings import parse_level_at

        level_at, found, scale, warp = self.level_at, None, self.depth_scale, None
        if level_at is not None and frame not in (None, ALL_FRAMES) and parse_level_at(level_at)[0] is None:
            level_at = f"{frame}:{level_at}"
        if self.intrinsics is not None:
            five = self.intrinsics.count(",") == 4
            require(not five or scale is None, "--depth-scale and the fifth number of --intrinsics say the same")
            form, problem = "fx,fy,cx,cy" + ",UNITS_PER_METRE" * five, "--intrinsics must be four numbers"
            *found, last = numbers(self.intrinsics, form, float, problem)
            found, scale = (tuple(found), last) if five else ((*found, last), scale)
        if self.registration is not None:
            form = "fx,fy,cx,cy,tx,ty,tz"
            warp = numbers(self.registration, form, float, "--registration must be seven numbers")
        told = {"depth_scale": scale, "up": self.up, "level_at": level_at, "depth_model": self.depth_model}
        return {"intrinsics": found, **told, "poses": self.poses, "registration": warp}


# Docstrings of common options are named to tyro, which would look for comments in the source of commands: 15 ms.
CameraArg = OmitArgPrefixes[Annotated[CameraOptions, arg(help=CameraOptions.__doc__)]]


@dataclass(frozen=True)
class DatasetOptions(CameraOptions):
    """Dataset of the pictures, for corrections of masks and boxes."""

    dataset: str | None = None
    """Dataset folder, or "demo". Default: where the labels say it was, if it is still there."""

    def open(self, labels: Labels) -> Dataset | None:
        """Labelled dataset; None, with a warning, for a missing one not named."""
        from pipeline.labels.reading import labelled_dataset

        try:
            return labelled_dataset(labels.manifest, self.dataset, **self.camera())
        except InputError as error:
            if self.dataset is not None:
                raise
            warn(f"without the dataset ({error}); --dataset says where it is")
            return None

    def masks(self, labels: Labels) -> OtherMasks:
        """Comparison of the labels' masks from view to view; InputError where there can be none."""
        from pipeline.labels.check.other_masks import other_masks

        return other_masks(labels, self.open(labels))


OpenDatasetArg = OmitArgPrefixes[Annotated[DatasetOptions, arg(help=DatasetOptions.__doc__)]]


@dataclass(frozen=True)
class JournalOptions:
    """Journal of corrections."""

    journal: str | None = None
    """Path, or postgresql://user@host/database for a team. Default: journal.sqlite beside the labels."""
    project: str | None = None
    """Whose corrections, where several datasets share a database. Default: the name of the dataset's folder."""

    def open(self, labels: Labels, *, must_exist: bool = False) -> Journal:
        """Journal of these labels, with its warnings printed."""
        from pipeline.corrections.journal.journal import journal_of

        opened = journal_of(labels, self.journal, project=self.project, must_exist=must_exist)
        warn(*opened.warnings)
        return opened


JournalArg = OmitArgPrefixes[Annotated[JournalOptions, arg(help=JournalOptions.__doc__)]]


@dataclass(frozen=True, kw_only=True)
class OnJournal(OnLabels):
    """Command on a labels folder and its corrections."""

    journal: JournalArg = JournalOptions()


@dataclass(frozen=True, kw_only=True)
class OnPictures(OnJournal):
    """Command on corrections with possible need of the pictures."""

    source: OpenDatasetArg = DatasetOptions()


@dataclass(frozen=True, kw_only=True)
class OfCamera(Output):
    """Command on a recording without models."""

    camera: CameraArg = CameraOptions()


@dataclass(frozen=True, kw_only=True)
class OnFrame(Output):
    """Command on a single frame."""

    dataset: DatasetArg
    frame: OneFrameArg


@dataclass(frozen=True)
class DetectorOptions(DetectorSetup):
    """Detector, and further ones fused with it."""

    provider: Provider | None = None
    """What networks compute on. Default: cuda, directml or coreml where ONNX Runtime has it, else the CPU."""


@dataclass(frozen=True)
class ProposalOptions(DetectorOptions, CameraOptions):
    """Dataset, and the finder of its objects."""

    segmenter: str | None = None
    """Makes masks for boxes that have none: depth | recorded | yolo-seg | sam | sam2 | efficientsam.
    Default: none, the whole box is lifted."""
    segmenter_model: Path | tuple[Path, Path] | None = None
    """Model file, hub id or recording for the segmenter, ENCODER DECODER for the SAM kinds; depth needs none."""
    verbose: Flag = False
    """Show ONNX Runtime's own messages."""

    def arguments(self, frame: str | None = None) -> dict[str, Any]:
        """Arguments of `open_pipeline`; `frame` is the asked one. Sets the device of networks."""

        use_execution(self.provider, self.verbose)
        names = ("detector", "model", "model_config", "min_score", "segmenter", "segmenter_model", "synonyms")
        fused = {"fuse": self.fuse, "fusion": self.fusion} if self.fuse else {}
        return {**self.camera(frame), **{name: getattr(self, name) for name in names}, **fused}


@dataclass(frozen=True)
class FramesOptions(ProposalOptions):
    """Detector with its settings, and the frames to run on."""

    k: int = 10
    """Proposals of each name."""
    frames: str = ALL_FRAMES
    """all, FROM:TO by index (FROM is in, TO is not), or a frame's id or index."""

    def open(self, dataset: str) -> tuple[Pipeline, tuple[str, ...]]:
        """Dataset with the detector, and the ids of the frames."""
        from pipeline.answering.ask import AskConfig
        from pipeline.answering.pipeline import frame_range, open_pipeline

        source = open_pipeline(dataset, srm="rule", config=AskConfig(k=self.k), **self.arguments())
        return source, frame_range(source.dataset, self.frames)


FramesArg = OmitArgPrefixes[Annotated[FramesOptions, arg(help=FramesOptions.__doc__)]]


@dataclass(frozen=True)
class LabelledOptions(ProposalOptions):
    """Dataset to label, and the finder of its objects."""

    segmenter: str | None = "depth"
    """depth | recorded | yolo-seg | sam | sam2 | efficientsam: masks for the boxes that have none."""

    def spec(self, dataset: str) -> SourceSpec:
        """Specification for the core."""
        from pipeline.labels.plan import SourceSpec

        return SourceSpec(dataset, with_files(self.arguments(), str))


LabelledArg = OmitArgPrefixes[Annotated[LabelledOptions, arg(help=LabelledOptions.__doc__)]]


@dataclass(frozen=True)
class ReaderOptions:
    """Reader of expressions."""

    reader: Literal["grammar", "llm"] = "grammar"
    """grammar | llm: a language model behind an OpenAI-compatible server is asked for the same tree, once for each
    expression. Key: SPATIALVIZ_VLM_KEY."""
    reader_url: str | None = None
    """With --reader llm: the server, such as http://localhost:8000/v1 (vLLM, Ollama, llama.cpp)."""
    reader_model: str | None = None
    """The model's name on that server."""


@dataclass(frozen=True)
class SourceOptions(ReaderOptions, ProposalOptions):
    """Dataset with its models."""

    srm: str = "trained"
    """What scores relations: trained (the network that comes with the program) | rule | an ONNX file."""
    vectors: Path | None = None
    """The text vectors that the relation network was trained with, for class names it was not trained on."""
    box: Box = "upright"
    boxes: Boxes = "seen"
    k: int = 10
    """Proposals that go on for each name."""
    score_calibration: Path | None = None
    """What `spatialviz detect --calibrate` wrote for this detector: its scores become probabilities."""
    force_calibration: Flag = False
    """Use it although it was fitted for another detector or setting."""

    def arguments(self, frame: str | None = None) -> dict[str, Any]:
        """Arguments as of `ProposalOptions`, with the relation scorer and the settings of an answer."""
        from pipeline.answering.ask import AskConfig
        from pipeline.geometry.cleaning import LiftConfig
        from pipeline.proposals.score_calibration import load_calibration

        calibration = None if self.score_calibration is None else load_calibration(self.score_calibration)
        if self.force_calibration:
            if calibration is None:
                raise InputError("--force-calibration needs --score-calibration", expected="a file to be used")
            calibration = calibration.for_any()
        config = AskConfig(k=self.k, lift=LiftConfig(box=self.box, boxes=self.boxes), score_calibration=calibration)
        reading = {f.name: value for f in fields(ReaderOptions) if (value := getattr(self, f.name)) != f.default}
        return {**super().arguments(frame), **reading, "srm": self.srm, "vectors": self.vectors, "config": config}

    def words(self) -> list[str]:
        """Options other than the defaults, as words of a command line."""
        words: list[str] = []
        for field in fields(self):
            value = getattr(self, field.name)
            if value != field.default:
                parts = value if isinstance(value, tuple) else () if value is True else (value,)
                words += [f"--{field.name.replace('_', '-')}", *map(str, parts)]
        return words

    def open(self, dataset: str, frame: str | None = None, labels: Labels | None = None) -> Pipeline:
        """Dataset with its models; `frame` is the asked one, `labels` judge the answers."""
        from pipeline.answering.pipeline import open_pipeline
        from pipeline.datasets.up import told_doubts

        options = self.arguments(frame)
        if labels is not None:
            from pipeline.labels.reading import labelled_up

            options = labelled_up(labels.manifest, options)
        source = open_pipeline(dataset, **options)
        if self.level_at is not None or self.up is not None:
            warn(*(f"frame {frame}: {'; '.join(doubts)}" for frame, doubts in told_doubts(source.dataset).items()))
        return source


SourceArg = OmitArgPrefixes[Annotated[SourceOptions, arg(help=SourceOptions.__doc__)]]


@dataclass(frozen=True, kw_only=True)
class OfAnswer(OnFrame):
    """Command on the answer to an expression."""

    expression: ExpressionArg
    source: SourceArg = SourceOptions()
