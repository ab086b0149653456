"""The command line: it parses, calls a job of the core, and prints what came back."""

from __future__ import annotations

import io
import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, Union

import tyro
from tyro.conf import OmitArgPrefixes, Positional, subcommand

from pipeline import __version__
from pipeline.system.errors import InputError, MissingExtra
from spatialviz.cli_agree import Agree
from spatialviz.cli_bench_srm import BenchSrm
from spatialviz.cli_cases import Replay, Report, SaveCase
from spatialviz.cli_detect import Calibrate, Detect
from spatialviz.cli_eval import BenchEval, Eval
from spatialviz.cli_exports import Export, Import
from spatialviz.cli_journal import Correct, Effective, Redo, ShowJournal, Undo
from spatialviz.cli_labels import BenchLabel, Check, Label, Merge
from spatialviz.cli_models import BenchDetect, Models
from spatialviz.cli_review import BenchReview, Install, Retrain, Review
from spatialviz.cli_runs import Failures, Query, Tables
from spatialviz.cli_show import Show
from spatialviz.cli_training import Train
from spatialviz.cli_view import View
from spatialviz.cli_whatif import WhatIf
from spatialviz.exits import BAD, FINE, INTERRUPTED, NO
from spatialviz.options import one_line_warnings, print_json, warn_skipped
from spatialviz.source_options import CameraOptions, SourceOptions


@dataclass(frozen=True)
class Ask:
    """Answer expressions such as "mug left of the laptop" on a frame.

    Exit status: 0 where a pair stands in the relation that was asked, 1 where there is none: a name was not found, or
    the best pair has a probability below .5 and is told as the nearest; 2 for bad usage or input. Of several
    expressions or frames one that holds is enough for 0.
    """

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    frame: Positional[str]
    """Frame id, its index, or "all"."""
    expressions: Positional[tuple[str, ...]]
    """TARGET RELATION REFERENCE, each in quotes."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    json: bool = False
    """Print one JSON object for each answer."""
    save: Path | None = None
    """Write the answer as a picture."""
    labels: Path | None = None
    """Labels that say what is true. Default: the frame's annotations."""

    def run(self) -> int:
        from pipeline.answering.missed_names import missed_names
        from pipeline.answering.opening import ALL_FRAMES
        from pipeline.answering.told_answer import holds
        from pipeline.diagnosis.asking import ask_and_judge, judged_record
        from pipeline.labels.reading import open_labels
        from spatialviz.printing import print_overlooked, print_trace, print_verdict
        from spatialviz.report.picture import save_picture

        if not self.expressions:
            raise InputError("an expression is missing", expected='for example "mug left of the laptop"')
        if self.save is not None and (self.frame == ALL_FRAMES or len(self.expressions) > 1):
            raise InputError("--save takes one frame and one expression", path=self.save)
        labels = None if self.labels is None else open_labels(self.labels)
        answered = 0
        source = self.source.open(self.dataset, self.frame, labels)
        for answer in ask_and_judge(source, self.frame, self.expressions, labels, warn_skipped):
            answered += holds(answer.trace)
            if self.json:
                print_json(judged_record(answer))
            else:
                print_trace(answer.trace)
                print_verdict(answer)
                if answer.trace.missing and self.frame != ALL_FRAMES:
                    print_overlooked(missed_names(source, answer.trace))
            if self.save is not None:
                save_picture(answer.trace, self.save)
        return FINE if answered else NO


@dataclass(frozen=True)
class Relations:
    """Every pair of objects of a frame (or of all frames): each relation's state and probability."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    frame: Positional[str] = "all"
    """Frame id, its index, or "all"."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    vocabulary: Literal["avd", "semantic-abstraction", "all"] = "all"
    """Which relations."""
    json: bool = False
    """Print one JSON object for each ordered pair."""

    def run(self) -> int:
        from pipeline.answering.json_records import relation_records
        from pipeline.answering.opening import relate_frames
        from pipeline.language.relation_names import VOCABULARIES
        from spatialviz.printing import print_relations

        relations = VOCABULARIES[self.vocabulary]
        pairs = 0
        for found in relate_frames(self.source.open(self.dataset, self.frame), self.frame, warn_skipped):
            pairs += len(found.objects) * max(len(found.objects) - 1, 0)
            if self.json:
                for record in relation_records(found, relations):
                    print_json(record)
            else:
                print_relations(found, relations)
        return FINE if pairs else NO


