"""Failures by words, as they may be typed: a search compiled to a condition of DuckDB, every value a parameter.

    verdict:SRM relation:behind class:chair margin<0.1 -lucky frame:000002/* "trash can" repair:LIFT,SRM sort:margin

Terms must all hold; values after a comma are alternatives; "-" before a term is its complement, rows without a value
included. `field:value` asks for equality whatever the case, with `*` for anything, and `field:none` for no value;
`field="value"` for exactly this text. Numbers take : = != < <= > >=. A yes-or-no column stands alone (`lucky`) or takes
yes and no. `repair:LIFT,SRM` asks for one of the two, `repair=LIFT,SRM` for just these. Free words, and a phrase in
quotes, must stand in the expression. `sort:margin`, `sort:-margin`: rows without a value come last.
"""

from __future__ import annotations

import difflib
import re
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.diagnosis.oracles import ALL_ORACLES
from pipeline.diagnosis.verdict import MODULE_OF, VERDICTS
from pipeline.evaluation.comparing import CHANGE, CHANGES, SECOND
from pipeline.evaluation.records import DIAGNOSIS_COLUMNS
from pipeline.evaluation.records_file import rows_where
from pipeline.evaluation.run_notes import MARKS
from pipeline.evaluation.summary import need_verdicts
from pipeline.labels.statistics import quoted
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

if TYPE_CHECKING:
    from pipeline.evaluation.records_file import Records

_HEAD = re.compile(r"(-)?(?:([A-Za-z_]\w*)(:|\s*(?:<=|>=|!=|<|>|=)\s*))?")
_QUOTED = re.compile(r'"((?:[^"\\]|\\.)*)"', re.DOTALL)
_BARE = re.compile(r'[^\s,"]+')
_FREE = re.compile(r"\S+")


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
        value, at = _value(text, at, _FREE if field is None else _BARE, text[start:at])
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


Condition = tuple[str, list[Any]]
_YES, _NO = ("yes", "true", "1"), ("no", "false", "0")

Kind = Literal["text", "words", "number", "flag", "names"]

ALIASES = {
    "class": "target",
    "size": "object_size",
    "distance": "object_distance",
    "occlusion": "object_occluded",
    "pixels": "object_pixels",
    "right": "set_correct",
}
"""Short names of columns."""
WORDS = ("text", "said", "problem")
"""Columns of sentences: a value must stand in them."""
SORT = "sort"
FAILURES = "-right"
"""What was not answered rightly. Of LABEL most was: by another thing that fits, too."""
_ABOUT_RIGHT = {
    "verdict",
    "lucky",
    "correct",
    "strict_correct",
    "set_correct",
    "pair_correct",
    "reference_correct",
    CHANGE,
    f"{SECOND}verdict",
    MARKS,
}


@dataclass(frozen=True)
class Field:
    """What can be asked for."""

    name: str
    column: str
    kind: Kind  # "text", "words", "number", "flag" or "names" (a list of names)
    # values: of a text, the most frequent ones first, as `field:value` takes them; of a number the least and the
    # greatest
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class Search:
    """A compiled search."""

    where: str  # SQL with a "?" for each parameter; columns are those of the records
    parameters: tuple[Any, ...]
    order: tuple[tuple[str, bool], ...]  # columns to sort by; True for descending
    columns: tuple[str, ...]  # all that are read
    about_right: bool = False  # a term asks for a verdict or for what is right, and not for its complement


_KINDS: tuple[tuple[str, Kind], ...] = (
    (r"(large_)?string", "text"),
    (r"bool", "flag"),
    (r"u?int\d+|halffloat|float|double", "number"),
    (r"(large_)?list<\w+: string.*>", "names"),
)
"""Types of Arrow, as it writes them, and what can be asked of them."""


@cache
def _kind_of(type_: str) -> Kind | None:
    return next((kind for pattern, kind in _KINDS if re.fullmatch(pattern, type_)), None)


def fields_of(schema: pa.Schema) -> dict[str, Field]:
    """Fields to search a run's records by, short names first."""
    found: list[tuple[str, Kind | None]] = [(field.name, _kind_of(str(field.type))) for field in schema]
    kinds: dict[str, Kind] = {name: "words" if name in WORDS else kind for name, kind in found if kind is not None}
    short = {name: Field(name, c, kinds[c]) for name, c in ALIASES.items() if c in kinds}
    return short | {name: Field(name, name, kind) for name, kind in kinds.items()}


