"""Tables from records: the systems of the paper, relation by relation, and where the answers are lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.labels.cases import HIT
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.intervals import BootstrapConfig, Estimate, mean_estimate
from pipeline.metrics.significance import McNemar, mcnemar
from pipeline.metrics.tables import NOTHING_SHARED, Row, Table, in_blocks
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

FIGURES = Path(__file__).with_name("reported.json")

ACCURACIES = {"Acc@0.5 single truth": "iou", "strict set": "strict_iou", "set-valued": "set_iou"}
COLUMNS = (*ACCURACIES, "only with the relation", "only by OPM alone", "McNemar p", "n")

MEASURES = (
    "Acc@0.5 single truth", "strict set", "set-valued", "mean IoU", "mean IoU over set", "reference", "pair", "n",
)  # fmt: skip

OPM_ONLY = ": OPM only"
"""Ends the name of a row of the detector's best target alone."""


def has_opm(records: pa.Table) -> bool:
    """Whether the records tell of the detector's best target alone: systems that take whole expressions have none."""
    return records.column("opm_iou").null_count < records.num_rows


def column(records: pa.Table, name: str) -> np.ndarray:
    """A column of records as float64; null is NaN."""
    values = records.column(name)
    found = values.to_numpy() if not values.null_count else values.cast("float64").to_numpy()
    return np.asarray(found, np.float64)


def clusters_of(records: pa.Table) -> tuple[np.ndarray, str]:
    """What resembles each other: the scene of each row; its frame where there is one scene only."""
    scenes = np.array(records.column("scene").to_pylist(), object)
    if len(set(scenes.tolist())) > 1:
        return scenes.astype(str), "scene"
    return np.array(records.column("frame").to_pylist(), object).astype(str), "frame"


def full_row(name: str, records: pa.Table, config: BootstrapConfig | None = None) -> Row:
    """The pipeline's line of the table of systems."""
    names = ("correct", "strict_correct", "set_correct", "iou", "set_iou", "reference_correct", "pair_correct")
    return _row(name, records, [column(records, measure) for measure in names], config)


def opm_row(name: str, records: pa.Table, config: BootstrapConfig | None = None) -> Row:
    """The line of the detector's best target alone: it has no reference."""
    single, strict, lenient = (column(records, f"opm_{n}") for n in ("iou", "strict_iou", "set_iou"))
    hits = [(overlap >= HIT).astype(np.float64) for overlap in (single, strict, lenient)]
    return _row(name, records, [*hits, single, lenient, None, None], config)


def _row(
    name: str, records: pa.Table, measures: Sequence[np.ndarray | None], config: BootstrapConfig | None
) -> Row:
    clusters, _ = clusters_of(records)
    # A system that gives one box has no reference to be measured by.
    cells = (None if m is None or np.isnan(m).all() else mean_estimate(m, clusters, config=config) for m in measures)
    return Row(name, (*cells, records.num_rows))


def systems_table(systems: Sequence[Row], unit: str, shares: Mapping[str, str] = NOTHING_SHARED) -> Table:
    """The systems of the paper as rows; `shares` as `Row.shares`, by system, its values in the order of the blocks."""
    return Table(
        "grounding",
        "Grounding",
        MEASURES,
        in_blocks(systems, shares.values()),
        "Percent. Single truth: IoU of at least 0.5 with the labelled target; set: with any target that the "
        "expression is true of (strict), or may be true of (set-valued). Reference and pair: the answer's reference, "
        f"and both, are acceptable ones. Brackets: 95 % bootstrap intervals over {unit}s.",
    )


def relation_table(
    systems: Mapping[str, pa.Table], config: BootstrapConfig | None = None, shares: Mapping[str, str] = NOTHING_SHARED
) -> Table:
    """Set-valued accuracy of each system by relation; `shares` as in `systems_table`."""
    first = next(iter(systems.values()))
    present = set(first.column("relation").to_pylist())
    relations = [r for r in PAIRWISE if r in present]
    rows = []
    for name, records in systems.items():
        clusters, _ = clusters_of(records)
        relation = np.array(records.column("relation").to_pylist(), object)
        for label, right in (
            (f"{name}{OPM_ONLY}", (column(records, "opm_set_iou") >= HIT).astype(np.float64)),
            (name, column(records, "set_correct")),
        ):
            if label != name and not has_opm(records):
                continue
            cells: list[Estimate] = []
            for r in relations:
                own = relation == r
                cells.append(mean_estimate(right[own], clusters[own], config=config))
            rows.append(Row(label, tuple(cells), shares=shares.get(name, "")))
    counts = tuple(int((np.array(first.column("relation").to_pylist(), object) == r).sum()) for r in relations)
    return Table(
        "relations",
        "Grounding by relation",
        tuple(PHRASE[r] for r in relations),
        (*in_blocks(rows, shares.values()), Row("expressions", counts)),
        "Percent, set-valued accuracy with 95 % intervals.",
    )


