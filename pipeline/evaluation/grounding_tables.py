"""Tables from records: the systems of the paper, by relation, and where answers are lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.answering.ask import AskConfig
from pipeline.answering.pipeline import Pipeline
from pipeline.evaluation.leakage import Share, rank, title_of, with_caveats
from pipeline.evaluation.records_file import some_rows, text_codes
from pipeline.labels.cases import HIT
from pipeline.labels.reading import Labels, read_table
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.metrics.intervals import BootstrapConfig, Estimate, McNemar, mcnemar, mean_estimate
from pipeline.metrics.tables import NOTHING_SHARED, Row, Table, in_blocks
from pipeline.proposals.score_calibration import ScoreCalibration
from pipeline.system.arrow import pa

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

ACCURACIES = {"Acc@0.5 single truth": "iou", "strict set": "strict_iou", "set-valued": "set_iou"}
COLUMNS = (*ACCURACIES, "only with the relation", "only by OPM alone", "McNemar p", "n")

MEASURES = (
    "Acc@0.5 single truth",
    "strict set",
    "set-valued",
    "mean IoU",
    "mean IoU over set",
    "reference",
    "pair",
    "n",
)

OPM_ONLY = ": OPM only"
"""Ends the name of a row of the detector's best target alone."""


def has_opm(records: pa.Table) -> bool:
    """Tell whether records hold the detector's best target alone; systems of whole expressions record none."""
    return records.column("opm_iou").null_count < records.num_rows


def column(records: pa.Table, name: str) -> np.ndarray:
    """A column of records as float64; null is NaN."""
    values = records.column(name)
    found = values.to_numpy() if not values.null_count else values.cast("float64").to_numpy()
    return np.asarray(found, np.float64)


def clusters_of(records: Records) -> tuple[np.ndarray, str]:
    """Clusters for intervals, (N,) int64: the scene of each row; the frame in a run of one scene; and what they are.

    They are places in the order of the names.
    """
    scenes, codes = coded_texts(records, "scene")
    return (codes, "scene") if len(scenes) > 1 else (coded_texts(records, "frame")[1], "frame")


def coded_texts(records: Records, name: str) -> tuple[list[str | None], np.ndarray]:
    """Texts of a column in order, null as "None", and (N,) int64: the place of each row's among them."""
    names, codes = text_codes(some_rows(records, None, [name], coded=True).column(0))
    order = sorted(range(len(names)), key=lambda k: str(names[k]))
    return [names[k] for k in order], np.argsort(np.array(order, np.int64))[codes]


def full_row(name: str, records: pa.Table, config: BootstrapConfig | None = None) -> Row:
    """The pipeline's line of the table of systems."""
    names = ("correct", "strict_correct", "set_correct", "iou", "set_iou", "reference_correct", "pair_correct")
    return _row(name, records, [column(records, measure) for measure in names], config)


def opm_row(name: str, records: pa.Table, config: BootstrapConfig | None = None) -> Row:
    """Row of the detector's best target alone, without a reference."""
    single, strict, lenient = (column(records, f"opm_{n}") for n in ("iou", "strict_iou", "set_iou"))
    hits = [(overlap >= HIT).astype(np.float64) for overlap in (single, strict, lenient)]
    return _row(name, records, [*hits, single, lenient, None, None], config)


def _row(name: str, records: pa.Table, measures: Sequence[np.ndarray | None], config: BootstrapConfig | None) -> Row:
    clusters, _ = clusters_of(records)
    # A system that gives one box has no reference to be measured by, nor has one that gives it for a part.
    cells = (None if m is None or np.isnan(m).any() else mean_estimate(m, clusters, config=config) for m in measures)
    return Row(name, (*cells, records.num_rows))


def systems_table(systems: Sequence[Row], unit: str, shares: Mapping[str, str] = NOTHING_SHARED) -> Table:
    """The systems of the paper as rows; `shares` as `Row.shares`, by system, in the order of the blocks."""
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
            masks = (relation == r for r in relations)
            cells = tuple(mean_estimate(right[own], clusters[own], config=config) for own in masks)
            rows.append(Row(label, cells, shares=shares.get(name, "")))
    counts = tuple(int((np.array(first.column("relation").to_pylist(), object) == r).sum()) for r in relations)
    return Table(
        "relations",
        "Grounding by relation",
        tuple(PHRASE[r] for r in relations),
        (*in_blocks(rows, shares.values()), Row("expressions", counts)),
        "Percent, set-valued accuracy with 95 % intervals.",
    )


def stages_table(systems: Mapping[str, pa.Table], shares: Mapping[str, str] = NOTHING_SHARED) -> Table:
    """Count expressions by stage, up to the best possible result of the next stage; `shares` as in `systems_table`.

    Without a row where no system has proposals.
    """
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
    """Warn where half of the expressions or more were not even asked: figures then measure little else."""
    problems = records.column("problem")
    unasked = len(problems) - problems.null_count
    if not unasked or 2 * unasked < len(problems):
        return ()
    first = next(reason.as_py() for reason in problems if reason.is_valid)
    return (f"{unasked} of {len(problems)} expressions have no answer that the system could give; the first: {first}",)


