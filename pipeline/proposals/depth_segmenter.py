"""Masks from boxes by depth and colour, without a network.

Colour and surfaces of the strip around a box are a sample of the background,
the box's inside is a sample of the object and of what shows behind and before
it. Each cell of a coarse grid over the box is compared to both, by its colour
and by whether it continues a sampled surface (its distance from the tangent
plane there); a minimum cut whose links are weak at colour edges, depth steps
and creases makes a mask of it, and the mask becomes the sample of the object
for another round (as in GrabCut, Rother et al. 2004, with densities in place
of mixtures). A mask that leaves a side of its box untouched is cut again with
more weight on the object (the tightness of boxes, Lempitsky et al. 2009). A
pixel that several masks claim goes to the one with the best evidence for it.

Nothing is learnt and nothing is random. Mean IoU of the masks, given the boxes:

======================================  =====  =====  =======  ========
pictures                                boxes  this   GrabCut  bare box
======================================  =====  =====  =======  ========
YCB-Video, 6 real frames                   26   .837     .706      .657
the demo, 12 rendered frames              346   .827     .710      .616
12 rendered frames of 6 rooms (4711)      348   .800     .693      .609
12 rendered frames of 6 rooms (99)        349   .807     .711      .618
======================================  =====  =====  =======  ========

The constants were chosen on the first two; the rendered rooms (by their seeds)
played no part in it. With the boxes one at a time, without knowledge of the
others: .792, .806, .795, .796. The masks are worst where a box holds more of
other things than of its own (dining tables, books in a pile, rugs under
furniture). At 640x480 a box takes 10 to 15 ms and the picture once 40 to 60 ms
of one core.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from pipeline.geometry.camera import lift_pixels
from pipeline.geometry.frame import Frame
from pipeline.geometry.surface import depth_noise, surface_normals
from pipeline.system.frozen import dataclass

VERSION = "1"
"""Part of the fingerprint: a change of what comes out must change it."""

CELLS = 56
"""Cells of the grid along the longer side of a box, at most; one cell is at least one pixel."""
MIN_SIDE = 3
"""Pixels a side; a narrower box is left as it is."""
SAMPLES = 150
"""Samples of the background and of the inside, about."""
MARGIN = 0.3
"""Width of the strip around the box, by the mean of its longer side and the mean of both sides."""
ROUNDS = 2

COLOUR = 11.0
IMAGE = 0.45
"""Reach of a sample: in CIE Lab units, and in lengths of the longer side."""
SURFACE = 0.8
NOISE = 3.0
ANGLE = 0.03
"""Reach of a sample along its surface, in lengths of the longer side at the object's depth; across it, in standard
deviations of the depth noise, and in radians, because a normal has an error."""
COLOUR_FLOOR = 2e-3
SURFACE_FLOOR = 5e-3
SURFACE_WEIGHT = 1.5
RING_SHARE = 0.5
"""Share of the strip in the background's density; the rest is what the last round rejected inside the box."""
CENTRE, FALL = 0.54, 3.36
"""Log-odds of the object at the box's centre, and what is lost by the squared distance from it in box sizes."""

LINK = 4.0
STEP = 4.0
CREASE = 2.0
UNKNOWN_STEP = 0.7
"""Weight of links; depth steps in standard deviations of the noise that weaken one; how much a crease weakens it;
and the step that is assumed where one of both depths is missing."""

TIGHT = 0.8
BOOST = 1.0
BOOSTS = 3
"""A mask's own box fills at least this share of the box, or the log-odds are raised so often by so much."""
OWNER_AREA = 2.0
"""Where masks overlap, the log-odds count less this times the log of the box's area: small things lie on large ones."""
OWNER_KEEP = 0.1
"""A mask that would keep less than this share of itself keeps all of it."""


@dataclass(frozen=True)
class _Maps:
    """Points and normals (camera frame) of a frame, known normals, colour in CIE Lab."""

    points: np.ndarray
    normals: np.ndarray
    known: np.ndarray
    lab: np.ndarray


