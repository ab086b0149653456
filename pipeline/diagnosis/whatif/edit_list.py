"""All edits of a view one by one: what each says, and the edits without it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace

from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.settings_check import checked_lift, checked_profile, checked_rank
from pipeline.language.relation_names import PHRASE
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class Edit:
    """One edit.

    Attributes
    ----------
    id : str
        Names it among the edits of its view.
    said : str
        What is changed, in words.
    key : str or None
        Of the object; None for a setting, and for a relation that of its first end.
    """

    id: str
    said: str
    key: str | None = None


def each_edit(edits: Edits, named: Callable[[str], str] = str) -> tuple[Edit, ...]:
    """Every edit in a fixed order; `named` gives the word for an object's key."""
    found = [Edit(_id("boxes", k), f"{named(k)}: its box", k) for k in edits.boxes]
    found += [Edit(_id("masks", k), f"{named(k)}: its mask", k) for k in edits.masks]
    found += [Edit(_id("hidden", k), f"{named(k)}: hidden", k) for k in sorted(edits.hidden)]
    found += [
        Edit(_id("confidences", name, k), f"P({named(k)} | {name}) = {p:.2f}", k)
        for (name, k), p in edits.confidences.items()
    ]
    found += [
        Edit(_id("relations", r, a, b), f"P({named(a)} {PHRASE.get(r, r)} {named(b)}) = {p:.2f}", a)
        for (r, a, b), p in edits.relations.items()
    ]
    for name, value in (("k", edits.k), ("min_score", edits.min_score), ("scorer", edits.scorer)):
        if value is not None:
            found.append(Edit(_id(name), f"{_WORDS[name]}: {value}"))
    for group in ("rank", "profile", "lift"):
        settings = getattr(edits, group)
        found += [Edit(_id(group, name), f"{_WORDS.get(name, name)}: {value}") for name, value in settings.items()]
    return tuple(found)


def without_edit(edits: Edits, id: str) -> Edits:
    """The edits without one; InputError where there is none of this id, or where the other settings need it."""
    if id not in {edit.id for edit in each_edit(edits)}:
        raise InputError("there is no such edit", got=id)
    group, *rest = json.loads(id)
    if group in ("k", "min_score", "scorer"):
        return replace(edits, **{group: None})
    held = getattr(edits, group)
    at = rest[0] if len(rest) == 1 else tuple(rest)
    if group == "hidden":
        return replace(edits, hidden=held - {at})
    left = {key: value for key, value in held.items() if key != at}
    check = {"rank": checked_rank, "profile": checked_profile, "lift": checked_lift}.get(group)
    return replace(edits, **{group: left if check is None else check(left)})


def _id(*parts: str) -> str:
    return json.dumps(parts, separators=(",", ":"))


_WORDS = {
    "k": "proposals a name (K)",
    "min_score": "minimum score",
    "scorer": "relations by",
    "target_weight": "weight of the target α",
    "reference_weight": "weight of the reference β",
    "relation_weight": "weight of the relation γ",
    "aggregate": "references",
    "cone": "cone, degrees",
    "doubtful_cone": "doubtful cone, degrees",
    "dead_zone": "dead zone, m",
    "dead_zone_depth": "dead zone in depth, m",
}