def compile_search(query: str, schema: pa.Schema) -> Search:
    """Read a search against the columns of a run.

    Raises InputError: it cannot be read, names an unknown field or verdict, or compares what has no order.
    """
    fields = fields_of(schema)
    parts, parameters, order, columns = [], [], [], []
    about_right = False
    for term in read_terms(query):
        if term.field is not None and term.field.lower() == SORT:
            require(
                not term.negated and term.operator == ":",
                "an order is written sort:FIELD or sort:-FIELD",
                got=repr(term.field + term.operator),
            )
            order += [(_field(v.text.removeprefix("-"), fields).column, v.text.startswith("-")) for v in term.values]
            continue
        field, term = _meant(term, fields)
        condition, values = _condition(field, term, str(schema.field(field.column).type) == "float")
        if (term.operator == "!=") != term.negated:
            condition = f"NOT {condition}"
        else:
            about_right |= field.column in _ABOUT_RIGHT
        parts.append(condition)
        parameters += values
        columns.append(field.column)
    columns += [name for name, _ in order]
    where = " AND ".join(parts) or "true"
    return Search(where, tuple(parameters), tuple(order), tuple(dict.fromkeys(columns)), about_right)


def find_rows(records: Records, query: str) -> np.ndarray:
    """(N,) int64: indices of the rows of a search, in the order of the run or as asked.

    `records`: a table, or those of `open_records`, of which only the columns of the search are read.

    Raises InputError: the search cannot be read.
    """
    return _rows(records, compile_search(query, records.schema))


def terms_of(query: str, schema: pa.Schema) -> list[tuple[str, Term]]:
    """Terms of a search with their columns; "" for an order.

    Raises InputError: the search cannot be read.
    """
    fields = fields_of(schema)
    found = []
    for term in read_terms(query):
        order = term.field is not None and term.field.lower() == SORT
        found.append(("", term) if order else (_meant(term, fields)[0].column, term))
    return found


def find_failures(records: Records, query: str = "") -> pa.Table:
    """Rows of `failing_rows`; raises as it."""
    return records.take(failing_rows(records, query))


def failing_rows(records: Records, query: str = "") -> np.ndarray:
    """Search among FAILURES, or among all rows where the search names a verdict or correctness (`lucky`).

    Raises InputError: as in `find_rows`; or the run has no verdicts.
    """
    need_verdicts(records)
    return find_rows(records, among_failures(query, records.schema))


def among_failures(query: str, schema: pa.Schema) -> str:
    """Search of `find_failures`; raises InputError as `find_rows`."""
    return query if compile_search(query, schema).about_right else f"{FAILURES} {query}".strip()


def narrowed(query: str, more: str) -> str:
    """Search for what two searches both find; what stands in both is said once."""
    return " ".join(dict.fromkeys(term.written for text in (query, more) for term in read_terms(text)))


def _rows(records: Records, search: Search) -> np.ndarray:
    if not search.columns:
        return np.arange(records.num_rows)
    order = [f"{_defined(n, records.schema)} {'DESC' if down else 'ASC'} NULLS LAST" for n, down in search.order]
    return rows_where(records, search.where, search.parameters, search.columns, order)


def _defined(name: str, schema: pa.Schema) -> str:
    """Column with NaN as missing."""
    column = quoted(name)
    floating = str(schema.field(name).type) in ("halffloat", "float", "double")
    return f"(CASE WHEN isnan({column}) THEN NULL ELSE {column} END)" if floating else column


def _field(name: str, fields: dict[str, Field]) -> Field:
    found = fields.get(name.lower())
    if found is not None:
        return found
    require(
        ALIASES.get(name.lower(), name.lower()) not in DIAGNOSIS_COLUMNS,
        f"this run has no {name}",
        cause="it was made by an older release; run `eval` again",
    )
    near = difflib.get_close_matches(name.lower(), [*fields, SORT], 3, 0.5)
    raise InputError(
        "the search names an unknown field",
        got=repr(name),
        expected=" or ".join(near) if near else "such as verdict, relation, class, margin",
        cause="words are looked for in the text where they stand in quotes",
    )


def _meant(term: Term, fields: dict[str, Field]) -> tuple[Field, Term]:
    """Field of a term; a free word is a flag by itself, or stands in the text."""
    if term.field is not None:
        return _field(term.field, fields), term
    value = term.values[0]
    flag = fields.get(value.text.lower())
    if flag is not None and flag.kind == "flag" and not value.quoted:
        return flag, Term(flag.name, ":", (Value("yes"),), term.negated)
    return _field("text", fields), term


def _none(value: Value) -> bool:
    return not value.quoted and value.text.lower() == "none"


