"""Tables of fields: of classes by their JSON Schema, and of JSON that functions make by their keys."""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass
from typing import Any

import meanings
from markdown_tables import cell, code, table
from pydantic import BaseModel, TypeAdapter

HEAD = ("field", "type", "default", "meaning")
ARROW = "arrow"
"""What a field of a table is stored as, where the schema of labels says it."""


def _inside(kind: Any) -> Iterable[type]:
    """Yield the classes with fields that a type is made of."""
    if isinstance(kind, type) and (is_dataclass(kind) or issubclass(kind, BaseModel)):
        yield kind
    for part in typing.get_args(kind):
        yield from _inside(part)


def classes_of(kind: type) -> dict[str, type]:
    """Return a class and the classes of its fields, by name."""
    found: dict[str, type] = {}
    waiting = [kind]
    while waiting:
        one = waiting.pop()
        if one.__name__ not in found:
            found[one.__name__] = one
            waiting += [c for hint in typing.get_type_hints(one, include_extras=True).values() for c in _inside(hint)]
    return found


def shown_type(field: Mapping[str, Any], link: Callable[[str], str]) -> str:
    """Word the type of a field of a JSON Schema, as Markdown; `link` makes one of a class's name."""
    if "$ref" in field:
        return link(field["$ref"].rpartition("/")[2])
    if "const" in field:
        return code(f"{field['const']}")
    if "enum" in field:
        return " or ".join(code(f"{v}") for v in field["enum"])
    if "anyOf" in field or "oneOf" in field:
        parts = [shown_type(one, link) for one in field.get("anyOf", field.get("oneOf", ()))]
        return " or ".join(dict.fromkeys(parts))
    if "allOf" in field:
        return shown_type(field["allOf"][0], link)
    kind = field.get("type")
    if kind == "array":
        return _list(field, link)
    if kind == "object":
        inside = field.get("additionalProperties")
        return f"object of {shown_type(inside, link)}" if isinstance(inside, dict) and inside else "object"
    words = {"integer": "whole number", "string": "text", "boolean": "true or false", "null": "null"}
    return words.get(f"{kind}", f"{kind or 'any'}") + _bounds(field)


def _list(field: Mapping[str, Any], link: Callable[[str], str]) -> str:
    if parts := field.get("prefixItems"):
        kinds = [shown_type(one, link) for one in parts]
        return _so_many(len(kinds), kinds[0]) if len(set(kinds)) == 1 else f"list: {', '.join(kinds)}"
    least, most = field.get("minItems"), field.get("maxItems")
    fixed = least is not None and least == most
    return _so_many(int(least or 0), shown_type(field["items"], link)) if fixed else _several(field, link)


def _so_many(count: int, kind: str) -> str:
    """Word a fixed number of things: "4 numbers", "3 by 3 numbers"."""
    if kind[:1].isdigit():
        return f"{count} by {kind}"
    return f"{count} {kind.replace('number', 'numbers', 1)}" if "number" in kind[:12] else f"{count} of {kind}"


def _several(field: Mapping[str, Any], link: Callable[[str], str]) -> str:
    inside = field.get("items")
    return f"list of {shown_type(inside, link)}" if inside else "list"


def _bounds(field: Mapping[str, Any]) -> str:
    least = field.get("minimum", field.get("exclusiveMinimum"))
    most = field.get("maximum", field.get("exclusiveMaximum"))
    if least is not None and most is not None and most < 2**31:
        return f" {least:g} to {most:g}"
    if least is None or field.get("type") == "string":
        return ""
    return f" above {least:g}" if "exclusiveMinimum" in field else f" from {least:g}"


def _default(name: str, field: Mapping[str, Any], needed: Iterable[str]) -> str:
    if name in needed:
        return "required"
    value = field.get("default")
    if value in (None, "", [], {}):
        return ""
    return code(f"{value}".lower() if isinstance(value, bool) else f"{value}") if not isinstance(value, dict) else ""


def fields_of(kind: type, schema: Mapping[str, Any], link: Callable[[str], str]) -> list[tuple[str, ...]]:
    """Return the rows of a class's table, by its JSON Schema and what the code says of its fields."""
    said = meanings.of_class(kind)
    rows = []
    for name, field in schema.get("properties", {}).items():
        stored = field.get(ARROW) or next((x[ARROW] for x in field.get("anyOf", ()) if ARROW in x), "")
        shown = shown_type(field, link) + (f" ({stored})" if stored else "")
        meaning = field.get("description") or said.get(name, "")
        rows.append((code(name), shown, _default(name, field, schema.get("required", ())), cell(meaning)))
    return rows


def class_tables(kind: type, level: int, only: Callable[[type], bool] = lambda _: True, alone: bool = False) -> str:
    """Return a class's table and, below headings, those of the classes of its fields; `alone`: its own only."""
    whole = TypeAdapter(kind).json_schema()
    known = {
        n: c for n, c in classes_of(kind).items() if n == kind.__name__ or (n in whole.get("$defs", {}) and only(c))
    }

    def link(name: str) -> str:
        if alone or name not in known:
            found = whole.get("$defs", {}).get(name, {})
            return shown_type(found, link) if "properties" not in found else "object"
        return f"[{title_of(known[name])}](#{title_of(known[name]).lower()})"

    parts = [table(HEAD, fields_of(kind, whole, link))]
    for name, one in known.items():
        if one is not kind and not alone:
            parts += [f"{'#' * level} {title_of(one)}\n", f"{cell(doc_of(one))}\n"]
            parts += [table(HEAD, fields_of(one, whole["$defs"][name], link))]
    return "\n".join(parts)


def title_of(kind: type) -> str:
    """Return the heading of a class."""
    return kind.__name__.lstrip("_")


def doc_of(kind: type) -> str:
    """Return the first paragraph of a class's docstring."""
    return (kind.__doc__ or "").split("\n\n")[0].split("\nAttributes\n")[0]


def json_type(values: Iterable[Any]) -> str:
    """Word the types of values of JSON that were seen."""
    words = {bool: "true or false", int: "whole number", float: "number", str: "text", dict: "object", list: "list"}
    kinds = dict.fromkeys(words.get(type(v), "null") for v in values)
    if "number" in kinds:
        kinds.pop("whole number", None)
    null = kinds.pop("null", "") is None
    return " or ".join([*kinds, *(["null"] if null else [])])
