"""Context of an expression: the view of its relations, and words of asking before the first thing."""

from __future__ import annotations

import re
from functools import cache

from pipeline.language import choices, lexicon
from pipeline.language.attribute_reader import is_name
from pipeline.language.attributes import attribute
from pipeline.language.chain import FORM, check_judged, other_view
from pipeline.language.naming import DETERMINERS, is_compound, singular
from pipeline.language.openers import ASKERS, FRAMING, is_leading
from pipeline.language.tokens import Token, check_text, joined_words
from pipeline.system.errors import Unsupported
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


@cache
def _viewpoints() -> list[re.Pattern[str]]:
    """Expressions that begin with a viewpoint, and that end with one."""
    first = [rf"(?:{_IF})?{view} ?[,;:.] ?(?P<rest>.+)" for view in _VIEWS]
    # Who stands there is the thing itself in `the man standing at ...`.
    before = [rf"(?:, ?(?:{_IF})?| {'' if k else _IF})" for k in range(len(_VIEWS))]
    last = [rf"(?P<rest>.+?){start}{view} ?[.?!]*" for start, view in zip(before, _VIEWS, strict=True)]
    return [re.compile(pattern, re.IGNORECASE) for pattern in (*first, *last)]


@dataclass(frozen=True)
class SpokenViewpoint:
    """Somebody's place and direction, each by the name of a thing."""

    at: str
    facing: str | None  # None where it is not said: then the reference is faced


def spoken_viewpoint(text: str) -> tuple[str, SpokenViewpoint | None]:
    """Split an expression into what is asked and the viewpoint it is asked from; None for none, or the camera's.

    Raises InputError as `check_text`.

    >>> spoken_viewpoint("standing at the door, facing the window, the chair left of the table")
    ('the chair left of the table', SpokenViewpoint(at='door', facing='window'))
    >>> spoken_viewpoint("the chair left of the table, as seen from the sofa")
    ('the chair left of the table', SpokenViewpoint(at='sofa', facing=None))
    """
    text = check_text(text)
    for pattern in _viewpoints():
        found = pattern.fullmatch(text)
        if found is not None and found["at"].split()[-1].casefold() not in lexicon.NO_PLACES:
            return found["rest"], SpokenViewpoint(found["at"], found.groupdict().get("facing"))
    return text, None


def without_view(tokens: list[Token], text: str) -> list[Token]:
    """Drop the camera's view, the default; refuse other views, and relations that are not judged."""
    words = {t.text for t in tokens}
    if not words.isdisjoint(lexicon.VIEW_WORDS):
        joined, starts, ends = joined_words(tokens)
        first = lexicon.VIEW_FIRST.match(joined)
        if first and first.end() in ends:
            tokens = tokens[ends.index(first.end()) + 1 :]
            joined, starts, ends = joined_words(tokens)
        last = lexicon.VIEW_LAST.search(joined)
        if last and last.start() in starts:
            tokens = tokens[: starts.index(last.start())]
    singles = {w for t in tokens for w in t.text.split()}
    if not singles.isdisjoint(lexicon.OBJECT_VIEW_WORDS):
        _, viewpoint = spoken_viewpoint(text)
        if viewpoint is not None:
            raise other_view(f"from the {viewpoint.at}", text, viewpoint.at)
        found = lexicon.OBJECT_VIEW.search(joined_words(tokens)[0])
        if found:
            raise other_view(found[0].strip(), text)
    if "'" in text or "’" in text:
        joined, _, ends = joined_words(tokens)
        for owned in lexicon.SIDE_OF_OWNER.finditer(joined):
            following = ends.index(owned.end()) + 1 if owned.end() in ends else None
            about = owned[0].split()[0] in lexicon.COPULAS
            if (
                following is not None
                and not (about and following < len(tokens))
                and all(
                    t.relation is not None or t.plain in lexicon.LINKING or t.plain in lexicon.AND
                    for t in tokens[following : following + 1]
                )
            ):
                raise other_view(owned[0], text)
    counting = lexicon.COUNTING.match(joined_words(tokens)[0]) if tokens and tokens[0].plain else None
    if counting:
        raise Unsupported(
            f"'{counting[0]}' asks for a number, and only a thing can be asked for", got=f"'{text}'", expected=FORM
        )
    check_judged(tokens, text)
    return tokens


def address_removed(tokens: list[Token], text: str) -> list[Token]:
    """Drop `look,` or `robot,` before all the rest."""
    while len(tokens) > 1 and tokens[0].plain in lexicon.ADDRESS and "," in text[tokens[0].end : tokens[1].start]:
        tokens = tokens[1:]
    return tokens


