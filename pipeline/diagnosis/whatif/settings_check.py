"""Settings by field name, checked once: the fields of RankConfig, Profile and LiftConfig that an edit changes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from pipeline.answering.ranking import RankConfig
from pipeline.geometry.lifting import LiftConfig
from pipeline.relations.relations import Profile
from pipeline.system.errors import InputError

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
    """Fields of RankConfig; InputError for an unknown one, or a weight outside 0..1000."""
    found = _checked(RankConfig, values, "rank")
    for name, value in found.items():
        if name != "aggregate":
            _within(name, value, 0, 1000)
    return found


def checked_profile(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of Profile; InputError for an unknown one, one out of range, or bands the wrong way round."""
    found = _checked(Profile, values, "profile")
    for name, value in found.items():
        for number in value if isinstance(value, tuple) else (value,):
            least = 1e-6 if name == "min_extent" else 0.0
            _within(name, number, least, 90.0 if name in _ANGLES else _LARGEST_LENGTH)
    whole = Profile(**found)
    for wider, narrower in (
        ("doubtful_cone", "cone"),
        ("elevation", "elevation_doubtful"),
        ("overlap_excludes", "overlap_doubts"),
        ("plan_overlap", "plan_overlap_doubtful"),
        ("in_share", "in_share_doubtful"),
        ("near_diagonals_doubtful", "near_diagonals"),
    ):
        if getattr(whole, wider) < getattr(whole, narrower):
            raise InputError(f"{wider} must be at least {narrower}", got=f"{getattr(whole, wider)}")
    if whole.gap_switch_band[0] > whole.gap_switch_band[1]:
        raise InputError("gap_switch_band must be from low to high", got=list(whole.gap_switch_band))
    return found


def checked_lift(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of LiftConfig; InputError for an unknown one, or one out of range."""
    found = _checked(LiftConfig, values, "lift")
    for name, value in found.items():
        if name in _LIFT_BOUNDS:
            _within(name, value, *_LIFT_BOUNDS[name])
    whole = LiftConfig(**found)
    if whole.near >= whole.far:
        raise InputError("near must be less than far", got=f"{whole.near} and {whole.far}")
    return found


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _checked(kind: type, values: Mapping[str, Any], where: str) -> dict[str, Any]:
    known = [f.name for f in fields(kind)]
    for name in values:
        if name not in known:
            raise InputError(f"{where} has no setting {name!r}", expected=", ".join(known))
    try:
        whole = _adapter(kind).validate_json(json.dumps(dict(values), allow_nan=False), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        index = ".".join(str(p) for p in first["loc"])
        got = repr(first["input"])[:80]
        raise InputError(f"{where}: {index} cannot be this", got=got, expected=first["msg"]) from error
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: a value is no finite number", got=str(error)) from error
    return {name: getattr(whole, name) for name in values}


def _within(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise InputError(f"{name} is out of range", got=value, expected=f"{least:g} to {most:g}")
