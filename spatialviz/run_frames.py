"""Commands on the frames of a recording, with their output for people."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from pipeline.datasets.base import Dataset
from pipeline.datasets.demo import found_by_name
from pipeline.datasets.frame_reports import FrameReport, SurveyCounts, spread, survey
from pipeline.datasets.odd_frames import MOST_DEPTHS, DepthSample, OddFrame, odd_frames
from pipeline.datasets.opening import open_dataset, open_each
from pipeline.datasets.report_records import frame_record
from pipeline.datasets.scene_mesh import export_mesh, fuse_context
from pipeline.datasets.settings import write_settings
from pipeline.datasets.up import told_up
from pipeline.geometry.frame import Frame
from pipeline.language.counted import counted
from spatialviz.cli_ask import (
    ContextCommand,
    FramesCommand,
)
from spatialviz.options import FINE, NO, one_frame, print_json, warn
from spatialviz.printing import print_summary, rate_bar, say, say_lines

SHOWN_ODD, SHOWN_LEFT_OUT = 5, 20
DECODED = 60
"""So many frames are decoded by default, evenly spread."""


def run_frames(command: FramesCommand) -> int:
    camera = command.camera.camera()
    datasets, left_out = open_each(
        command.dataset, lambda path: open_dataset(found_by_name(path), **camera, browse=True)
    )
    warn(*(f"left out {name}: {reason}" for name, reason in list(left_out.items())[:SHOWN_LEFT_OUT]))
    if len(left_out) > SHOWN_LEFT_OUT:
        warn(f"left out {len(left_out) - SHOWN_LEFT_OUT} more folders in which no dataset is recognised")
    usable = 0
    for name, dataset in datasets.items():
        # One dataset alone needs no name in its records.
        named = {"dataset": name} if len(datasets) > 1 else {}
        usable += _survey_frames(command, dataset, camera, named)
    return FINE if usable else NO


def _survey_frames(command: FramesCommand, dataset: Dataset, camera: dict[str, Any], named: dict[str, str]) -> int:
    """Report the contents of a dataset; returns the number of usable frames."""
    if command.remember:
        more = {key: camera[key] for key in ("poses", "registration")}
        write_settings(dataset.root, camera["intrinsics"], camera["depth_scale"], *told_up(dataset), **more)
    counts, notes = SurveyCounts(), Counter[str]()
    if not command.json:
        say((str(dataset.root), "bold"), f"  {dataset.format}, {counted(len(dataset.frame_ids), 'frame')}")
    depths, most = (MOST_DEPTHS, None) if command.decode else (DECODED, DECODED)
    read: dict[int, DepthSample] = {}
    # Records tell how odd a frame is as they come; for people that is told last, of what was decoded by then.
    records, odd = command.json and not command.summary, ()
    wanted = set() if records or command.json else set(spread(len(dataset.frame_ids), depths))

    def sample(index: int, frame: Frame) -> None:
        if index in wanted:
            read[index] = DepthSample.of(frame.depth)

    if records:
        with rate_bar("looking for odd frames", "frames") as advance:
            odd = odd_frames(dataset, most_depths=depths, progress=advance)
    with rate_bar("looking at frames", "frames") as advance:
        for report in counts.watch(survey(dataset, most, sample)):
            advance(report.index + 1, len(dataset.frame_ids))
            notes.update(report.notes)
            if records:
                print_json({**named, **frame_record(report, odd[report.index])})
            elif command.all and not command.json:
                print_frame(report)
    record = counts.record()
    if command.json and command.summary:
        print_json({**named, **record})
    elif not command.json:
        say_lines((f"note on {counted(frames, 'frame')}: {note}" for note, frames in notes.items()), "yellow")
        print_summary(record)
        with rate_bar("looking for odd frames", "frames") as advance:
            odd = odd_frames(dataset, most_depths=depths, progress=advance, known=read)
        print_odd_frames(odd, depths)
    return record["frames_usable"]


def run_context(command: ContextCommand) -> None:
    dataset = open_dataset(found_by_name(command.dataset), **command.camera.camera(command.frame))
    frame = dataset.load(one_frame(dataset.frame_ids, command.frame, dataset.root))
    mesh = fuse_context(dataset, frame)
    export_mesh(mesh, command.out)
    record = {"frame": frame.id, "frames": mesh.frames, "vertices": len(mesh.vertices), "faces": len(mesh.faces)}
    command.write(record, say, f"{mesh.frames} frames around {frame.id}: {len(mesh.faces)} faces -> {command.out}")


def print_frame(report: FrameReport) -> None:
    """Print a line or two for a frame."""
    if not report.ok:
        say(f"{report.index:>5}  {report.id}  broken: {report.problem}", style="red")
        return
    if not report.decoded:
        size = f"  {report.width}x{report.height}" if report.width else ""
        say(
            f"{report.index:>5}  {report.id}{size}  not decoded  {'pose' if report.has_pose else 'no pose'}",
            style="dim",
        )
        return
    median = "of no known unit" if report.median_depth is None else f"median {report.median_depth:.2f} m"
    pose = "pose" if report.has_pose else "no pose"
    off = "?" if report.up is None else f"{math.degrees(math.acos(max(-1.0, min(1.0, -report.up[1])))):.0f}°"
    up = f"up {report.up_source}, {off} off image-up" if report.up_source else "up not asked"
    say(
        f"{report.index:>5}  {report.id}  {report.width}x{report.height}  {report.depth_valid:.0%} depth, {median}  "
        f"{pose}  {up}  {counted(report.annotations, 'object')}"
    )
    if report.labels:
        say("       " + ", ".join(report.labels), style="dim")


def print_odd_frames(frames: Sequence[OddFrame], depths: int = MOST_DEPTHS) -> None:
    """Print the oddest frames with their reasons, and how many were looked at."""
    found = sorted((frame for frame in frames if frame.reasons), key=lambda frame: -(frame.oddness or 0))
    say_lines((f"odd: {frame.id}  {', '.join(frame.reasons)}" for frame in found), "yellow", SHOWN_ODD, " (--json)")
    if len(frames) > depths:
        say(f"  for odd depth at most {depths:,} frames were looked at, evenly spread", style="dim")
