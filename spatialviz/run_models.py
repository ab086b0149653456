"""Commands running and calibrating detectors; and the catalogue of networks."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.answering.detector_runs import RecordingReport, annotated_names, calibrate_scores, record_detections
from pipeline.answering.model_catalogue import (
    Adapter,
    FileReport,
    Inventory,
    adapters,
    describe_file,
    is_fetched,
    take_inventory,
)
from pipeline.language.counted import listed
from pipeline.proposals.mismatch import BOXES, shapes
from pipeline.proposals.score_calibration import ScoreCalibration, save_calibration
from pipeline.system.execution import ACCELERATORS
from pipeline.system.model_files import KnownModel
from spatialviz.cli_models import CalibrateCommand, DetectCommand, ModelsCommand
from spatialviz.options import FINE, NO, warn_skipped
from spatialviz.printing import print_rows, rate_bar, say, say_lines


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
    say_lines([listed(report.classes)])
    if report.unknown:
        say("not known to the detector: " + ", ".join(report.unknown))
    if not report.detections and not command.classes:
        say(f"asked for the dataset's classes: {', '.join(names)}; others: --classes NAME ...")


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
        say_lines((f"  {line}" for model in adapter.known for line in _model_lines(model)), "cyan")
    say("here", style="bold")
    providers = [*(name for name, own in ACCELERATORS.items() if own in here.providers), "cpu"]
    say(f"  ONNX Runtime {here.version}, --provider {' or '.join(providers)}")
    say_lines(f"  fetched {name} -> {path}" for name, path in here.fetched)
    say_lines(f"  relation network --srm {name} -> {path}" for name, path in here.networks)
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
        say_lines((f"  missing: {what}" for what in report.missing), "yellow")
        say_lines((f"    {line}" for line in _commands(report)), "cyan")


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
