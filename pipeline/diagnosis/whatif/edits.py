"""Edits: what is changed of a frame's detections, their geometry, their probabilities and the settings.

An edit refers to objects by the keys of `pipeline.diagnosis.whatif.keys`. What it means:

- hidden: as if the detector had not found the object; the next best moves up.
- masks: the pixels are lifted anew, with the whole cleaning; the 2D box becomes that of the pixels.
- boxes: the object's points move with its box by one affine map; its mask and 2D box stay the detector's.
- confidences: P(object | name) of a candidate, after any calibration. Who is a candidate does not depend on it.
- relations: P("a RELATION b") of that one ordered pair; its mirror image stays.
- k, min_score: which detections go on. A detector whose detections are the truth is not cut.
- rank, profile, lift: fields of RankConfig, Profile and LiftConfig by name; the rest as it was.
- scorer: what `make_scorer` takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from pipeline.diagnosis.whatif.settings_check import checked_lift, checked_profile, checked_rank
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import decode_run_length, encode_run_length
from pipeline.system.errors import InputError

Three = tuple[float, float, float]


@dataclass(frozen=True)
class PlacedBox:
    """A 3D box as plain numbers, camera frame, metres; `R` row by row.

    Attributes
    ----------
    center, size : three floats
    R : three times three floats
    """

    center: Three
    R: tuple[Three, Three, Three]
    size: Three

    @staticmethod
    def of(box: Box3D) -> PlacedBox:
        """The same box."""
        rows = tuple(tuple(row) for row in box.R.tolist())
        return PlacedBox(tuple(box.center.tolist()), rows, tuple(box.size.tolist()))  # pyright: ignore

    def box(self) -> Box3D:
        """The box; InputError where it is none."""
        return Box3D(np.array(self.center), np.array(self.R), np.array(self.size))


@dataclass(frozen=True)
class RunLengthMask:
    """A mask in COCO's compressed run-length code.

    Attributes
    ----------
    size : (int, int)
        Height and width, pixels.
    counts : str
    """

    size: tuple[int, int]
    counts: str

    @staticmethod
    def of(mask: np.ndarray) -> RunLengthMask:
        """The code of a mask ((H, W) bool)."""
        return RunLengthMask((int(mask.shape[0]), int(mask.shape[1])), encode_run_length(np.ascontiguousarray(mask)))

    def decoded(self, height: int, width: int, key: str) -> np.ndarray:
        """(H, W) bool; InputError where it is not of a picture of that size."""
        if self.size != (height, width):
            raise InputError(
                f"the mask of {key} is of another picture size", got=list(self.size), expected=f"[{height}, {width}]"
            )
        return decode_run_length(self.size, self.counts, f"the mask of {key}")


@dataclass(frozen=True)
class Edits:
    """All edits of a view; `Edits()` has none. Made by `read_edits` or by the functions below, which check.

    Attributes
    ----------
    boxes : mapping of key to PlacedBox
    masks : mapping of key to RunLengthMask
    hidden : frozenset of key
    confidences : mapping of (name, key) to float
        0..1; the name as it is asked in the expression.
    relations : mapping of (relation, key of a, key of b) to float
        0..1.
    k : int or None
    min_score : float or None
    rank, profile, lift : mapping of field name to value
    scorer : str or None
    """

    boxes: Mapping[str, PlacedBox] = field(default_factory=dict)
    masks: Mapping[str, RunLengthMask] = field(default_factory=dict)
    hidden: frozenset[str] = frozenset()
    confidences: Mapping[tuple[str, str], float] = field(default_factory=dict)
    relations: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    k: int | None = None
    min_score: float | None = None
    rank: Mapping[str, Any] = field(default_factory=dict)
    profile: Mapping[str, Any] = field(default_factory=dict)
    lift: Mapping[str, Any] = field(default_factory=dict)
    scorer: str | None = None

    def __bool__(self) -> bool:
        """Whether anything is edited."""
        return any(getattr(self, f.name) not in (None, {}, frozenset()) for f in fields(self))

    @property
    def keys(self) -> frozenset[str]:
        """All objects that an edit names."""
        ends = {key for _, a, b in self.relations for key in (a, b)}
        return frozenset({*self.boxes, *self.masks, *self.hidden, *(key for _, key in self.confidences), *ends})

    def with_box(self, key: str, box: Box3D) -> Edits:
        """The object's 3D box is this one (camera frame)."""
        return replace(self, boxes={**self.boxes, key: PlacedBox.of(box)})

    def with_mask(self, key: str, mask: np.ndarray) -> Edits:
        """The object's pixels are these ((H, W) bool)."""
        if mask.ndim != 2 or mask.dtype != np.bool_:
            raise InputError("a mask must be bool (H, W)", got=f"{mask.dtype} {mask.shape}")
        return replace(self, masks={**self.masks, key: RunLengthMask.of(mask)})

    def with_hidden(self, key: str) -> Edits:
        """The object was not found."""
        return replace(self, hidden=self.hidden | {key})

    def with_shown(self, key: str) -> Edits:
        """The object is not hidden any more."""
        return replace(self, hidden=self.hidden - {key})

    def with_confidence(self, name: str, key: str, p: float) -> Edits:
        """P(object | name) is `p`."""
        return replace(self, confidences={**self.confidences, (name, key): probability(p)})

    def with_relation(self, relation: str, a: str, b: str, p: float) -> Edits:
        """P("a RELATION b") is `p`."""
        if a == b:
            raise InputError("a relation is between two objects", got=f"{a} twice")
        return replace(self, relations={**self.relations, (relation, a, b): probability(p)})

    def with_k(self, k: int | None) -> Edits:
        """So many proposals of each name go on; None for the setting's own number."""
        if k is not None and k < 1:
            raise InputError("at least one proposal must go on for each name", got=f"k={k}")
        return replace(self, k=k)

    def with_min_score(self, score: float | None) -> Edits:
        """Detections below are dropped; None for the detector's own threshold."""
        return replace(self, min_score=None if score is None else probability(score))

    def with_rank(self, **values: Any) -> Edits:
        """Fields of RankConfig."""
        return replace(self, rank=checked_rank({**self.rank, **values}))

    def with_profile(self, **values: Any) -> Edits:
        """Fields of `relations.Profile`."""
        return replace(self, profile=checked_profile({**self.profile, **values}))

    def with_lift(self, **values: Any) -> Edits:
        """Fields of LiftConfig."""
        return replace(self, lift=checked_lift({**self.lift, **values}))

    def with_scorer(self, scorer: str | None) -> Edits:
        """What scores relations: "rule", "trained", or the path of a network."""
        return replace(self, scorer=scorer)

    def without(self, key: str) -> Edits:
        """Everything that names the object is taken back."""
        return replace(
            self,
            boxes={k: v for k, v in self.boxes.items() if k != key},
            masks={k: v for k, v in self.masks.items() if k != key},
            hidden=self.hidden - {key},
            confidences={k: v for k, v in self.confidences.items() if k[1] != key},
            relations={k: v for k, v in self.relations.items() if key not in k[1:]},
        )


def probability(p: float) -> float:
    """`p` as a float; InputError outside 0..1."""
    if not 0.0 <= p <= 1.0:
        raise InputError("a probability must lie in 0..1", got=p)
    return float(p)
