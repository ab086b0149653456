"""The diagnosis of an expression as columns of the run's records."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.diagnosis.substitution import CONF, LIFT, SRM

if TYPE_CHECKING:
    from pipeline.diagnosis.verdict import Diagnosis

DIAGNOSIS_COLUMNS: dict[str, str] = {
    "verdict": "string", "detail": "string", "lucky": "bool", "said": "string", "repair": "strings",
    "mends": "strings", "right_with": "int32",
    "margin": "float32", "margin_lift": "float32", "margin_srm": "float32", "margin_conf": "float32",
    "false_target": "bool", "false_reference": "bool",
    "missed_name": "string", "missed_overlap": "float32", "missed_score": "float32", "missed_rank": "int32",
    "object_size": "float32", "object_distance": "float32", "object_occluded": "float32", "object_pixels": "int32",
}  # fmt: skip
"""`verdict` and the rest of `pipeline.diagnosis.verdict.Diagnosis`; `said` is it in words; `mends` names each oracle
that alone would do. `right_with` has bit s set where the target is right with subset s of the oracles (RECALL 1, LIFT
2, SRM 4, CONF 8). `margin…` is S of the best acceptable pair less S of the best other one, as it is and with one
oracle. `object_…` is the labelled target: longest edge of its box and distance in metres, occluded share of its border,
pixels of its mask."""


def diagnosis_columns(d: Diagnosis) -> dict[str, Any]:
    """The cells of one expression."""
    missed, truth, k = d.missed, d.truth, d.case.target_object
    return {
        "verdict": d.verdict, "detail": d.detail, "lucky": d.lucky, "said": d.text, "repair": list(d.repair),
        "mends": list(d.mends), "right_with": d.right_with,
        "margin": _finite(d.margins[0]), "margin_lift": _finite(d.margins[LIFT]), "margin_srm": _finite(d.margins[SRM]),
        "margin_conf": _finite(d.margins[CONF]),
        "false_target": d.false_target, "false_reference": d.false_reference,
        "missed_name": d.missed_name,
        "missed_overlap": None if missed is None else missed.overlap,
        "missed_score": None if missed is None else missed.score,
        "missed_rank": None if missed is None else missed.rank,
        "object_size": _finite(truth.geometry["size"][k].max()),
        "object_distance": _finite(truth.facts["distance"][k]), "object_occluded": _finite(truth.facts["occluded"][k]),
        "object_pixels": int(truth.facts["mask_pixels"][k]),
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
