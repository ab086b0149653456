"""Whether colour and depth are registered, by outlines of depth on edges of colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.datasets.doctor.opinions import Opinion
from pipeline.datasets.settings import Settings
from pipeline.geometry.frame import Frame
from pipeline.geometry.registration import Outlines, Registration, agreement, estimated

LEAST_OUTLINES = 300
"""Of a frame; with fewer it does not count."""
LEAST_FRAMES = 2
LEAST_GAIN = 0.08
"""The warp must bring so much more of the outlines onto edges, in nearly every frame."""
GAINING = 0.8
LEAST_PEAK = 0.06
"""What is registered falls by so much when one picture is moved by a few pixels."""
MOVED_PX = 8.0
WORTH_PX = 3.0
"""Where the warp moves the border of the picture by less, at a width of 640, it is not worth declaring."""
AT_M = 2.0
"""How far away what is looked at is taken to be there, metres."""


def registration_opinion(frames: Sequence[Frame], settings: Settings | None = None) -> Opinion:
    """What is thought of the registration of frames of one camera, one size, and right depth."""
    outlines = [Outlines.of(f.rgb, f.depth, f.camera) for f in frames]
    outlines = [frame for frame in outlines if len(frame.u) >= LEAST_OUTLINES]
    if len(outlines) < LEAST_FRAMES:
        return Opinion("registration", "unknown", "too few outlines in the depth to compare with edges of the colour")
    told = Registration.none(outlines[0].camera)
    own = agreement(outlines, told)
    peak = own - float(np.mean([agreement(outlines, _moved(told, way)) for way in ((1, 0), (-1, 0), (0, 1), (0, -1))]))
    warp = estimated(outlines)
    gains = np.array([frame.near(warp).mean() - frame.near(told).mean() for frame in outlines])
    best = own + float(gains.mean())
    off = displacement(warp, outlines[0])
    evidence = {"edges": round(own, 4), "edges_warped": round(best, 4), "border_px": round(off, 1)}
    if gains.mean() >= LEAST_GAIN and (gains > 0).mean() >= GAINING and off >= WORTH_PX:
        numbers = tuple(round(float(n), 4) for n in (warp.fx, warp.fy, warp.cx, warp.cy, warp.tx, warp.ty, warp.tz))
        text = (
            f"outlines of depth miss edges of colour ({own:.0%} agree, {best:.0%} with a colour camera of its own): "
            f"off by {off:.0f} pixels at the border"
        )
        line = f"--registration {','.join(f'{n:g}' for n in numbers)}"
        return Opinion("registration", "wrong", text, {"registration": numbers}, line, evidence)
    if peak < LEAST_PEAK:
        return Opinion("registration", "unknown", "edges of colour are everywhere or nowhere", evidence=evidence)
    already = ", by the warp that is declared" if settings is not None and settings.registration else ""
    text = f"{own:.0%} of the outlines of depth lie on edges of colour{already}; no warp does much better"
    return Opinion("registration", "fine", text, evidence=evidence)


def _moved(warp: Registration, way: tuple[int, int]) -> Registration:
    pixels = MOVED_PX * 2 * warp.cx / 640
    return Registration(warp.fx, warp.fy, warp.cx + way[0] * pixels, warp.cy + way[1] * pixels)


def displacement(warp: Registration, frame: Outlines) -> float:
    """By how many pixels, at a width of 640, a warp moves the corners of the picture at most."""
    height, width = frame.away.shape
    u, v = np.array([0.0, 0.0, width - 1, width - 1]), np.array([0.0, height - 1, 0.0, height - 1])
    columns, rows, _ = warp.pixels(u, v, np.full(4, AT_M), frame.camera)
    return float(np.hypot(columns - u, rows - v).max() * 640 / width)
