"""What is opened, and with which models: the options that most commands share."""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pipeline.errors import InputError
from pipeline.execution import Provider
from spatialviz.options import four_numbers

if TYPE_CHECKING:
    from pipeline.jobs import Source
    from pipeline.labels.reading import Labels
    from pipeline.proposals.detector_setup import DetectorSetup
    from pipeline.proposals.score_calibration import ScoreCalibration


def read_calibration(path: Path | None, forced: bool = False) -> ScoreCalibration | None:
    """The score calibration of a file, for any detector where it is forced; None without a file."""
    from pipeline.proposals.score_calibration import load_calibration

    if path is None:
        if forced:
            raise InputError("--force-calibration needs --score-calibration", expected="a file to be used")
        return None
    calibration = load_calibration(path)
    return calibration.for_any() if forced else calibration


def fusing(fuse: tuple[str, ...], fusion: str) -> dict[str, Any]:
    """Detectors to be fused as arguments of `pipeline.jobs.open_source`; none where there is nothing to fuse."""
    return {"fuse": fuse, "fusion": fusion} if fuse else {}


@dataclass(frozen=True)
class SecondDetectorOptions:
    """A detector that says what it sees in labelled frames."""

    detector: str | None = None
    """Let this detector look at the labelled frames too: annotations | recorded | yolo-seg | grounding-dino | owlv2 |
    owlvit | detic | boxes | simulated."""
    model: Path | None = None
    """Its model file, its id on the model hub (OWNER/REPO:FILE@REVISION), a recording, or options of the simulated
    one."""
    model_config: Path | None = None
    """What the file of --model does not say: the TOML file of boxes (default: beside the model), the class names of
    detic and yolo-seg."""
    fuse: tuple[str, ...] = ()
    """Further detectors, NAME or NAME=MODEL, whose detections are fused with the detector's."""
    fusion: Literal["wbf", "nms"] = "wbf"
    """With --fuse: weighted boxes fusion, or all with non-maximum suppression."""
    min_score: float | None = None
    """Drop detections below this score, of each detector before they are fused. Default: the detector's own."""
    synonyms: Path | None = None
    """A JSON file with more synonyms: {"groups": [["mug", "cup"], …]}."""
    provider: Provider | None = None
    """What networks compute on. Default: cuda, directml or coreml where ONNX Runtime has it, else the CPU."""

    def check(self) -> None:
        """Raise InputError where an option is of no detector."""
        own = ("model", "model_config", "fuse", "min_score")
        given = [name for name in own if getattr(self, name) not in (None, ())]
        if self.detector is None and given:
            raise InputError(f"--{given[0].replace('_', '-')} needs --detector", cause="of which detector?")

    def setup(self) -> DetectorSetup | None:
        """What it is made from; None where none is asked."""
        from pipeline.execution import use_execution
        from pipeline.proposals.detector_setup import DetectorSetup

        if self.detector is None:
            return None
        use_execution(self.provider, False)
        return DetectorSetup(
            self.detector, self.model, self.model_config, self.min_score, self.synonyms, self.fuse, self.fusion
        )


@dataclass(frozen=True)
class CameraOptions:
    """What a person knows of the camera of a recording, and of where up is."""

    intrinsics: str | None = None
    """fx,fy,cx,cy in pixels, for recordings without a camera file."""
    depth_scale: float | None = None
    """Depth units in one metre (1000 for millimetres), for recordings without a camera file."""
    up: str | None = None
    """Against gravity, X,Y,Z: in the world of the poses; in a dataset without poses in the camera frame (OpenCV: x
    right, y down, z forward; a level camera has 0,-1,0). world:X,Y,Z and camera:X,Y,Z say which. It wins over what the
    dataset declares."""
    level_at: str | None = None
    """U,V (column, row): the surface at this pixel of the frame that is asked, else of the first one, is level;
    FRAME:U,V says which frame. The poses carry it to the whole scene."""

    def camera(self, frame: str | None = None) -> dict[str, Any]:
        """The same as arguments of `open_dataset`; `frame` is the one that a bare --level-at is of."""
        from pipeline.datasets.up_text import parse_level_at

        level_at = self.level_at
        if level_at is not None and frame not in (None, "all") and parse_level_at(level_at)[0] is None:
            level_at = f"{frame}:{level_at}"
        return {
            "intrinsics": four_numbers(self.intrinsics),
            "depth_scale": self.depth_scale,
            "up": self.up,
            "level_at": level_at,
        }


