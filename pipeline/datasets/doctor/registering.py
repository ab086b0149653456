"""Registration of colour and depth, by depth outlines on colour edges, region by region."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.doctor.trying import MOST_LOSS, Agreement, Opinion
from pipeline.geometry.outlines import REGIONS, WIDE, Outlines, mean_known
from pipeline.geometry.registration import Registration
from pipeline.geometry.warp_search import Fitted, estimated

LEAST_FRAMES = 2
LEAST_REGIONS = REGIONS[0] * REGIONS[1] // 2 + 1
"""In fewer regions of the picture outlines say nothing of the whole: a robot's arms at its border are no witness."""
LEAST_GAIN, LEAST_GAIN_ABOVE = 0.1, 0.07
"""The warp must bring so much more of the outlines onto edges, and more than chance does."""
GAINING_FRAMES = 0.8
LEAST_PEAK, REGION_PEAK = 0.06, 0.12
"""What is registered falls by so much when one picture is moved by a few pixels; and in a region alone."""
LEAST_ELSEWHERE = 0.02
"""And what is found without a row or column of regions must bring so much more of theirs onto edges."""
KEPT = 0.03
"""What a region that is registered as it is may lose by a warp."""
WORTH_PX = 3.0
"""Where the warp moves what is seen by less, at a width of 640, it is not worth declaring."""


class OfOutlines:
    """Registration test by outlines."""

    def opinions(self, seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
        return [_opinion(seen)]

    def measured(self, seen: Seen, mended: Seen) -> tuple[Agreement, ...]:
        own, other = ((o, Registration.none(o.camera)) for o in (seen.outlines, mended.outlines))
        plain = [o.by_region(o.near(none)) for o, none in (own, other)]
        above = [o.by_region(o.above_chance(none)) for o, none in (own, other)]
        peaked = np.nan_to_num(above[0]) > REGION_PEAK
        # A region that is registered as it is may lose nothing to speak of.
        kept = np.where(peaked & (plain[1] - plain[0] < -KEPT), plain[0] - 2 * MOST_LOSS, plain[1])
        return Agreement(plain[0], kept, LEAST_GAIN), Agreement(above[0], above[1], LEAST_GAIN_ABOVE)


def _opinion(seen: Seen) -> Opinion:
    outlines = seen.outlines
    told = Registration.none(outlines.camera)
    near = outlines.near(told)
    own = outlines.by_region(near)
    frames = int(np.isfinite(outlines.by_frame(near)).sum())
    regions = int(np.isfinite(own).sum())
    if frames < LEAST_FRAMES or regions < LEAST_REGIONS:
        text = f"outlines of depth in {regions} of {own.size} regions of the picture, {frames} frames: too few to tell"
        return Opinion("registration", "unknown", text)
    peak = mean_known(outlines.by_region(outlines.above_chance(told)))
    fitted = estimated(outlines)
    gain = np.nan_to_num(outlines.near(fitted.warp) - near)
    gained, off = mean_known(outlines.by_region(gain)), displacement(fitted.warp, outlines)
    by_frame = outlines.by_frame(gain)
    edges = mean_known(own)
    evidence = {"edges": round(edges, 4), "edges_warped": round(edges + gained, 4), "border_px": round(off, 1)}
    gaining = float(np.mean(by_frame[np.isfinite(by_frame)] > 0))
    if gained >= LEAST_GAIN and gaining >= GAINING_FRAMES and off >= WORTH_PX:
        what = "outlines of depth miss edges of colour"
        if fitted.bounded:
            text = f"{what}; the search for a colour camera of its own ended at its bound"
            return Opinion("registration", "unknown", text, evidence=evidence)
        if not _holds_elsewhere(outlines, fitted):
            text = f"{what}, those of one part of the picture by another warp than the rest"
            return Opinion("registration", "unknown", text, evidence=evidence)
        warp = fitted.warp
        numbers = tuple(round(float(n), 4) for n in (warp.fx, warp.fy, warp.cx, warp.cy, warp.tx, warp.ty, warp.tz))
        text = (
            f"{what} ({evidence['edges']:.0%} agree, {evidence['edges_warped']:.0%} "
            f"with a colour camera of its own): off by {off:.0f} pixels"
        )
        line = f"--registration {','.join(f'{n:g}' for n in numbers)}"
        return Opinion("registration", "wrong", text, {"registration": numbers}, line, evidence)
    if peak < LEAST_PEAK:
        return Opinion("registration", "unknown", "edges of colour are everywhere or nowhere", evidence=evidence)
    already = ", by the warp that is declared" if seen.settings.registration else ""
    text = f"{evidence['edges']:.0%} of the outlines of depth lie on edges of colour{already}; no warp does much better"
    return Opinion("registration", "fine", text, evidence=evidence)


def _holds_elsewhere(outlines: Outlines, fitted: Fitted) -> bool:
    """Cross-validate a warp on each row and column of regions left out of the fit."""
    near = outlines.near(Registration.none(outlines.camera))
    grid = np.arange(REGIONS[0] * REGIONS[1]).reshape(REGIONS)
    for left_out in (*grid, *grid.T):
        warp = estimated(outlines, ~np.isin(grid.ravel(), left_out), fitted.warp).warp
        gain = outlines.by_region(np.nan_to_num(outlines.near(warp) - near))[left_out]
        if np.isfinite(gain).any() and mean_known(gain) < LEAST_ELSEWHERE:
            return False
    return True


def displacement(warp: Registration, outlines: Outlines) -> float:
    """Displacement of outlines by a warp, 0.9 quantile, pixels at a width of 640."""
    columns, rows, _ = warp.pixels(outlines.u, outlines.v, outlines.z, outlines.camera)
    moved = np.hypot(columns - outlines.u, rows - outlines.v)
    return float(np.quantile(moved, 0.9) * WIDE / outlines.away.shape[3])
