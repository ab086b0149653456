"""Checked reading of files by people and other programs, with one line for a fault."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pipeline.system.errors import InputError, as_input_error, first_line, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import parse_json, read_text

if TYPE_CHECKING:
    from pydantic import ValidationError

Checked = TypeVar("Checked")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; ValueError on malformed text."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib  # pyright: ignore[reportMissingImports]

    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("brackets inside brackets too deep") from error


def checked(
    check: Callable[[Any], Checked],
    content: Any,
    wrong: str,
    path: Path | None = None,
    *,
    inside: Iterable[str] = (),
    keys: Iterable[str] | Callable[[tuple[Any, ...]], Iterable[str]] = (),
) -> Checked:
    """Validate a content by `check`, a validating method of pydantic; InputError for the first fault and its location.

    Parameters
    ----------
    wrong : str
        Words for a fault, with the location for {}.
    inside : iterable of str
        Location of the content in the file.
    keys : iterable of str, or a function
        Known keys, told for an unknown one; the function gives those beside a location.
    """
    from pydantic import ValidationError

    try:
        return check(content)
    except ValidationError as error:
        place, got, expected = _first_fault(error, content)
        if got == _UNKNOWN:
            known = ", ".join(keys(place) if callable(keys) else keys)
            expected = known and f"one of {known}"
        what = wrong.replace("{}", ".".join(str(part)[:60] for part in (*inside, *place)) or "the top")
        if got is None:
            what, expected = f"{what}: {expected}", None
        raise InputError(what, got=got, expected=expected or None, path=path) from error


_UNKNOWN = "a field of another name"
_KINDS: dict[str, str] = {
    "float": "a number",
    "int": "a whole number",
    "string": "text",
    "bool": "true or false",
    "tuple": "a list",
    "list": "a list",
    "set": "a list",
    "frozen": "a list",
    "dict": "an object {...}",
    "dataclass": "an object {...}",
    "model": "an object {...}",
}


def _first_fault(error: ValidationError, content: Any) -> tuple[tuple[Any, ...], str | None, str]:
    """The keys and numbers that lead to the first fault of a content, what stands there, and what is asked for.

    Of a value that may be of several kinds it is that of the kind which fits furthest; where none fits, all are told.
    Where a rule of our own is broken, nothing and what the rule says.
    """
    if isinstance(content, str | bytes):
        with suppress(ValueError, RecursionError):
            content = parse_json(content)
    every = [(_place(content, fault["loc"], fault["type"] == "missing"), fault) for fault in error.errors()]
    first = every[0][0]
    place, fault = max((one for one in every if one[0][: len(first)] == first), key=lambda one: len(one[0]))
    kind, value, context = fault["type"], fault["input"], fault.get("ctx", {})
    if kind in ("value_error", "assertion_error"):
        return place, None, str(context["error"])
    if kind.startswith("union_tag"):
        place = (*place, context["discriminator"].strip("'"))
        got = _quoted(context["tag"]) if "tag" in context else "nothing"
        return place, got, f"one of {context['expected_tags']}" if "tag" in context else "a value"
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return place, _UNKNOWN, ""
    if kind == "missing" and not isinstance(value, list | tuple):
        return place, "nothing", "a value"
    beside = [other for at, other in every if at == place and other["loc"][:-1] == fault["loc"][:-1]]
    words = [f"{len(value) + len(beside)} values"] if kind == "missing" else dict.fromkeys(map(asked, beside))
    return place, _quoted(value), " or ".join(words)


def _quoted(value: Any) -> str:
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    got = json.dumps(value, ensure_ascii=False, default=str, skipkeys=True)
    return got if len(got) <= 60 else f"{got[:57]}..."


def asked(fault: Any) -> str:
    """Wanted value in words, for one of pydantic's `errors()`."""
    kind, context = fault["type"], fault.get("ctx", {})
    if kind == "json_invalid":
        return f"JSON ({context['error']})"
    if kind == "too_short":
        return f"at least {context['min_length']} values"
    if kind == "too_long":
        return f"at most {context['max_length']} values"
    if kind == "string_too_short":
        return "text that is not empty"
    bound = fault["msg"].removeprefix("Input should be ")
    bound = bound.replace("greater than or equal to", "at least").replace("less than or equal to", "at most")
    return str(context["expected"]) if kind == "literal_error" else _KINDS.get(kind.split("_")[0]) or bound


