"""The commands that make, merge, check and export labels."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.execution import Provider
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json, task_of
from spatialviz.source_options import CameraOptions, fusing

if TYPE_CHECKING:
    from pipeline.labels.config import SelectConfig
    from pipeline.labels.plan import SourceSpec


@dataclass(frozen=True)
class LabelSource(CameraOptions):
    """What is labelled, and what finds the objects."""

    detector: str | None = None
    """annotations | recorded | yolo-seg | grounding-dino | owlv2 | owlvit | detic | boxes | simulated. Default:
    annotations, where the dataset has them."""
    model: Path | None = None
    """Model file, its id on the model hub (OWNER/REPO:FILE@REVISION), a recording, or options of the simulated one."""
    model_config: Path | None = None
    """What the model file does not say: the TOML file of boxes (default: beside the model), class names of detic."""
    fuse: tuple[str, ...] = ()
    """Further detectors, NAME or NAME=MODEL, whose detections are fused with the detector's. What a MODEL does not say
    stands beside it."""
    fusion: Literal["wbf", "nms"] = "wbf"
    """With --fuse: weighted boxes fusion, or all with non-maximum suppression."""
    segmenter: str | None = "depth"
    """depth | recorded | yolo-seg | sam | sam2 | efficientsam: masks for the boxes that have none."""
    segmenter_model: Path | tuple[Path, Path] | None = None
    """Model file, hub id or recording for the segmenter, ENCODER DECODER for the SAM kinds."""
    min_score: float | None = None
    """Drop detections below this score, of each detector before they are fused. Default: the detector's own."""
    synonyms: Path | None = None
    """A JSON file with more synonyms."""
    provider: Provider | None = None
    """What networks compute on. Default: cuda, directml or coreml where ONNX Runtime has it, else the CPU."""
    verbose: bool = False
    """Show ONNX Runtime's own messages."""

    def spec(self, dataset: str) -> SourceSpec:
        """The same as the core takes it."""
        from pipeline.labels.plan import SourceSpec
        from pipeline.system.execution import use_execution

        use_execution(self.provider, self.verbose)
        options: dict[str, Any] = {
            "detector": self.detector,
            "model": self.model,
            "model_config": self.model_config,
            "segmenter": self.segmenter,
            "segmenter_model": self.segmenter_model,
            "min_score": self.min_score,
            "synonyms": self.synonyms,
            **self.camera(),
            **fusing(self.fuse, self.fusion),
        }
        plain = {k: str(v) if isinstance(v, Path) else v for k, v in options.items()}
        if isinstance(self.segmenter_model, tuple):
            plain["segmenter_model"] = [str(path) for path in self.segmenter_model]
        if self.fuse:
            plain["fuse"] = list(self.fuse)
        return SourceSpec(dataset, plain)


@dataclass(frozen=True)
class Selection:
    """Which of all candidate expressions are kept."""

    expressions: int | None = None
    """At most so many, level over relations and classes. Default: as many as the other rules allow."""
    per_frame: int = 40
    """At most so many of one frame."""
    balance: float = 3.0
    """No relation has more than so many times the expressions of the rarest one; 0 for no such limit."""
    selection_seed: int = 0
    """Another seed chooses others."""
    keep_vague: bool = False
    """Keep sentences that every object of the target's class answers."""

    def config(self) -> SelectConfig:
        """The same as the core takes it."""
        from pipeline.labels.config import SelectConfig

        balance = self.balance or None
        return SelectConfig(self.expressions, self.per_frame, balance, self.selection_seed, not self.keep_vague)


