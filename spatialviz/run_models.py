"""Commands running, comparing and calibrating detectors; and the catalogue of networks."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.text import Text

from pipeline.answering.agreement import FrameAgreement, agree_frames, agreement_record, figures
from pipeline.answering.calibrating import annotated_names, calibrate_scores
from pipeline.answering.model_catalogue import (
    Adapter,
    FileReport,
    Inventory,
    adapters,
    describe_file,
    is_fetched,
    take_inventory,
)
from pipeline.answering.pipeline import open_pipeline
from pipeline.answering.recording import RecordingReport, record_detections
from pipeline.proposals.mismatch import BOXES, shapes
from pipeline.proposals.score_calibration import ScoreCalibration, save_calibration
from pipeline.system.detector_setup import named_model
from pipeline.system.errors import InputError, require
from pipeline.system.model_files import KnownModel
from pipeline.system.onnx_session import ACCELERATORS
from spatialviz.cli_models import AgreeCommand, CalibrateCommand, DetectCommand, ModelsCommand
from spatialviz.options import ALL_FRAMES, FINE, NO, warn_skipped
from spatialviz.printing import figure, print_rows, rate_bar, say

SHOWN_NAMES = 8


def run_detect(command: DetectCommand) -> None:
    source, frame_ids = command.source.open(command.dataset)
    names = command.classes or source.dataset.class_names or None
    with rate_bar("detecting", "frames") as advance:
        report = record_detections(source, command.out, names, advance, frame_ids=frame_ids)
    for frame_id, reason in report.skipped.items():
        warn_skipped(frame_id, reason)
    record = {
        "frames": report.frames,
        "detections": report.detections,
        "skipped": report.skipped,
        "unknown": list(report.unknown),
        "seconds": round(report.seconds, 3),
        "classes": report.classes,
    }
    command.write(record, print_recorded, report, command, names or ())


def print_recorded(report: RecordingReport, command: DetectCommand, names: Sequence[str]) -> None:
    """Print the detections by class, and the asked names without any."""
    say(f"{report.detections} detections in {report.frames} frames, {report.seconds:.1f} s -> {command.out}")
    if report.classes:
        say(", ".join(f"{name} {count}" for name, count in report.classes.items()))
    if report.unknown:
        say("not known to the detector: " + ", ".join(report.unknown))
    if not report.detections and not command.classes:
        say(f"asked for the dataset's classes: {', '.join(names)}; others: --classes NAME ...")


def run_agree(command: AgreeCommand) -> int:
    require(
        not (command.frame != ALL_FRAMES and command.source.frames != ALL_FRAMES),
        "frames are named twice",
        got=f"{command.frame} and --frames {command.source.frames}",
    )
    if command.also is None:
        raise InputError("there is nothing to compare the detector with", expected="--also NAME or --also NAME=MODEL")
    source, _ = command.source.open(command.dataset)
    frames = command.source.frames if command.frame == ALL_FRAMES else command.frame
    kind, model = named_model(command.also)
    shared = ("min_score", "segmenter", "segmenter_model", "synonyms")
    options = {name: getattr(command.source, name) for name in shared}
    second = open_pipeline(source.dataset, detector=kind, model=model, srm="rule", **options).needed_detector()
    names = [source.needed_detector().name, second.name]
    models = [command.source.model, model]
    if names[0] == names[1] and models[0] != models[1]:
        # Two models of one kind go by their files.
        names = [path.stem if path else name for path, name in zip(models, names, strict=True)]
    found = []
    with rate_bar("comparing", "frames") as advance:
        for frame_id, one in agree_frames(
            source,
            second,
            frames,
            names=command.classes or None,
            min_iou=command.iou,
            skipped=warn_skipped,
            progress=advance,
        ):
            found.append(one)
            if command.json or command.frame != ALL_FRAMES:
                record = agreement_record(frame_id, one, source.synonyms)
                command.write(record, print_frame_agreement, frame_id, one)
    sums = figures(found, source.synonyms)
    command.write({"detectors": names, **sums}, print_agreement, sums, names)
    return FINE if sums["a"] + sums["b"] else NO


def run_calibrate(command: CalibrateCommand) -> int:
    source, frame_ids = command.source.open(command.dataset)
    everything = source.dataset.class_names
    with rate_bar("detecting", "frames") as advance:
        calibration, report = calibrate_scores(
            source,
            frame_ids,
            annotated_names if command.names == "frame" else lambda frame: everything,
            progress=advance,
            skipped=warn_skipped,
        )
    save_calibration(calibration, command.out, report)
    command.write(
        {"a": calibration.a, "b": calibration.b, "detector": calibration.detector, **report},
        print_calibration,
        calibration,
        report,
        command.out,
    )
    return FINE if report["fitted"] else NO


def run_models(command: ModelsCommand) -> int:
    if not command.files:
        known, here = adapters(), take_inventory()
        command.write(catalogue_record(known, here), print_catalogue, known, here)
        return FINE
    reports = [describe_file(path) for path in command.files]
    command.write({"files": [file_record(r) for r in reports]}, print_files, reports)
    return FINE if all(r.kind is not None and r.kind.options for r in reports) else NO


def print_frame_agreement(frame_id: str, found: FrameAgreement) -> None:
    """Print the disagreements of two detectors in a frame, row by row."""
    say(("frame ", "dim"), frame_id, (f"  {int(found.same.sum())} things alike", ""))
    pairs = ((p, *found.pairs[p].tolist()) for p in found.named_otherwise.tolist())
    a = [(Text(name), f"{score:.2f}") for name, score in zip(found.labels_a, found.scores_a, strict=True)]
    b = [(Text(name), f"{score:.2f}") for name, score in zip(found.labels_b, found.scores_b, strict=True)]
    rows = [
        *(("named otherwise", *a[i], *b[j], f"{found.iou[p]:.2f}") for p, i, j in pairs),
        *(("only A", *a[i], "", "", f"{found.nearest_a[i]:.2f}") for i in found.only_a.tolist()),
        *(("only B", "", "", *b[j], f"{found.nearest_b[j]:.2f}") for j in found.only_b.tolist()),
    ]
    if rows:
        print_rows(("", "A", ">score", "B", ">score", ">IoU"), rows)
        say("IoU of what one found alone: with the nearest of the other's", style="dim")


def print_agreement(sums: dict[str, Any], detectors: Sequence[str]) -> None:
    """Print the figures of all frames, and the table of classes."""
    a, b = detectors
    say(("A ", "dim"), a, ("   B ", "dim"), b, (f"   {sums['frames']} frames", "dim"))
    say("{both} things alike, {otherwise} named otherwise, {only_a} only A, {only_b} only B".format(**sums))
    if sums["beyond_a"] or sums["beyond_b"]:
        beyond = "of classes that the other does not know: {beyond_a} of A, {beyond_b} of B (not counted)"
        say(beyond.format(**sums), style="dim")
    share, placed, kappa, iou, correlation = (
        shown(sums[name]) for name in ("share", "share_placed", "name_kappa", "mean_iou", "score_correlation")
    )
    say(
        f"agreement {share}, whatever the name {placed}; kappa of names {kappa}; mean IoU {iou}; "
        f"score correlation {correlation}"
    )
    if not sums["classes"]:
        return
    counts = ("A", "B", "alike", "otherwise", "only A", "only B", "agreement", "mean IoU")
    print_rows(
        ("class", *(f">{name}" for name in counts)),
        (
            (
                row["name"],
                *map(str, (row["a"], row["b"], row["both"], row["otherwise"], row["only_a"], row["only_b"])),
                shown(row["share"]),
                shown(row["mean_iou"]),
            )
            for row in sums["classes"]
        ),
    )
    if sums["renamed"]:
        names = ", ".join(f"{a}/{b} {n}" for a, b, n in sums["renamed"][:SHOWN_NAMES])
        more = len(sums["renamed"]) - SHOWN_NAMES
        say(f"named otherwise, A/B: {names}" + (f" and {more} more" if more > 0 else ""))
        say("names that mean the same can be declared in a file: --synonyms", style="dim")


def shown(value: float | None) -> str:
    """Number with two decimals; a dash for none."""
    return figure(value, ".2f", "–")


def print_calibration(calibration: ScoreCalibration, report: dict[str, Any], out: Path) -> None:
    """Print the sigmoid, and the calibration figures before and after."""
    say(
        f"{report['detections']} detections in {report['frames']} frames, {report['hits']} of them hits: "
        f"a = {calibration.a:.3f}, b = {calibration.b:+.3f}"
    )
    if not report["fitted"]:
        reason = f"scores stay as they are: a fit needs at least {report['fewest']} hits and as many misses"
        say(reason + ", and must rise with the score", style="yellow")
    times = ("before", "after")
    print_rows(
        ("", ">Brier", ">ECE", ">log loss"),
        ((name, *(f"{report[name][k]:.4f}" for k in ("brier", "ece", "log_loss"))) for name in times),
    )
    bins = [
        {
            round(row["low"], 2): (str(row["count"]), f"{row['score']:.3f}", f"{row['hits']:.3f}")
            for row in report[name]["reliability"]
        }
        for name in times
    ]
    print_rows(
        (">score", ">before: n", ">mean score", ">hits", ">after: n", ">mean score", ">hits"),
        (
            (f"{low:.1f}-{low + 0.1:.1f}", *(cell for side in bins for cell in side.get(low, ("", "", ""))))
            for low in sorted({low for side in bins for low in side})
        ),
    )
    say("after: each half of the frames under the fit of the other half", style="dim")
    say(f"-> {out}")


def catalogue_record(known: Sequence[Adapter], here: Inventory) -> dict[str, Any]:
    """JSON record of the catalogue."""
    return {
        "adapters": [
            {
                "option": a.option,
                "needs": a.needs,
                "contracts": [asdict(c) for c in a.contracts],
                "models": [{**asdict(m), "fetched": is_fetched(m)} for m in a.known],
            }
            for a in known
        ],
        "onnxruntime": here.version,
        "providers": list(here.providers),
        "fetched": [{"id": name, "path": str(path)} for name, path in here.fetched],
        "relation_networks": [{"name": name, "path": str(path)} for name, path in here.networks],
    }


def print_catalogue(known: Sequence[Adapter], here: Inventory) -> None:
    """Print adapters with their contracts and public files, then the inventory of this machine."""
    for adapter in known:
        say(adapter.option, style="bold")
        if adapter.needs:
            say(f"  not installed: pip install 'spatialviz[{adapter.needs}]'", style="yellow")
        for contract in adapter.contracts:
            say(f"  {contract.what}")
            outputs = f" -> {shapes(contract.outputs)}" if contract.outputs else ""
            say(f"    {shapes(contract.inputs)}{outputs}", style="dim")
        for model in adapter.known:
            for line in _model_lines(model):
                say(f"  {line}", style="cyan")
    say("here", style="bold")
    providers = [*(name for name, own in ACCELERATORS.items() if own in here.providers), "cpu"]
    say(f"  ONNX Runtime {here.version}, --provider {' or '.join(providers)}")
    for name, path in here.fetched:
        say(f"  fetched {name} -> {path}")
    for name, path in here.networks:
        say(f"  relation network --srm {name} -> {path}")
    if not here.fetched and not here.networks:
        say("  no model was fetched, and no relation network installed", style="dim")


def _model_lines(model: KnownModel) -> list[str]:
    """Lines of a model and the model's files."""
    state = " (fetched)" if is_fetched(model) else ""
    lines = [f"{model.name}, {model.licence}{state}" + (f". {model.note}" if model.note else "")]
    for file in model.files:
        where = f"{model.repo}:{file.file}" if model.repo else file.file
        size = "" if file.megabytes is None else f", {file.megabytes:g} MB"
        lines.append(f"  {where}{size}" + ("" if file.sha256 is None else f", sha256 {file.sha256[:12]}…"))
    return lines


