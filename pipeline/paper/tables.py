"""The paper's tables in its own shapes, with the published rows beside what was measured here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

import numpy as np

from pipeline.datasets.semantic_abstraction_splits import SUBSETS, subsets_of
from pipeline.datasets.settings import read_settings
from pipeline.evaluation.grounding_tables import OPM_ONLY, clusters_of, column, has_opm
from pipeline.evaluation.leakage import shares_of_run, title_of
from pipeline.evaluation.records import read_records
from pipeline.evaluation.relation_records import FILE, RelationRecords, read_pair_names, read_relation_records
from pipeline.evaluation.relation_report import counted_pairs, relation_ranks
from pipeline.evaluation.run_folder import RECORDS_FILE, open_run
from pipeline.labels.cases import HIT
from pipeline.labels.profiles import GIVEN
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import VOCABULARIES
from pipeline.metrics.intervals import BootstrapConfig, mean_estimate
from pipeline.metrics.relation_metrics import cell_outcomes, relation_estimates
from pipeline.metrics.tables import NOTHING_SHARED, Cell, Row, Table, in_blocks
from pipeline.relations.relations import T
from pipeline.system.arrow import pa
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import read_json

FIGURES = Path(__file__).with_name("reported.json")
SA, AVD = "semantic-abstraction", "avd"
PUBLISHED_ON = {SA: "Semantic Abstraction", AVD: "AVD-Spatial"}
Names = tuple[str, str, str]
"""Frame, class of the target, class of the reference."""
AVD_ORDER = ("behind", "front", "above", "below", "left", "right")
ALL_NEGATIVE = "all-negative (always no)"
MOST_FREQUENT = "most frequent relation (always)"
EVERYTHING = "all"
"""Heads the columns of a dataset that has none of the subsets."""

_ACC = "ACC: percent of expressions whose answer overlaps the labelled target by an IoU of at least 0.5."
NOTES = {
    ("relations", SA): "Percent. Of the pairs of which exactly one relation holds, the share whose relation is the "
    "most probable one (Top-1), is among the two most probable (Top-2); for networks that choose one.",
    ("relations", AVD): "Percent. A column a relation: F1 at 0.5, on cells that are not in doubt. Accuracy: cells "
    "that are right, most of them negative; the published micro-F1 and accuracy imply that always saying no gets 80 to "
    "83 there. LLaVA's published accuracy equals its micro-F1, and so is another quantity; 100.00 for left and right "
    "does not come of a split that keeps scenes apart.",
    ("pipeline", SA): f"{_ACC} Mean IoU is a fraction here and a percentage in the table of AVD-Spatial, as published.",
    ("pipeline", AVD): f"{_ACC} Mean IoU is a percentage here and a fraction in the table of Semantic Abstraction, as "
    "published.",
}
IMITATION = (
    "The labels here are a rule's verdicts: networks that learnt from such labels are measured by how well they "
    "imitate the rule."
)
WHAT = {"relations": "Relations alone", "pipeline": "The whole pipeline"}


@dataclass(frozen=True)
class Evaluated:
    """What was evaluated on what."""

    vocabulary: str  # of the labels: "avd", "semantic-abstraction" or "all"
    # dataset, format: its name for people, and its layout
    dataset: str
    format: str
    ruled: bool = False  # the labels' relations are a rule's verdicts, and not the dataset's own
    # shares: of systems and of relation scorers (by title), what their figures are where they are agreement with what
    # made the labels: see `Row.shares`
    shares: Mapping[str, str] = field(default_factory=dict)

    @property
    def shapes(self) -> tuple[str, ...]:
        """Table shapes of the vocabulary."""
        return (self.vocabulary,) if self.vocabulary in PUBLISHED_ON else (SA, AVD)

    def title(self, what: str, shape: str) -> str:
        """Title of a table, with the frames of the published and the measured rows."""
        on = f"reported on {PUBLISHED_ON[shape]}, measured on {self.dataset}"
        return f"{WHAT[what]}: {on}; not comparable frame by frame"


def paper_tables(
    evaluated: Evaluated,
    systems: Mapping[str, pa.Table],
    relations: RelationRecords | None = None,
    pairs: Sequence[Names] = (),
    *,
    held_out: bool = False,
    config: BootstrapConfig | None = None,
) -> list[Table]:
    """Make the paper's tables of the labels' vocabulary.

    `systems`: records of expressions by system; empty where none were answered. `pairs`: the pairs of the relation
    records; needed for the subsets of Semantic Abstraction alone. `held_out`: only pairs of frames that no network was
    trained or calibrated on.
    """
    found = []
    for shape in evaluated.shapes:
        if relations is not None:
            counted = counted_pairs(relations, held_out)
            if shape == SA:
                found.append(_top_table(evaluated, relations, pairs, counted, config))
            else:
                found.append(_f1_table(evaluated, relations, counted, config))
        if systems:
            found.append(_pipeline_table(evaluated, systems, shape, config))
    return found


@dataclass(frozen=True)
class Reported:
    """One published line: figures by the measure's name, as shares, and where they stand."""

    table: str
    name: str
    source: str
    figures: dict[str, float]


