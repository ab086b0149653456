"""Records of runs that never were: random verdicts, numbers and gaps, in the schema of real ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.diagnosis import VERDICTS, names_of
from pipeline.evaluation.records import COLUMNS, records_schema
from pipeline.language import QUERY_KINDS

CLASSES = ("chair", "Chair", "trash can", "none", 'a "b" c', "ta*ble", "100%_x", "it's")
RELATIONS = ("left", "behind", "on")


def random_records(seed: int, rows: int = 60, scenes: int = 4) -> pa.Table:
    """A run of `rows` expressions; numbers have gaps, NaN and values that lie on the edges of bins."""
    rng = np.random.default_rng(seed)

    def maybe(value: Any, share: float = 0.2) -> Any:
        return None if rng.random() < share else value

    found = []
    for k in range(rows):
        scene = int(rng.integers(scenes))
        verdict = str(rng.choice(VERDICTS))
        number = float(rng.choice([0.1, 0.2, 1.0, float(rng.normal()), np.nan]))
        row: dict[str, Any] = dict.fromkeys(COLUMNS)
        row |= {
            "id": f"{k:04x}",
            "frame": f"{scene:06d}/{k % 3:06d}",
            "frame_index": scene * 3 + k % 3,
            "scene": f"{scene:06d}",
            "text": str(rng.choice(["the red Chair", "a trash can?", "50% left_of", "chair"])),
            "kind": QUERY_KINDS[k % 7],
            "target": str(rng.choice(CLASSES)),
            "relation": str(rng.choice(RELATIONS)),
            "reference": "table",
            "same_class": int(rng.integers(1, 8)),
            "label_margin": maybe(abs(number)),
            "verdict": verdict,
            "detail": maybe(str(rng.choice(["RANK", "ABSENT"]))),
            "lucky": verdict == "CORRECT" and rng.random() < 0.5,
            "said": "why",
            "repair": maybe(list(names_of(int(rng.integers(16))))),
            "right_with": int(rng.integers(1 << 16)),
            "margin": maybe(number),
            "set_correct": verdict in ("CORRECT", "LABEL"),
            "correct": verdict == "CORRECT",
            "strict_correct": verdict == "CORRECT",
            "reference_correct": verdict == "LIFT",
            "pair_correct": verdict == "CORRECT",
            "object_distance": maybe(float(rng.choice([0.5, 1, 2, 3, 5, 9]))),
            "object_size": maybe(abs(number)),
            "object_occluded": float(rng.random()),
        }
        found.append(row)
    return pa.Table.from_pylist(found, schema=records_schema())