def relation_gain(
    records: pa.Table, overlap: str = "iou", config: BootstrapConfig | None = None
) -> tuple[Estimate, McNemar]:
    """Accuracy of OPM+SRM+PRM less OPM alone, paired, with a clustered interval, and McNemar's exact test.

    `overlap` is "iou" (single truth), "strict_iou" or "set_iou".
    """
    clusters, _ = clusters_of(records)
    own, alone = (column(records, name) >= HIT for name in (overlap, f"opm_{overlap}"))
    difference = mean_estimate(own.astype(np.float64), clusters, other=alone.astype(np.float64), config=config)
    return difference, mcnemar(own, alone)


def gain_table(
    systems: Mapping[str, pa.Table], config: BootstrapConfig | None = None, shares: Mapping[str, str] = NOTHING_SHARED
) -> Table:
    """Gain of every system with both; without a row for none. `shares` as in `systems_table`."""
    rows = []
    for name, records in systems.items():
        if has_opm(records):
            found = [relation_gain(records, overlap, config) for overlap in ACCURACIES.values()]
            test = found[0][1]
            cells = (*(d for d, _ in found), test.b, test.c, f"{test.p_value:.2g}", test.n)
            rows.append(Row(name, cells, shares=shares.get(name, "")))
    return Table(
        "gain",
        "What the relation adds to OPM only",
        COLUMNS,
        in_blocks(rows, shares.values()),
        "Points of accuracy, paired, with 95 % bootstrap intervals as above; right only with the relation, right only "
        "by the detector's best target, and McNemar's exact test are of the single truth.",
    )


def calibration_warnings(source: Pipeline, labels: Labels, records: pa.Table) -> tuple[str, ...]:
    """Warn where the effect of the calibration in these records is not held out, or may not be."""
    calibration = source.config.score_calibration
    if calibration is None or source.needed_detector().exact:
        return ()
    rows = read_table(labels.root / "frames.parquet", "frames", ("frame", "scene", "rgb_hash")).to_pylist()
    evaluated = set(records.column("frame").to_pylist())
    frames = {row["frame"]: (row["scene"], row["rgb_hash"]) for row in rows if row["frame"] in evaluated}
    found = held_out_warning(calibration, frames, source.dataset.root.resolve().name)
    return () if found is None else (found,)


def recorded_config(config: AskConfig) -> dict[str, Any]:
    """Settings for a run's manifest: of a calibration the number of fitted frames in place of their list."""
    found = asdict(config)
    if found["score_calibration"] is not None:
        found["score_calibration"]["frames"] = len(found["score_calibration"]["frames"])
    return found


def held_out_warning(
    calibration: ScoreCalibration, frames: Mapping[str, tuple[str, str | None]], dataset: str
) -> str | None:
    """Reason against held-out figures of a calibration; None if held out.

    `frames`: those that were evaluated, by id. `dataset`: its folder's name.
    """
    if not calibration.frames:
        return "the score calibration does not say which frames it was fitted on: its effect may not be held out"
    fitted = {f.rgb_hash for f in calibration.frames}
    same = sum(rgb_hash in fitted for _, rgb_hash in frames.values())
    if same:
        return (
            f"the score calibration was fitted on {same} of the {len(frames)} frames that are evaluated: its effect is "
            "not held out; fit it on others (calibrate --frames FROM:TO)"
        )
    if calibration.dataset == dataset:
        shared = {f.scene for f in calibration.frames} & {scene for scene, _ in frames.values()}
        if shared:
            return (
                f"the score calibration was fitted on other frames of {len(shared)} of the scenes that are evaluated: "
                "the same objects were seen"
            )
    return None


def make_tables(
    systems: dict[str, pa.Table],
    bootstrap: BootstrapConfig | None = None,
    shares: Mapping[str, Sequence[Share]] = NOTHING_SHARED,
) -> list[Table]:
    """All tables of a run; the first system is the run itself.

    What systems share with what made the labels is said, and rows that are agreement stand below those that are not.
    """
    first = next(iter(systems.values()))
    shares = {name: shares.get(name, ()) for name in systems}
    titles = dict(sorted(((name, title_of(found)) for name, found in shares.items()), key=lambda t: rank(t[1])))
    rows = []
    for name, records in systems.items():
        found = []
        if has_opm(records):
            found.append(opm_row(f"{name}{OPM_ONLY}", records, bootstrap))
        found.append(full_row(name, records, bootstrap))
        rows += [replace(row, shares=titles[name]) for row in found]
    unit = clusters_of(first)[1]
    tables = [
        systems_table(rows, unit, titles),
        relation_table(systems, bootstrap, titles),
        stages_table(systems, titles),
        gain_table(systems, bootstrap, titles),
    ]
    return [with_caveats(table, shares) for table in tables if table.rows]
