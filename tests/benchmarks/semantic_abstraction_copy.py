"""Writes a dataset in Semantic Abstraction's layout from rendered rooms: views, expressions by exact geometry, splits.

`cd tests && python -m benchmarks.semantic_abstraction_copy FOLDER --train 50 --test 16`. The expressions follow the
published rule on whole surfaces, and what stands in or on what is known from how the room was put together: another
maker than the rules of this program, which see one view's cleaned points. Names of classes are such as text-vector
files have.
"""

from __future__ import annotations

import argparse
import json
import math
from functools import partial
from pathlib import Path

import numpy as np
from benchmarks.container_rooms import inside, with_containers, without
from semantic_abstraction_writer import FIRST_OBJECT, RenderedView, scene_clouds, write_rendered

from pipeline.datasets.semantic_abstraction import RELATIONS
from pipeline.datasets.semantic_abstraction_splits import NOVEL_CLASSES
from pipeline.geometry.camera import Camera, intrinsics
from pipeline.synthetic import Room, camera_at, exact_view, make_room, render_view

HEIGHT_M = 1.576
NAMES = {
    "tv": "television",
    "wardrobe": "dresser",
    "bookshelf": "shelf",
    "picture": "painting",
    "rug": "doormat",
    "office chair": "chair",
    "trash can": "bucket",
    "bottle": "wine bottle",
}
"""Ours to names of which television, dresser, sofa and pillow have a synonym, and wine bottle, mug and teddy bear are
novel."""
UNNAMED = ("laptop",)
"""Left out: its synonym is in no file of text vectors at hand."""
NOVEL = tuple(label for label in ("bottle", "mug", "teddy bear") if NAMES.get(label, label) in NOVEL_CLASSES)
LEAST_PIXELS = 200
COSINE, LEAST_REACH, GREATEST_REACH = 0.6, 0.1, 1.0
PROBE, TRIED = 56, 30


def level_camera(place: np.ndarray, heading: float, size: int) -> Camera:
    """The dataset's camera: level, 80 degrees across."""
    posed = camera_at(np.array([*place, HEIGHT_M]), heading, 0.0, 0.0, size, size)
    f = size / 2 / math.tan(math.radians(40))
    return Camera(intrinsics(f, f, size / 2, size / 2), size, size, posed.T_world_camera)


def choose_cameras(
    room: Room, count: int, rng: np.random.Generator, size: int, candidates: int = TRIED
) -> list[Camera]:
    """Cameras that see many things, and things inside others: each the best of some candidates."""
    held = [k for k in range(len(room.instances)) if inside(room, k)]
    found = []
    for _ in range(count):
        tried: list[tuple[float, np.ndarray, float]] = []
        for _ in range(candidates):
            focus = room.instances[held[int(rng.integers(len(held)))]].position if held else room.focuses[0].target
            heading, distance = rng.uniform(-np.pi, np.pi), rng.uniform(1.3, 2.6)
            place = focus[:2] - distance * np.array([np.cos(heading), np.sin(heading)])
            place = np.clip(place, 0.3, [room.width - 0.3, room.depth - 0.3])
            heading = math.atan2(focus[1] - place[1], focus[0] - place[0]) + rng.uniform(-0.3, 0.3)
            depth, instances = exact_view(room, level_camera(place, heading, PROBE))
            seen = np.bincount(instances[instances >= 0], minlength=len(room.instances)) >= 4
            close = 0 < depth[depth > 0].min(initial=9) < 0.45
            tried.append((-1.0 if close else float(seen.sum() + 2 * seen[held].sum()), place, heading))
        _, place, heading = max(tried, key=lambda t: t[0])
        found.append(level_camera(place, heading, size))
    return found


