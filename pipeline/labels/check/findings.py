"""What a check of labels finds, and the rules by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, Literal

from pipeline.system.errors import InputError

Severity = Literal["error", "warning"]
Figure = float | int | str


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or questionable, in labels.

    Attributes
    ----------
    rule : str
        One of RULES.
    severity : str
        "error" or "warning".
    frame : str or None
        The frame's id; None where the finding is of a whole file.
    objects : tuple of int
        The objects it is about, by number; of a pair the first is the one that is said to be somewhere.
    message : str
        One sentence.
    figures : dict
        The numbers behind it.
    """

    rule: str
    severity: Severity
    frame: str | None
    objects: tuple[int, ...]
    message: str
    figures: dict[str, Figure] = field(default_factory=dict)


@dataclass(frozen=True)
class Rule:
    """What a rule looks for.

    Attributes
    ----------
    about : str
        One line.
    severity : str
        The worst it reports; `about` says where it is milder.
    """

    about: str
    severity: Severity


_error, _warning = partial(Rule, severity="error"), partial(Rule, severity="warning")


RULES: dict[str, Rule] = {
    "file/unreadable": _error("a table cannot be read as Parquet, or is of another table or schema"),
    "file/schema": _error("a column is missing, unknown, or of another type (of another width: warning)"),
    "file/changed": _warning("a table or the manifest is not as it was written: edited by hand"),
    "file/order": _warning("rows are not in canonical order"),
    "profile/changed": _warning("this release has other rules under the profile's name: geometry is not compared"),
    "row/model": _error("a value is outside what the schema allows"),
    "row/non-finite": _error("a number is NaN or infinite"),
    "row/duplicate-key": _error("two rows have one key"),
    "row/dangling": _error("a row names a frame or an object that does not exist"),
    "frame/camera": _error("intrinsics, pose or up vector are not those of a camera"),
    "frame/up-assumed": _warning("nothing says where up is: image-up was taken, and every direction rests on it"),
    "frame/up-disagrees": _warning("in the world of its scene, the up vector of a frame is not that of most others"),
    "frame/objects": _error("the frame's number of objects is not that of its rows"),
    "object/mask": _error("a mask cannot be decoded, or is not of the frame's size or stated area"),
    "object/rotation": _error("the rotation of a 3D box is not a rotation, or an edge is negative"),
    "object/bbox-mask": _error("the 2D box lies elsewhere than the mask (off by a part: warning)"),
    "object/box-mask": _error("the 3D box lies elsewhere in the picture than the mask (off by a part: warning)"),
    "object/extent-box": _error("the extents are not those of the 3D box (off by a part: warning)"),
    "object/duplicate": _error("two objects are one thing (under different names: warning)"),
    "object/few-points": _warning("an object that may be asked for has fewer than 100 points"),
    "object/no-depth": _warning("most pixels of an object that may be asked for have no depth"),
    "object/border": _warning("the image border cuts an object that may be asked for"),
    "object/implausible-size": _error("it is larger than its class can be (smaller or unlike its kind: warning)"),
    "relation/inverse": _error("a is left of b, and b is not right of a; so for above and below, front and behind"),
    "relation/antisymmetry": _error("a relation holds both ways (on and in, where geometry allows it: warning)"),
    "relation/exclusive": _error("two opposite relations hold of one pair"),
    "relation/pair-missing": _error("a pair of objects, or the state of a labelled relation, is missing"),
    "relation/unexpected": _error("a relation of an object with itself or with a background class"),
    "relation/cycle": _error("a relation leads back to its start (on and in, where geometry allows it: warning)"),
    "relation/geometry": _error("a state contradicts the extents (where one of the two is U, and margins: warning)"),
    "expression/empty": _error("an expression without targets, or whose own target is not among them"),
    "expression/everything": _warning("all objects of the target's class are acceptable: it tells nothing apart"),
    "expression/state": _error("the relation that the expression states does not hold"),
    "expression/margin": _warning("the expression's margin is not that of its relation"),
    "expression/sets": _error("targets or acceptable objects are not those that the relations give"),
    "expression/class": _error("target or reference is not called what the object is called"),
    "expression/unreadable": _error("the text does not read back as target, relation and reference"),
    "expression/article": _warning("the text says `the` of a name that several objects of the frame have"),
    "expression/duplicate-id": _error("two expressions of a frame have one id"),
    "expression/id": _warning("the id is not the hash of what the row says: edited, or copied from another row"),
    "expression/ambiguous": _error("the flag `ambiguous` does not fit the acceptable objects"),
    "expression/unusable": _error("an expression names an object that may not be asked for"),
    "expression/source": _warning("profile or source of the up vector are not those of the labels and the frame"),
}  # fmt: skip
"""All rules by name, in the order in which they are described."""


def chosen_rules(names: Sequence[str] | None) -> frozenset[str]:
    """The rules of the names given: of a rule or of a whole group, such as "relation"; all for None.

    Raises
    ------
    InputError
        A name is neither.
    """
    if names is None:
        return frozenset(RULES)
    found: set[str] = set()
    for name in names:
        group = name.removesuffix("/*").removesuffix("/")
        members = {r for r in RULES if r == name or r.split("/")[0] == group}
        if not members:
            known = (*(r.split("/")[0] for r in RULES), *RULES)
            raise InputError("no such rule", got=repr(name), expected=" | ".join(dict.fromkeys(known)))
        found |= members
    return frozenset(found)


def finding_record(finding: Finding) -> dict[str, Any]:
    """A finding as JSON: plain values only."""
    return {**asdict(finding), "objects": list(finding.objects)}