def _place(content: Any, location: tuple[Any, ...], missing: bool) -> tuple[Any, ...]:
    """Location reduced to keys and numbers of the content, without names of kinds."""

    def leads(inside: Any, k: int) -> bool:
        if isinstance(inside, dict):
            return location[k] in inside or (missing and k == len(location) - 1 and isinstance(location[k], str))
        return isinstance(inside, list | tuple) and location[k] in range(len(inside))

    found = []
    for k, part in enumerate(location):
        if not leads(content, k):
            continue
        below = content[part] if not isinstance(content, dict) else content.get(part)
        # The name of a kind may be a key as well: then it is the next part that leads on from here.
        if k + 1 == len(location) or leads(below, k + 1) or not leads(content, k + 1):
            found.append(part)
            content = below
    return tuple(found)


DELIMITERS = {".csv": ",", ".tsv": "\t"}
MOST_COLUMNS = 10_000
"""Of CSV and TSV."""
EXCEL = (".xlsx", ".xls")


@dataclass(frozen=True)
class Content:
    """Text file's content: the JSON value, or for JSON lines and CSV a list of rows with their line numbers, from 1."""

    value: Any
    path: Path
    numbers: tuple[int, ...] | None = None

    def where(self, k: int) -> str:
        """Name row `k` for a message: "line 3", or "entry 2" of a list."""
        return f"entry {k}" if self.numbers is None else f"line {self.numbers[k]}"

    @property
    def first(self) -> dict[str, Any]:
        """First row or the value, if an object; else an empty object."""
        found = self.value[0] if isinstance(self.value, list) and self.value else self.value
        return found if isinstance(found, dict) else {}

    def rows(self, check: Callable[[Any], Checked], wrong: str) -> list[Checked]:
        """Validate every row by `check`, a validating method of pydantic; InputError with line or entry."""
        require(isinstance(self.value, list), f"{wrong}: a list of entries is asked for", path=self.path)
        return [checked(check, row, f"{self.where(k)}, {{}}: {wrong}", self.path) for k, row in enumerate(self.value)]


def read_content(path: Path, what: str = "the file") -> Content:
    """Read a file of JSON, JSON lines, or (by its ending) CSV or TSV; `what` names it in messages.

    Raises InputError for an unreadable file, with the line of JSON lines.
    """
    ending = path.suffix.lower()
    require(ending not in EXCEL, f"{what} is a table of Excel", expected="the same saved as .tsv or .csv", path=path)
    utf8 = as_input_error(
        f"{what} is not UTF-8", UnicodeDecodeError, got=str, expected="a file saved as UTF-8", path=path
    )
    with as_input_error(f"{what} cannot be read", OSError, got=str, path=path), utf8:
        text = read_text(path, "utf-8-sig")
    if ending in DELIMITERS:
        with as_input_error(f"{what} is not {ending[1:].upper()}", csv.Error, got=str, path=path):
            reader = csv.DictReader(text.splitlines(), delimiter=DELIMITERS[ending])
            columns = len(reader.fieldnames or ())
            require(columns <= MOST_COLUMNS, f"{what} has too many columns", got=columns, path=path)
            table: list[tuple[int, dict[str, Any]]] = []
            for row in reader:
                extra = f"line {reader.line_num} has more cells than the first line names"
                require(None not in row, extra, expected=columns, path=path)
                table.append((reader.line_num, row))
        return Content([row for _, row in table], path, tuple(number for number, _ in table))
    lines = [(number, line) for number, line in enumerate(text.split("\n"), 1) if line.strip()]
    if ending == ".jsonl" or (len(lines) > 1 and _is_json(lines[0][1]) and _is_json(lines[1][1])):
        rows = [_parsed(line, f"line {number}: not JSON", path) for number, line in lines]
        return Content(rows, path, tuple(number for number, _ in lines))
    return Content(_parsed(text, f"{what} is not JSON", path), path)


def _is_json(text: str) -> bool:
    try:
        parse_json(text)
    except (ValueError, InputError):
        return False
    return True


def _parsed(text: str, wrong: str, path: Path) -> Any:
    with as_input_error(wrong, ValueError, got=first_line, path=path):
        return parse_json(text, path)
