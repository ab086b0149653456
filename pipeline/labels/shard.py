"""Labelling a shard: the one pure function that every engine runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from pipeline.answering.objects import prepare_frame
from pipeline.answering.opening import Pipeline
from pipeline.datasets import given_expressions
from pipeline.datasets.base import scene_of
from pipeline.labels.config import LabelConfig
from pipeline.labels.labelling import FrameLabels, broken_frame, label_objects
from pipeline.labels.plan import Shard, SourceSpec
from pipeline.labels.profiles import GIVEN
from pipeline.labels.second_opinion import open_second_opinion
from pipeline.labels.store import Store
from pipeline.labels.tables import CANDIDATES, PART_TABLES, arrow_schema, build_table
from pipeline.proposals.base import Proposals
from pipeline.relations.model import OnnxScorer
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class ShardReport:
    """What became of a shard.

    Attributes
    ----------
    name : str
        Of its part.
    frames : int
    objects, pairs, candidates : int
        Rows written.
    broken : int
        Frames that could not be used.
    seconds : float
        0 where it was there already.
    reused : bool
    """

    name: str
    frames: int
    objects: int = 0
    pairs: int = 0
    candidates: int = 0
    broken: int = 0
    seconds: float = 0.0
    reused: bool = False


@dataclass(frozen=True)
class Labeller:
    """What a process opens once and labels many frames with.

    Attributes
    ----------
    config : LabelConfig
    source : Pipeline
        The dataset and what finds objects in it.
    network : OnnxScorer or None
        The second opinion.
    """

    config: LabelConfig
    source: Pipeline
    network: OnnxScorer | None


def open_labeller(spec: SourceSpec, config: LabelConfig) -> Labeller:
    """Open the dataset and the models of a plan; raises as `open_source`."""
    return Labeller(config, spec.open(config), open_second_opinion(config.second_opinion))


def label_frame(labeller: Labeller, frame_id: str, frame_index: int, found: Proposals | None = None) -> FrameLabels:
    """The rows of one frame; one that cannot be used is a row with the reason.

    `found` is what the detector said of the frame, where another process ran it.
    """
    source, config = labeller.source, labeller.config
    scene = scene_of(source.dataset, frame_id)
    detector = source.needed_detector()
    try:
        given = given_expressions(source.dataset, frame_id) if config.profile == GIVEN else ()
        context = prepare_frame(source.dataset, source.dataset.load(frame_id), config.lift)
        found = detector.detect(context.frame, None) if found is None else found
        if (np.diff(found.ids) < 0).any():
            found = found.take(np.argsort(found.ids, kind="stable"))
        objects = context.lift(found, detector)
    except InputError as error:
        return broken_frame(frame_id, frame_index, scene, str(error))
    return label_objects(
        context,
        objects,
        config,
        frame_index=frame_index,
        scene=scene,
        exact=detector.exact,
        network=labeller.network,
        given=given,
    )


def detect_shard(shard: Shard, source: Pipeline) -> dict[str, Proposals]:
    """What the detector finds in the frames of a shard; frames that cannot be used are left to the labelling."""
    detector = source.needed_detector()
    found = {}
    for frame_id in shard.frames:
        try:
            found[frame_id] = detector.detect(prepare_frame(source.dataset, source.dataset.load(frame_id)).frame, None)
        except InputError:
            continue
    return found


def shard_tables(labels: Iterable[FrameLabels]) -> dict[str, pa.Table]:
    """The rows of many frames as Arrow tables."""
    import pyarrow as pa

    found: dict[str, list[pa.Table]] = {name: [] for name in PART_TABLES}
    for frame in labels:
        for name, columns in frame.tables().items():
            if columns:
                found[name].append(build_table(name, columns))
    return {
        name: pa.concat_tables(tables).combine_chunks() if tables else arrow_schema(name).empty_table()
        for name, tables in found.items()
    }


def finished(shard: Shard, store: Store) -> ShardReport | None:
    """The report of a shard that is there already, else None."""
    if not store.has_part(shard.name):
        return None
    record = store.part_record(shard.name)
    rows = {name: int(record["files"].get(name, {}).get("rows", 0)) for name in PART_TABLES}
    broken = int(record.get("broken", 0))
    return ShardReport(
        shard.name, rows["frames"], rows["objects"], rows["relations"], rows[CANDIDATES], broken, reused=True
    )


def label_shard(
    shard: Shard, labeller: Labeller, store: Store, found: Mapping[str, Proposals] | None = None
) -> ShardReport:
    """Label the frames of a shard and write its part; one that is there already is left alone.

    The rows depend on the plan alone: not on the engine, nor on what else runs.
    `found` is what the detector said of its frames, where another process ran it.
    """
    there = finished(shard, store)
    if there is not None:
        return there
    start = perf_counter()
    found = found or {}
    tables = shard_tables(
        label_frame(labeller, frame, shard.first + k, found.get(frame))
        for k, frame in enumerate(shard.frames)
    )
    seconds = perf_counter() - start
    broken = sum(not ok for ok in tables["frames"].column("ok").to_pylist())
    record = {"shard": shard.index, "key": shard.key, "broken": broken, "seconds": round(seconds, 3)}
    store.write_part(shard.name, tables, record)
    return ShardReport(
        shard.name,
        len(shard.frames),
        tables["objects"].num_rows,
        tables["relations"].num_rows,
        tables[CANDIDATES].num_rows,
        broken,
        seconds,
    )