@dataclass(frozen=True)
class Label:
    """Label a dataset: objects, every relation between them, and sentences that are true of them."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    out: str
    """Folder for the labels, or a URL that fsspec knows; what is at a URL is then merged with `merge --to`."""
    source: OmitArgPrefixes[LabelSource] = LabelSource()
    selection: OmitArgPrefixes[Selection] = Selection()
    vocabulary: Literal["avd", "semantic-abstraction", "all"] = "avd"
    """Which relations."""
    profile: Literal["viewer-cone-v1", "semantic-abstraction-published", "given"] = "viewer-cone-v1"
    """The rules that decide them; given: no rule of ours, what the dataset's own expressions say."""
    second_opinion: str = "trained"
    """trained | none | an ONNX file: a network that makes labels doubtful where it does not agree."""
    style: Literal["varied", "plain", "semantic-abstraction"] = "varied"
    """How sentences are worded."""
    box: Literal["gravity", "pca"] = "gravity"
    """How 3D boxes are fitted: upright, or the paper's PCA box."""
    seed: int = 0
    """The same seed gives the same labels."""
    engine: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster (extra: cluster)."""
    workers: int = os.cpu_count() or 1
    """Processes at once. The labels do not depend on it."""
    gpus_a_detector: float = 0.0
    """Share of a GPU for each detector of the engine ray."""
    shard: str | None = None
    """k/N: only this task of N that share the folder, for arrays of jobs; then run `merge`."""
    resume: bool = False
    """Go on in a folder where a run was stopped."""
    limit: int | None = None
    """Only the first so many frames."""
    frames_of: tuple[str, ...] = ()
    """Only the frames of these splits of the dataset's own, such as vool/train."""
    json: bool = False
    """Print one JSON object: counts, seconds, hashes."""

    def run(self) -> int:
        from pipeline.geometry.lifting import LiftConfig
        from pipeline.labels.config import LabelConfig
        from pipeline.labels.job import label_dataset
        from spatialviz.printing import rate_bar
        from spatialviz.printing_labels import label_record, print_labelled

        config = LabelConfig(
            profile=self.profile,
            vocabulary=self.vocabulary,
            lift=LiftConfig(box=self.box),
            style=self.style,
            seed=self.seed,
            second_opinion=self.second_opinion,
        )
        part, spec, selection = task_of(self.shard), self.source.spec(self.dataset), self.selection.config()
        try:
            with rate_bar("labelling", "frames") as advance:
                report = label_dataset(
                    spec,
                    self.out,
                    config,
                    selection,
                    engine=self.engine,
                    workers=self.workers,
                    part=part,
                    resume=self.resume,
                    limit=self.limit,
                    frames_of=self.frames_of,
                    gpus_a_detector=self.gpus_a_detector,
                    progress=advance,
                )
        except KeyboardInterrupt:
            more = "run the same command again" + ("" if part else " with --resume")
            print(f"spatialviz: finished shards are kept in {self.out}; to go on, {more}", file=sys.stderr)
            raise
        if self.json:
            print_json(label_record(report))
        else:
            print_labelled(report, self.out)
        # A task of more than there are shards has nothing to do, and that is fine.
        return FINE if report.frames > report.broken or not report.frames else NO


@dataclass(frozen=True)
class Merge:
    """Merge the shards of `label --shard`, or select expressions anew."""

    labels: Positional[str]
    """Labels folder, or URL."""
    to: Path | None = None
    """Where the merged tables go. Default: the labels folder."""
    selection: OmitArgPrefixes[Selection] = Selection()
    json: bool = False
    """Print the manifest."""

    def run(self) -> int:
        import json

        from pipeline.labels.merge import merge_labels
        from spatialviz.printing_labels import print_manifest

        manifest = merge_labels(self.labels, self.selection.config(), self.to)
        if self.json:
            print_json(json.loads(manifest.model_dump_json()))
        else:
            print_manifest(manifest, str(self.to or self.labels))
        return FINE


@dataclass(frozen=True)
class Check:
    """Say what is wrong with labels; exit status 1 where errors stand."""

    labels: Positional[Path]
    """Labels folder."""
    report: Path | None = None
    """Folder for statistics as pictures and a page."""
    rules: tuple[str, ...] = ()
    """Only these rules, or groups of them such as "expression"."""
    show: int = 20
    """Findings shown of each rule."""
    json: bool = False
    """Print one JSON object for each finding, and one with the statistics."""

    def run(self) -> int:
        from pipeline.labels.check import check_labels, finding_record
        from pipeline.labels.makers import makers_of
        from pipeline.labels.reading import open_labels
        from pipeline.labels.report import check_report_folder, need_matplotlib, write_report
        from pipeline.labels.statistics import label_statistics
        from pipeline.system.errors import InputError, MissingExtra
        from spatialviz.printing_findings import print_findings
        from spatialviz.printing_statistics import print_statistics

        labels = open_labels(self.labels)
        if self.report is not None:
            check_report_folder(self.report)
        statistics = problem = None
        try:
            statistics = label_statistics(labels)
        except InputError as error:
            # A damaged table is first of all a finding.
            problem = error
        found = check_labels(labels, rules=self.rules or None)
        errors = 0
        if self.json:
            for finding in found:
                errors += finding.severity == "error"
                print_json(finding_record(finding))
        if statistics is not None:
            if self.json:
                print_json({"statistics": statistics, "makers": makers_of(labels.manifest).record()})
            else:
                print_statistics(statistics, labels)
        if not self.json:
            errors = print_findings(found, self.show)
        if problem is not None and not errors:
            raise problem
        if self.report is not None and statistics is not None:
            page = write_report(labels, statistics, self.report)[0]
            if why := MissingExtra.missing(need_matplotlib):
                print(f"spatialviz: the pictures are left out: {why}", file=sys.stderr)
            if not self.json:
                print(f"-> {page}")
        return NO if errors else FINE


@dataclass(frozen=True)
class BenchLabel:
    """Time labelling: lifting and relations beside the usual Open3D recipe, and the whole job on a dataset."""

    dataset: Positional[str] = "demo"
    """What the whole job labels."""
    views: int = 12
    """Rendered views for the comparison (extra: render; open3d for the recipe)."""
    repeat: int = 3
    """Passes; the fastest counts."""
    workers: int = os.cpu_count() or 1
    """Processes of the whole job."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.evaluation.labels_bench import bench_labels
        from spatialviz.printing_labels import print_label_bench

        record = bench_labels(
            LabelSource().spec(self.dataset), views=self.views, repeat=self.repeat, workers=self.workers
        )
        if self.json:
            print_json(record)
        else:
            print_label_bench(record)
        return FINE
