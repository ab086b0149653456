"""Questions to a whole scene, with their output for people."""

from __future__ import annotations

from typing import Any

from pipeline.answering.ask import Trace
from pipeline.datasets.base import resolve_frame, scene_of
from pipeline.diagnosis.asking import judged
from pipeline.language.counted import counted
from pipeline.scenes.map_files import check_map, map_path, read_map
from pipeline.scenes.object_map import Presence, map_scene
from pipeline.scenes.views import posed_frames
from pipeline.scenes.world_frame import WorldFrame, ask_world, asked_from, from_frame, imagined, presence_from
from pipeline.system.errors import require
from spatialviz.cli_ask import WorldCommand
from spatialviz.options import ALL_FRAMES, FINE, NO, warn
from spatialviz.printing import say, say_lines
from spatialviz.run_ask import print_answer

FROM_HERE: dict[Presence, str] = {
    "seen": "visible from here",
    "missed": "visible from here, and not found in this frame",
    "hidden": "not visible from here: hidden",
    "out": "not visible from here: outside the picture",
    "gone": "not there in this frame: it was moved",
}


def run_world(command: WorldCommand) -> int:
    require(command.expressions, "an expression is missing", expected='for example "mug left of the laptop"')
    both = (command.standing_at is None) == (command.facing is None)
    require(both, "an imagined viewpoint stands at one object and faces another", expected="--standing-at X --facing Y")
    require(command.frame != ALL_FRAMES, "--world takes one frame: it says which scene, and from where")
    pipeline = command.source.open(command.dataset, command.frame)
    frame_id = resolve_frame(pipeline.dataset, command.frame)
    scene = scene_of(pipeline.dataset, frame_id)
    if command.map is None:
        made = map_scene(pipeline, scene, posed_frames(pipeline.dataset, frame_id))
    else:
        path = map_path(command.map, scene)
        require(path.is_file(), f"there is no map of the scene {scene}", expected="spatialviz map DATASET", path=path)
        made = read_map(path)
        require(check_map(made, pipeline.dataset, path), "the map is of another dataset's frames", path=path)
    if command.standing_at is None or command.facing is None:
        given = from_frame(pipeline, made, frame_id)
    else:
        given = imagined(pipeline, made, command.standing_at, command.facing)
    answered = 0
    for said in command.expressions:
        text, spoken = asked_from(pipeline, made, said)
        world = spoken or given
        trace = ask_world(pipeline, world, text)
        answer = judged(trace, pipeline, world, None)
        answered += answer.holds is True
        told = seen_from(world, trace)
        if not command.json:
            warn(*world.notes)
        command.write(answer.record() | {"world": told}, print_answer, answer, trace)
        if not command.json:
            say_lines(
                [f"{counted(len(made.objects), 'object')} in {counted(len(made.frame_ids), 'frame')} of {made.scene}"]
            )
            for role, own in told["objects"].items():
                frames = f"; seen in {', '.join(own['frames'])}" if own["presence"] != "seen" else ""
                say(f"{role} {own['name']}: {FROM_HERE[own['presence']]}{frames}", style="dim")
    return FINE if answered else NO


def seen_from(world: WorldFrame, trace: Trace) -> dict[str, Any]:
    """JSON record of the viewpoint, and of where target and reference of the best pair are seen."""
    found: dict[str, Any] = {}
    best = None if trace.ranking is None else trace.ranking.pairs[0]
    roles = {} if best is None else {"target": best.target, "reference": best.reference}
    for role, index in roles.items():
        if index is not None:
            own = next(o for o in world.made.objects if o.id == trace.objects[index].id)
            presence = presence_from(world, own.id)
            found[role] = {"id": own.id, "name": trace.name(index), "presence": presence, "frames": sorted(own.numbers)}
    return {"scene": world.made.scene, "viewpoint": world.frame.id, "notes": list(world.notes), "objects": found}
