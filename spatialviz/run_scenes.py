"""Commands on scenes, with their output for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.datasets.base import scene_of, scenes_of
from pipeline.language.counted import counted
from pipeline.scenes.joining import LEAST_SEEN
from pipeline.scenes.map_files import map_path, read_map, save_map
from pipeline.scenes.move_check import RobotMove, robot_moves
from pipeline.scenes.object_map import ObjectMap, map_record, map_scene
from pipeline.scenes.views import posed_frames
from pipeline.system.errors import FrameUnusable
from spatialviz.cli_labels import MapCommand
from spatialviz.options import ALL_FRAMES, FINE, NO, one_frame, warn
from spatialviz.printing import figure, print_rows, progress_bars, say, say_lines

PAIRS = 12
"""So many pairs of frames are printed, those that agree least; --json has all."""


def run_map(command: MapCommand) -> int:
    frame = command.frame
    source = open_pipeline(command.dataset, srm="rule", **command.source.arguments(frame))
    whole = True
    for made in _maps(command, source):
        whole = whole and len(made.left_out) == 0
        driven = robot_moves(source.dataset, made.frame_ids)
        record = map_record(made) | ({"moves": [m.record() for m in driven]} if driven else {})
        command.write(record, lambda made, driven=driven: print_map(made, driven), made)
    return FINE if whole else NO


def _maps(command: MapCommand, source: Pipeline) -> Iterator[ObjectMap]:
    """Make and save the map of each asked scene; FrameUnusable where none has poses."""
    dataset = source.dataset
    if command.frame == ALL_FRAMES:
        frames = list(dict(zip(reversed(scenes_of(dataset)), reversed(dataset.frame_ids), strict=True)).values())[::-1]
    else:
        frames = [one_frame(dataset.frame_ids, command.frame, dataset.root)]
    unposed: list[FrameUnusable] = []
    for frame_id in frames:
        try:
            ids = posed_frames(dataset, frame_id)
        except FrameUnusable as error:
            unposed.append(error)
            continue
        scene = scene_of(dataset, frame_id)
        path = map_path(command.out, scene)
        known = read_map(path) if path.exists() else None
        with progress_bars() as tell:
            made = map_scene(source, scene, ids, known, command.refine, tell)
        if known is not None and (known.settings != made.settings or known.listed != ids[: len(known.listed)]):
            warn(
                f"scene {scene}: the map was made anew: the detector, its settings, the poses or the frames are others"
            )
        save_map(made, command.out)
        yield made
    if len(unposed) == len(frames):
        raise unposed[0]
    warn(*(f"left out: {error}" for error in unposed))


def print_map(made: ObjectMap, driven: Sequence[RobotMove] = ()) -> None:
    """Print a scene's objects, residuals of its poses by pair, refinements, frames left out, and wrong moves."""
    states = Counter(o.state for o in made.objects)
    told = "".join(f", {states[state]} {state}" for state in ("moved", "doubtful") if states[state])
    frames = f"  {counted(len(made.frame_ids), 'frame')}, {counted(len(made.objects), 'object')}{told}"
    say(("scene ", "dim"), made.scene, (frames, "dim"))
    rows = []
    for o in made.objects:
        count = Counter(o.presence.values())
        others = ", ".join(name for name in o.votes if name != o.label)
        state = o.state if o.other_place is None else f"{o.state}, also {o.other_place}"
        places = [str(count[p]) if count[p] else "" for p in ("seen", "hidden", "out", "missed", "gone")]
        box = made.boxes.get(o.id)
        size = "" if box is None else " × ".join(f"{edge:.2f}" for edge in box.box.size)
        rows.append(
            (
                str(o.id),
                o.label,
                size,
                "" if box is None else box.by,
                *places,
                "" if state == "static" else state,
                others,
            )
        )
    counts = (">seen", ">hidden", ">out", ">missed", ">gone")
    print_rows((">id", "object", "whole box, m", "by", *counts, "state", "also called"), rows)
    doubtful = (
        f"doubtful: {j.label} {j.number} of {j.frame_id} is {j.object_id}: "
        + (
            f"only {j.known:.0%} of its pixels show places that were seen before"
            if j.known < LEAST_SEEN
            else f"IoU {j.iou:.2f}, and {j.second:.2f} with the next best"
        )
        for j in made.joins
        if j.doubtful
    )
    say_lines(doubtful, "yellow", PAIRS)
    pairs = sorted((p for p in made.agreements if p.agree is not None), key=lambda p: p.agree or 0.0)
    if pairs:
        say(("poses: agreement of surfaces that two frames share, and their distance", "dim"))
        cells = [(p.one, p.other, figure(p.agree, ".2f"), f"{100 * p.residual_m:.1f} cm") for p in pairs[:PAIRS]]
        print_rows(("frame", "with", ">agree", ">apart"), cells)
    for r in made.refinements:
        told = "used" if r.used else "not used" + ("; --refine uses it" if r.better else ": no better, or too far")
        moves = f"refined, it moves {100 * r.moved_m:.1f} cm and turns {r.turned_deg:.1f} degrees"
        say(f"frame {r.frame_id}: {moves}, agreement {r.agree_before:.2f} -> {r.agree:.2f}; {told}")
    say_lines((f"left out {i}: {reason}" for i, reason in made.left_out.items()), "yellow")
    wrong = [m for m in driven if not m.agrees]
    if driven:
        say(f"{len(driven) - len(wrong)} of {counted(len(driven), 'move')} of the robot agree with the poses")
    say_lines(
        (
            f"{m.move} from {m.frame} to {m.other}: the poses turn {m.turned_deg:.0f} degrees to the right, and move "
            f"{m.moved_m[0]:.2f} m to the right, {m.moved_m[1]:.2f} m forward"
            for m in wrong
        ),
        "yellow",
        PAIRS,
    )