def closing_removed(tokens: list[Token]) -> list[Token]:
    """Drop `please`, `for me` and the like at the end, as long as something is left."""
    while tokens:
        if tokens[-1].plain in lexicon.CLOSING and tokens[-2:][0].text not in lexicon.POINTING:
            tokens = tokens[:-1]
            continue
        ends = (n for n in (4, 3, 2) if len(tokens) > n + 1)
        size = next((n for n in ends if " ".join(t.plain or "_" for t in tokens[-n:]) in lexicon.CLOSING_PHRASES), None)
        if size is None:
            return tokens
        tokens = tokens[:-size]
    return tokens


def leading_removed(tokens: list[Token]) -> tuple[list[Token], bool]:
    """Drop `please find me` and the like, as long as something is left; with a flag for `what` or `which`."""
    asks = False
    while tokens:
        tokens = _among_removed(tokens)[_frame(tokens) :]
        for n in range(7, 0, -1):
            run = tokens[:n]
            if len(run) == n and is_leading(" ".join(t.text for t in run)):
                if any(t.bound or t.name is not None for t in run) or _names_a_thing(tokens[:3]):
                    continue
                asked = any(t.text.startswith(("what", "which")) for t in run)
                if len(tokens) > n and (tokens[n].relation is None or tokens[n].text in lexicon.SUPERLATIVES or asked):
                    tokens, asks = tokens[n:], asks or asked
                    break
        else:
            return tokens, asks
    return tokens, asks


def _frame(tokens: list[Token]) -> int:
    """Number of words at the start that ask for a thing: `might I trouble you for`."""
    size = next((k for k, t in enumerate(tokens) if t.plain is None or t.text not in FRAMING), 0)
    asked = not ASKERS.isdisjoint(t.text for t in tokens[:size])
    # A thing follows, and the last words are not its name: `you have hand towels`.
    named = size and _names_a_thing(tokens[size - 1 : size + 2])
    return size if asked and not named and _begins_a_thing(tokens[size]) else 0


def _begins_a_thing(token: Token) -> bool:
    """Test if a word is an article, a known name, an adjective, counts or chooses, or asks."""
    asks = token.text in ("where", "where's", "which", "what", "what's", "any", "all", "both") or (
        token.text in choices.NUMBERS.keys() | choices.ORDINALS.keys() | choices.EXTREMES.keys() | lexicon.ANYTHING
    )
    known = asks or token.name is not None or token.plain in DETERMINERS - lexicon.RELATIVE
    return known or (token.plain is not None and (is_name(singular(token.plain)) or attribute(token.plain) is not None))


def _names_a_thing(tokens: list[Token]) -> bool:
    """Test if a name begins with a word of asking: `hand sanitizer`."""
    words = [t.text for t in tokens if t.plain is not None]
    return any(is_compound(words[:n]) for n in (2, 3))


def _among_removed(tokens: list[Token]) -> list[Token]:
    """Drop `of` at the start: `the two chairs, the one by the door` of `of the two chairs, the one by the door`."""
    joined, _, ends = joined_words(tokens)
    found = lexicon.AMONG_FIRST.match(joined)
    end = None if found is None else len(found[0].rstrip())
    return tokens[ends.index(end) + 1 :] if end in ends else tokens


def thing_first(tokens: list[Token], text: str) -> list[Token]:
    """Move the thing to the front: `a mug on the desk` of `on the desk is a mug`, `on the desk, find a mug`.

    So too `see the desk? On it is a mug`.
    """
    it = next((k for k in range(1, len(tokens) - 2) if tokens[k].relation and tokens[k + 1].plain == "it"), None)
    if it and any(c in text[tokens[it - 1].end : tokens[it].start] for c in ",;:.?"):
        turned = thing_first([tokens[it], *tokens[:it], *tokens[it + 2 :]], text)
        return tokens if turned[0] is tokens[it] else turned
    if not tokens or tokens[0].relation is None:
        return tokens
    for k in range(2, len(tokens) - 1):
        there = tokens[k].plain in ("there", "there's")
        if there or tokens[k].plain in lexicon.BE | lexicon.POSTURES:
            after = k + 1 + (there and tokens[k + 1].plain in lexicon.BE)
            related = tokens[k - 1].plain in lexicon.RELATIVE or tokens[after].plain in lexicon.RELATIVE
            starts = tokens[after].plain in DETERMINERS | choices.NUMBERS.keys() if after < len(tokens) else False
            return tokens[after:] + tokens[:k] if starts and not related else tokens
        seen = tokens[k].plain in ("you", "you'll", "i", "we", "one")
        if seen or any(c in text[tokens[k - 1].end : tokens[k].start] for c in ",;:."):
            rest, _ = leading_removed(tokens[k:])
            if rest[0].plain in DETERMINERS - lexicon.RELATIVE or len(rest) < len(tokens) - k:
                among = tokens[0].relation == "between" and all(t.plain not in lexicon.AND for t in tokens[:k])
                return tokens[1:k] + rest if among else rest + tokens[:k]
    return tokens
