"""The words of a search: terms such as `-class:chair,"trash can"` or `margin<0.1`, read and taken apart."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pipeline.system.errors import InputError, require

_HEAD = re.compile(r"(-)?(?:([A-Za-z_]\w*)(:|\s*(?:<=|>=|!=|<|>|=)\s*))?")
_QUOTED = re.compile(r'"((?:[^"\\]|\\.)*)"', re.DOTALL)
_BARE = re.compile(r'[^\s,"]+')
_WORD = re.compile(r"\S+")


@dataclass(frozen=True)
class Value:
    """One value of a term."""

    text: str
    quoted: bool = False  # then `*` and `none` mean themselves

    @property
    def written(self) -> str:
        """Write as in a search."""
        return quote(self.text, self.quoted) if self.quoted else self.text


@dataclass(frozen=True)
class Term:
    """One condition of a search; all of them must hold."""

    field: str | None  # None for a free word
    operator: str  # one of : = != < <= > >=; ":" for a free word
    values: tuple[Value, ...]  # any of them may hold
    negated: bool = False

    @property
    def written(self) -> str:
        """Write as in a search."""
        head = "" if self.field is None else f"{self.field}{self.operator}"
        return f"{'-' if self.negated else ''}{head}{','.join(v.written for v in self.values)}"


def read_terms(text: str) -> tuple[Term, ...]:
    """Take a search apart.

    Raises InputError: a quote is not closed, or a value is missing.
    """
    terms = []
    at = len(text) - len(text.lstrip())
    while at < len(text):
        head = _HEAD.match(text, at)
        assert head is not None
        negated, field, operator = head.group(1) is not None, head.group(2), (head.group(3) or ":").strip()
        start, at = at, head.end()
        value, at = _value(text, at, _WORD if field is None else _BARE, text[start:at])
        values = [value]
        while field is not None and text.startswith(",", at):
            value, at = _value(text, at + 1, _BARE, text[start : at + 1])
            values.append(value)
        require(
            at >= len(text) or text[at].isspace(), "a space is missing in the search", got=repr(text[start : at + 1])
        )
        terms.append(Term(field, operator, tuple(values), negated))
        at = len(text) - len(text[at:].lstrip())
    return tuple(terms)


def _value(text: str, at: int, bare: re.Pattern[str], before: str) -> tuple[Value, int]:
    if text.startswith('"', at):
        found = _QUOTED.match(text, at)
        if found is None:
            raise InputError("a quote is not closed in the search", got=repr(text[at:]))
        return Value(re.sub(r"\\(.)", r"\1", found.group(1), flags=re.DOTALL), True), found.end()
    found = bare.match(text, at)
    if found is None:
        raise InputError("a value is missing in the search", got=repr(before.strip()))
    return Value(found.group()), found.end()


def quote(text: str, always: bool = False) -> str:
    """Write a value for a search literally; with `always` in quotes also where none are needed."""
    if not always and re.fullmatch(r"[A-Za-z0-9_./+-]+", text) and text.lower() != "none":
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
