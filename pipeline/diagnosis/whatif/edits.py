"""Edits of a frame's detections, their geometry, their probabilities and the settings.

An edit refers to objects by the keys of `pipeline.diagnosis.whatif.pair_tables`. What it means:

- hidden: as if the detector had not found the object; the next best moves up.
- added: as if the detector had found an object of these pixels, asked for a name; it goes on whatever K is.
- masks: the pixels are lifted anew, with the whole cleaning; the 2D box becomes that of the pixels.
- boxes: the object's points move with its box by one affine map; its mask and 2D box stay the detector's.
- confidences: P(object | name) of a candidate, after any calibration. Who is a candidate does not depend on it.
- relations: P("a RELATION b") of that one ordered pair; its mirror image stays.
- k, min_score: which detections go on. A detector whose detections are the truth is not cut.
- rank, profile, lift: fields of RankConfig, Profile and LiftConfig by name; the rest as it was.
- scorer: what `make_scorer` takes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter

from pipeline.answering.ranking import RankConfig
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.cleaning import LiftConfig
from pipeline.geometry.masks import RunLength
from pipeline.relations.relations import Profile
from pipeline.system.errors import InputError, as_input_error, in_file, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked
from pipeline.system.safe_files import parse_json, read_bytes

Record = dict[str, Any]
_T = TypeVar("_T")

FORMAT = "spatialviz-edits-1"
MOST_EDITS = 2000
"""Of one kind; a page cannot make more by hand."""
FAR = 1000.0
LARGEST_SIDE = 16384

Key = Annotated[str, Field(min_length=1, max_length=300)]
Number = Annotated[float, Field(ge=-FAR, le=FAR)]
Length = Annotated[float, Field(ge=0, le=FAR)]
Share = Annotated[float, Field(ge=0, le=1)]
Three = tuple[float, float, float]
Axis = tuple[Number, Number, Number]


_LARGEST_LENGTH = 100.0
_ANGLES = ("cone", "doubtful_cone", "elevation", "elevation_doubtful")
_LIFT_BOUNDS: dict[str, tuple[float, float]] = {
    "near": (0, _LARGEST_LENGTH),
    "far": (0, _LARGEST_LENGTH),
    "edge": (0, _LARGEST_LENGTH),
    "edge_relative": (0, _LARGEST_LENGTH),
    "erode": (0, 50),
    "erode_keep": (0, 1),
    "part": (0, 1),
    "min_pixels": (1, 1_000_000),
    "max_points": (1, 100_000),
}


def checked_rank(values: Mapping[str, Any]) -> dict[str, Any]:
    """Check fields of RankConfig; InputError for an unknown field, or a weight outside 0..1000."""
    return _checked(RankConfig, values, "rank", lambda name: None if name == "aggregate" else (0, 1000))


def checked_profile(values: Mapping[str, Any]) -> dict[str, Any]:
    """Check fields of Profile; InputError for an unknown field, a value out of range, or reversed bands."""
    found = _checked(
        Profile,
        values,
        "profile",
        lambda name: (1e-6 if name == "min_extent" else 0.0, 90.0 if name in _ANGLES else _LARGEST_LENGTH),
    )
    whole = Profile(**found)
    for wider, narrower in (
        ("doubtful_cone", "cone"),
        ("elevation", "elevation_doubtful"),
        ("overlap_excludes", "overlap_doubts"),
        ("plan_overlap", "plan_overlap_doubtful"),
        ("in_share", "in_share_doubtful"),
        ("near_diagonals_doubtful", "near_diagonals"),
    ):
        require(
            getattr(whole, wider) >= getattr(whole, narrower),
            f"{wider} must be at least {narrower}",
            got=f"{getattr(whole, wider)}",
        )
    require(
        whole.gap_switch_band[0] <= whole.gap_switch_band[1],
        "gap_switch_band must be from low to high",
        got=list(whole.gap_switch_band),
    )
    return found


def checked_lift(values: Mapping[str, Any]) -> dict[str, Any]:
    """Check fields of LiftConfig; InputError for an unknown field, or a value out of range."""
    found = _checked(LiftConfig, values, "lift", _LIFT_BOUNDS.get)
    whole = LiftConfig(**found)
    require(whole.near < whole.far, "near must be less than far", got=f"{whole.near} and {whole.far}")
    return found


def _checked(
    kind: type, values: Mapping[str, Any], where: str, bounds: Callable[[str], tuple[float, float] | None]
) -> dict[str, Any]:
    """Check the fields of a dataclass, each within its bounds, if any."""
    known = [f.name for f in fields(kind)]
    for name in values:
        require(name in known, f"{where} has no setting {name!r}", expected=", ".join(known))
    with as_input_error(f"{where}: a value is no finite number", TypeError, ValueError, got=str):
        text = json.dumps(dict(values), allow_nan=False)
    whole = checked(partial(adapter(kind).validate_json, strict=True), text, f"{where}: {{}} cannot be this")
    found = {name: getattr(whole, name) for name in values}
    for name, value in found.items():
        least, most = bounds(name) or (-np.inf, np.inf)
        for number in value if isinstance(value, tuple) else (value,):
            require(
                not (bounds(name) and not least <= number <= most),
                f"{name} is out of range",
                got=number,
                expected=f"{least:g} to {most:g}",
            )
    return found


@cache
def adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


CHECKS = {"rank": checked_rank, "profile": checked_profile, "lift": checked_lift}
"""Of each group of settings."""


@dataclass(frozen=True)
class PlacedBox:
    """3D box as plain numbers, camera frame, metres; `R` row by row."""

    center: Axis  # Camera frame, metres
    R: tuple[Axis, Axis, Axis]  # Three rows; the columns are the box's axes
    size: tuple[Length, Length, Length]  # Full edge lengths along those, metres

    def __post_init__(self) -> None:
        self.box()

    @staticmethod
    def of(box: Box3D) -> PlacedBox:
        """Plain numbers of a box."""
        rows = tuple(tuple(row) for row in box.R.tolist())
        return PlacedBox(tuple(box.center.tolist()), rows, tuple(box.size.tolist()))  # pyright: ignore

    def box(self) -> Box3D:
        """Box of these numbers; InputError for no box."""
        return Box3D(np.array(self.center), np.array(self.R), np.array(self.size))


def _of_a_picture(mask: RunLength) -> RunLength:
    require(
        1 <= min(mask.size) <= max(mask.size) <= LARGEST_SIDE,
        "a mask is of no picture",
        got=list(mask.size),
        expected=f"sides of 1 to {LARGEST_SIDE} pixels",
    )
    return mask


_Mask = Annotated[RunLength, AfterValidator(_of_a_picture)]


@dataclass(frozen=True)
class AddedObject:
    """Object as if found: by which name, with which score, and its pixels."""

    name: Key  # As it is asked in the expression
    p: Share  # P(object | name)
    mask: _Mask  # Its pixels


@dataclass(frozen=True)
class _Confidence:
    """P(object | name), as in a file."""

    name: Key  # As it is asked in the expression
    object: Key  # Key of the object
    p: Share  # 0..1


@dataclass(frozen=True)
class _Relation:
    """P("a RELATION b"), as in a file."""

    relation: Key  # Its name
    a: Key  # Key of the object that it is said of
    b: Key  # Key of its reference
    p: Share  # 0..1

    def __post_init__(self) -> None:
        require(self.a != self.b, "a relation is between two objects", got=f"{self.a} twice")


def _each_once(entries: Sequence[_Confidence | _Relation]) -> dict[tuple[str, ...], float]:
    """Probabilities by subject, each once."""
    found = {tuple(vars(entry).values())[:-1]: entry.p for entry in entries}
    require(len(found) >= len(entries), "the edits give one and the same probability twice")
    return found


if TYPE_CHECKING:
    _Confidences = Mapping[tuple[str, str], float]
    _Relations = Mapping[tuple[str, str, str], float]
else:
    _Confidences = Annotated[list[_Confidence], Field(max_length=MOST_EDITS), AfterValidator(_each_once)]
    _Relations = Annotated[list[_Relation], Field(max_length=MOST_EDITS), AfterValidator(_each_once)]


@dataclass(frozen=True)
class Edits:
    """Edits of a view; `Edits()` is empty. Made by `read_edits` or by the checked methods below."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    format: Literal["spatialviz-edits-1"] = FORMAT  # Of the file
    # 3D boxes by the object's key
    boxes: Annotated[Mapping[Key, PlacedBox], Field(max_length=MOST_EDITS)] = field(default_factory=dict)
    # Pixels by the object's key
    masks: Annotated[Mapping[Key, _Mask], Field(max_length=MOST_EDITS)] = field(default_factory=dict)
    # Keys of objects, as if the detector had not found them
    hidden: Annotated[frozenset[Key], Field(max_length=MOST_EDITS)] = frozenset()
    # Objects by new keys, as if the detector had found them
    added: Annotated[Mapping[Key, AddedObject], Field(max_length=MOST_EDITS)] = field(default_factory=dict)
    # P(object | name) by name and key, 0..1; the name as it is asked in the expression
    confidences: _Confidences = field(default_factory=dict)
    relations: _Relations = field(default_factory=dict)  # P by relation, key of a, key of b; 0..1
    k: Annotated[int, Field(ge=1, le=100_000)] | None = None  # Proposals that go on for each name
    min_score: Share | None = None  # Drop detections below this score
    # Settings of the ranking by name: fields of RankConfig
    rank: Annotated[Mapping[str, Any], AfterValidator(checked_rank)] = field(default_factory=dict)
    # Thresholds of the rules by name: fields of Profile
    profile: Annotated[Mapping[str, Any], AfterValidator(checked_profile)] = field(default_factory=dict)
    # Settings of the lifting by name: fields of LiftConfig
    lift: Annotated[Mapping[str, Any], AfterValidator(checked_lift)] = field(default_factory=dict)
    # What scores relations: rule, trained, or an ONNX file
    scorer: Annotated[str, Field(min_length=1, max_length=4096)] | None = None

    def __bool__(self) -> bool:
        """True with any edit."""
        return self != Edits()

    @property
    def keys(self) -> frozenset[str]:
        """Objects named by any edit."""
        ends = {key for _, a, b in self.relations for key in (a, b)}
        return frozenset(
            {*self.boxes, *self.masks, *self.hidden, *self.added, *(key for _, key in self.confidences), *ends}
        )

    def with_box(self, key: str, box: Box3D) -> Edits:
        """Set the object's 3D box (camera frame)."""
        return replace(self, boxes={**self.boxes, key: PlacedBox.of(box)})

    def with_mask(self, key: str, mask: np.ndarray) -> Edits:
        """Set the object's pixels ((H, W) bool)."""
        require(
            mask.ndim == 2 and mask.dtype == np.bool_, "a mask must be bool (H, W)", got=f"{mask.dtype} {mask.shape}"
        )
        return replace(self, masks={**self.masks, key: RunLength.of(mask)})

    def with_hidden(self, key: str) -> Edits:
        """Hide the object, as if not found; an added one is gone."""
        if key in self.added:
            return replace(self, added={k: entry for k, entry in self.added.items() if k != key})
        return replace(self, hidden=self.hidden | {key})

    def with_added(self, name: str, mask: np.ndarray | RunLength, p: float) -> Edits:
        """Add an object of these pixels, found by a name with this score; its key is the next free "+N"."""
        code = mask if isinstance(mask, RunLength) else RunLength.of(mask)
        key = next(f"+{n}" for n in range(1, MOST_EDITS + 2) if f"+{n}" not in self.added)
        return replace(self, added={**self.added, key: AddedObject(name, probability(p), code)})

    def with_shown(self, key: str) -> Edits:
        """Show a hidden object again."""
        return replace(self, hidden=self.hidden - {key})

    def with_confidence(self, name: str, key: str, p: float) -> Edits:
        """Set P(object | name)."""
        return replace(self, confidences={**self.confidences, (name, key): probability(p)})

    def with_relation(self, relation: str, a: str, b: str, p: float) -> Edits:
        """Set P("a RELATION b")."""
        require(a != b, "a relation is between two objects", got=f"{a} twice")
        return replace(self, relations={**self.relations, (relation, a, b): probability(p)})

    def with_k(self, k: int | None) -> Edits:
        """Set the number of proposals of each name; None for the setting's own number."""
        require(k is None or k >= 1, "at least one proposal must go on for each name", got=f"k={k}")
        return replace(self, k=k)

    def with_min_score(self, score: float | None) -> Edits:
        """Drop detections below a score; None for the detector's own threshold."""
        return replace(self, min_score=None if score is None else probability(score))

    def with_settings(self, group: Literal["rank", "profile", "lift"], **values: Any) -> Edits:
        """Set fields of RankConfig, of `relations.Profile` or of LiftConfig."""
        return replace(self, **{group: CHECKS[group]({**getattr(self, group), **values})})

    def with_scorer(self, scorer: str | None) -> Edits:
        """Set the relation scorer: "rule", "trained", or the path of a network."""
        return replace(self, scorer=scorer)