def _condition(field: Field, term: Term, single: bool) -> Condition:
    """Compile a term to SQL; `single` is for columns of float32."""
    require(
        not (term.operator not in (":", "=", "!=") and field.kind != "number"),
        f"{field.name} has no order",
        got=repr(term.operator),
        expected=f"{field.name}:VALUE",
    )
    if field.kind == "names":
        return _names(field, term)
    one = {"number": _number, "flag": _flag}.get(field.kind, _text)
    found = [one(field, term.operator, value, single) for given in term.values for value in _named(field, given)]
    return _any([sql for sql, _ in found]), [value for _, values in found for value in values]


def _any(parts: list[str]) -> str:
    return f"coalesce({' OR '.join(parts)}, false)"


def _text(field: Field, operator: str, value: Value, _single: bool) -> Condition:
    column = quoted(field.column)
    if _none(value):
        return f"{column} IS NULL", []
    if operator != ":":
        return f"{column} = ?", [value.text]
    if field.kind == "words":
        return f"contains(lower({column}), lower(?))", [value.text]
    if "*" in value.text and not value.quoted:
        like = "".join({"*": "%", "%": "\\%", "_": "\\_", "\\": "\\\\"}.get(c, c) for c in value.text)
        return f"lower({column}) LIKE lower(?) ESCAPE '\\'", [like]
    return f"lower({column}) = lower(?)", [value.text]


_KNOWN = {"verdict": VERDICTS, f"{SECOND}verdict": VERDICTS, "relation": PAIRWISE, CHANGE: tuple(CHANGES)}


def _named(field: Field, value: Value) -> tuple[Value, ...]:
    """Verdict or relation by name, InputError for an unknown name; OPM stands for the detector's three."""
    known = _KNOWN.get(field.column)
    if known is None or _none(value) or ("*" in value.text and not value.quoted):
        return (value,)
    text = value.text.lower()
    if known is VERDICTS and text == "opm":
        return tuple(Value(v) for v, module in MODULE_OF.items() if module == "OPM")
    phrases = {phrase: name for name, phrase in PHRASE.items()} if field.column == "relation" else {}
    names = {name.lower(): name for name in known} | phrases
    if text not in names:
        near = difflib.get_close_matches(text, names, 1, 0.5)
        expected = repr(names[near[0]]) if near else f"one of {', '.join(known)}"
        raise InputError(f"no such {field.column}", got=repr(value.text), expected=expected)
    return (Value(names[text], True),)


def _number(field: Field, operator: str, value: Value, single: bool) -> Condition:
    operator = {":": "=", "!=": "="}.get(operator, operator)
    number = f"CAST({quoted(field.column)} AS DOUBLE)"
    if _none(value) and operator == "=":
        return f"({quoted(field.column)} IS NULL OR isnan({number}))", []
    try:
        asked = float(value.text)
    except ValueError:
        asked = np.nan
    require(
        not np.isnan(asked), f"{field.name} is a number", got=repr(value.text), expected=f"such as {field.name}<0.1"
    )
    # 0.1 means the number nearest to it that the column can hold.
    with np.errstate(over="ignore"):
        asked = float(np.float32(asked)) if single else asked
    return f"(NOT isnan({number}) AND {number} {operator} CAST(? AS DOUBLE))", [asked]


def _flag(field: Field, _operator: str, value: Value, _single: bool) -> Condition:
    column, text = quoted(field.column), value.text.lower()
    shown = {**dict.fromkeys(_YES, column), **dict.fromkeys(_NO, f"NOT {column}")}
    require(
        not (not _none(value) and text not in shown),
        f"{field.name} is yes or no",
        got=repr(value.text),
        expected=f"{field.name}:yes",
    )
    return f"{column} IS NULL" if _none(value) else shown[text], []


def _names(field: Field, term: Term) -> Condition:
    column = quoted(field.column)
    named = [v for v in term.values if not _none(v)]
    oracles = field.column != MARKS
    for v in named if oracles else ():
        require(
            v.text.upper() in ALL_ORACLES,
            f"no such {field.name}",
            got=repr(v.text),
            expected=f"one of {', '.join(ALL_ORACLES)}",
        )
    chosen = sorted({v.text.upper() if oracles else v.text.lower() for v in named})
    parts = [f"len(coalesce({column}, [])) = 0"] if len(named) < len(term.values) else []
    if term.operator == ":":
        parts += [f"list_contains({column}, ?)" for _ in chosen]
    elif chosen:
        parts.append(f"list_sort({column}) = list_sort([{', '.join('?' for _ in chosen)}])")
    return _any(parts), list(chosen)