def stages_table(systems: Mapping[str, pa.Table], shares: Mapping[str, str] = NOTHING_SHARED) -> Table:
    """How many expressions get how far: what the next stage still could get right; `shares` as in `systems_table`."""
    rows = []
    for name, records in systems.items():
        if not has_opm(records):
            continue
        found = column(records, "target_rank")
        reference = column(records, "reference_rank")
        cells = (
            float(np.mean(column(records, "parse_ok"))),
            float(np.mean(np.isfinite(found))),
            float(np.mean(np.isfinite(found) & np.isfinite(reference))),
            float(np.mean(column(records, "pair_covered"))),
            float(np.mean(column(records, "set_correct"))),
        )
        rows.append(Row(name, cells, shares=shares.get(name, "")))
    return Table(
        "stages",
        "How far expressions get",
        ("read rightly", "target found", "and a reference", "as an acceptable pair", "answered rightly"),
        in_blocks(rows, shares.values()),
        "Percent of all expressions; found: a candidate overlaps an acceptable object by at least 0.5.",
    )


def problem_warnings(records: pa.Table) -> tuple[str, ...]:
    """What must be said where half of the expressions or more were not even asked: figures then measure little else."""
    problems = records.column("problem")
    unasked = len(problems) - problems.null_count
    if not unasked or 2 * unasked < len(problems):
        return ()
    first = next(reason.as_py() for reason in problems if reason.is_valid)
    return (f"{unasked} of {len(problems)} expressions have no answer that the system could give; the first: {first}",)


def relation_gain(
    records: pa.Table, overlap: str = "iou", config: BootstrapConfig | None = None
) -> tuple[Estimate, McNemar]:
    """Accuracy of OPM+SRM+PRM less that of OPM alone, paired, with a clustered interval, and McNemar's exact test.

    `overlap` is "iou" (single truth), "strict_iou" or "set_iou".
    """
    clusters, _ = clusters_of(records)
    own, alone = (column(records, name) >= HIT for name in (overlap, f"opm_{overlap}"))
    difference = mean_estimate(own.astype(np.float64), clusters, other=alone.astype(np.float64), config=config)
    return difference, mcnemar(own, alone)


def gain_table(
    systems: Mapping[str, pa.Table], config: BootstrapConfig | None = None, shares: Mapping[str, str] = NOTHING_SHARED
) -> Table | None:
    """The gain of every system that has both; None where none has. `shares` as in `systems_table`."""
    rows = []
    for name, records in systems.items():
        if has_opm(records):
            found = [relation_gain(records, overlap, config) for overlap in ACCURACIES.values()]
            test = found[0][1]
            cells = (*(d for d, _ in found), test.b, test.c, f"{test.p_value:.2g}", test.n)
            rows.append(Row(name, cells, shares=shares.get(name, "")))
    if not rows:
        return None
    return Table(
        "gain",
        "What the relation adds to OPM only",
        COLUMNS,
        in_blocks(rows, shares.values()),
        "Points of accuracy, paired, with 95 % bootstrap intervals as above; right only with the relation, right only "
        "by the detector's best target, and McNemar's exact test are of the single truth.",
    )


class Reported(BaseModel):
    """One published line: figures by the measure's name, as shares, and where they stand."""

    model_config = ConfigDict(extra="forbid")

    table: str
    name: str
    source: str = Field(min_length=1)
    figures: dict[str, float]


class Publications(BaseModel):
    """The file."""

    model_config = ConfigDict(extra="forbid")

    rows: list[Reported]


def read_reported(path: Path = FIGURES) -> tuple[Reported, ...]:
    """All published lines of a file.

    Raises
    ------
    InputError
        It is missing or of another shape.
    """
    try:
        return tuple(Publications.model_validate_json(path.read_bytes()).rows)
    except FileNotFoundError as error:
        raise InputError("there is no such file of published figures", path=path) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        raise InputError(f"published figures: {where}: {first['msg']}", path=path) from error


def reported_rows(table: str = "grounding", columns: tuple[str, ...] = MEASURES, path: Path = FIGURES) -> list[Row]:
    """The published lines of a table; a measure that was not published is left blank."""
    return [
        Row(f"{line.name}, {line.source}", tuple(line.figures.get(c) for c in columns), "reported")
        for line in read_reported(path)
        if line.table == table
    ]
