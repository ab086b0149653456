"""Facets of a run: by every property how many expressions have which value, of those that the rest of a search leaves;
and searches with one more value, or one less."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pipeline.diagnosis.oracles import ALL_ORACLES
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.comparing import CHANGE, CHANGES, SECOND
from pipeline.evaluation.run_notes import MARKS
from pipeline.evaluation.search import find_rows, terms_of
from pipeline.evaluation.search_words import Term, Value, read_terms
from pipeline.evaluation.slices import DIMENSIONS, YES_NO, Coded, Dimension, coded
from pipeline.language.expression import UNREAD
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import QUERY_KINDS
from pipeline.system.arrow import pa

_VERDICT, _CHANGE, _SECOND, _MARKS = (
    Dimension(name, title, name)
    for name, title in (
        ("verdict", "verdict"),
        (CHANGE, "in the second run"),
        (f"{SECOND}verdict", "verdict of the second run"),
        (MARKS, "marks"),
    )
)
FACETS = (
    _CHANGE,
    _VERDICT,
    _SECOND,
    DIMENSIONS["relation"],
    DIMENSIONS["kind"],
    DIMENSIONS["class"],
    DIMENSIONS["reference"],
    _MARKS,
    Dimension("detail", "detail of the verdict", "detail"),
    Dimension("mends", "one oracle that alone mends it", "mends"),
    Dimension("lucky", "correct by luck", "lucky"),
    Dimension("parse_ok", "read as it was meant", "parse_ok"),
    Dimension("ambiguous", "several right answers", "ambiguous"),
    DIMENSIONS["distance"],
    DIMENSIONS["size"],
    DIMENSIONS["occlusion"],
    DIMENSIONS["same_class"],
    DIMENSIONS["scene"],
    DIMENSIONS["frame"],
)
"""What a run is looked at by, in this order; what it has no column for is left out."""
_ORDERS = {
    "verdict": VERDICTS,
    f"{SECOND}verdict": VERDICTS,
    CHANGE: tuple(CHANGES),
    "relation": PAIRWISE,
    "kind": (*QUERY_KINDS, UNREAD),
    "mends": ALL_ORACLES,
    "lucky": YES_NO,
    "parse_ok": YES_NO,
    "ambiguous": YES_NO,
}


@dataclass(frozen=True)
class FacetValue:
    """One value of a facet."""

    name: str
    term: str  # the search for it
    count: int  # expressions that have it, of those that the rest of the search leaves
    state: int = 0  # 1 where the search asks for it, -1 where it asks for what has it not, else 0


@dataclass(frozen=True)
class Facet:
    """One property of the expressions."""

    name: str
    title: str
    values: tuple[FacetValue, ...]  # those that occur, and those that are asked for
    ranges: bool = False  # its values are ranges of a number: one at a time

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        return asdict(self)


class Facets:
    """Counts the facets of one run.

    `records`: with the columns `change` and `marks` where there are any.
    """

    def __init__(self, records: pa.Table) -> None:
        self._records = records
        self._coded = {d.column: _coded(records, d) for d in FACETS if d.column in records.column_names}

    def marked(self, records: pa.Table) -> Facets:
        """The facets of the same records with other marks."""
        other = copy(self)
        other._records, other._coded = records, self._coded | {MARKS: _coded(records, _MARKS)}
        return other

    def of(self, query: str = "") -> tuple[Facet, ...]:
        """The facets under a search.

        Raises InputError: the search cannot be read.
        """
        terms = terms_of(query, self._records.schema)
        left: dict[str, np.ndarray] = {}
        found = []
        for one in self._coded.values():
            own = [term for column, term in terms if column == one.cut.column]
            rest = " ".join(t.written for column, t in terms if column not in ("", one.cut.column))
            if rest not in left:
                left[rest] = np.zeros(self._records.num_rows, np.bool_)
                left[rest][find_rows(self._records, rest)] = True
            # What is the same of all says nothing.
            if len(one.parts) > 1 or one.cut is _MARKS:
                found.append(_facet(one, one.counts(left[rest]), own))
        return tuple(f for f in found if f.values)


def _coded(records: pa.Table, cut: Dimension) -> Coded:
    return coded(records, cut, known=_ORDERS.get(cut.name, ()))


def _facet(found: Coded, counts: np.ndarray, own: Sequence[Term]) -> Facet:
    values = [
        FacetValue(name, term, int(n), _state(term, own)) for (name, term), n in zip(found.parts, counts, strict=True)
    ]
    cut = found.cut
    if not cut.edges and cut.name not in _ORDERS and cut.order == "count":
        values.sort(key=lambda v: (-v.count, v.name))
    return Facet(cut.name, cut.title, tuple(v for v in values if v.count or v.state), bool(cut.edges))


def _state(term: str, own: Sequence[Term]) -> int:
    """State of a value: 1 asked for, -1 excluded, else 0."""
    first, *more = read_terms(term)
    if more or first.operator not in (":", "="):
        written = {t.written for t in own}
        return int(written == {t.written for t in (first, *more)})
    value = first.values[0].text.lower()
    for t in own:
        # A flag may stand alone, as a free word.
        texts = ["yes"] if t.field is None else [v.text.lower() for v in t.values]
        if t.operator in (":", "=") and value in texts:
            return -1 if t.negated else 1
    return 0


def with_value(query: str, term: str, schema: pa.Schema, without: bool = False) -> str:
    """Add a value of a facet to a search, or remove a value already there; `without` excludes the value.

    Raises InputError: one of the two cannot be read.
    """
    terms = terms_of(query, schema)
    wanted = terms_of(term, schema)
    column = wanted[0][0]
    own = [t for c, t in terms if c == column]
    state = _state(term, own)
    ranged = len(wanted) > 1 or wanted[0][1].operator not in (":", "=")
    value = wanted[0][1].values[0]
    if ranged:
        kept = [] if state == 1 else [t for _, t in wanted]
    else:
        # Of the terms of this field those stay that go on to mean something beside the new one.
        kept = [_less(t, value) for t in own if t.operator in (":", "=") and t.field is not None]
        kept = [t for t in kept if t is not None and t.negated == without]
        if state != (-1 if without else 1):
            kept = _more(kept, replace(wanted[0][1], negated=without))
    first = next((k for k, (c, _) in enumerate(terms) if c == column), len(terms))
    others = [(k, t) for k, (c, t) in enumerate(terms) if c != column]
    parts = [t for k, t in others if k < first] + kept + [t for k, t in others if k > first]
    # An order comes last.
    parts.sort(key=lambda t: t.field is not None and t.field.lower() == "sort")
    return " ".join(t.written for t in parts)


def _less(term: Term, value: Value) -> Term | None:
    values = tuple(v for v in term.values if v.text.lower() != value.text.lower())
    return replace(term, values=values) if values else None


def _more(terms: list[Term], term: Term) -> list[Term]:
    """Join alternatives of a field in one term; of `=` and `:` the exact operator wins."""
    if not terms:
        return [term]
    operator = "=" if "=" in (term.operator, *(t.operator for t in terms)) else ":"
    values = (*(v for t in terms for v in t.values), *term.values)
    return [replace(term, operator=operator, values=values)]
