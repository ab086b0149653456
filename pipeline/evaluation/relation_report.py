"""Relations alone: each relation scorer against the labelled states of pairs, as tables and in the run (SRM table)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.evaluation.leakage import Share, scorer_share, with_caveats
from pipeline.evaluation.relation_cases import RelationSystem, geometry_of_labels, open_systems
from pipeline.evaluation.relation_records import (
    FILE,
    RelationRecords,
    SystemRecords,
    read_relation_records,
    relation_schema,
)
from pipeline.evaluation.systems import EvalSpec
from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import Labels
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.metrics.calibration_metrics import CalibrationMetrics, calibration_metrics
from pipeline.metrics.intervals import BootstrapConfig, Estimate, mean_estimate
from pipeline.metrics.relation_metrics import (
    RelationEstimates,
    RelationMetrics,
    cell_outcomes,
    multi_label_metrics,
    relation_estimates,
    true_ranks,
    tuned_thresholds,
)
from pipeline.metrics.splits import DROPPED, TRAIN, VALIDATION
from pipeline.metrics.tables import NOTHING_SHARED, Cell, Row, Table, in_blocks
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import T
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.training.label_data import same_dataset

SHOWN_SCENES = 5
MEASURES = (
    "micro-F1",
    "macro-F1",
    "element accuracy",
    "mean AP",
    "Brier",
    "ECE",
    "Top-1",
    "Top-2",
    "relations",
    "pairs",
    "masked U cells",
)
BY_RELATION = ("precision", "recall", "F1", "F1, tuned threshold", "AP", "positives", "U cells")


@dataclass(frozen=True, eq=False)
class SystemFigures:
    """Every figure of one scorer."""

    title: str
    metrics: RelationMetrics
    estimates: RelationEstimates  # the same with intervals
    calibration: CalibrationMetrics
    # top1, top2: where it says which one relation fits, and all it can say was labelled
    top1: Estimate | None
    top2: Estimate | None
    # tuned (R,) float64: F1 at the thresholds that are best on the network's validation frames, on the pairs of frames
    # that it has not seen at all; NaN without either
    tuned: np.ndarray


def counted_pairs(records: RelationRecords, held_out: bool) -> np.ndarray:
    """(P,) bool: all pairs, or those of frames without use in training or calibration."""
    seen = [system.part != DROPPED for system in records.systems] if held_out else []
    return ~np.logical_or.reduce([np.zeros(len(records), np.bool_), *seen])


def system_figures(
    system: SystemRecords,
    states: np.ndarray,
    clusters: np.ndarray,
    counted: np.ndarray,
    config: BootstrapConfig | None = None,
) -> SystemFigures:
    """Figures of a scorer.

    `states` (P, R_k) int8: of its relations. `clusters` (P,) int. `counted` (P,) bool: the pairs that are measured; the
    others only serve to find thresholds.
    """
    p, truth, names = system.p[counted].astype(np.float64), states[counted], system.relations
    own = clusters[counted]
    metrics, top1, top2 = multi_label_metrics(p, truth, relations=names), None, None
    if system.prior:
        ranks = relation_ranks(p, system.prior, truth)
        one = ranks >= 0
        top1, top2 = (mean_estimate(ranks[one] < k, own[one], config=config) for k in (1, 2))
    return SystemFigures(
        system.title,
        metrics,
        relation_estimates(cell_outcomes(p, truth), own, relations=names, config=config),
        calibration_metrics(p, truth),
        top1,
        top2,
        _tuned(system, states, counted),
    )


def relation_ranks(p: np.ndarray, prior: Sequence[float] | np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(P,) int64: rank, from 0, of the single relation of each pair; -1 for none or several.

    `p` is (P, R) float of a softmax network of that prior, `truth` (P, R) int8.
    """
    holds = truth == T
    one = holds.sum(axis=1) == 1
    # What ranks pairs has the prior divided out; what the network says of one pair has not.
    likely = p[one].astype(np.float64) * np.array(prior)
    likely /= np.maximum(likely.sum(axis=1, keepdims=True), 1e-12)
    ranks = np.full(len(p), -1, np.int64)
    ranks[one] = true_ranks(likely, holds[one].argmax(axis=1))
    return ranks


