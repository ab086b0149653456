"""Commands on what holds in a frame: relations of its objects, distances of its pixels."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.answering.json_records import relation_records
from pipeline.answering.pipeline import FrameRelations, open_pipeline, relate_frames
from pipeline.datasets.settings import ASSUMED, DECLARE
from pipeline.geometry.viewer import ViewerAxes, measure
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE, VOCABULARIES
from pipeline.relations.relations import letter
from spatialviz.cli_ask import (
    MeasureCommand,
    RelationsCommand,
)
from spatialviz.options import FINE, NO, numbers, one_frame, warn_skipped
from spatialviz.printing import say, say_lines


def run_relations(command: RelationsCommand) -> int:
    relations = VOCABULARIES[command.vocabulary]
    pairs = 0
    for found in relate_frames(command.source.open(command.dataset, command.frame), command.frame, warn_skipped):
        pairs += len(found.objects) * max(len(found.objects) - 1, 0)
        command.write(relation_records(found, relations), print_relations, found, relations)
    return FINE if pairs else NO


def run_measure(command: MeasureCommand) -> None:
    pipeline = open_pipeline(command.dataset, **command.camera.camera(command.frame))
    context = pipeline.prepare(one_frame(pipeline.dataset.frame_ids, command.frame, pipeline.dataset.root))
    (u0, v0), (u1, v1) = (
        numbers(text, "U,V", int, "a pixel is two numbers") for text in (command.first, command.second)
    )
    found = measure(context.frame.depth, context.frame.camera, context.viewer, (u0, v0), (u1, v1))
    estimated = {"depth_source": context.frame.depth_source} if context.frame.depth_source else {}
    record = {"frame": context.frame.id, **found.record(), "up_source": context.viewer.up_source, **estimated}
    command.write(record, say, f"{found.distance:.3f} m  {'  '.join(found.words)}")
    if not command.json:
        warn_assumed(context.viewer, context.frame.depth_source)


def warn_assumed(viewer: ViewerAxes | None, depth_source: str) -> None:
    """Warn of unmeasured bases of all geometry: an assumed up vector, an estimated depth."""
    lines = [f"depth is {depth_source}" if depth_source else ""]
    if viewer is not None:
        lines.append(f"{ASSUMED}; {DECLARE}" if viewer.up_source == "assumed" else "")
        lines.append(f"up may be wrong: {viewer.up_doubt}" if viewer.up_doubt else "")
    say_lines(lines, "yellow")


def print_relations(found: FrameRelations, relations: Sequence[str]) -> None:
    """Print relations of a frame held (T) or undecided (U), a line for each pair."""
    up = "" if found.viewer is None else f"  up {found.viewer.up_source}"
    say(("frame ", "dim"), found.frame_id, (f"  {counted(len(found.objects), 'object')}{up}", "dim"))
    warn_assumed(found.viewer, found.depth_source)
    columns = [(PHRASE[r], found.scores.relations.index(r)) for r in relations]
    for i, a in enumerate(found.objects):
        for j, b in enumerate(found.objects):
            states = {phrase: letter(found.scores.states[i, j, n]) for phrase, n in columns} if i != j else {}
            text = ", ".join(
                f"{phrase} {found.scores.probabilities[i, j, n]:.2f}{'?' if states[phrase] == 'U' else ''}"
                for phrase, n in columns
                if states.get(phrase, "F") != "F"
            )
            if text:
                say(a.name(i, found.exact), (" — ", "dim"), text, (" — ", "dim"), b.name(j, found.exact))