def describe(view: RenderedView, clouds: list[np.ndarray]) -> list[tuple[str, int, str, str]]:
    """Expressions about every pair of things that are seen: (target, its id, relation, reference).

    Directions by the published geometry on whole surfaces (scene units, x away from the camera, y to its left);
    in and on by what each thing was put into or onto. A pair that is joined, over others too, gets no direction.
    """
    words = {ours: theirs for theirs, ours in RELATIONS.items()}
    counts = np.bincount(view.instances[view.instances >= 0], minlength=len(view.names))
    seen = np.flatnonzero(counts >= LEAST_PIXELS).tolist()
    room = view.room
    below: dict[int, list[int]] = {}
    for k in seen:
        chain, base = [], room.instances[k].support
        while base >= 0:
            chain.append(base)
            base = room.instances[base].support
        below[k] = chain
    found: list[tuple[str, int, str, str]] = []
    for a in seen:
        for b in seen:
            if a == b:
                continue
            relations: list[str] = []
            if b in below[a] or a in below[b]:
                relations = [("in" if inside(room, a) else "on")] if below[a][:1] == [b] else []
            else:
                disp = clouds[b].mean(axis=0) - clouds[a].mean(axis=0)
                length, extent = float(np.linalg.norm(disp)), np.ptp(clouds[b], axis=0)[:2].max()
                if length <= min(max(2 * extent, LEAST_REACH), GREATEST_REACH):
                    x, y = disp[:2] / length
                    signs = {"behind": -x, "front": x, "right": y, "left": -y}
                    relations = [name for name, value in signs.items() if value > COSINE]
            found += [(view.names[a], a + FIRST_OBJECT, words[r], view.names[b]) for r in relations]
    return found


def write_room(
    root: Path, number: int, *, views: int, size: int, train: bool, points: int, tried: int = TRIED
) -> list[str]:
    """The views of one room; their paths in the dataset."""
    leave_out = (*UNNAMED, *(NOVEL if train else ()))
    room = with_containers(without(make_room(number), leave_out), number, leave_out)
    rng = np.random.default_rng([number, 31])
    names = tuple(NAMES.get(i.model.label, i.model.label) for i in room.instances)
    written = []
    for k, camera in enumerate(choose_cameras(room, views, rng, size, tried)):
        frame = render_view(room, camera, rng)
        view = RenderedView(room, camera, frame.rgb, frame.depth, frame.instances, names)
        tints = rng.uniform(0.3, 1.0, (len(names) + 1, 3))
        other = (frame.rgb[..., ::-1] * tints[frame.instances]).astype(np.uint8)
        path = f"{number * 100 + k:05d}|FloorPlan{number}_physics.hdf5"
        said = describe(view, scene_clouds(view, np.random.default_rng([number, k]), 600))
        write_rendered(root / path, view, rng, points, "proper", said, None if train else other)
        written.append(path)
    return written


def write_copy(
    root: Path,
    train: int,
    test: int,
    *,
    views: int = 4,
    size: int = 448,
    points: int = 60_000,
    first: int = 0,
    workers: int = 1,
    tried: int = TRIED,
) -> dict[str, list[str]]:
    """Rooms from `first` on: for training, without the novel classes, then for the test; and the split file."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "spatialviz.toml").write_text('name = "rendered rooms in the layout of Semantic Abstraction"\n')
    of_part = {"train": range(first, first + train), "test": range(first + train, first + train + test)}
    listed: dict[str, list[str]] = {}
    for part, numbers in of_part.items():
        write = partial(write_room, root, views=views, size=size, train=part == "train", points=points, tried=tried)
        listed[part] = [path for paths in _mapped(write, list(numbers), workers) for path in paths]
    table = {"train": listed["train"]}
    table |= {f"unseen_instances{end}": listed["test"] for end in ("", "_dr", "_synonyms")}
    (root / "vool_split.json").write_text(json.dumps(table))
    return table


def _mapped(write: partial[list[str]], numbers: list[int], workers: int) -> list[list[str]]:
    if workers == 1:
        return [write(number) for number in numbers]
    from multiprocessing import get_context

    with get_context("spawn").Pool(workers) as pool:
        return pool.map(write, numbers, chunksize=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    for name, number in (("train", 50), ("test", 16), ("views", 4), ("size", 448), ("first", 0), ("workers", 2)):
        parser.add_argument(f"--{name}", type=int, default=number)
    given = vars(parser.parse_args())
    folder, rooms, tested = given.pop("folder"), given.pop("train"), given.pop("test")
    print(len(write_copy(folder, rooms, tested, **given)["train"]), "training views")