@dataclass(frozen=True)
class Frames:
    """List the frames of a dataset: what is in each, and what is broken."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)
    json: bool = False
    """Print one JSON object for each frame."""
    summary: bool = False
    """Print only counts over all frames; with --json, as one JSON object."""
    remember: bool = False
    """Keep --intrinsics, --depth-scale, --up and --level-at in spatialviz.toml beside the data."""

    def run(self) -> int:
        from pipeline.answering.json_records import frame_record
        from pipeline.answering.opening import open_pipeline
        from pipeline.datasets import SurveyCounts, summarise, survey, write_settings
        from pipeline.datasets.given_up import told_up
        from spatialviz.printing import print_frames
        from spatialviz.printing_statistics import print_summary

        camera = self.camera.camera()
        dataset = open_pipeline(self.dataset, **camera).dataset
        if self.remember:
            write_settings(dataset.root, camera["intrinsics"], camera["depth_scale"], *told_up(dataset))
        counts = SurveyCounts()
        reports = survey(dataset)
        if self.summary:
            record = summarise(reports)
            print_json(record) if self.json else print_summary(record)
            return FINE if record["frames_usable"] else NO
        if not self.json:
            usable = print_frames(dataset, counts.watch(reports))
            print_summary(counts.record())
            return FINE if usable else NO
        usable = 0
        for report in reports:
            usable += report.ok
            print_json(frame_record(report))
        return FINE if usable else NO


@dataclass(frozen=True)
class Render:
    """Render synthetic annotated RGB-D rooms in BOP format."""

    out: Positional[Path]
    """Folder to write; it must not exist, or be empty."""
    rooms: int = 4
    """Number of rooms; each becomes one BOP scene."""
    views: int = 3
    """Pictures of each room."""
    seed: int = 0
    """The same seed gives the same files."""
    width: int = 640
    height: int = 480
    workers: int = os.cpu_count() or 1
    """Rooms rendered at once, each by a process of its own. The files do not depend on it."""

    def run(self) -> int:
        from pipeline.datasets.synthetic import render_dataset
        from spatialviz.printing import progress_bar

        with progress_bar("rendering", self.rooms * self.views) as advance:
            report = render_dataset(
                self.out,
                rooms=self.rooms,
                views=self.views,
                seed=self.seed,
                width=self.width,
                height=self.height,
                progress=advance,
                workers=self.workers,
            )
        print(
            f"{report.frames} frames of {report.rooms} rooms with {report.objects} objects "
            f"of {len(report.classes)} classes in {report.seconds:.1f} s -> {self.out}"
        )
        return FINE


@dataclass(frozen=True)
class Context:
    """Fuse the posed frames around a frame into a mesh, in its camera frame (extra: open3d)."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    frame: Positional[str]
    """Frame id, or its index."""
    out: Positional[Path]
    """Mesh file to write: .ply, .obj or .glb."""
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.answering.opening import open_pipeline
        from pipeline.datasets import resolve_frame
        from pipeline.datasets.scene_mesh import export_mesh, fuse_context

        dataset = open_pipeline(self.dataset, **self.camera.camera(self.frame)).dataset
        frame = dataset.load(resolve_frame(dataset, self.frame))
        mesh = fuse_context(dataset, frame)
        export_mesh(mesh, self.out)
        record = {"frame": frame.id, "frames": mesh.frames, "vertices": len(mesh.vertices), "faces": len(mesh.faces)}
        if self.json:
            print_json(record)
        else:
            print(f"{mesh.frames} frames around {frame.id}: {len(mesh.faces)} faces -> {self.out}")
        return FINE


@dataclass(frozen=True)
class Bench:
    """Time the stages on a dataset: milliseconds a frame, and ratios measured in one run."""

    dataset: Positional[str] = "demo"
    """Dataset folder, or "demo"."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    repeat: int = 5
    """Passes; the fastest counts."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.answering.bench import bench_source
        from spatialviz.printing import print_bench

        record = bench_source(self.source.open(self.dataset), repeat=self.repeat)
        if self.json:
            print_json(record)
        else:
            print_bench(record)
        return FINE


