"""Figures that single documents tell: names, frames, the doctor, attributes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from pipeline.bench.clock import Figure, Setup, least, seconds, side_by_side
from pipeline.bench.worlds import crowded_frame, decode, demo_frames, pictures
from pipeline.datasets import demo_path, examine, open_dataset, survey
from pipeline.language import default_synonyms, meanings, name_table
from pipeline.relations import object_colors
from pipeline.system.whole_files import scratch_folder
from pipeline.system.worker_pool import one_thread

FRAMES, DECODED = 1000, 60


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure all in processor time."""
    files = sorted((Path(name_table.__file__).parent / "names").glob("*.json"))
    # As a user meets them: each once, with nothing remembered.
    loading = seconds(default_synonyms)
    yield "docs.names_load", loading * 1000, least(lambda: [json.loads(f.read_bytes()) for f in files], 5) * 1000
    tables = {f.stem: json.loads(f.read_bytes()) for f in files if f.stem in ("lvis", "indoor")}
    lvis, asked = tables["lvis"], tables["indoor"]["names"][:200]
    names = (*lvis["names"], *(name for group in lvis["groups"] for name in group))[:1203]
    index = seconds(lambda: meanings("mug", names))
    each = seconds(lambda: [meanings(query, names) for query in asked]) / len(asked)
    yield "docs.names_query", each * 1000, index * 1000
    with scratch_folder() as folder, one_thread():
        count = setup.times(FRAMES, FRAMES // 10)
        root = demo_frames(folder / "many", count)
        dataset, scale = open_dataset(str(root)), FRAMES / count
        listed = _surveyed(dataset, max(1, DECODED * count // FRAMES))
        yield "docs.frames", listed * scale, least(lambda: pictures(root), 1) * scale
        few = open_dataset(str(demo_frames(folder / "few", 25)))
        floor = pictures(folder / "few")
        yield "docs.decode", _surveyed(few, None) * FRAMES / 25, least(lambda: decode(floor), 1) * FRAMES / 25
        demo = pictures(Path(demo_path()))
        found = side_by_side([lambda: examine(demo_path()), lambda: decode(demo)], 1)
        yield "docs.doctor", found[0], found[1]
        dataset = open_dataset(str(crowded_frame(folder / "fifty", 50, cell=64)))
        frame, floor = dataset.load(dataset.frame_ids[0]), pictures(folder / "fifty")
        masks = [a.mask for a in frame.annotations if a.mask is not None]
        found = side_by_side([lambda: object_colors(frame.rgb, masks), lambda: decode(floor)], setup.times(9))
        yield "docs.attributes", found[0] * 1000, found[1] * 1000


def _surveyed(dataset: object, decoded: int | None) -> float:
    return least(lambda: list(survey(dataset, decoded)), 1)  # pyright: ignore[reportArgumentType]
