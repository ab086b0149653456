"""What an event of a trace costs the pipeline that tells it, and what reading the file back does.

cd tests && python -m benchmarks.trace_events [EXPRESSIONS]
"""

from __future__ import annotations

import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from time import perf_counter

import numpy as np

from pipeline.answering.predictions import read_predictions
from pipeline.answering.tracing import trace

MASK = np.zeros((480, 640), np.bool_)
MASK[200:260, 100:180] = True


def measure(expressions: int, path: Path) -> dict[str, np.ndarray]:
    """Seconds of every call by its kind, of expressions of level 3 on frames of their own."""
    seconds: dict[str, list[float]] = defaultdict(list)
    with trace(path, ranking="product") as t:
        for n in range(expressions):
            calls = [
                ("expression", lambda n=n: t.expression(f"{n}", "mug left of the laptop")),
                ("proposals", lambda: t.proposals("mug", [[290, 180, 330, 230], [10, 60, 40, 99]], [0.9, 0.1])),
                ("proposals with a mask", lambda: t.proposals("laptop", [[100, 200, 180, 260]], [0.8], masks=[MASK])),
                ("boxes", lambda: t.boxes({0: {"center": [0.1, 0.2, 1.4], "size": [0.1, 0.1, 0.1]}, 2: None})),
                ("relations", lambda: t.relations({"left": {(0, 2): 0.9, (1, 2): 0.2}})),
                ("answer", lambda: t.answer(0, 2)),
            ]
            for name, call in calls:
                start = perf_counter()
                call()
                seconds[name].append(perf_counter() - start)
    return {name: np.array(values) for name, values in seconds.items()}


def main(expressions: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.jsonl"
        for name, values in measure(expressions, path).items():
            print(
                f"{name}: median {1e6 * np.median(values):.0f} µs, 99 % below {1e6 * np.quantile(values, 0.99):.0f} µs"
            )
        start = perf_counter()
        lines = len(read_predictions(path).lines)
        print(f"{lines} expressions, {path.stat().st_size / 1e6:.1f} MB, read in {perf_counter() - start:.2f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
