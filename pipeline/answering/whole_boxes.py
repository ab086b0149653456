"""Whole boxes: from what one view sees of an object, and its name, a small network estimates the box of the whole.

A side that faces the camera and is not open is measured, and stays; the other ones may move outwards, never inwards.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.geometry.boxes import SIDES, Box3D, Side
from pipeline.geometry.camera import Camera
from pipeline.geometry.lifting import LiftedObject
from pipeline.language.class_sizes import is_thin, size_range
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import metadata, open_session, run_session, signature
from pipeline.system.paths import asset_path
from pipeline.system.safe_files import parse_json

CONTRACT = "spatialviz-box-1"
AXES = ("right", "down", "forward")
STEPS = (0.1, 0.3, 0.8)
"""Places beyond a side that are looked at, in lengths of the longest edge."""
BEYOND = ("through", "outside", "hidden")
"""What such a place is: seen through, outside the picture, or behind something nearer."""
GRID = np.stack(np.meshgrid(*[np.linspace(-0.4, 0.4, 4)] * 2), axis=-1).reshape(-1, 2)
"""Where on a side, (16, 2), in its lengths from its middle."""
TOLERANCE = 0.03
"""Metres, and share of the distance, by which something is nearer or farther."""
NEAR_FACE = 0.08
"""Share of a box's length from a side within which points lie on it."""
QUANTILES = (0.1, 0.5, 0.9)
LEAST_SIZE, SLACK = 0.005, 0.1
"""Metres that an edge has at least; a side's unit is its box's length across it, and so much of the longest edge."""
MOVED = 0.02
"""Units from which a side counts as completed."""
UNSURE_M, UNSURE_SHARE = 0.05, 0.2
"""Lengths of intervals above which a side is uncertain, metres and as a share."""
COLUMNS = (
    *(f"log_size_{axis}" for axis in AXES),
    *("log_longest", "log_distance"),
    *(f"towards_{axis}" for axis in AXES),
    *(f"faces_{side}" for side in SIDES),
    *(f"open_{side}" for side in SIDES),
    *("cut", "yaw_confidence", "log_points", "kept", "depth_missing", "thin"),
    *("class_known", "log_class_least", "log_class_most"),
    *(f"points_{q}_{axis}" for q in QUANTILES for axis in AXES),
    *(f"points_at_{side}" for side in SIDES),
    *(f"{what}_{side}_{step}" for side in SIDES for step in STEPS for what in BEYOND),
)
"""Names of the network's inputs."""
LENGTHS, NAMED = ("log_longest", "log_distance"), ("class_known", "log_class_least", "log_class_most")
"""Inputs that change with the size of the scene, and those that follow from the name."""


@dataclass(frozen=True)
class CompletedBox:
    """Estimated box of a whole object beside that of what is seen of it.

    Attributes
    ----------
    box : Box3D
        Camera frame, metres; it contains the seen box, and has its axes.
    seen : Box3D
        As LIFT fitted it.
    completed : tuple of Side
        Sides that are estimated: they lie farther out than the seen ones.
    interval : dict of Side to (float, float)
        10 to 90 % interval of where each side that is not measured lies, metres outwards from the seen one.
    views : int
        So many views tell of it; what none of them sees is the network's.
    """

    box: Box3D
    seen: Box3D
    completed: tuple[Side, ...] = ()
    interval: Mapping[Side, tuple[float, float]] = field(default_factory=dict)
    views: int = 1

    @property
    def by(self) -> str:
        """What completed it, in words."""
        return "the network" if self.views == 1 else f"{self.views} views"

    @property
    def unsure(self) -> tuple[Side, ...]:
        """Sides that may lie anywhere within more than UNSURE_M or UNSURE_SHARE of the box's length across them."""
        most = np.minimum(UNSURE_M, UNSURE_SHARE * np.repeat(self.box.size, 2))
        return tuple(side for side, (low, high) in self.interval.items() if high - low > most[SIDES.index(side)])

    @property
    def within(self) -> float:
        """Half the longest interval of a side, metres."""
        return max((high - low for low, high in self.interval.values()), default=0.0) / 2

    def record(self) -> dict[str, object]:
        """Completed box for JSON: centre and size in metres, sides by name."""
        return {
            "center": np.round(self.box.center, 4).tolist(),
            "size": np.round(self.box.size, 4).tolist(),
            "completed": list(self.completed),
            "interval_m": {side: np.round(ends, 4).tolist() for side, ends in self.interval.items()},
            "views": self.views,
        }