def probability(p: float) -> float:
    """Check a probability; InputError outside 0..1."""
    require(0.0 <= p <= 1.0, "a probability must lie in 0..1", got=p)
    return float(p)


def edits_record(edits: Edits) -> Record:
    """JSON object of edits, without unedited fields.

    >>> edits_record(Edits().with_k(3).with_confidence("mug", "#4", 0.2))
    {'format': 'spatialviz-edits-1', 'confidences': [{'name': 'mug', 'object': '#4', 'p': 0.2}], 'k': 3}
    """
    record: Record = {
        "format": FORMAT,
        "boxes": {
            key: {"center": list(b.center), "R": [list(row) for row in b.R], "size": list(b.size)}
            for key, b in sorted(edits.boxes.items())
        },
        "masks": {key: {"size": list(m.size), "counts": m.counts} for key, m in sorted(edits.masks.items())},
        "hidden": sorted(edits.hidden),
        "added": {
            key: {"name": a.name, "p": a.p, "mask": {"size": list(a.mask.size), "counts": a.mask.counts}}
            for key, a in sorted(edits.added.items())
        },
        "confidences": [{"name": n, "object": key, "p": p} for (n, key), p in sorted(edits.confidences.items())],
        "relations": [{"relation": r, "a": a, "b": b, "p": p} for (r, a, b), p in sorted(edits.relations.items())],
        "k": edits.k,
        "min_score": edits.min_score,
        **{
            name: {k: list(v) if isinstance(v, tuple) else v for k, v in sorted(getattr(edits, name).items())}
            for name in ("rank", "profile", "lift")
        },
        "scorer": edits.scorer,
    }
    return {name: value for name, value in record.items() if value not in (None, {}, [])}


def read_edits(record: Record | str | bytes) -> Edits:
    """Read edits from a JSON object, or from its text."""
    return validated(Edits, record, "the edits")


def load_edits(path: str | Path) -> Edits:
    """Read edits from a file; InputError for an unreadable file, or one without edits."""
    path, unreadable = Path(path), "the edits cannot be read"
    with in_file(path), as_input_error(unreadable, OSError, got=lambda error: error.strerror):
        return read_edits(read_bytes(path, "text"))


def validated(kind: type[_T], record: Record | str | bytes, what: str) -> _T:
    """Validate a JSON object, or its text, as a dataclass; InputError in one line otherwise."""
    try:
        value = parse_json(record) if isinstance(record, str | bytes) else record
        # Once more through JSON: infinities (1e999) and what is not JSON end here.
        text = json.dumps(value, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{what} cannot be read as JSON", got=str(error)[:120]) from error

    def known(place: tuple[Any, ...]) -> list[str]:
        return [f.name for f in fields(kind)] if len(place) == 1 else []  # pyright: ignore

    return checked(partial(adapter(kind).validate_json, strict=True), text, f"{what}: {{}} cannot be this", keys=known)