def _tuned(system: SystemRecords, states: np.ndarray, counted: np.ndarray) -> np.ndarray:
    validation, unseen = system.part == VALIDATION, (system.part == DROPPED) & counted
    if not validation.any() or not unseen.any():
        return np.full(len(system.relations), np.nan)
    cut = tuned_thresholds(system.p[validation], states[validation])
    return multi_label_metrics(system.p[unseen], states[unseen], cut, system.relations).f1


def all_systems(
    records: RelationRecords, *, held_out: bool = False, config: BootstrapConfig | None = None
) -> list[SystemFigures]:
    """The figures of all scorers, in the order of the run."""
    counted = counted_pairs(records, held_out)
    clusters, _ = records.clusters(counted)
    return [system_figures(s, records.truth(s.relations), clusters, counted, config) for s in records.systems]


def always_no(records: RelationRecords, *, held_out: bool = False) -> list[Row]:
    """Row of a scorer without a single yes, for each set of relations."""
    counted = counted_pairs(records, held_out)
    sets = list(dict.fromkeys(s.relations for s in records.systems))
    rows = []
    for relations in sets:
        truth = records.truth(relations)[counted]
        zeros = np.zeros(truth.shape)
        metrics = multi_label_metrics(zeros, truth, relations=relations)
        calibration = calibration_metrics(zeros, truth)
        name = "always no" if len(sets) == 1 else f"always no ({', '.join(PHRASE[r] for r in relations)})"
        cells: list[Cell] = [metrics.micro_f1, metrics.macro_f1, metrics.all_negative_accuracy]
        rows.append(Row(name, (*cells, *_rest(metrics, calibration, None, None))))
    return rows


def _rest(
    metrics: RelationMetrics, calibration: CalibrationMetrics, top1: Estimate | None, top2: Estimate | None
) -> tuple[Cell, ...]:
    return (
        metrics.mean_average_precision,
        calibration.brier,
        calibration.diagram.ece,
        top1,
        top2,
        len(metrics.relations),
        metrics.pairs,
        int(metrics.undecided.sum()),
    )


def system_row(found: SystemFigures, shares: str = "") -> Row:
    """A scorer's line of the table of scorers; `shares` as `Row.shares`."""
    e = found.estimates
    cells = (e.micro_f1, e.macro_f1, e.element_accuracy)
    rest = _rest(found.metrics, found.calibration, found.top1, found.top2)
    return Row(found.title, (*cells, *rest), shares=shares)


def relation_rows(found: SystemFigures, shares: str = "") -> list[Row]:
    """A scorer's lines of the table by relation; `shares` as `Row.shares`."""
    m, e = found.metrics, found.estimates
    rows = []
    for k, relation in enumerate(m.relations):
        figures = (e.precision[k], e.recall[k], e.f1[k], float(found.tuned[k]), float(m.average_precision[k]))
        cells = (*figures, int(m.positives[k]), int(m.undecided[k]))
        rows.append(Row(f"{found.title}: {PHRASE[relation]}", cells, shares=shares))
    return rows


