"""Commands labelling and merging labels, with their output for people."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from pipeline.geometry.cleaning import LiftConfig
from pipeline.labels.by_hand import begun_labels, with_frames
from pipeline.labels.job import LabelReport, label_dataset
from pipeline.labels.merge import merge_labels
from pipeline.labels.plan import CAMERA, SENTENCE_KINDS, LabelConfig
from pipeline.labels.reading import SENTENCES_FILE
from pipeline.labels.schema import Manifest
from pipeline.labels.selection import SelectConfig
from pipeline.language.counted import counted
from spatialviz.cli_labels import LabelCommand, MergeCommand, Selection
from spatialviz.options import FINE, NO, task_of, warn
from spatialviz.printing import print_rows, rate_bar, say, say_lines


def run_label(command: LabelCommand) -> int:
    config = LabelConfig(
        profile=command.profile,
        vocabulary=command.vocabulary,
        lift=LiftConfig(box=command.box, boxes=command.boxes),
        style=command.style,
        seed=command.seed,
        second_opinion=command.second_opinion,
        sentences=SENTENCE_KINDS if command.sentences == () else command.sentences or (),
        sentences_a_kind=command.sentences_a_kind,
        map=str(Path(command.map).expanduser().absolute()) if command.map else "",
    )
    if command.empty:
        return _begin(command, config)
    part, spec, selection = task_of(command.shard), command.source.spec(command.dataset), _selection(command.selection)
    try:
        with rate_bar("labelling", "frames") as advance:
            report = label_dataset(
                spec,
                command.out,
                config,
                selection,
                engine=command.engine,
                workers=command.workers,
                part=part,
                resume=command.resume,
                limit=command.limit,
                frames_of=command.frames_of,
                gpus_a_detector=command.gpus_a_detector,
                progress=advance,
            )
    except KeyboardInterrupt:
        more = "run the same command again" + ("" if part else " with --resume")
        warn(f"finished shards are kept in {command.out}; to go on, {more}")
        raise
    manifest = report.manifest
    record = {
        "frames": report.frames,
        "reused": report.reused,
        "broken": report.broken,
        "frames_up_assumed": None if manifest is None else manifest.counts["frames_up_assumed"],
        "objects": report.objects,
        "pairs": report.pairs,
        "candidates": report.candidates,
        "seconds": round(report.seconds, 3),
        "expressions": None if manifest is None else manifest.counts["expressions"],
        "sentences": None if manifest is None else manifest.sentences,
        "hashes": None if manifest is None else {n: t.content_hash for n, t in manifest.tables.items()},
    }
    command.write(record, print_labelled, report, command.out)
    # A task of more than there are shards has nothing to do, and that is fine.
    return FINE if report.frames > report.broken or not report.frames else NO


def _begin(command: LabelCommand, config: LabelConfig) -> int:
    """Labels to be filled by hand."""
    spec = command.source.spec(command.dataset).absolute()
    camera = {name: spec.options.get(name) for name in CAMERA}
    dataset = spec.open(config).dataset
    new = begun_labels(dataset, command.out, camera, replace(config, vocabulary="all"))
    labels = with_frames(new, dataset, dataset.frame_ids[: command.limit] if command.limit else ())
    frames = labels.frames.num_rows
    command.write({"frames": frames}, lambda _: say(f"-> {command.out}: labels by hand, {counted(frames, 'frame')}"))
    return FINE


def run_merge(command: MergeCommand) -> None:
    manifest = merge_labels(command.labels, _selection(command.selection), command.to)
    command.write(json.loads(manifest.model_dump_json()), print_manifest, manifest, str(command.to or command.labels))


def _selection(options: Selection) -> SelectConfig:
    telling = not options.keep_vague
    return SelectConfig(
        options.expressions, options.per_frame, options.balance or None, options.selection_seed, telling
    )


def print_labelled(report: LabelReport, out: str) -> None:
    """Print counts, speed, and the next step."""
    new = report.frames - report.reused
    rate = f", {new / report.seconds:.1f} frames/s" if new and report.seconds else ""
    reused = f" ({report.reused} were there already)" if report.reused else ""
    say(
        f"{counted(report.frames, 'frame')}{reused}: {counted(report.objects, 'object')}, "
        f"{counted(report.pairs, 'pair')}, "
        f"{report.candidates} candidate expressions in {report.seconds:.1f} s{rate}"
    )
    if report.broken:
        say(f"{counted(report.broken, 'frame')} could not be used; the manifest says why", style="yellow")
    if report.manifest is None:
        say(f"-> {out}; when all shards are there: spatialviz label --merge {out}")
    else:
        print_manifest(report.manifest, out)


def print_manifest(manifest: Manifest, out: str) -> None:
    """Print counts and hashes of merged labels."""
    say(
        f"{manifest.counts['expressions']} of {manifest.counts['candidates']} candidate expressions kept, "
        f"rules {manifest.profile['name']} {manifest.profile_hash[:12]}, settings {manifest.config_hash[:12]}"
    )
    if made := manifest.sentences:
        kinds = ", ".join(f"{count} {kind}" for kind, count in made.items())
        say(f"{counted(sum(made.values()), 'sentence')} in {SENTENCES_FILE}: {kinds}")
    rows = ((name, str(entry.rows), entry.content_hash[:16]) for name, entry in manifest.tables.items())
    print_rows(("table", ">rows", "hash of its rows"), rows)
    say_lines(manifest.warnings, "yellow", 5, ", in the manifest")
    say(f"-> {out}", style="dim")
