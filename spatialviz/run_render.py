"""The command that renders rooms."""

from __future__ import annotations

from pipeline.synthetic import render_dataset
from spatialviz.cli_ask import (
    RenderCommand,
)
from spatialviz.printing import rate_bar, say


def run_render(command: RenderCommand) -> None:
    with rate_bar("rendering", "views") as advance:
        report = render_dataset(
            command.out,
            rooms=command.rooms,
            views=command.views,
            seed=command.seed,
            width=command.width,
            height=command.height,
            progress=advance,
            workers=command.workers,
        )
    say(
        f"{report.frames} frames of {report.rooms} rooms with {report.objects} objects "
        f"of {len(report.classes)} classes in {report.seconds:.1f} s -> {command.out}"
    )
