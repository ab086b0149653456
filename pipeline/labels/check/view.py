"""What a check of labels finds, the rules by name, and one frame of labels laid out for them.

Objects are in a row, relations as matrices over them.

Masks are read without trust: `pycocotools` writes where a code says, whatever its size; so every code is read here
first, and only a sound one is handed on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from pipeline.geometry.masks import MaskCrop, decode_crop, run_lengths
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.check.stream import Rows
from pipeline.language.naming import normal_form
from pipeline.language.noun_phrase import alone, same_names
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.relations.pair_measures import NOT_JUDGED
from pipeline.relations.relations import F, T, U, letter
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass


def state_letter(state: Any) -> str:
    """ "T", "U", "F", or any other number as text."""
    return letter(state) if state in (T, U, F) else str(int(state))


@dataclass(frozen=True)
class FrameView:
    """The rows of one frame."""

    index: int
    tables: dict[str, Rows]
    background: frozenset[str]
    """Normal forms of the background classes."""
    relation_names: tuple[str, ...]
    """The relations that the labels hold."""

    @cached_property
    def id(self) -> str | None:
        """Id of the frame, by any table."""
        for rows in self.tables.values():
            if len(rows) and rows["frame"][0] is not None:
                return str(rows["frame"][0])
        return None

    def finding(
        self,
        rule: str,
        objects: tuple[Any, ...],
        message: str,
        figures: dict[str, Any] | None = None,
        severity: Severity | None = None,
    ) -> Finding:
        """A finding of this frame, as severe as the rule says unless told otherwise.

        Figures become Python's own numbers; those that are not finite are left out, for JSON has none.
        """
        plain = ((k, v.item() if isinstance(v, np.generic) else v) for k, v in (figures or {}).items())
        return Finding(
            rule,
            severity or RULES[rule],
            self.id,
            tuple(int(o) for o in objects),
            message,
            {k: v for k, v in plain if not isinstance(v, float) or np.isfinite(v)},
        )

    def where(
        self,
        rule: str,
        chosen: np.ndarray,
        message: Callable[..., str],
        figures: Callable[..., dict[str, Any]] | None = None,
        error: np.ndarray | None = None,
    ) -> Iterator[Finding]:
        """Findings of the objects of (N,) or the pairs of (N, N) bool, in their order.

        `message` and `figures` take the rows of the objects; `error` (of the same shape) tells the errors from the
        warnings, where that is not as the rule says.
        """
        for at in np.argwhere(chosen).tolist():
            severity: Severity | None = None if error is None else "error" if error[tuple(at)] else "warning"
            told = {} if figures is None else figures(*at)
            yield self.finding(rule, tuple(self.ids[at]), message(*at), told, severity)

    def named(self, k: int) -> str:
        """Name of an object by row: "mug 3"."""
        return f"{self.labels[k]} {self.ids[k]}"

    def relation_text(self, a: int, relation: str, b: int) -> str:
        """Relation of two rows in words: "mug 3 left of laptop 5"."""
        return f"{self.named(a)} {PHRASE[relation]} {self.named(b)}"

    @property
    def objects(self) -> Rows:
        return self.tables["objects"]

    @property
    def relations(self) -> Rows:
        return self.tables["relations"]

    @property
    def expressions(self) -> Rows:
        return self.tables["expressions"]

    @cached_property
    def usable(self) -> bool:
        """Frame listed as usable."""
        frames = self.tables["frames"]
        return len(frames) > 0 and bool(frames["ok"][0])

    @cached_property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels; (0, 0) where unknown."""
        frames = self.tables["frames"]
        return (int(frames["height"][0]), int(frames["width"][0])) if len(frames) else (0, 0)

    @cached_property
    def K(self) -> np.ndarray | None:
        """(3, 3) intrinsics, if finite."""
        return self._of_frame("K", (3, 3))

    @cached_property
    def viewer(self) -> ViewerAxes | None:
        """Viewer's axes, if the up vector is valid."""
        up = self._of_frame("up", (3,))
        return None if up is None or np.linalg.norm(up) < 1e-6 else viewer_axes(up)

    def _of_frame(self, name: str, shape: tuple[int, ...]) -> np.ndarray | None:
        frames = self.tables["frames"]
        return None if not len(frames) or not np.isfinite(frames[name][0]).all() else frames[name][0].reshape(shape)

    @cached_property
    def ids(self) -> np.ndarray:
        """(N,) int64: the objects' numbers."""
        return self.objects["object"]

    @cached_property
    def labels(self) -> list[str]:
        return ["" if x is None else str(x) for x in self.objects["label"]]

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Row of an object by number."""
        return {int(number): k for k, number in reversed(list(enumerate(self.ids)))}

    @cached_property
    def alike(self) -> np.ndarray:
        """(N, N) bool: objects with names of the same meaning."""
        return same_names(self.labels)

    @cached_property
    def alone(self) -> np.ndarray:
        """(N,) bool: objects with a name of their own in the frame."""
        return alone(self.labels)

    @cached_property
    def related(self) -> np.ndarray:
        """(N,) bool: objects with relations."""
        return np.array([normal_form(label) not in self.background for label in self.labels], np.bool_)

    @cached_property
    def crops(self) -> list[MaskCrop | str | None]:
        """Masks of all objects, or the fault of the code; None without mask or frame size."""
        return (
            [None if code is None else read_mask(code, *self.size) for code in self.objects["mask"]]
            if all(self.size)
            else [None] * len(self.ids)
        )

    @cached_property
    def pair_rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of relations between two different known objects, and the indices of a and b; three (P,) int64."""
        none = np.zeros(0, np.int64)
        if not len(self.ids):
            return none, none, none
        order = np.argsort(self.ids, kind="stable")
        ids, numbers = self.ids[order], np.stack([self.relations["a"], self.relations["b"]])
        at = np.minimum(np.searchsorted(ids, numbers), len(ids) - 1)
        a, b = order[at]
        known = (ids[at] == numbers).all(axis=0) & (a != b)
        return np.flatnonzero(known), a[known], b[known]

    @cached_property
    def present(self) -> np.ndarray:
        """(N, N) bool: pairs with a row."""
        found = np.zeros((len(self.ids), len(self.ids)), np.bool_)
        _, a, b = self.pair_rows
        found[a, b] = True
        return found

    @cached_property
    def states(self) -> dict[str, np.ndarray]:
        """(N, N) int8 by relation; NOT_JUDGED if absent."""
        return {r: self._matrix(r, np.int8, NOT_JUDGED) for r in self.relation_names}

    @cached_property
    def margins(self) -> dict[str, np.ndarray]:
        """(N, N) float64 by relation; NaN if absent."""
        return {r: self._matrix(f"{r}_margin", np.float64, np.nan) for r in self.relation_names}

    @cached_property
    def distance(self) -> np.ndarray:
        """(N, N) float64 metres between the extents as stored, NaN if absent."""
        return self._matrix("distance", np.float64, np.nan)

    def doubted(self, relation: str) -> np.ndarray:
        """(N, N) bool: pairs left undecided by a second opinion."""
        bits = self._matrix("doubted", np.int64, 0)
        return (np.maximum(bits, 0) >> PAIRWISE.index(relation)) & 1 == 1

    def _matrix(self, column: str, kind: type, empty: float) -> np.ndarray:
        found = np.full((len(self.ids), len(self.ids)), empty, kind)
        rows, a, b = self.pair_rows
        found[a, b] = self.relations[column][rows]
        return found

    @cached_property
    def extents(self) -> tuple[np.ndarray, np.ndarray]:
        """lo and hi, (N, 3) float64 metres along (right, up, forward); NaN where unknown."""
        return self.objects["lo"], self.objects["hi"]