class BoxNetwork:
    """Network that completes boxes, from an ONNX file; InputError for another file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._session = open_session(path, threads=1)
        told = metadata(self._session)
        require(
            told.get("box.contract") == CONTRACT and told.get("box.columns") == json.dumps(COLUMNS),
            "the model does not complete boxes, or is fed otherwise",
            got=told.get("box.contract", "no contract"),
            expected=f"contract {CONTRACT!r} with {len(COLUMNS)} columns in its metadata",
            cause="was it made by `spatialviz train boxes`?",
            path=path,
        )
        sizes = [list(v.shape)[1:] for v in (*self._session.get_inputs(), *self._session.get_outputs())]
        try:
            scale = np.array([parse_json(told[f"box.{name}"], path) for name in ("mean", "std")], np.float64)
        except (KeyError, ValueError, TypeError):
            scale = np.zeros((2, 0))
        require(
            scale.shape == (2, len(COLUMNS))
            and sizes == [[len(COLUMNS)], [18]]
            and bool(np.isfinite(scale).all() and (scale[1] > 0).all()),
            "the graph that completes boxes does not fit its metadata",
            got=lambda: signature(self._session),
            path=path,
        )
        self.mean, self.std = scale

    def offsets(self, rows: np.ndarray) -> np.ndarray:
        """(N, 3, 6) float64 of (N, F) inputs: estimate, 10 % and 90 % of each of SIDES, outwards, in its units."""
        if not len(rows):
            return np.zeros((0, 3, 6))
        given = ((rows - self.mean) / self.std).astype(np.float32)
        name = self._session.get_inputs()[0].name
        (raw,) = run_session(self._session, [self._session.get_outputs()[0].name], {name: given}, self.path)
        return bounded(raw.astype(np.float64).reshape(-1, 3, 6))


def bounded(raw: np.ndarray) -> np.ndarray:
    """Outputs of the network with the estimate at least 0, and the interval around it."""
    estimate = np.logaddexp(0, SHARPNESS * raw[:, 0]) / SHARPNESS
    return np.stack([estimate, np.minimum(raw[:, 1], estimate), np.maximum(raw[:, 2], estimate)], axis=1)


SHARPNESS = 8.0
"""Of the soft bound at 0: softplus(SHARPNESS x) / SHARPNESS."""


@lru_cache(maxsize=1)
def shipped_box_network() -> BoxNetwork:
    """Network that is shipped with the program; InputError where the installation lacks it."""
    return BoxNetwork(asset_path("box", "box98.onnx"))


def complete(
    items: Sequence[LiftedObject],
    labels: Sequence[str],
    depth: np.ndarray,
    camera: Camera,
    network: BoxNetwork | None = None,
) -> tuple[CompletedBox | None, ...]:
    """Estimate the whole boxes of objects of one frame.

    Parameters
    ----------
    items : sequence of LiftedObject
        Without a box there is nothing to complete (None); boxes whose open sides are not known, as those that a person
        set, stay as they are.
    labels : sequence of str
        Class names.
    depth : (H, W) float32
        Metres, 0 where missing: what is seen beside an object tells where it ends.
    network : BoxNetwork, optional
        By default the shipped one.

    Raises
    ------
    InputError
        The numbers of objects and names differ.
    """
    require(len(items) == len(labels), "objects and names differ in number", got=f"{len(items)} and {len(labels)}")
    found = [None if o.box is None else CompletedBox(o.box, o.box) for o in items]
    chosen = [k for k, o in enumerate(items) if can_complete(o)]
    if chosen:
        network = network or shipped_box_network()
        own = [items[k] for k in chosen]
        offsets = network.offsets(describe(own, [labels[k] for k in chosen], depth, camera))
        for k, item, sides in zip(chosen, own, offsets, strict=True):
            found[k] = _completed(item, sides)
    return tuple(found)


def can_complete(item: LiftedObject) -> bool:
    """Test for an object with points, a fitted box of some size, and known open sides."""
    fitted = item.box is not None and item.box.size.max() > LEAST_SIZE and item.open_sides is not None
    return fitted and len(item.points) > 0 and item.evidence is not None


def _completed(item: LiftedObject, offsets: np.ndarray) -> CompletedBox:
    """Completed box of an object by its (3, 6) offsets."""
    box = item.box
    assert box is not None
    free, unit = ~measured_sides(item), side_units(box)
    moved = free & (offsets[0] > MOVED)
    outwards = np.where(moved, offsets[0] * unit, 0.0).reshape(3, 2)
    # A box of which nothing moves is the same to the last bit.
    whole = box
    if moved.any():
        whole = Box3D(
            box.center + box.R @ (outwards[:, 1] - outwards[:, 0]) / 2, box.R, box.size + outwards.sum(axis=1)
        )
    low, high = (offsets[1:] * unit).tolist()
    sides = [k for k in range(6) if free[k]]
    return CompletedBox(
        whole, box, tuple(SIDES[k] for k in sides if moved[k]), {SIDES[k]: (low[k], high[k]) for k in sides}
    )


def side_units(box: Box3D) -> np.ndarray:
    """(6,): metres of an offset of 1 of each of SIDES."""
    return np.repeat(box.size + SLACK * box.size.max(), 2)


def facing_sides(box: Box3D) -> np.ndarray:
    """(6,) bool: which of SIDES the camera is outside of, and so may see."""
    center = box.center @ box.R
    return np.stack([center, -center], axis=1).ravel() > np.repeat(box.size / 2, 2)


def measured_sides(item: LiftedObject) -> np.ndarray:
    """(6,) bool: which of SIDES face the camera and are not open."""
    assert item.box is not None
    return facing_sides(item.box) & ~np.isin(SIDES, item.open_sides or ())


def describe(items: Sequence[LiftedObject], labels: Sequence[str], depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Inputs of the network, (N, F) float64, of objects that `can_complete`, by COLUMNS."""
    rows = [[*_described(o, n), *_beyond(o, depth, camera)] for o, n in zip(items, labels, strict=True)]
    return np.array(rows, np.float64).reshape(-1, len(COLUMNS))


