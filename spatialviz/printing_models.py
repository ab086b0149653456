"""What a person, or a program, reads of networks: the contracts, public files, what is here, what a file is."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.text import Text

from pipeline.answering.endurance import Endurance
from pipeline.answering.model_catalogue import Adapter, FileReport, Here, is_fetched
from pipeline.proposals.contracts import Contract
from pipeline.proposals.mismatch import BOXES, shapes
from pipeline.system.execution import ACCELERATORS
from pipeline.system.model_files import KnownModel
from spatialviz.printing import make_console


def catalogue_record(known: Sequence[Adapter], here: Here) -> dict[str, Any]:
    """As JSON."""
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


def print_catalogue(known: Sequence[Adapter], here: Here) -> None:
    """Adapters with their contracts and public files, then what this machine has."""
    console = make_console()
    for adapter in known:
        console.print(Text(adapter.option, "bold"))
        if adapter.needs:
            console.print(Text(f"  not installed: pip install 'spatialviz[{adapter.needs}]'", "yellow"))
        for contract in adapter.contracts:
            console.print(Text(f"  {contract.what}"))
            console.print(Text(f"    {_tensors(contract)}", "dim"))
        for model in adapter.known:
            for line in _model_lines(model):
                console.print(Text(f"  {line}", "cyan"))
    console.print(Text("here", "bold"))
    console.print(Text(f"  ONNX Runtime {here.version}, --provider {' or '.join(_choices(here.providers))}"))
    for name, path in here.fetched:
        console.print(Text(f"  fetched {name} -> {path}"))
    for name, path in here.networks:
        console.print(Text(f"  relation network --srm {name} -> {path}"))
    if not here.fetched and not here.networks:
        console.print(Text("  no model was fetched, and no relation network installed", "dim"))


def _tensors(contract: Contract) -> str:
    return shapes(contract.inputs) + (f" -> {shapes(contract.outputs)}" if contract.outputs else "")


def _model_lines(model: KnownModel) -> list[str]:
    """A model and its files, a line each."""
    state = " (fetched)" if is_fetched(model) else ""
    lines = [f"{model.name}, {model.licence}{state}" + (f". {model.note}" if model.note else "")]
    for file in model.files:
        where = f"{model.repo}:{file.file}" if model.repo else file.file
        size = "" if file.megabytes is None else f", {file.megabytes:g} MB"
        lines.append(f"  {where}{size}" + ("" if file.sha256 is None else f", sha256 {file.sha256[:12]}…"))
    return lines


def file_record(report: FileReport) -> dict[str, Any]:
    """As JSON."""
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


def print_file(report: FileReport) -> None:
    """What a file is, in a few lines."""
    console = make_console()
    size = "" if report.megabytes is None else f", {_size(report.megabytes)}"
    console.print(Text(f"{report.path}{size}", "bold"))
    if report.problem is not None:
        console.print(Text(f"  {report.problem}", "red"))
        return
    console.print(Text(f"  {shapes(report.inputs)} -> {shapes(report.outputs)}", "dim"))
    if report.kind is None:
        console.print(Text("  no option reads it; a detector of boxes can be described in a TOML file", "yellow"))
        return
    console.print(Text(f"  {report.kind.sentence}", "" if report.kind.options else "yellow"))
    if report.class_names:
        console.print(Text(f"  {len(report.class_names)} class names inside: {', '.join(report.class_names)}"))
    for what in report.missing:
        console.print(Text(f"  missing: {what}", "yellow"))
    for line in _commands(report):
        console.print(Text(f"    {line}", "cyan"))


def _choices(providers: Sequence[str]) -> list[str]:
    """Those of ONNX Runtime's providers that can be asked for."""
    return [*(name for name, own in ACCELERATORS.items() if own in providers), "cpu"]


def _commands(report: FileReport) -> list[str]:
    """The options that use a file, to be copied."""
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


def _size(megabytes: float) -> str:
    return f"{megabytes:.1f} MB" if megabytes >= 0.1 else f"{megabytes * 1000:.1f} kB"


def print_endurance(report: Endurance) -> None:
    """The rate and the memory of a run, in two lines."""
    console = make_console()
    console.print(
        Text(
            f"{report.detector}: {report.pictures} pictures, {report.detections} detections, "
            f"{report.frames_per_second:.1f} frames/s"
        )
    )
    if report.growth_mb is not None:
        low, high = min(report.resident_mb), max(report.resident_mb)
        console.print(
            Text(f"memory {low:.0f} to {high:.0f} MB, from the second to the last quarter {report.growth_mb:+.1f} MB")
        )