@dataclass(frozen=True)
class _Samples:
    """Pixels as samples: colour and place scaled by their reach, points, normals."""

    features: np.ndarray  # (N, 5) float32
    points: np.ndarray
    normals: np.ndarray  # (N, 3) float32
    measured: np.ndarray
    known: np.ndarray  # (N,) bool: With a depth; with a normal


@dataclass(frozen=True)
class _Cut:
    """Full-size mask of a box with log-odds."""

    x0: int
    y0: int
    mask: np.ndarray
    log_odds: np.ndarray

    @property
    def window(self) -> tuple[slice, slice]:
        h, w = self.mask.shape
        return slice(self.y0, self.y0 + h), slice(self.x0, self.x0 + w)

    @property
    def claim(self) -> np.ndarray:
        """Claim strength (h, w) float32 of the mask on pixels; -inf outside."""
        evidence = self.log_odds - np.float32(OWNER_AREA * np.log(self.mask.size))
        return np.where(self.mask, evidence, -np.inf).astype(np.float32)


class DepthSegmenter:
    """Segmenter by depth and colour; method and figures in the module's docstring.

    Masks stay inside their boxes, widened to whole pixels. `has_mask` is False for boxes narrower than three pixels,
    outside of the picture, or as large as it: their masks are the filled box.
    """

    name = "depth"

    def __init__(self) -> None:
        self._last: tuple[Frame, _Maps] | None = None

    def fingerprint(self) -> str:
        return f"depth:{VERSION}"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Masks (N, H, W) bool of boxes ((N, 4), x0 y0 x1 y1), and masks differing from the box. Names are ignored."""
        shape = (frame.height, frame.width)
        masks = np.zeros((len(boxes), *shape), np.bool_)
        windows = [_window(box, *shape) for box in np.asarray(boxes, np.float64).reshape(-1, 4)]
        cuts: list[_Cut | None] = [None] * len(windows)
        maps = self._maps(frame) if any(w is not None for w in windows) else None
        for i, window in enumerate(windows):
            if window is None or maps is None:
                continue
            x0, y0, x1, y1 = window
            masks[i, y0:y1, x0:x1] = True
            cuts[i] = _cut(maps, window, frame.camera.fx)
        found = [c for c in cuts if c is not None]
        best = np.full(shape, -np.inf, np.float32)
        for cut in found:
            best[cut.window] = np.maximum(best[cut.window], cut.claim)
        for i, cut in enumerate(cuts):
            if cut is not None:
                own = cut.mask & (cut.claim >= best[cut.window])
                masks[i][cut.window] = own if own.sum() >= OWNER_KEEP * cut.mask.sum() else cut.mask
        return masks, np.array([c is not None for c in cuts], np.bool_)

    def _maps(self, frame: Frame) -> _Maps:
        """Maps of a frame, cached per picture."""
        if self._last is None or self._last[0].rgb is not frame.rgb or self._last[0].depth is not frame.depth:
            self._last = frame, _maps(frame)
        return self._last[1]


def _maps(frame: Frame) -> _Maps:
    v, u = np.indices(frame.depth.shape)
    points = lift_pixels(frame.depth.ravel(), frame.camera, v.ravel(), u.ravel()).reshape(*frame.depth.shape, 3)
    normals, known = surface_normals(frame.depth, frame.camera)
    lab = cv2.cvtColor(frame.rgb.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)
    return _Maps(points, normals, known, lab)


def _window(box: np.ndarray, height: int, width: int) -> tuple[int, int, int, int] | None:
    """Box as whole pixels inside the picture; None where too narrow or no box."""
    if not np.isfinite(box).all():
        return None
    limit = np.array([width, height], np.float64)
    x0, y0 = np.floor(np.clip(box[:2], 0, limit)).astype(int)
    x1, y1 = np.ceil(np.clip(box[2:], 0, limit)).astype(int)
    return (int(x0), int(y0), int(x1), int(y1)) if x1 > x0 and y1 > y0 else None


def _even(start: int, stop: int, step: float) -> np.ndarray:
    """Pixels in the middle of equal parts of about `step` pixels."""
    n = max(1, round((stop - start) / step))
    return np.minimum((start + (np.arange(n) + 0.5) * (stop - start) / n).astype(np.int64), stop - 1)


def _cut(maps: _Maps, window: tuple[int, int, int, int], fx: float) -> _Cut | None:
    """Mask of a single box; None without evidence."""
    x0, y0, x1, y1 = window
    height, width = maps.known.shape
    longer, shorter = max(x1 - x0, y1 - y0), min(x1 - x0, y1 - y0)
    if shorter < MIN_SIDE:
        return None
    margin = max(5, round(MARGIN * (longer + shorter) / 2))
    left, top = max(x0 - margin, 0), max(y0 - margin, 0)
    right, bottom = min(x1 + margin, width), min(y1 + margin, height)
    strip = (right - left) * (bottom - top) - (x1 - x0) * (y1 - y0)
    if strip < 8:
        return None
    step = max(1.0, longer / CELLS)
    rows, columns = _even(y0, y1, step), _even(x0, x1, step)
    shape = (len(rows), len(columns))
    colour = maps.lab[y0:y1, x0:x1]
    if colour.shape[:2] != shape:
        colour = cv2.resize(colour, shape[::-1], interpolation=cv2.INTER_AREA)
    v, u = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    cells = _samples(maps, v, u, window, colour.reshape(-1, 3))

    spread = max(1.0, np.sqrt(strip / SAMPLES))
    rv, ru = (a.ravel() for a in np.meshgrid(_even(top, bottom, spread), _even(left, right, spread), indexing="ij"))
    around = ~((rv >= y0) & (rv < y1) & (ru >= x0) & (ru < x1))
    if not around.any():
        return None
    ring = _samples(maps, rv[around], ru[around], window, maps.lab[rv[around], ru[around]])
    pick = _every(shape)
    inner = _samples(maps, v[pick], u[pick], window, colour.reshape(-1, 3)[pick])

    reach = SURFACE * longer / fx * (float(np.median(cells.points[cells.measured, 2])) if cells.measured.any() else 1.0)
    colours = _colour_kernel(cells, ring), _colour_kernel(cells, inner)
    surfaces = _surface_kernel(cells, ring, reach), _surface_kernel(cells, inner, reach)
    off_centre = ((u - (x0 + x1 - 1) / 2) / (x1 - x0)) ** 2 + ((v - (y0 + y1 - 1) / 2) / (y1 - y0)) ** 2
    prior = CENTRE - FALL * off_centre

    # One cell of known background around the box gives the cut something to hold on to.
    e = int(np.ceil(step))
    frame_rows = np.concatenate([[max(y0 - e, 0)][: y0 > 0], rows, [min(y1 - 1 + e, height - 1)][: y1 < height]])
    frame_columns = np.concatenate([[max(x0 - e, 0)][: x0 > 0], columns, [min(x1 - 1 + e, width - 1)][: x1 < width]])
    at = np.ix_(frame_rows.astype(np.int64), frame_columns.astype(np.int64))
    inside = slice(int(y0 > 0), int(y0 > 0) + shape[0]), slice(int(x0 > 0), int(x0 > 0) + shape[1])
    framed = maps.lab[at].copy()
    framed[inside] = colour
    links = _links(framed, maps.points[at], maps.normals[at], maps.known[at])

    def solved(log_odds: np.ndarray) -> np.ndarray:
        everything = np.full(framed.shape[:2], -50.0)
        everything[inside] = log_odds
        return minimum_cut(everything, links)[inside]

    share = 1 / (1 + np.exp(-prior[pick]))
    log_odds, mask = prior.reshape(shape), np.ones(shape, np.bool_)
    for _ in range(ROUNDS):
        ratio = _log_ratio(*colours, share, np.ones_like(ring.known), np.ones_like(inner.known), COLOUR_FLOOR)
        surface = _log_ratio(*surfaces, share, ring.measured, inner.measured, SURFACE_FLOOR)
        ratio = ratio + SURFACE_WEIGHT * np.where(cells.measured, surface, 0.0)
        log_odds = (prior + ratio).reshape(shape)
        mask = solved(log_odds)
        share = (mask.ravel()[pick] + 1 / (1 + np.exp(-log_odds.ravel()[pick]))) / 2
    mask, log_odds = _tightened(mask, log_odds, solved)

    size = (x1 - x0, y1 - y0)
    full = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5
    if not full.any():
        return None
    return _Cut(x0, y0, full, cv2.resize(log_odds.astype(np.float32), size, interpolation=cv2.INTER_LINEAR))


def _every(shape: tuple[int, int]) -> np.ndarray:
    """Places of about `SAMPLES` cells, evenly over a grid."""
    step = max(1, round(np.sqrt(shape[0] * shape[1] / SAMPLES)))
    picked = np.zeros(shape, np.bool_)
    picked[min(step // 2, shape[0] - 1) :: step, min(step // 2, shape[1] - 1) :: step] = True
    return np.flatnonzero(picked)


def _samples(
    maps: _Maps, v: np.ndarray, u: np.ndarray, window: tuple[int, int, int, int], colour: np.ndarray
) -> _Samples:
    x0, y0, x1, y1 = window
    reach = IMAGE * max(x1 - x0, y1 - y0)
    position = np.stack([(u - (x0 + x1) / 2) / reach, (v - (y0 + y1) / 2) / reach], axis=-1)
    points = maps.points[v, u]
    features = np.concatenate([colour / COLOUR, position], axis=1).astype(np.float32)
    return _Samples(features, points, maps.normals[v, u], points[:, 2] > 0, maps.known[v, u])


def _squared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, M) squared distances of two sets of points."""
    square = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None, :] - 2 * (a @ b.T)
    return np.maximum(square, 0, out=square)


