"""What relation and reference add to the detector's best target: paired differences on the same expressions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pipeline.evaluation.grounding_tables import clusters_of, column, has_opm
from pipeline.labels.cases import HIT
from pipeline.metrics.intervals import BootstrapConfig, Estimate, mean_estimate
from pipeline.metrics.significance import McNemar, mcnemar
from pipeline.metrics.tables import NOTHING_SHARED, Row, Table, in_blocks

if TYPE_CHECKING:
    import pyarrow as pa

ACCURACIES = {"Acc@0.5 single truth": "iou", "strict set": "strict_iou", "set-valued": "set_iou"}
COLUMNS = (*ACCURACIES, "only with the relation", "only by OPM alone", "McNemar p", "n")


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