def file_record(report: FileReport) -> dict[str, Any]:
    """JSON record of a file."""
    return {
        "path": str(report.path),
        "megabytes": report.megabytes,
        "inputs": [asdict(s) for s in report.inputs],
        "outputs": [asdict(s) for s in report.outputs],
        "what": None if report.kind is None else report.kind.what,
        "options": [] if report.kind is None else list(report.kind.options),
        "advice": None if report.kind is None else report.kind.advice or None,
        "missing": list(report.missing),
        "class_names": len(report.class_names),
        "names": list(report.class_names),
        "problem": report.problem,
    }


def print_files(reports: Sequence[FileReport]) -> None:
    """Print the identification of each file in a few lines."""
    for report in reports:
        megabytes = report.megabytes or 0.0
        size = f", {megabytes:.1f} MB" if megabytes >= 0.1 else f", {megabytes * 1000:.1f} kB"
        say(f"{report.path}{'' if report.megabytes is None else size}", style="bold")
        if report.problem is not None:
            say(f"  {report.problem}", style="red")
            continue
        say(f"  {shapes(report.inputs)} -> {shapes(report.outputs)}", style="dim")
        if report.kind is None:
            say("  no option reads it; a detector of boxes can be described in a TOML file", style="yellow")
            continue
        say(f"  {report.kind.sentence}", style="" if report.kind.options else "yellow")
        if report.class_names:
            say(f"  {len(report.class_names)} class names inside: {', '.join(report.class_names)}")
        for what in report.missing:
            say(f"  missing: {what}", style="yellow")
        for line in _commands(report):
            say(f"    {line}", style="cyan")


def _commands(report: FileReport) -> list[str]:
    """Options using a file, ready to copy."""
    assert report.kind is not None
    path, lines = shlex.quote(str(report.path)), []
    for option in report.kind.options:
        face, _, name = option.partition(" ")
        if face == "--detector":
            more = " --model-config FILE.toml" if option == BOXES and report.missing else ""
            lines.append(f"{option} --model {path}{more}")
        elif face == "--segmenter":
            pair = f"{path} DECODER.onnx" if "encoder" in report.kind.what else f"ENCODER.onnx {path}"
            lines.append(f"{option} --segmenter-model {path if name == 'yolo-seg' else pair}")
        else:
            lines.append(f"{face} {path}")
    return lines
