"""Start-up: commands in processes of their own, beside the imports that none can do without."""

from __future__ import annotations

from collections.abc import Iterator

from pipeline.bench.clock import Figure, Setup, child_seconds
from pipeline.labels import SourceSpec, label_dataset
from pipeline.system.whole_files import scratch_folder

BARE_IMPORTS = ("-c", "import numpy, cv2, onnxruntime")
FRAME = ("demo", "000001/000000")


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure commands in processor seconds."""
    with scratch_folder() as folder:
        labels = folder / "labels"
        label_dataset(SourceSpec("demo"), labels)
        commands = {
            "ask": (*FRAME, "mug left of the laptop"),
            "relations": FRAME,
            "frames": ("demo",),
            "check": (str(labels),),
        }
        words = [("-m", "spatialviz", name, *given) for name, given in commands.items()]
        *found, floor = child_seconds([*words, BARE_IMPORTS], setup.times(8))
        for name, seconds in zip(commands, found, strict=True):
            yield f"start.{name}", seconds, floor
        told, nothing = child_seconds([("-m", "spatialviz", "--help"), ("-c", "pass")], setup.times(8))
        yield "start.help", told, nothing