def _described(item: LiftedObject, label: str) -> list[float]:
    box, quality, known = item.box, item.quality, size_range(label)
    assert box is not None
    center, size = box.center @ box.R, np.maximum(box.size, LEAST_SIZE)
    longest, distance = float(size.max()), max(float(np.linalg.norm(center)), 1e-3)
    local = np.clip((item.points - box.center) @ box.R / size, -1, 1)
    return [
        *np.log(size / longest),
        np.log(longest),
        np.log(distance),
        *(center / distance),
        *facing_sides(box),
        *(side in (item.open_sides or ()) for side in SIDES),
        quality.touches_border,
        item.yaw_confidence,
        np.log(max(quality.points, 1)),
        quality.kept,
        quality.depth_missing,
        is_thin(label),
        *((1.0, *(np.log(known) - np.log(longest))) if known else (0.0, 0.0, 0.0)),
        *np.quantile(local, QUANTILES, axis=0).ravel(),
        *(local[:, :, None] * (-1, 1) > 0.5 - NEAR_FACE).mean(axis=0).ravel(),
    ]


def _beyond(item: LiftedObject, depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Shares of the places beyond each side, at each of STEPS, that are each of BEYOND."""
    box, evidence = item.box, item.evidence
    assert box is not None
    assert evidence is not None
    reach = box.size.max() * np.array(STEPS)
    local = np.empty((6, len(STEPS), len(GRID), 3))
    for k, places in enumerate(local):
        axis, sign = k // 2, 2 * (k % 2) - 1
        others = [a for a in range(3) if a != axis]
        places[..., others] = GRID * box.size[others]
        places[..., axis] = sign * (box.size[axis] / 2 + reach)[:, None]
    x, y, z = np.moveaxis(local @ box.R.T + box.center, -1, 0)
    height, width = depth.shape
    h, w = evidence.codes.shape
    ahead = np.maximum(z, 0.05)
    u, v = np.rint(camera.fx * x / ahead + camera.cx), np.rint(camera.fy * y / ahead + camera.cy)
    shown = (z > 0.05) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    v, u = (np.where(shown, pixel, 0).astype(np.intp) for pixel in (v, u))
    row, column = v - evidence.y0, u - evidence.x0
    own = (row >= 0) & (row < h) & (column >= 0) & (column < w)
    own &= evidence.codes[np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)] > 0
    sensed, slack = depth[v, u], TOLERANCE * (1 + z)
    through = shown & (sensed > z + slack)
    hidden = shown & (sensed > 0) & (sensed < z - slack) & ~own
    return np.stack([through, ~shown, hidden], axis=2).mean(axis=3).ravel()
