"""What the code says of fields, columns and keys, where they are defined.

A field or key is described by the text below it, by the comment at the end of its line, or by the comment above it; of
a class also by the list of attributes in its docstring. A comment that begins "a, b: ..." is of these fields.
"""

from __future__ import annotations

import ast
import inspect
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from types import ModuleType

from griffe import Docstring, DocstringSectionAttributes


@cache
def _parsed(file: str) -> tuple[ast.Module, dict[int, str], dict[int, str]]:
    """Return a file's tree, its comments after code and those on lines of their own, by line."""
    with open(file, encoding="utf-8") as opened:
        text = opened.read()
    lines, after, alone = text.splitlines(), {}, {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            own = not lines[token.start[0] - 1][: token.start[1]].strip()
            (alone if own else after)[token.start[0]] = token.string.lstrip("# ").rstrip()
    return ast.parse(text), after, alone


def _names_of(node: ast.AST) -> Iterator[tuple[str, int, int]]:
    """Yield fields, keys and arguments with a name below a node, each with its first and last line."""
    for inner in node.body if isinstance(node, ast.ClassDef) else ast.walk(node):
        if isinstance(inner, ast.AnnAssign) and isinstance(inner.target, ast.Name):
            yield inner.target.id, inner.lineno, inner.end_lineno or inner.lineno
        elif isinstance(inner, ast.keyword) and inner.arg:
            yield inner.arg, inner.value.lineno, inner.value.end_lineno or inner.value.lineno
        elif isinstance(inner, ast.Dict):
            for key, value in zip(inner.keys, inner.values, strict=True):
                if isinstance(key, ast.Constant) and isinstance(key.value, str):
                    yield key.value, key.lineno, value.end_lineno or value.lineno
        elif isinstance(inner, ast.Subscript) and isinstance(inner.slice, ast.Constant):
            yield f"{inner.slice.value}", inner.lineno, inner.lineno
        elif isinstance(inner, ast.Tuple):
            for one in inner.elts:
                if isinstance(one, ast.Constant) and isinstance(one.value, str):
                    yield one.value, one.lineno, one.end_lineno or one.lineno


def _by_comments(file: str, node: ast.AST) -> dict[str, str]:
    _, after, alone = _parsed(file)
    names = list(_names_of(node))
    known = {name for name, _, _ in names}
    found: dict[str, str] = {}
    taken: set[int] = set()
    for name, first, last in names:
        # Of several on a line the comment is of the outermost, which comes first.
        text = None if first in taken else after.get(first) or after.get(last)
        taken |= {first} if text else set()
        if text is None and first not in taken:
            above, line = [], first - 1
            while line in alone:
                above.insert(0, alone[line])
                line -= 1
            text = " ".join(above)
            several = re.match(r"((?:\w+, )*\w+): ", text)
            of = several[1].split(", ") if several else []
            if of and set(of) <= known:
                found |= dict.fromkeys(of, _sentence(text[several.end() :])) if several else {}
                continue
            taken |= {first} if text else set()
        if text:
            found.setdefault(name, _sentence(text))
    return found


def _sentence(text: str) -> str:
    """Return a text with a capital, where it does not begin with a value or a name."""
    text = text.strip()
    return text[:1].upper() + text[1:] if re.match(r"[a-z]+[ .;:]", text) else text


def _by_texts_below(node: ast.ClassDef) -> dict[str, str]:
    found = {}
    for field, below in zip(node.body, node.body[1:], strict=False):
        text = below.value if isinstance(below, ast.Expr) else None
        named = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if named and isinstance(text, ast.Constant) and isinstance(text.value, str):
            found[field.target.id] = " ".join(text.value.split())
    return found


def _node(file: str, name: str) -> ast.AST | None:
    """Return the class, function or constant of a name in a file; "Answer.record" is a function of a class."""
    outer, _, name = name.rpartition(".")
    for node in ast.walk(_node(file, outer) or ast.Module([], []) if outer else _parsed(file)[0]):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return node
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
            return node
        if isinstance(node, ast.Assign) and name in [t.id for t in node.targets if isinstance(t, ast.Name)]:
            return node
    return None


@cache
def of_class(kind: type) -> dict[str, str]:
    """Return what is said of a class's fields, those of its bases too."""
    found: dict[str, str] = {}
    for one in kind.__mro__:
        if one.__module__.split(".")[0] not in ("pipeline", "spatialviz"):
            continue
        file = inspect.getfile(one)
        listed = Docstring(inspect.getdoc(one) or "").parse("numpy", warnings=False)
        told = {
            a.name: " ".join(a.description.split())
            for section in listed
            if isinstance(section, DocstringSectionAttributes)
            for a in section.value
        }
        node = _node(file, one.__name__)
        if not isinstance(node, ast.ClassDef):  # Made by a function.
            continue
        found = {**_by_comments(file, node), **told, **_by_texts_below(node), **found}
    return found


def left_out(module: ModuleType, function: str) -> list[str]:
    """Return the keys that a function leaves out where they have nothing to say: arguments of `present`."""
    node = _node(inspect.getfile(module), function)
    given = (n for n in ast.walk(node) if isinstance(n, ast.Return)) if node else ()
    calls = (c for one in given for c in ast.walk(one) if isinstance(c, ast.Call))
    named = [c for c in calls if isinstance(c.func, ast.Name) and c.func.id == "present"]
    return [k.arg for c in named[:1] for k in c.keywords if k.arg]


def of_keys(module: ModuleType, *names: str) -> dict[str, str]:
    """Return what is said of the keys in constants or functions of a module, that of the first of them first."""
    file = inspect.getfile(module)
    found: dict[str, str] = {}
    for name in names:
        node = _node(file, name)
        assert node is not None, f"{file} has no {name}"
        found = {**_by_comments(file, node), **found}
    return found