def read_reported() -> tuple[Reported, ...]:
    """All published lines."""
    return tuple(Reported(**row) for row in read_json(FIGURES)["rows"])


def published(key: str, columns: Sequence[str]) -> list[Row]:
    """Published rows of a table; unpublished figures are left blank."""
    lines = (line for line in read_reported() if line.table == key)
    return [Row(line.name, tuple(line.figures.get(name) for name in columns), "reported") for line in lines]


def _subset_masks(evaluated: Evaluated, names: Sequence[Names], count: int) -> dict[str, np.ndarray]:
    """(`count`,) bool by subset; without any subset all under EVERYTHING."""
    if evaluated.format == SA and len(names) == count:
        held = [subsets_of(*name) for name in names]
        masks = {subset: np.array([subset in h for h in held], np.bool_) for subset in SUBSETS}
        if any(mask.any() for mask in masks.values()):
            return masks
    nothing = np.zeros(count, np.bool_)
    return {**dict.fromkeys(SUBSETS, nothing), EVERYTHING: ~nothing}


def _mean(values: np.ndarray, mask: np.ndarray, clusters: np.ndarray, config: BootstrapConfig | None) -> Cell:
    return mean_estimate(values[mask], clusters[mask], config=config) if mask.any() else None


def _top_table(
    evaluated: Evaluated,
    records: RelationRecords,
    pairs: Sequence[Names],
    counted: np.ndarray,
    config: BootstrapConfig | None,
) -> Table:
    masks = _subset_masks(evaluated, pairs, len(records))
    columns = tuple(f"Top-{k} {subset}" for k in (1, 2) for subset in masks)
    clusters, unit = records.clusters(counted)

    def row(name: str, ranks: np.ndarray) -> Row:
        cells = tuple(
            _mean((ranks < k).astype(np.float64), mask & counted & (ranks >= 0), clusters, config)
            for k in (1, 2)
            for mask in masks.values()
        )
        return Row(name, cells, shares=evaluated.shares.get(name, ""))

    truth = records.truth(tuple(r for r in VOCABULARIES[SA] if r in records.relations))
    one = counted & ((truth == T).sum(axis=1) == 1)
    shares = (truth[one] == T).mean(axis=0) if one.any() else np.full(truth.shape[1], 1 / max(truth.shape[1], 1))
    rows = [row(MOST_FREQUENT, relation_ranks(np.ones(truth.shape), shares, truth))]
    rows += [row(s.title, relation_ranks(s.p, s.prior, records.truth(s.relations))) for s in records.systems if s.prior]
    counts = {subset: int((mask & one).sum()) for subset, mask in masks.items()}
    return _table(evaluated, "relations", SA, columns, rows, f"{unit}s; pairs: {_listed(counts)}")


def _f1_table(
    evaluated: Evaluated, records: RelationRecords, counted: np.ndarray, config: BootstrapConfig | None
) -> Table:
    clusters, unit = records.clusters(counted)
    columns = (*AVD_ORDER, "micro-F1", "macro-F1", "accuracy")
    labelled = tuple(r for r in AVD_ORDER if r in records.relations)

    def cells(p: np.ndarray, relations: tuple[str, ...]) -> tuple[Cell, ...]:
        truth = records.truth(relations)[counted]
        outcomes = cell_outcomes(p[counted].astype(np.float64), truth)
        e = relation_estimates(outcomes, clusters[counted], relations=relations, config=config)
        of_relation = dict(zip(relations, e.f1, strict=True))
        return (*(of_relation.get(r) for r in AVD_ORDER), e.micro_f1, e.macro_f1, e.element_accuracy)

    rows = []
    for system in records.systems:
        judged = tuple(r for r in labelled if r in system.relations)
        if judged and not system.prior:
            p = system.p[:, [system.relations.index(r) for r in judged]]
            rows.append(Row(system.title, cells(p, judged), shares=evaluated.shares.get(system.title, "")))
    if labelled:
        *_, accuracy = cells(np.zeros((len(records), len(labelled))), labelled)
        rows.insert(0, Row(ALL_NEGATIVE, (*[0.0] * (len(columns) - 1), accuracy)))
    return _table(evaluated, "relations", AVD, columns, rows, f"{unit}s; {int(counted.sum())} pairs")


