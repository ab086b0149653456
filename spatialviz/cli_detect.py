"""The commands that record what a detector finds, and that calibrate its scores."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.execution import Provider
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json, warn_skipped
from spatialviz.source_options import CameraOptions, fusing

if TYPE_CHECKING:
    from pipeline.answering.opening import Pipeline


@dataclass(frozen=True)
class DetectorOptions(CameraOptions):
    """Which detector is run, and how."""

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
    """depth | recorded | yolo-seg | sam | sam2 | efficientsam: makes masks for boxes that have none. Default: none."""
    segmenter_model: Path | tuple[Path, Path] | None = None
    """Model file, hub id or recording for the segmenter, ENCODER DECODER for the SAM kinds; depth needs none."""
    k: int = 10
    """Proposals of each name."""
    frames: str = "all"
    """all, FROM:TO by index (FROM is in, TO is not), or a frame's id or index."""
    synonyms: Path | None = None
    """A JSON file with more synonyms: {"groups": [["mug", "cup"], …]}."""
    provider: Provider | None = None
    """What networks compute on. Default: cuda, directml or coreml where ONNX Runtime has it, else the CPU."""
    verbose: bool = False
    """Show ONNX Runtime's own messages."""

    def open(self, dataset: str, also: str | None = None) -> tuple[Pipeline, tuple[str, ...]]:
        """The dataset with the detector (and `also` another beside it), and the frames that are meant."""
        from pipeline.answering.ask import AskConfig
        from pipeline.answering.opening import frame_range, open_pipeline
        from pipeline.system.execution import use_execution

        use_execution(self.provider, self.verbose)
        source = open_pipeline(
            dataset,
            also=also,
            **fusing(self.fuse, self.fusion),
            **self.camera(),
            detector=self.detector,
            model=self.model,
            model_config=self.model_config,
            min_score=self.min_score,
            segmenter=self.segmenter,
            segmenter_model=self.segmenter_model,
            srm="rule",
            synonyms=self.synonyms,
            config=AskConfig(k=self.k),
        )
        return source, frame_range(source.dataset, self.frames)


@dataclass(frozen=True)
class Detect:
    """Run a detector over a dataset and record what it finds, for --detector recorded."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    out: Path
    """A JSON file (NAME.json), or a folder, new or empty, for one NPZ file a frame: better for many frames."""
    source: OmitArgPrefixes[DetectorOptions] = DetectorOptions()
    classes: tuple[str, ...] = ()
    """Names to ask for, each by itself. Default: the dataset's classes; without any, all that the detector knows."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.answering.recording import record_detections
        from spatialviz.printing import rate_bar

        source, frame_ids = self.source.open(self.dataset)
        names = self.classes or source.dataset.class_names or None
        with rate_bar("detecting", "frames") as advance:
            report = record_detections(source, self.out, names, advance, frame_ids=frame_ids)
        for frame_id, reason in report.skipped.items():
            warn_skipped(frame_id, reason)
        if self.json:
            print_json(
                {
                    "frames": report.frames,
                    "detections": report.detections,
                    "skipped": report.skipped,
                    "unknown": list(report.unknown),
                    "seconds": round(report.seconds, 3),
                    "classes": report.classes,
                }
            )
        else:
            print(f"{report.detections} detections in {report.frames} frames, {report.seconds:.1f} s -> {self.out}")
            if report.classes:
                print(", ".join(f"{name} {count}" for name, count in report.classes.items()))
            if report.unknown:
                print("not known to the detector: " + ", ".join(report.unknown))
            if not report.detections and not self.classes:
                print(f"asked for the dataset's classes: {', '.join(names or ())}; others: --classes NAME ...")
        return FINE


@dataclass(frozen=True)
class Calibrate:
    """Fit what a detector's scores mean on annotated frames that it was not trained on, and show the effect."""

    dataset: Positional[str]
    """Dataset folder with annotations, or "demo"."""
    out: Path
    """JSON file to write, for --score-calibration."""
    source: OmitArgPrefixes[DetectorOptions] = DetectorOptions()
    names: Literal["frame", "dataset"] = "frame"
    """Ask each frame for the classes that are in it, as expressions about it do, or for all of the dataset's."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.answering.calibrating import annotated_names, calibrate_scores
        from pipeline.proposals.score_calibration import save_calibration
        from spatialviz.printing import rate_bar
        from spatialviz.printing_calibration import print_calibration

        source, frame_ids = self.source.open(self.dataset)
        everything = source.dataset.class_names
        with rate_bar("detecting", "frames") as advance:
            calibration, report = calibrate_scores(
                source,
                frame_ids,
                annotated_names if self.names == "frame" else lambda frame: everything,
                progress=advance,
                skipped=warn_skipped,
            )
        save_calibration(calibration, self.out, report)
        if self.json:
            print_json({"a": calibration.a, "b": calibration.b, "detector": calibration.detector, **report})
        else:
            print_calibration(calibration, report, self.out)
        return FINE if report["fitted"] else NO
