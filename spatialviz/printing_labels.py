"""What a person reads of labels on the terminal."""

from __future__ import annotations

from typing import Any

from rich.table import Table
from rich.text import Text

from pipeline.counted import counted
from pipeline.labels.job import LabelReport
from pipeline.labels.schema import Manifest
from spatialviz.printing import make_console


def label_record(report: LabelReport) -> dict[str, Any]:
    """`label --json`."""
    manifest = report.manifest
    return {
        "frames": report.frames,
        "reused": report.reused,
        "broken": report.broken,
        "frames_up_assumed": None if manifest is None else manifest.counts["frames_up_assumed"],
        "objects": report.objects,
        "pairs": report.pairs,
        "candidates": report.candidates,
        "seconds": round(report.seconds, 3),
        "expressions": None if manifest is None else manifest.counts["expressions"],
        "hashes": None if manifest is None else {n: t.content_hash for n, t in manifest.tables.items()},
    }


def print_labelled(report: LabelReport, out: str) -> None:
    """Counts, speed, and what to do next."""
    console = make_console()
    new = report.frames - report.reused
    rate = f", {new / report.seconds:.1f} frames/s" if new and report.seconds else ""
    reused = f" ({report.reused} were there already)" if report.reused else ""
    console.print(
        f"{counted(report.frames, 'frame')}{reused}: {counted(report.objects, 'object')}, "
        f"{counted(report.pairs, 'pair')}, "
        f"{report.candidates} candidate expressions in {report.seconds:.1f} s{rate}"
    )
    if report.broken:
        console.print(Text(f"{counted(report.broken, 'frame')} could not be used; the manifest says why", "yellow"))
    if report.manifest is None:
        console.print(Text(f"-> {out}; when all shards are there: spatialviz merge {out}"))
    else:
        print_manifest(report.manifest, out)


def print_manifest(manifest: Manifest, out: str) -> None:
    """What was merged, and its hashes."""
    console = make_console()
    console.print(
        f"{manifest.counts['expressions']} of {manifest.counts['candidates']} candidate expressions kept, "
        f"rules {manifest.profile['name']} {manifest.profile_hash[:12]}, settings {manifest.config_hash[:12]}"
    )
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("table", "rows", "hash of its rows"):
        table.add_column(column, justify="right" if column == "rows" else "left")
    for name, entry in manifest.tables.items():
        table.add_row(name, str(entry.rows), entry.content_hash[:16])
    console.print(table)
    for warning in manifest.warnings[:5]:
        console.print(Text(warning, "yellow"))
    if len(manifest.warnings) > 5:
        console.print(Text(f"and {len(manifest.warnings) - 5} more, in the manifest", "yellow"))
    console.print(Text(f"-> {out}", "dim"))


def print_label_bench(record: dict[str, Any]) -> None:
    """Lifting beside the recipe, relations, and the whole job."""
    console = make_console()
    lifting = record["lifting"]
    console.print(
        f"{counted(record['views'], 'rendered view')}, {counted(record['objects'], 'object')}, "
        f"{record['width']}x{record['height']}; "
        "processor time of one thread"
    )
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("lifting and relations", "ms/frame", "face error cm", "95 % of faces below cm"):
        table.add_column(column, justify="left" if column.startswith("lifting") else "right")
    for name in ("ours", "open3d recipe"):
        entry = lifting[name]
        if "skipped" in entry:
            table.add_row(name, "-", "-", "-")
        else:
            figures = (entry["ms_per_frame"], entry["face_error_cm"], entry["face_error_p95_cm"])
            table.add_row(name, *(f"{x:.2f}" for x in figures))
    console.print(table)
    if "ratio" in lifting:
        console.print(f"ours is {lifting['ratio']:.1f} times as fast as {lifting['recipe']}")
    else:
        console.print(Text(lifting["open3d recipe"]["skipped"], "yellow"))
    for name, rate in record["relations"]["pairs_per_s"].items():
        console.print(f"  {name:<34} {rate:>10,} pairs/s")
    job = record["job"]
    console.print(
        f"whole job: {job['frames']} frames with {job['objects_per_frame']} objects each in {job['seconds']} s "
        f"({job['workers']} workers, {job['frames_per_s']} frames/s), {job['candidates_per_frame']} candidate "
        f"expressions a frame; 1,500 such frames: {job['seconds_for_1500_frames']} s and the start"
    )