def _pipeline_table(
    evaluated: Evaluated, systems: Mapping[str, pa.Table], shape: str, config: BootstrapConfig | None
) -> Table:
    rows, heads = [], ("ACC", "mean IoU")
    columns: tuple[str, ...] = heads
    unit, counts = "scene", ""
    for name, records in systems.items():
        clusters, unit = clusters_of(records)
        masks = {"": np.ones(records.num_rows, np.bool_)}
        if shape == SA:
            ends = ([str(v) for v in records.column(c).to_pylist()] for c in ("frame", "target", "reference"))
            masks = _subset_masks(evaluated, list(zip(*ends, strict=True)), records.num_rows)
            columns = tuple(f"{head} {subset}" for head in heads for subset in masks)
        counts = counts or _listed({subset: int(mask.sum()) for subset, mask in masks.items()})
        for title, overlap in ((f"{name}{OPM_ONLY}", "opm_iou"), (name, "iou")):
            if title != name and not has_opm(records):
                continue
            iou = column(records, overlap)
            values = ((iou >= HIT).astype(np.float64), iou)
            cells = tuple(_mean(v, mask, clusters, config) for v in values for mask in masks.values())
            rows.append(Row(title, cells, shares=evaluated.shares.get(name, "")))
    table = _table(evaluated, "pipeline", shape, columns, rows, f"{unit}s; expressions: {counts}")
    return replace(table, fractions=columns[len(columns) // 2 :]) if shape == SA else table


def _table(
    evaluated: Evaluated, what: str, shape: str, columns: tuple[str, ...], rows: Sequence[Row], drawn: str
) -> Table:
    """Order published rows, measured rows, and rows of agreement with the labels' makers."""
    key = f"paper_{what}_{shape.replace('-', '_')}"
    more = f" {IMITATION}" if evaluated.ruled and what == "relations" else ""
    return Table(
        key,
        evaluated.title(what, shape),
        columns,
        in_blocks([*published(key, columns), *rows]),
        f"{NOTES[what, shape]} Brackets: 95 % bootstrap intervals over {drawn}.{more}",
        decimals=2,
    )


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {subset}".strip() for subset, count in counts.items() if count) or "none"


def tables_of_folder(
    folder: Path,
    labels: Labels,
    systems: Mapping[str, pa.Table],
    shares: Mapping[str, str] = NOTHING_SHARED,
    *,
    held_out: bool = False,
    config: BootstrapConfig | None = None,
) -> list[Table]:
    """Make the paper's tables of a run's folder; relations if recorded.

    `systems` are the records of expressions by system, `shares` as in `Evaluated`.
    """
    root = Path(str(labels.manifest.dataset.get("path", "")))
    dataset = (read_settings(root).name if root.is_dir() else None) or root.name
    stored = folder / FILE
    relations = read_relation_records(stored) if stored.exists() else None
    pairs = read_pair_names(stored) if stored.exists() else ()
    vocabulary, layout = str(labels.manifest.config.get("vocabulary")), str(labels.manifest.dataset.get("format"))
    ruled = labels.manifest.profile.get("name") != GIVEN
    evaluated = Evaluated(vocabulary, dataset, layout, ruled, shares)
    return paper_tables(evaluated, systems, relations, pairs, held_out=held_out, config=config)


def tables_of_run(folder: str | Path) -> list[Table]:
    """Make the paper's tables of a finished run; its labels must be at hand.

    Raises InputError: no run there, no labels, or neither expressions nor relations in it.
    """
    run = open_run(folder)
    require(
        not (not (run.folder / RECORDS_FILE).exists() and not (run.folder / FILE).exists()),
        "the run has neither records of expressions nor of relations",
        path=run.folder,
    )
    systems = {run.name: read_records(run.folder)} if (run.folder / RECORDS_FILE).exists() else {}
    how = run.manifest.get("relations") or {}
    own = title_of(shares_of_run(run.manifest, run.labels.root))
    blocks = dict.fromkeys(systems, own) | {n: str(s["title"]) for n, s in how.get("shares", {}).items()}
    return tables_of_folder(run.folder, run.labels, systems, blocks, held_out=how.get("pairs") == "held-out")