@dataclass(frozen=True)
class SourceOptions(CameraOptions):
    """What is opened, and with which models."""

    detector: str | None = None
    """annotations | recorded | yolo-seg | grounding-dino | owlv2 | owlvit | detic | boxes | simulated. Default:
    annotations, where the dataset has them."""
    model: Path | None = None
    """Model file, its id on the model hub (OWNER/REPO:FILE@REVISION), a recording, or options of the simulated one."""
    model_config: Path | None = None
    """What the file of --model does not say: the TOML file of boxes (default: beside the model), the class names of
    detic and yolo-seg."""
    fuse: tuple[str, ...] = ()
    """Further detectors, NAME or NAME=MODEL, whose detections are fused with the detector's. What a MODEL does not say
    stands beside it."""
    fusion: Literal["wbf", "nms"] = "wbf"
    """With --fuse: weighted boxes fusion, or all with non-maximum suppression."""
    min_score: float | None = None
    """Drop detections below this score, of each detector before they are fused. Default: the detector's own."""
    segmenter: str | None = None
    """Makes masks for boxes that have none: depth | recorded | yolo-seg | sam | sam2 | efficientsam.
    Default: none, the whole box is lifted."""
    segmenter_model: Path | tuple[Path, Path] | None = None
    """Model file, hub id or recording for the segmenter, ENCODER DECODER for the SAM kinds; depth needs none."""
    srm: str = "trained"
    """What scores relations: trained (the network that comes with the program) | rule | an ONNX file."""
    vectors: Path | None = None
    """The text vectors that the relation network was trained with, for class names it was not trained on."""
    box: Literal["gravity", "pca"] = "gravity"
    """How 3D boxes are fitted: upright, or the paper's PCA box."""
    k: int = 10
    """Proposals that go on for each name."""
    score_calibration: Path | None = None
    """What `spatialviz calibrate` wrote for this detector: its scores become probabilities before pairs are ranked."""
    force_calibration: bool = False
    """Use it although it was fitted for another detector or setting."""
    synonyms: Path | None = None
    """A JSON file with more synonyms: {"groups": [["mug", "cup"], …]}."""
    provider: Provider | None = None
    """What networks compute on. Default: cuda, directml or coreml where ONNX Runtime has it, else the CPU."""
    verbose: bool = False
    """Show ONNX Runtime's own messages."""

    def options(self, frame: str | None = None) -> dict[str, Any]:
        """The same as arguments of `pipeline.jobs.open_source`; `frame` is the one that is asked."""
        from pipeline.ask import AskConfig
        from pipeline.execution import use_execution
        from pipeline.lifting import LiftConfig

        use_execution(self.provider, self.verbose)
        return {
            **self.camera(frame),
            "detector": self.detector,
            "model": self.model,
            "model_config": self.model_config,
            "min_score": self.min_score,
            "segmenter": self.segmenter,
            "segmenter_model": self.segmenter_model,
            "srm": self.srm,
            "vectors": self.vectors,
            "synonyms": self.synonyms,
            **fusing(self.fuse, self.fusion),
            "config": AskConfig(
                k=self.k,
                lift=LiftConfig(box=self.box),
                score_calibration=read_calibration(self.score_calibration, self.force_calibration),
            ),
        }

    def words(self) -> list[str]:
        """Those that are not as they are by default, as words of a command line."""
        words: list[str] = []
        for field in fields(self):
            value = getattr(self, field.name)
            if value != field.default:
                parts = value if isinstance(value, tuple) else () if value is True else (value,)
                words += [f"--{field.name.replace('_', '-')}", *map(str, parts)]
        return words

    def open(self, dataset: str, frame: str | None = None, labels: Labels | None = None) -> Source:
        """The dataset with its models; `frame` is the one that is asked, `labels` judge what is answered."""
        from pipeline.datasets.given_up import told_doubts
        from pipeline.jobs import open_source
        from pipeline.labels.pictures import labelled_up

        options = self.options(frame)
        source = open_source(dataset, **(options if labels is None else labelled_up(labels.manifest, options)))
        if self.level_at is not None or self.up is not None:
            for frame_id, doubts in told_doubts(source.dataset).items():
                print(f"spatialviz: frame {frame_id}: {'; '.join(doubts)}", file=sys.stderr)
        return source
