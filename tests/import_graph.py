"""Imports between the project's modules, read from the source: at the top, within functions, for types, and by name."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BY_NAME = ("import_module",)
"""What imports a module whose name is a string."""


@dataclass(frozen=True)
class Imports:
    """What a module imports.

    Attributes
    ----------
    everywhere : in functions and for types too
    top : at the top of the file, conditions included
    always : at the top, without a condition
    named : modules whose names stand as strings in a file that imports by name
    """

    everywhere: list[ast.Import | ast.ImportFrom]
    top: list[ast.Import | ast.ImportFrom]
    always: list[ast.Import | ast.ImportFrom]
    named: frozenset[str]


@cache
def modules(package: str) -> dict[str, Imports]:
    """Every module of a package of the project by its dotted name."""
    trees = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        trees[".".join(parts).removesuffix(".__init__")] = ast.parse(path.read_text(encoding="utf-8"))
    return {name: imports_of(tree, trees) for name, tree in trees.items()}


def imports_of(tree: ast.Module, known: Mapping[str, object]) -> Imports:
    """What a file imports; `known` holds the dotted names of modules that strings may name."""
    everywhere = [n for n in statements(tree) if isinstance(n, (ast.Import, ast.ImportFrom))]
    top = {id(n) for n in tree.body for n in ([n] if not isinstance(n, (ast.If, ast.Try)) else ast.walk(n))}
    return Imports(
        everywhere,
        [n for n in everywhere if id(n) in top],
        [n for n in everywhere if n in tree.body],
        frozenset(_named(tree, known)),
    )


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """Every statement of a file, in functions and classes too; no import stands within an expression."""
    left: list[ast.stmt] = [*tree.body]
    while left:
        node = left.pop()
        yield node
        for part in (node, *getattr(node, "handlers", ()), *getattr(node, "cases", ())):
            for name in ("body", "orelse", "finalbody"):
                left += getattr(part, name, ())


def _named(tree: ast.Module, known: Mapping[str, object]) -> Iterator[str]:
    """Modules that strings name, whole or after the beginning of an f-string such as f"pipeline.proposals.{module}"."""
    imports = (n for n in statements(tree) if isinstance(n, ast.ImportFrom) and n.module == "importlib")
    if not any(a.name in BY_NAME for n in imports for a in n.names) and "importlib" not in _imported_whole(tree):
        return
    nodes = list(ast.walk(tree))
    texts = {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    begun = {
        n.values[0].value
        for n in nodes
        if isinstance(n, ast.JoinedStr) and n.values and isinstance(n.values[0], ast.Constant)
    }
    for text in texts - begun - {""}:
        # "module.Name" and "module:Name" name a module too.
        for part in {text, text.rpartition(".")[0], text.partition(":")[0]} - {""}:
            yield from {part, *(f"{start}{part}" for start in begun)} & known.keys()


def _imported_whole(tree: ast.Module) -> set[str]:
    return {a.name.split(".")[0] for n in statements(tree) if isinstance(n, ast.Import) for a in n.names}


def imported(nodes: list[ast.Import | ast.ImportFrom], known: Mapping[str, object]) -> Iterator[tuple[str, int]]:
    """Modules among `known` that these import, and in which line."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((a.name, node.lineno) for a in node.names if a.name in known)
        elif node.module and not node.level:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if whole in known or node.module in known:
                    yield (whole if whole in known else node.module), node.lineno


def circles(found: Mapping[str, Imports], without: tuple[str, ...] = ()) -> set[str]:
    """Modules that stand in circles of imports, or between two; those in `without` are not looked at."""
    arrows = {
        name: ({t for t, _ in imported(each.everywhere, found)} | each.named) - {name, *without}
        for name, each in found.items()
        if name not in without
    }
    # What imports nothing that is left is taken away, and so is what nothing that is left imports.
    left = set(arrows)
    while free := {n for n in left if not arrows[n] & left} | (left - set().union(*(arrows[n] for n in left))):
        left -= free
    return left
