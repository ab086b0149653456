"""Growth: a frame with ten times as many objects."""

from __future__ import annotations

from collections.abc import Iterator

from pipeline.bench.clock import Figure, Setup, side_by_side
from pipeline.bench.label_part import labelled, opened
from pipeline.bench.worlds import crowded_frame
from pipeline.system.whole_files import scratch_folder
from pipeline.system.worker_pool import one_thread


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure a labelled frame of 300 objects beside one of 30."""
    with scratch_folder() as folder, one_thread():
        few, many = (opened(crowded_frame(folder / str(n), n)) for n in (30, 300))
        found = side_by_side([lambda: labelled(*many), lambda: labelled(*few)], setup.times(5, 2))
        yield "growth.label", found[0] * 1000, found[1] * 1000