def relation_tables(
    figures: Sequence[SystemFigures],
    no_rows: Sequence[Row],
    unit: str,
    notes: Sequence[str] = (),
    shares: Mapping[str, Share] = NOTHING_SHARED,
) -> list[Table]:
    """Tables of relation scorers: overall, and by relation.

    `unit`: what the intervals are drawn over, "scene" or "frame". `notes`: what else a reader must know: of what pairs,
    and what was learnt from them. `shares`: what scorers have in common with what made the labels, by their titles.
    """
    text = " ".join(notes)
    titles = {f.title: shares[f.title].title if f.title in shares else "" for f in figures}
    rows = (*(system_row(f, titles[f.title]) for f in figures), *no_rows)
    tables = [
        Table(
            "srm",
            "Relations alone",
            MEASURES,
            in_blocks(rows),
            "Percent; Brier score and ECE times 100. A relation is said to hold above 0.5. Each scorer is measured on "
            "the relations that it judges and that were labelled: only rows with the same relations can be compared, "
            "and beside each stands what always saying no gets. U cells count neither way. Top-1 and Top-2: of the "
            "pairs of which exactly one relation holds, for networks that choose one. Brackets: 95 % bootstrap "
            f"intervals over {unit}s. {text}".strip(),
        ),
        Table(
            "srm_relations",
            "Relations alone, one by one",
            BY_RELATION,
            in_blocks(row for found in figures for row in relation_rows(found, titles[found.title])),
            "Percent. Tuned threshold: the best one on the network's own validation frames, F1 on the pairs of frames "
            "that it has never seen. Pairs and warnings as above.",
        ),
    ]
    found = shares_by_title(figures, shares)
    return [with_caveats(table, found) for table in tables]


def shares_by_title(figures: Sequence[SystemFigures], shares: Mapping[str, Share]) -> dict[str, tuple[Share, ...]]:
    """Shares of each system with the labels' makers, by title."""
    return {f.title: (shares[f.title],) if f.title in shares else () for f in figures}


def leak_warnings(
    records: RelationRecords, systems: Sequence[RelationSystem], labels: Labels, held_out: bool
) -> list[str]:
    """Warn of pairs and scenes from a scorer's training, and of relations without labels.

    `systems`: in the order of the records. `held_out`: pairs that were learnt from are left out.
    """
    found: dict[str, list[str]] = {}
    for own, system in zip(records.systems, systems, strict=True):
        for text in _leaks(records, own, system, labels, held_out):
            found.setdefault(text, []).append(system.name)
    return [f"{', '.join(names)}: {text}" for text, names in found.items()]


def _leaks(
    records: RelationRecords, own: SystemRecords, system: RelationSystem, labels: Labels, held_out: bool
) -> Iterator[str]:
    """Warnings about a scorer."""
    if system.unlabelled:
        text = f"measured without {', '.join(system.unlabelled)}, which were not labelled"
        yield text + ("; hence no Top-1" if system.prior else "")
    if not system.recorded:
        yield "the file does not say what it was trained on, so these pairs may be among it"
    learnt = system.trained_on
    if learnt is None or not same_dataset(learnt, labels):
        return
    seen, train = own.part != DROPPED, int((own.part == TRAIN).sum())
    shared = sorted(set(records.scenes) & set(learnt.scenes))
    if seen.any() and not held_out:
        yield (
            f"{train} of {len(seen)} pairs are ones it was trained on and {int(seen.sum()) - train} "
            f"ones it was calibrated on, in {len(shared)} of {len(records.scenes)} scenes "
            f"({', '.join(shared[:SHOWN_SCENES])}{', ...' if len(shared) > SHOWN_SCENES else ''}): the figures say "
            "how well it remembers; --relation-pairs held-out leaves these pairs out"
        )
    elif shared and learnt.split != "scene":
        yield "the pairs are of other frames than it learnt from, but of the same scenes"


@dataclass(frozen=True, eq=False)
class RelationRun:
    """Relations alone, measured."""

    figures: tuple[SystemFigures, ...]  # a scorer each, then the vision-language model
    tables: tuple[Table, ...]
    warnings: tuple[str, ...]
    record: dict[str, Any]
    pairs: int
    shares: dict[str, Share]  # what scorers have in common with what made the labels, by their titles


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

    Raises InputError: no pair is left to be measured.
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
    return RelationRun(tuple(figures), tuple(tables), tuple(warnings), record, int(counted.sum()), shares)


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
        found |= {
            "features": contract.features,
            "output": contract.output,
            "seed": contract.seed,
            "data": contract.data,
        }
    return found | ({} if system.trained_on is None else {"trained_on": asdict(system.trained_on)})