def _colour_kernel(cells: _Samples, samples: _Samples) -> np.ndarray:
    """(N, M): how alike cells and samples are in colour and place, 0..1."""
    return np.exp(np.float32(-0.5) * _squared(cells.features, samples.features))


def _surface_kernel(cells: _Samples, samples: _Samples, reach: float) -> np.ndarray:
    """(N, M): how well cells continue the surfaces of samples, 0..1; 0 where a depth is missing."""
    square = _squared(cells.points, samples.points)
    across = cells.points @ samples.normals.T - (samples.normals * samples.points).sum(axis=1)[None, :]
    # A sample without a normal speaks for what is near it in space only.
    across = np.where(samples.known[None, :], across * across, square / 2)
    tolerance = (np.float32(NOISE) * depth_noise(cells.points[:, 2:])) ** 2 + np.float32(ANGLE**2) * square
    exponent = across / tolerance + square / np.float32(reach * reach)
    return np.exp(np.float32(-0.5) * exponent) * (cells.measured[:, None] & samples.measured[None, :])


def _log_ratio(
    ring: np.ndarray,
    inner: np.ndarray,
    share: np.ndarray,
    ring_counts: np.ndarray,
    inner_counts: np.ndarray,
    floor: float,
) -> np.ndarray:
    """Log ratio (N,) of object density over background density, by each inner sample's share in the object."""
    of_object, rejected = share * inner_counts, (1 - share) * inner_counts
    near = inner @ of_object / max(float(of_object.sum()), 1e-6)
    outside = ring.sum(axis=1) / max(int(ring_counts.sum()), 1)
    behind = inner @ rejected / max(float(rejected.sum()), 1e-6)
    return np.log(near + floor) - np.log(RING_SHARE * outside + (1 - RING_SHARE) * behind + floor)


