"""Known depth units, and the depth scale by sizes of known things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.datasets.base import readable_frames
from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.doctor.trying import Agreement, Opinion
from pipeline.datasets.plausible import annotated_sizes

UNITS = {
    1.0: "metres", 39.3701: "inches", 100.0: "centimetres", 256.0: "1/256 m, as in KITTI", 500.0: "1/500 m",
    1000.0: "millimetres", 4000.0: "1/4000 m", 5000.0: "1/5000 m, as in TUM RGB-D",
    8000.0: "millimetres rotated by three bits, as in SUN RGB-D", 10000.0: "tenths of a millimetre",
    1e6: "micrometres",
}  # fmt: skip
"""By depth units in a metre."""
LOOKED_AT = 4
"""Frames whose annotations are read."""


def only_unit(units: float, low: float, high: float) -> float | None:
    """Single known unit with a scale in the range; None for none or several."""
    allowed = [unit for unit in UNITS if low <= units / unit <= high]
    return allowed[0] if len(allowed) == 1 else None


class OfSizes:
    """Size test: annotated things of known classes against their class sizes."""

    def opinions(self, seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
        landed = next(opinion for opinion in known if opinion.about == "depth scale")
        if landed.state != "unknown" or not seen.dataset.class_names or seen.units is None:
            return []
        wanted = [frame.id for frame in seen.frames[:LOOKED_AT]]
        annotated = {frame.id: frame.annotations for frame in readable_frames(seen.dataset.load, wanted)}
        frames = [frame for frame in seen.frames if frame.id in annotated]
        factors = [annotated_sizes(replace(frame, annotations=annotated[frame.id])) for frame in frames]
        found = [factor for factor in factors if factor is not None]
        if 2 * len(found) <= len(frames):
            return []
        low, high = max(f.low for f in found), min(f.high for f in found)
        unit = only_unit(seen.units, 1 / high, 1 / low) if low <= high else None
        if unit is None:
            return []
        things, fitting = sum(f.things for f in found), sum(f.fitting for f in found)
        text = (
            f"{fitting} of {things} things of known classes have the size of their class, nearly all with {UNITS[unit]}"
        )
        evidence = {"things": float(things), "fitting": float(fitting), "low": 1 / high, "high": 1 / low}
        return [Opinion("depth scale", "wrong", text, {"depth_scale": unit}, f"--depth-scale {unit:g}", evidence)]

    def measured(self, seen: Seen, mended: Seen) -> tuple[Agreement, ...]:
        # With its mend the same sizes are looked at again: none may speak for another unit.
        return ()
