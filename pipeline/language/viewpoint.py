"""Viewpoint named in an expression: that of somebody who is at one thing and faces another."""

from __future__ import annotations

import re

from pipeline.language import lexicon
from pipeline.language.tokens import check_text
from pipeline.system.frozen import dataclass

_WHO = r"(?:(?:you|i|one|we|someone|somebody)(?: are| am| is| were|'re|'m|'s)? )?"
_STANDING = rf"{_WHO}(?:stand|stands|standing|sit|sits|sitting|seated) (?:at|by|near|next to|beside|on|in)"
_FACING = (
    rf",? (?:and |while |when )?{_WHO}(?:facing|faces?|(?:looking|looks?) (?:at|to|towards?)|turned (?:to|towards?))"
)
_AT, _FACED = (
    rf" (?:(?:the|an?|my|your|our|this|that) )?(?P<{role}>[^\s,;:.!?][^,;:.!?]*?)" for role in ("at", "facing")
)
_SEEN = r"(?:as |when )?(?:seen|viewed|observed|looking)"
_WHOSE = r"(?:point of view|viewpoint|perspective|position|standpoint)"
_VIEWS = (
    rf"{_STANDING}{_AT}{_FACING}{_FACED}",
    rf"(?:{_SEEN} )?from{_AT}{_FACING}{_FACED}",
    rf"(?:{_SEEN} )?from the {_WHOSE} of{_AT}",
    rf"(?:{_SEEN} )?from{_AT}'s? {_WHOSE}",
    rf"{_SEEN} from{_AT}",
)
_IF = r"(?:if|when|while|imagine|suppose|assume)(?: that)? "
_FIRST = [re.compile(rf"(?:{_IF})?{view} ?[,;:.] ?(?P<rest>.+)", re.IGNORECASE) for view in _VIEWS]
_LAST = [
    re.compile(rf"(?P<rest>.+?)(?:, ?(?:{_IF})?| {_IF if k == 0 else ''}){view} ?[.?!]*", re.IGNORECASE)
    for k, view in enumerate(_VIEWS)
]


@dataclass(frozen=True)
class Viewpoint:
    """Somebody's place and direction, each by the name of a thing."""

    at: str
    facing: str | None  # None where it is not said: then the reference is faced


def spoken_viewpoint(text: str) -> tuple[str, Viewpoint | None]:
    """Split an expression into what is asked and the viewpoint it is asked from; None for none, or the camera's.

    Raises InputError as `check_text`.

    >>> spoken_viewpoint("standing at the door, facing the window, the chair left of the table")
    ('the chair left of the table', Viewpoint(at='door', facing='window'))
    >>> spoken_viewpoint("the chair left of the table, as seen from the sofa")
    ('the chair left of the table', Viewpoint(at='sofa', facing=None))
    """
    text = check_text(text)
    for pattern in (*_FIRST, *_LAST):
        found = pattern.fullmatch(text)
        if found is not None and found["at"].split()[-1].casefold() not in lexicon.NO_PLACES:
            return found["rest"], Viewpoint(found["at"], found.groupdict().get("facing"))
    return text, None
