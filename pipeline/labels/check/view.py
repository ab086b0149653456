"""One frame of labels, laid out for the rules: objects in a row, relations as matrices over them.

Masks are read without trust: `pycocotools` writes where a code says, whatever its size; so every code is read here
first, and only a sound one is handed on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.geometry.masks import decode_crop, run_lengths
from pipeline.geometry.viewer import ViewerAxes, viewer_axes
from pipeline.labels.check.findings import RULES, Figure, Finding, Severity
from pipeline.labels.check.stream import Rows
from pipeline.language.naming import normal_form
from pipeline.language.noun_phrase import alone, same_names
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.relations.pair_measures import NOT_JUDGED
from pipeline.relations.relations import F, T, U, letter


def plain_figures(figures: dict[str, Figure]) -> dict[str, Figure]:
    """Figures as Python's own numbers; those that are not finite are left out, for JSON has none."""
    plain = ((k, v.item() if isinstance(v, np.generic) else v) for k, v in figures.items())
    return {k: v for k, v in plain if not isinstance(v, float) or np.isfinite(v)}


def pairs_where(chosen: np.ndarray) -> list[tuple[int, int]]:
    """Rows and columns of the true entries of (N, N) bool, row by row."""
    rows, columns = np.nonzero(chosen)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def indices_where(chosen: np.ndarray) -> list[int]:
    """Indices of the true entries of (N,) bool."""
    return np.flatnonzero(chosen).tolist()


def state_letter(state: int) -> str:
    """ "T", "U", "F", or a number that is none of the three as it is."""
    return letter(state) if state in (T, U, F) else str(int(state))


@dataclass(frozen=True)
class FrameView:
    """The rows of one frame.

    Attributes
    ----------
    index : int
    tables : dict of str to Rows
    background : frozenset of str
        Normal forms of the background classes.
    relation_names : tuple of str
        The relations that the labels hold.
    """

    index: int
    tables: dict[str, Rows]
    background: frozenset[str]
    relation_names: tuple[str, ...]

    @cached_property
    def id(self) -> str | None:
        """The frame's id, from whichever table has it."""
        for rows in self.tables.values():
            if len(rows) and rows["frame"][0] is not None:
                return str(rows["frame"][0])
        return None

    def finding(
        self,
        rule: str,
        objects: tuple[Any, ...],
        message: str,
        figures: dict[str, Figure] | None = None,
        severity: Severity | None = None,
    ) -> Finding:
        """A finding of this frame, as severe as the rule says unless told otherwise."""
        return Finding(
            rule,
            severity or RULES[rule].severity,
            self.id,
            tuple(int(o) for o in objects),
            message,
            plain_figures(figures or {}),
        )

    def named(self, k: int) -> str:
        """An object in words, by its row: "mug 3"."""
        return f"{self.labels[k]} {self.ids[k]}"

    def relation_text(self, a: int, relation: str, b: int) -> str:
        """A relation in words, by the rows of its objects: "mug 3 left of laptop 5"."""
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
        """The frame has a row that says it could be used."""
        frames = self.tables["frames"]
        return len(frames) > 0 and bool(frames["ok"][0])

    @cached_property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels; (0, 0) where unknown."""
        frames = self.tables["frames"]
        return (int(frames["height"][0]), int(frames["width"][0])) if len(frames) else (0, 0)

    @cached_property
    def K(self) -> np.ndarray | None:
        """(3, 3) intrinsics, where they are finite."""
        return self._of_frame("K", (3, 3))

    @cached_property
    def viewer(self) -> ViewerAxes | None:
        """The viewer's axes, where the up vector is one."""
        up = self._of_frame("up", (3,))
        return None if up is None or np.linalg.norm(up) < 1e-6 else viewer_axes(up)

    def _of_frame(self, name: str, shape: tuple[int, ...]) -> np.ndarray | None:
        frames = self.tables["frames"]
        if not len(frames) or not np.isfinite(frames[name][0]).all():
            return None
        return frames[name][0].reshape(shape)

    @cached_property
    def ids(self) -> np.ndarray:
        """(N,) int64: the objects' numbers."""
        return self.objects["object"]

    @cached_property
    def labels(self) -> list[str]:
        return ["" if x is None else str(x) for x in self.objects["label"]]

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Row of an object by its number."""
        return {int(number): k for k, number in reversed(list(enumerate(self.ids)))}

    @cached_property
    def alike(self) -> np.ndarray:
        """(N, N) bool: objects whose names mean the same."""
        return same_names(self.labels)

    @cached_property
    def alone(self) -> np.ndarray:
        """(N,) bool: objects whose name means no other one of the frame."""
        return alone(self.labels)

    @cached_property
    def related(self) -> np.ndarray:
        """(N,) bool: objects that take part in relations."""
        return np.array([normal_form(label) not in self.background for label in self.labels], np.bool_)

    @cached_property
    def runs(self) -> list[MaskRuns | str | None]:
        """Each object's mask as its code says, or why it cannot be read; None without a mask or a frame's size."""
        if not all(self.size):
            return [None] * len(self.ids)
        return [None if code is None else read_runs(code, *self.size) for code in self.objects["mask"]]

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
        """(N, N) bool: pairs that have a row."""
        found = np.zeros((len(self.ids), len(self.ids)), np.bool_)
        _, a, b = self.pair_rows
        found[a, b] = True
        return found

    @cached_property
    def states(self) -> dict[str, np.ndarray]:
        """(N, N) int8 by relation; NOT_JUDGED where there is none."""
        return {r: self._matrix(r, np.int8, NOT_JUDGED) for r in self.relation_names}

    @cached_property
    def margins(self) -> dict[str, np.ndarray]:
        """(N, N) float64 by relation; NaN where there is none."""
        return {r: self._matrix(f"{r}_margin", np.float64, np.nan) for r in self.relation_names}

    @cached_property
    def distance(self) -> np.ndarray:
        """(N, N) float64 metres between the extents as stored, NaN where there is none."""
        return self._matrix("distance", np.float64, np.nan)

    def doubted(self, relation: str) -> np.ndarray:
        """(N, N) bool: pairs of which a second opinion left a relation undecided."""
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


@dataclass(frozen=True)
class MaskRuns:
    """A mask as its code says.

    Attributes
    ----------
    area : int
        Pixels.
    bbox : (4,) float64
        x0, y0, x1, y1, edges exclusive; zeros for an empty mask.
    """

    area: int
    bbox: np.ndarray


def read_runs(code: str, height: int, width: int) -> MaskRuns | str:
    """Area and extents of a mask, or in words why its code is none of that size."""
    counts = run_lengths(code)
    if isinstance(counts, str):
        return counts
    if counts.sum() != height * width:
        return f"it is of {int(counts.sum())} pixels, and the frame has {height * width}"
    crop = decode_crop((height, width), code)
    h, w = crop.mask.shape
    return MaskRuns(int(crop.mask.sum()), np.array([crop.x, crop.y, crop.x + w, crop.y + h], np.float64))


def runs_object(code: str, height: int, width: int) -> Any:
    """A code that `read_runs` accepts, as pycocotools takes it."""
    return {"size": [height, width], "counts": code.encode("ascii")}
