"""The command that looks for faults of a recording, with its output for people."""

from __future__ import annotations

from pathlib import Path

from pipeline.datasets.demo import DEMO_NAME, demo_path
from pipeline.datasets.doctor.examine import Examination, apply, examine, overlay
from pipeline.language.counted import counted
from pipeline.pictures.writing import write_picture
from spatialviz.cli_ask import (
    DoctorCommand,
)
from spatialviz.options import FINE, NO
from spatialviz.printing import print_rows, progress_bars, say, say_lines

STYLES = {"fine": "green", "wrong": "bold red", "unknown": "yellow"}
WORDS = {"fine": "fine", "wrong": "WRONG", "unknown": "cannot tell"}
SHOWN = 6


def run_doctor(command: DoctorCommand) -> int:
    demo = command.dataset == DEMO_NAME and not Path(command.dataset).exists()
    with progress_bars() as tell:
        found = examine(demo_path() if demo else command.dataset, tell, **command.camera.camera())
    if command.overlay is not None:
        write_picture(overlay(found), command.overlay)
    written = apply(found) if command.apply else None
    record = {**found.record(), "written": None if written is None else str(written)}
    command.write(record, print_examination, found, written)
    return NO if found.wrong and written is None else FINE


def print_examination(found: Examination, written: Path | None) -> None:
    """Print the opinions with their evidence, the mending settings, and other attempts."""
    overlapping = counted(found.pairs, "pair") + " of them overlap"
    say((f"{counted(len(found.frames), 'frame')} looked at, {overlapping}", "dim"))
    say_lines((f"note: {note}" for note in found.notes), "yellow")
    for opinion in found.opinions:
        say((f"{opinion.about:<16}", ""), (f"{WORDS[opinion.state]:<12}", STYLES[opinion.state]), opinion.text)
        if opinion.option is not None:
            say(" " * 28, (opinion.option, "bold"))
    if found.hypotheses:
        rows = [(f"{one.score:.3f}", "" if one.as_good else "surely worse", one.words) for one in found.hypotheses]
        print_rows((">lands", "", "tried"), rows[:SHOWN])
    if written is not None:
        say(f"wrote {', '.join(found.mends)} to {written}")
    elif found.mends:
        say("--apply keeps this in spatialviz.toml beside the data", style="dim")