def _links(colour: np.ndarray, points: np.ndarray, normals: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """Cost of a border between neighbouring cells, for `minimum_cut`: small at colour edges, steps and creases."""
    squares = [((colour[a] - colour[b]) ** 2).sum(axis=-1) for a, b, _ in NEIGHBOURS]
    contrast = max(float(np.concatenate([s.ravel() for s in squares]).mean()), 4.0)
    measured = points[..., 2] > 0
    noise = depth_noise(points[..., 2])
    links = []
    for (a, b, weight), square in zip(NEIGHBOURS, squares, strict=True):
        delta = points[b] - points[a]
        from_a, from_b = (np.abs((delta * normals[k]).sum(axis=-1)) * known[k] for k in (a, b))
        off = np.where(known[a] | known[b], np.maximum(from_a, from_b), np.abs(delta[..., 2]))
        step = np.where(measured[a] & measured[b], off / noise[a] / STEP, UNKNOWN_STEP)
        bend = np.maximum(0.0, 0.95 - (normals[a] * normals[b]).sum(axis=-1)) * (known[a] & known[b])
        links.append(LINK * weight * np.exp(-square / (2 * contrast) - step * step / 2 - CREASE * bend))
    return links


def _tightened(
    mask: np.ndarray, log_odds: np.ndarray, solved: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Mask, cut again with higher log-odds where too small for the box."""
    best, best_fit = (mask, log_odds), _fit(mask)
    for boost in np.arange(1, BOOSTS + 1) * BOOST:
        if best_fit >= TIGHT:
            break
        raised = solved(log_odds + boost)
        if _fit(raised) > best_fit + 0.02:
            best, best_fit = (raised, log_odds + boost), _fit(raised)
    return best


def _fit(mask: np.ndarray) -> float:
    """Share of the grid inside the mask's bounding box."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return 0.0
    return float((rows[-1] - rows[0] + 1) * (columns[-1] - columns[0] + 1)) / mask.size


NEIGHBOURS = (
    (np.s_[:, :-1], np.s_[:, 1:], 1.0),
    (np.s_[:-1], np.s_[1:], 1.0),
    (np.s_[:-1, :-1], np.s_[1:, 1:], 0.7),
    (np.s_[1:, :-1], np.s_[:-1, 1:], 0.7),
)
"""The 8-neighbourhood as pairs of views on a grid, with a link's weight by its length."""
_UNITS = 100
"""Capacities are whole numbers: this many for one unit of log-odds."""


def minimum_cut(log_odds: np.ndarray, links: list[np.ndarray]) -> np.ndarray:
    """The labelling of least energy (Boykov and Jolly 2001).

    `log_odds` (h, w) float: Positive where a pixel by itself is of the object; `links` list of four (h', w') float:
    Cost of a border between neighbours, in the order of `NEIGHBOURS`.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    n = log_odds.size
    nodes = np.arange(n)
    grid = nodes.reshape(log_odds.shape)
    a = np.concatenate([grid[first].ravel() for first, _, _ in NEIGHBOURS])
    b = np.concatenate([grid[second].ravel() for _, second, _ in NEIGHBOURS])
    link = np.concatenate([np.ravel(k) for k in links]) * _UNITS
    evidence = np.clip(log_odds.ravel(), -1e4, 1e4) * _UNITS
    source, sink = np.full(n, n), np.full(n, n + 1)
    capacity = np.concatenate([link, link, np.maximum(evidence, 0), np.maximum(-evidence, 0)]).astype(np.int32)
    rows, columns = np.concatenate([a, b, source, nodes]), np.concatenate([b, a, nodes, sink])
    graph = csr_matrix((capacity, (rows, columns)), shape=(n + 2, n + 2))
    residual = graph - maximum_flow(graph, n, n + 1).flow
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    reached = np.zeros(n + 2, np.bool_)
    reached[breadth_first_order(residual, n, return_predecessors=False)] = True
    return reached[:n].reshape(log_odds.shape)