def read_mask(code: str, height: int, width: int) -> MaskCrop | str:
    """Decode a mask, or tell in words the fault of the code."""
    counts = run_lengths(code)
    if isinstance(counts, str):
        return counts
    if counts.sum() != height * width:
        return f"it is of {int(counts.sum())} pixels, and the frame has {height * width}"
    return decode_crop((height, width), code)


Severity = Literal["error", "warning"]
Figure = float | int | str


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or questionable, in labels."""

    rule: str
    """One of RULES."""
    severity: Severity
    """ "error" or "warning"."""
    frame: str | None
    """The frame's id; None where the finding is of a whole file."""
    objects: tuple[int, ...]
    """The objects it is about, by number; of a pair the first is the one that is said to be somewhere."""
    message: str
    """One sentence."""
    figures: dict[str, Figure] = field(default_factory=dict)
    """The numbers behind it."""


RULES: dict[str, Severity] = {
    # A table cannot be read as Parquet, is of another table or schema, or not in the order of its frames.
    "file/unreadable": "error",
    # A table or the manifest is not as it was written: edited by hand.
    "file/changed": "warning",
    # This release has other rules under the profile's name: geometry is not compared.
    "profile/changed": "warning",
    # A value is outside what the schema allows.
    "row/model": "error",
    # A number is NaN or infinite.
    "row/non-finite": "error",
    # Two rows have one key.
    "row/duplicate-key": "error",
    # A row names a frame or an object that does not exist.
    "row/dangling": "error",
    # Intrinsics, pose or up vector are not those of a camera.
    "frame/camera": "error",
    # Nothing says where up is: it was assumed, and every direction rests on it.
    "frame/up-assumed": "warning",
    # A frame's up vector, or its own level plane, is not that of most of its scene.
    "frame/up-disagrees": "warning",
    # Its things are all too large or too small: is the depth scale another?
    "frame/implausible-depth": "warning",
    # The frame's number of objects is not that of its rows.
    "frame/objects": "error",
    # A mask cannot be decoded, or is not of the frame's size or stated area.
    "object/mask": "error",
    # The rotation of a 3D box is not a rotation, or an edge is negative.
    "object/rotation": "error",
    # The 2D box lies elsewhere than the mask (off by a part: warning).
    "object/bbox-mask": "error",
    # The 3D box lies elsewhere in the picture than the mask (off by a part: warning).
    "object/box-mask": "error",
    # The extents are not those of the 3D box (off by a part: warning).
    "object/extent-box": "error",
    # Two objects are one thing (under different names: warning).
    "object/duplicate": "error",
    # An object that may be asked for has fewer than 100 points.
    "object/few-points": "warning",
    # Most pixels of an object that may be asked for have no depth.
    "object/no-depth": "warning",
    # The image border cuts an object that may be asked for.
    "object/border": "warning",
    # It is larger than its class can be (smaller or unlike its kind: warning).
    "object/implausible-size": "error",
    # Most other views of the same object call it another class.
    "object/other-views": "warning",
    # Most other views of the same object place it elsewhere.
    "object/other-places": "warning",
    # Its mask is not what other views of the same object show there; compared where the pictures are given.
    "object/other-masks": "warning",
    # A is left of b, and b is not right of a; so for above and below, front and behind.
    "relation/inverse": "error",
    # A relation holds both ways (on and in, where geometry allows it: warning).
    "relation/antisymmetry": "error",
    # Two opposite relations hold of one pair.
    "relation/exclusive": "error",
    # A pair of objects, or the state of a labelled relation, is missing.
    "relation/pair-missing": "error",
    # What does not change with the viewpoint is another in another view of the same objects.
    "relation/other-views": "warning",
    # A relation of an object with itself or with a background class.
    "relation/unexpected": "error",
    # A relation leads back to its start (on and in, where geometry allows it: warning).
    "relation/cycle": "error",
    # A state contradicts the extents (where one of the two is U, and margins: warning).
    "relation/geometry": "error",
    # An expression without targets, or whose own target is not among them.
    "expression/empty": "error",
    # All objects of the target's class are acceptable: it tells nothing apart.
    "expression/everything": "warning",
    # The relation that the expression states does not hold.
    "expression/state": "error",
    # The expression's margin is not that of its relation.
    "expression/margin": "warning",
    # Targets or acceptable objects are not those that the relations give.
    "expression/sets": "error",
    # Target or reference is not called what the object is called.
    "expression/class": "error",
    # The text does not read back as target, relation and reference.
    "expression/unreadable": "error",
    # The text says `the` of a name that several objects of the frame have.
    "expression/article": "warning",
    # The flag `ambiguous` does not fit the acceptable objects.
    "expression/ambiguous": "error",
    # An expression names an object that may not be asked for.
    "expression/unusable": "error",
}
"""All rules by name, with the worst that each reports."""


def chosen_rules(names: Sequence[str] | None) -> frozenset[str]:
    """The rules of the names given: of a rule or of a whole group, such as "relation"; all for None.

    Raises InputError: a name is neither.
    """
    if names is None:
        return frozenset(RULES)
    found: set[str] = set()
    for name in names:
        members = {rule for rule in RULES if name in (rule, rule.split("/")[0])}
        if not members:
            known = (*(r.split("/")[0] for r in RULES), *RULES)
            raise InputError("no such rule", got=repr(name), expected=" | ".join(dict.fromkeys(known)))
        found |= members
    return frozenset(found)


def finding_record(finding: Finding) -> dict[str, Any]:
    """A finding as JSON: plain values only."""
    return {**asdict(finding), "objects": list(finding.objects)}
