"""Features of object pairs for the network: `rel32`, `rel26`, `rel14`, `paper30`, `canon30`, `geom2d8` and `+lang`.

Each contract first describes every object by a row of numbers, then every
ordered pair by parts made from two of them, many pairs at once. `+lang` after
any of the names appends the phrase vectors of both class names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.fitting import pca_box
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.class_sizes import size_range
from pipeline.relations.pair_measures import Profile, measures_between
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass

LANGUAGE = "+lang"
"""What the name of a contract with class names ends with."""

CLI_FEATURES = {
    "2d": "geom2d8",
    "2d+lang": "geom2d8+lang",
    "3d": "paper30",
    "3d+lang": "paper30+lang",
    "canon": "canon30",
    "rel14": "rel14",
    "rel26": "rel26",
    "rel32": "rel32",
    "rel14+lang": "rel14+lang",
}
"""Contracts by the names that the command line gives them: the paper's 2D-Geom, 3D-Geom and so on."""

_AXES = ("right", "up", "forward")


Parts = Callable[[np.ndarray, np.ndarray], Sequence[np.ndarray]]
Describe = Callable[..., np.ndarray]
"""(objects, viewer, appearance) -> a row of numbers for each object."""


@dataclass(frozen=True)
class FeatureSet:
    """Feature contract."""

    name: str
    columns: tuple[str, ...]  # Name of each feature; their number is the network's input dimension
    # (N, K) float64, one row an object; NaN for an object without points and box. With
    # language, its geometry alone.
    describe: Describe
    # Features of "a to b" in parts, (d, ...) each, of rows of a and of b, (K + language, ...) each
    parts: Parts
    lengths: tuple[int, ...]  # Columns of the description that are lengths: they grow with the scene, the others do not
    named: tuple[int, ...] = ()  # Columns that follow from the class name, all 0 where that tells nothing
    shown: bool = False  # Objects are described by their 2D boxes or class names: `describe` needs the appearance
    # Dimension of the phrase vectors that stand after the geometry in each object's row; 0 without language
    language: int = 0

    @property
    def dimension(self) -> int:
        return len(self.columns)

    @property
    def needs_appearance(self) -> bool:
        return self.shown or self.language > 0

    def pair(self, rows: np.ndarray) -> np.ndarray:
        """Features of "a to b" at [a, b], (N, N, D) float64, of (N, K + language) rows or a batch of such."""
        own = np.ascontiguousarray(np.moveaxis(rows, -1, 0))
        return np.ascontiguousarray(np.moveaxis(self.between(own[..., :, None], own[..., None, :]), 0, -1))

    def between(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Features, (D, ...) float64, of rows of a and of b, (K + language, ...), that are broadcast."""
        parts = self.parts(a, b)
        found = np.empty((self.dimension, *np.broadcast_shapes(a.shape[1:], b.shape[1:])))
        start = 0
        for part in parts:
            found[start : start + len(part)] = part
            start += len(part)
        return found


def feature_set(name: str, language: int = 0) -> FeatureSet:
    """Feature contract by name; `language` is the dimension of phrase vectors, for a name with "+lang".

    Raises
    ------
    InputError
        For an unknown name.
    """
    base = geometry_of(name)
    if base not in FEATURES:
        known = ", ".join((*FEATURES, *(known + LANGUAGE for known in FEATURES)))
        raise InputError("there is no such feature contract", got=repr(name), expected=known)
    if name == base:
        return FEATURES[base]
    require(
        language >= 1, f"the feature contract {name} needs vectors of class names", expected="a file of text vectors"
    )
    return _with_language(FEATURES[base], language)


def cli_features(name: str) -> str:
    """Command-line name of a contract."""
    return next((short for short, full in CLI_FEATURES.items() if full == name), name)


def geometry_of(name: str) -> str:
    """Name of a contract without language: "rel14" of "rel14+lang"."""
    return name.removesuffix(LANGUAGE)


def _with_language(base: FeatureSet, dimension: int) -> FeatureSet:
    def parts(a: np.ndarray, b: np.ndarray) -> Sequence[np.ndarray]:
        split = len(a) - dimension
        return *base.parts(a[:split], b[:split]), a[split:], b[split:]

    words = tuple(f"{which}_word{k}" for which in ("a", "b") for k in range(dimension))
    return replace(base, name=base.name + LANGUAGE, columns=base.columns + words, parts=parts, language=dimension)


def describe_extents(
    objects: Sequence[LiftedObject], viewer: ViewerAxes, appearance: Appearance | None = None
) -> np.ndarray:
    """(N, 6): lo and hi along (right, up, forward), metres."""
    return np.array([np.concatenate([o.lo, o.hi]) for o in objects]).reshape(-1, 6)


def describe_raw_boxes(
    objects: Sequence[LiftedObject], viewer: ViewerAxes, appearance: Appearance | None = None
) -> np.ndarray:
    """(N, 15): T(3), R row by row (9), D(3) of the paper's PCA box, camera frame, with PCA's own axes."""
    return _rows([_fitted(o, None) for o in objects])


def describe_level_boxes(
    objects: Sequence[LiftedObject], viewer: ViewerAxes, appearance: Appearance | None = None
) -> np.ndarray:
    """(N, 15): T, R, D of the canonical PCA box in the level frame (x right, y down, z forward)."""
    T = np.eye(4)
    T[:3, :3] = viewer.R_level_camera
    boxes = [_fitted(o, viewer) for o in objects]
    return _rows([None if box is None else box.transformed(T) for box in boxes])


def describe_boxes_2d(
    objects: Sequence[LiftedObject], viewer: ViewerAxes, appearance: Appearance | None = None
) -> np.ndarray:
    """(N, 4): centre x, centre y, width, height of the 2D box, divided by the image's width and height."""
    shown = needed(appearance, "geom2d8 needs the objects' 2D boxes", expected="their appearance in the image")
    return rows_2d(shown.bboxes, shown.width, shown.height)


def rows_2d(bboxes: np.ndarray, width: float, height: float) -> np.ndarray:
    """`geom2d8` of boxes x0, y0, x1, y1 ((N, 4), pixels): (N, 4) float64."""
    corners = np.asarray(bboxes, np.float64).reshape(-1, 4) / np.array([width, height, width, height], np.float64)
    return np.concatenate([(corners[:, :2] + corners[:, 2:]) / 2, corners[:, 2:] - corners[:, :2]], axis=1)


def _fitted(item: LiftedObject, viewer: ViewerAxes | None) -> Box3D | None:
    return pca_box(item.points, viewer)[0] if len(item.points) else item.box


def _rows(boxes: Sequence[Box3D | None]) -> np.ndarray:
    rows = np.full((len(boxes), 15), np.nan)
    for k, box in enumerate(boxes):
        if box is not None:
            rows[k] = np.concatenate([box.center, box.R.ravel(), box.size])
    return rows


def relative(a: np.ndarray, b: np.ndarray) -> Sequence[np.ndarray]:
    """`rel14` of extents, (6, ...).

    Differences of centres, signed gaps, overlap shares and the logarithm of the
    ratio of extents (a over b), each along (right, up, forward); the forward
    coordinates of both centres. Metres.
    """
    own = [(rows[:3], rows[3:], *_measured(rows)) for rows in (a, b)]
    delta, gap, _, share = measures_between(*own)
    (*_, center_a, extent_a), (*_, center_b, extent_b) = own
    return delta, gap, share, np.log(extent_a) - np.log(extent_b), center_a[2:], center_b[2:]


def _measured(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres and extents, as `measure_pairs`, of (6, ...) rows."""
    return (rows[:3] + rows[3:6]) / 2, np.maximum(rows[3:6] - rows[:3], Profile().min_extent)


def describe_viewed_extents(
    objects: Sequence[LiftedObject], viewer: ViewerAxes, appearance: Appearance | None = None
) -> np.ndarray:
    """(N, 7): the extents, and 1 where the image border cuts the object, else 0."""
    cut = np.array([[float(o.quality.touches_border)] for o in objects]).reshape(-1, 1)
    return np.concatenate([describe_extents(objects, viewer), cut], axis=1)


def viewed(a: np.ndarray, b: np.ndarray) -> Sequence[np.ndarray]:
    """`rel26`: `rel14`, and of a and of b the viewing direction, apparent size, and cut by the image border.

    A camera sees the near side and, from above, the top: what is hidden of a thing depends on where it stands.
    """
    parts = [*relative(a[:6], b[:6])]
    for rows in (a, b):
        center, extent = _measured(rows)
        parts += center[:2], np.log(extent), rows[6:]
    return parts


def describe_named_extents(
    objects: Sequence[LiftedObject], viewer: ViewerAxes, appearance: Appearance | None = None
) -> np.ndarray:
    """(N, 10): the extents and the cut, and how long things of the object's class are."""
    shown = needed(appearance, "rel32 needs the objects' class names", expected="their appearance in the image")
    return with_class_lengths(describe_viewed_extents(objects, viewer), shown.labels)


def with_class_lengths(extents: np.ndarray, labels: Sequence[str] | np.ndarray) -> np.ndarray:
    """(N, 10): rows of `describe_viewed_extents` with lengths of classes.

    Of a class: 1 and the logarithms of the shortest and longest that its longest edge can be; 0, 0, 0 of one whose
    sizes are not known.
    """
    ranges = [size_range(str(label)) for label in labels]
    lengths = np.array([(0.0, 0.0, 0.0) if r is None else (1.0, *np.log(r)) for r in ranges]).reshape(-1, 3)
    return np.concatenate([extents, lengths], axis=1)


def named(a: np.ndarray, b: np.ndarray) -> Sequence[np.ndarray]:
    """`rel32`: `rel26`, and of a and of b the usual length of the class: a bed cut by the border is as long as beds
    are."""
    return *viewed(a[:_VIEWED], b[:_VIEWED]), a[_VIEWED:], b[_VIEWED:]


def side_by_side(a: np.ndarray, b: np.ndarray) -> Sequence[np.ndarray]:
    """The row of a, then the row of b."""
    return a, b


def _box_columns() -> tuple[str, ...]:
    one = [f"T{k}" for k in range(3)] + [f"R{i}{j}" for i in range(3) for j in range(3)] + [f"D{k}" for k in range(3)]
    return tuple(f"{which}_{name}" for which in ("a", "b") for name in one)


_FLAT_COLUMNS = tuple(f"{which}_{what}" for which in ("a", "b") for what in ("x", "y", "width", "height"))
_BOX_LENGTHS = (0, 1, 2, 12, 13, 14)
_RELATIVE_COLUMNS = (
    *(f"{what}_{axis}" for what in ("delta", "gap", "overlap", "log_size_ratio") for axis in _AXES),
    "forward_a",
    "forward_b",
)
_VIEWED_COLUMNS = _RELATIVE_COLUMNS + tuple(
    f"{what}_{which}"
    for which in ("a", "b")
    for what in ("right", "up", "log_size_right", "log_size_up", "log_size_forward", "cut")
)
_VIEWED = 7
"""Columns of `describe_viewed_extents`."""
_NAMED_COLUMNS = _VIEWED_COLUMNS + tuple(
    f"{what}_{which}" for which in ("a", "b") for what in ("class_known", "log_class_least", "log_class_most")
)

FEATURES: dict[str, FeatureSet] = {
    "rel14": FeatureSet("rel14", _RELATIVE_COLUMNS, describe_extents, relative, tuple(range(6))),
    "rel26": FeatureSet("rel26", _VIEWED_COLUMNS, describe_viewed_extents, viewed, tuple(range(6))),
    "rel32": FeatureSet("rel32", _NAMED_COLUMNS, describe_named_extents, named, tuple(range(6)), (7, 8, 9), shown=True),
    "paper30": FeatureSet("paper30", _box_columns(), describe_raw_boxes, side_by_side, _BOX_LENGTHS),
    "canon30": FeatureSet("canon30", _box_columns(), describe_level_boxes, side_by_side, _BOX_LENGTHS),
    "geom2d8": FeatureSet("geom2d8", _FLAT_COLUMNS, describe_boxes_2d, side_by_side, (), shown=True),
}


@dataclass(frozen=True, eq=False)
class Appearance:
    """2D boxes and class names of a list of objects, in order."""

    bboxes: np.ndarray  # (N, 4) float64: x0, y0, x1, y1, pixels; right and bottom edges exclusive
    labels: tuple[str, ...]
    # width, height: Of the image, pixels
    width: int
    height: int
    ids: tuple[int, ...] = ()  # The detector's own identity of each, -1 for none; empty where they are not told

    def __post_init__(self) -> None:
        require(
            self.bboxes.shape == (len(self.labels), 4),
            "boxes and class names differ in number",
            got=f"{self.bboxes.shape} boxes, {len(self.labels)} names",
            expected="(N, 4) boxes and N names",
        )
        require(min(self.width, self.height) >= 1, "the image has no size", got=f"{self.width}x{self.height}")

    def take(self, index: Sequence[int]) -> Appearance:
        """Selected objects alone, in this order."""
        labels = tuple(self.labels[k] for k in index)
        ids = tuple(self.ids[k] for k in index) if self.ids else ()
        return Appearance(self.bboxes[list(index)].reshape(-1, 4), labels, self.width, self.height, ids)
