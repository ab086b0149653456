"""Small label sets of exact scenes, and ways to damage them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from scenes import frame_of, upright

from pipeline.answering import PreparedFrame, all_objects
from pipeline.geometry import Frame
from pipeline.labels import (
    MANIFEST_FILE,
    TABLES,
    LabelConfig,
    LabelStore,
    SourceSpec,
    label_objects,
    merge_labels,
    save_plan,
)
from pipeline.labels.job import shard_tables
from pipeline.labels.plan import Plan
from pipeline.labels.reading import arrow_schema
from pipeline.proposals import AnnotationDetector

Tables = dict[str, list[dict[str, Any]]]
"""Rows as dicts, by table; under "manifest" a list of the one manifest."""

WALL = upright((0.0, 0.0, 4.0), (3.5, 2.0, 0.1))


def scenes() -> list[Frame]:
    """Three frames: mugs on a table beside a chair; boxes in a row; a lamp behind a sofa."""
    table = upright((0.0, 0.9, 2.2), (1.2, 0.6, 0.8))
    mugs = [upright((x, 0.53, z), (0.14, 0.14, 0.14)) for x, z in ((-0.45, 2.0), (0.0, 2.1), (0.42, 2.3))]
    chair = upright((1.1, 0.8, 2.6), (0.45, 0.8, 0.45))
    first = frame_of([table, *mugs, chair, WALL], ["table", "mug", "mug", "mug", "chair", "wall"], name="room/0")
    row = [upright((x, 1.0, z), (0.3, 0.4, 0.3), 15) for x, z in ((-0.9, 2.4), (-0.2, 2.5), (0.5, 2.4))]
    book = upright((-0.2, 0.77, 2.5), (0.2, 0.06, 0.16))
    second = frame_of([*row, book], ["box", "box", "box", "book"], name="room/1", pitch=25)
    sofa, lamp = upright((-0.3, 0.85, 2.2), (1.4, 0.7, 0.7)), upright((-0.2, 0.45, 3.3), (0.3, 1.5, 0.3))
    bin_, pillow = upright((0.9, 1.0, 1.9), (0.3, 0.4, 0.3)), upright((-0.6, 0.4, 2.2), (0.4, 0.2, 0.4))
    third = frame_of([sofa, lamp, bin_, pillow], ["sofa", "lamp", "trash can", "pillow"], name="room/2")
    return [first, second, third]


def write_labels(root: Path, config: LabelConfig) -> None:
    """Label the scenes and merge them, in two shards."""
    frames = scenes()
    ids = tuple(f.id for f in frames)
    plan = Plan(SourceSpec("scenes"), config, ids, {"detector": "annotations"}, "-", "test", True, 2)
    store = LabelStore(root)
    store.prepare()
    save_plan(plan, store)
    labelled = []
    for index, frame in enumerate(frames):
        context = PreparedFrame(frame, config.lift)
        objects = all_objects(context, AnnotationDetector())
        labelled.append(label_objects(context, objects, config, frame_index=index, scene="room", exact=True))
    for shard in plan.shards:
        part = labelled[shard.first : shard.first + len(shard.frames)]
        store.write_part(shard.name, shard_tables(part), {"shard": shard.index, "key": shard.key})
    merge_labels(root)


def copied(source: Path, target: Path) -> Path:
    """A copy of merged labels."""
    target.mkdir(parents=True)
    for name in (*(f"{table}.parquet" for table in TABLES), MANIFEST_FILE):
        shutil.copyfile(source / name, target / name)
    return target


def read_rows(root: Path) -> Tables:
    tables: Tables = {name: pq.read_table(root / f"{name}.parquet").to_pylist() for name in TABLES}
    tables["manifest"] = [json.loads((root / MANIFEST_FILE).read_text())]
    return tables


def damage(root: Path, change: Callable[[Tables], Any]) -> Any:
    """Let `change` edit the rows, and write the tables that it changed; what `change` returned."""
    tables = read_rows(root)
    # Compared as text: NaN is not equal to itself.
    before = {name: repr(rows) for name, rows in tables.items()}
    told = change(tables)
    for name in TABLES:
        if repr(tables[name]) != before[name]:
            # As libraries write that do not keep whether a column may be null.
            fields = [field.with_nullable(True) for field in arrow_schema(name)]
            schema = pa.schema(fields, metadata=arrow_schema(name).metadata)
            pq.write_table(pa.Table.from_pylist(tables[name], schema=schema), root / f"{name}.parquet")
    if repr(tables["manifest"]) != before["manifest"]:
        (root / MANIFEST_FILE).write_text(json.dumps(tables["manifest"][0]))
    return told