Command = Union[
    Annotated[View, subcommand("view")],
    Annotated[Ask, subcommand("ask")],
    Annotated[WhatIf, subcommand("whatif")],
    Annotated[Relations, subcommand("relations")],
    Annotated[Frames, subcommand("frames")],
    Annotated[Render, subcommand("render")],
    Annotated[Context, subcommand("context")],
    Annotated[Label, subcommand("label")],
    Annotated[Merge, subcommand("merge")],
    Annotated[Check, subcommand("check")],
    Annotated[Export, subcommand("export")],
    Annotated[Import, subcommand("import")],
    Annotated[Review, subcommand("review")],
    Annotated[Show, subcommand("show")],
    Annotated[ShowJournal, subcommand("journal")],
    Annotated[Correct, subcommand("correct")],
    Annotated[Undo, subcommand("undo")],
    Annotated[Redo, subcommand("redo")],
    Annotated[Effective, subcommand("effective")],
    Annotated[Train, subcommand("train")],
    Annotated[Retrain, subcommand("retrain")],
    Annotated[Install, subcommand("install")],
    Annotated[Detect, subcommand("detect")],
    Annotated[Agree, subcommand("agree")],
    Annotated[Calibrate, subcommand("calibrate")],
    Annotated[Models, subcommand("models")],
    Annotated[Eval, subcommand("eval")],
    Annotated[Failures, subcommand("failures")],
    Annotated[Query, subcommand("query")],
    Annotated[Tables, subcommand("tables")],
    Annotated[SaveCase, subcommand("save-case")],
    Annotated[Replay, subcommand("replay")],
    Annotated[Report, subcommand("report")],
    Annotated[Bench, subcommand("bench")],
    Annotated[BenchLabel, subcommand("bench-label")],
    Annotated[BenchEval, subcommand("bench-eval")],
    Annotated[BenchSrm, subcommand("bench-srm")],
    Annotated[BenchReview, subcommand("bench-review")],
    Annotated[BenchDetect, subcommand("bench-detect")],
]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0 fine, 1 the answer is no, 2 bad usage or input."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal that cannot show a character shows a question mark instead.
            stream.reconfigure(errors="replace")
    one_line_warnings()
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments in (["--version"], ["-V"]):
        print(f"spatialviz {__version__}")
        return FINE
    if not arguments or (arguments[0].startswith("-") and arguments[0] not in ("-h", "--help")):
        arguments = ["view", *arguments]
    if arguments[0] == "bench" and arguments[1:2] and arguments[1] in ("label", "eval", "srm", "review", "detect"):
        arguments = [f"bench-{arguments[1]}", *arguments[2:]]
    try:
        command = tyro.cli(
            Command,  # pyright: ignore[reportArgumentType]
            prog="spatialviz",
            args=arguments,
            description="See why an RGB-D spatial-reasoning pipeline answered what it answered.",
            config=(
                tyro.conf.FlagCreatePairsOff,
                tyro.conf.PositionalMetavarFromFieldName,
                tyro.conf.DisallowNone,
            ),
        )
        return command.run()
    except (InputError, MissingExtra) as error:
        print(f"spatialviz: error: {error}", file=sys.stderr)
        return BAD
    except KeyboardInterrupt:
        print("spatialviz: stopped", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader went away (for example `| head`); nothing is left to say.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FINE
    except OSError as error:  # A full disk, a folder that cannot be written.
        reason = error.strerror or str(error)
        print(f"spatialviz: error: {reason}" + (f" [{error.filename}]" if error.filename else ""), file=sys.stderr)
        return BAD
    except Exception as error:
        if os.environ.get("SPATIALVIZ_DEBUG"):
            raise
        where = traceback.extract_tb(error.__traceback__)[-1]
        print(
            f"spatialviz: internal error: {type(error).__name__}: {error} at {Path(where.filename).name}:{where.lineno}"
            " (SPATIALVIZ_DEBUG=1 shows all of it; please report it)",
            file=sys.stderr,
        )
        return BAD
