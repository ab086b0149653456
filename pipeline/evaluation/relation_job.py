"""The part of an evaluation run that measures relations alone: its records, its tables, and what it warns of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.evaluation.relation_cases import RelationSystem, geometry_of_labels, open_systems
from pipeline.evaluation.relation_records import (
    FILE,
    RelationRecords,
    read_relation_records,
    relation_schema,
)
from pipeline.evaluation.relation_report import (
    SystemFigures,
    all_systems,
    always_no,
    counted_pairs,
    leak_warnings,
    relation_tables,
    system_figures,
)
from pipeline.evaluation.shared_makers import Share, scorer_share
from pipeline.evaluation.systems import EvalSpec
from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import Labels
from pipeline.language.counted import counted
from pipeline.metrics.intervals import BootstrapConfig
from pipeline.metrics.tables import Table
from pipeline.relations.model import OnnxScorer
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import require


@dataclass(frozen=True, eq=False)
class RelationRun:
    """Relations alone, measured.

    Attributes
    ----------
    figures : tuple of SystemFigures
        A scorer each, then the vision-language model.
    record : dict
        For the manifest.
    pairs : int
        That were measured.
    shares : dict of str to Share
        What scorers have in common with what made the labels, by their titles.
    """

    figures: tuple[SystemFigures, ...]
    tables: tuple[Table, ...]
    warnings: tuple[str, ...]
    records: RelationRecords
    record: dict[str, Any]
    pairs: int
    shares: dict[str, Share]


@contextmanager
def relation_sink(spec: EvalSpec, labels: Labels, folder: Path) -> Iterator[Callable[[pa.Table], None] | None]:
    """Open the writer of relation records; None where relations are not measured."""
    if spec.relations is None:
        yield None
        return
    geometry_of_labels(spec.relations, labels)
    systems = open_systems(spec.options, spec.relations, labels)
    with pq.ParquetWriter(folder / FILE, relation_schema(systems, labels), compression="zstd") as writer:
        yield writer.write_table


def measure_relations(
    spec: EvalSpec, source: Pipeline, labels: Labels, folder: Path, bootstrap: BootstrapConfig | None = None
) -> RelationRun:
    """The tables of a run's relation records.

    Raises
    ------
    InputError
        No pair is left to be measured.
    """
    how = spec.relations
    assert how is not None
    held_out = how.pairs == "held-out"
    systems = open_systems(spec.options, how, labels)
    records = read_relation_records(folder / FILE)
    counted = counted_pairs(records, held_out)
    require(
        counted.any(),
        "no pair is left to measure relations on",
        got=f"{len(records)} pairs, all of frames that a network was trained or calibrated on",
        expected="labels of other scenes, or --relation-pairs all",
        path=labels.root,
    )
    warnings = leak_warnings(records, systems, labels, held_out)
    makers = makers_of(labels.manifest)
    shares = {s.title: share for s in systems if (share := scorer_share(makers, s.name, s.scorer)) is not None}
    figures = all_systems(records, held_out=held_out, config=bootstrap)
    clusters, unit = records.clusters(counted)
    geometry = geometry_of_labels(how, labels)
    notes = [_about(records, counted, geometry, held_out)]
    asked = None
    if spec.pairs is not None:
        asked = spec.pairs.ask(how, source.dataset, labels, records, counted, folder)
        rows, first = asked.rows, records.systems[0]
        same = replace(first, title=f"{first.title}, on the VLM's pairs", p=first.p[rows], part=first.part[rows])
        if first.title in shares:
            shares[same.title] = shares[first.title]
        for system in (same, asked.system):
            truth = records.truth(system.relations)[rows]
            figures.append(system_figures(system, truth, clusters[rows], np.ones(len(rows), np.bool_), bootstrap))
        notes.append(asked.note)
    notes += [f"Warning: {warning}." for warning in warnings]
    tables = relation_tables(figures, always_no(records, held_out=held_out), unit, notes, shares)
    record = {
        **asdict(how),
        "geometry": geometry,
        "measured_pairs": int(counted.sum()),
        "frames_measured": len(np.unique(records.frame_index[counted])),
        "unit": unit,
        "systems": [_system_record(s) for s in systems],
        "vlm": None if asked is None else asked.record,
        "warnings": warnings,
        "shares": {title: share.record() for title, share in shares.items()},
    }
    return RelationRun(tuple(figures), tuple(tables), tuple(warnings), records, record, int(counted.sum()), shares)


def _about(records: RelationRecords, measured: np.ndarray, geometry: str, held_out: bool) -> str:
    frames, scenes = (len(np.unique(column[measured])) for column in (records.frame_index, records.scene))
    where = "lifted from the dataset's annotations" if geometry == "lifted" else "with boxes as the labels store them"
    left = f", without {int((~measured).sum())} of frames that a network learnt from" if held_out else ""
    pairs = f"{counted(int(measured.sum()), 'ordered pair')} of labelled objects"
    return (
        f"{pairs}, {where}, in {counted(frames, 'frame')} of {counted(scenes, 'scene')}{left}. "
        "Auto-labels are the rule's own verdicts: the rule and networks that imitate it are flattered by them."
    )


def _system_record(system: RelationSystem) -> dict[str, Any]:
    found: dict[str, Any] = {"name": system.name, "title": system.title, "relations": list(system.relations)}
    if isinstance(system.scorer, OnnxScorer):
        contract = system.scorer.contract
        found |= {"features": contract.features, "output": contract.output, "seed": contract.seed,
                  "data": contract.data}  # fmt: skip
    return found | ({} if system.trained_on is None else {"trained_on": asdict(system.trained_on)})
