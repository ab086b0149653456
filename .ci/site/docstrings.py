"""Docstrings as griffe reads them: examples that end one become a section, and fields have the comments beside them."""

from __future__ import annotations

import re
from typing import Any

import griffe
import meanings

EXAMPLE = re.compile(r"\n\n(?=>>> )")
HEADED = re.compile(r"\nExamples\n-+\n")
RAISES = re.compile(r"\n\nRaises (\w+):? (.*?)(?=\n\n|\Z)", re.S)
SEVERAL = re.compile(r"^(\w+(?:, \w+)+)( : .*)?\n((?:    .*(?:\n|\Z))+)", re.M)
OURS, STANDARD = "pipeline.system.frozen.dataclass", "dataclasses.dataclass"


def numpydoc(text: str) -> str:
    """Return a docstring with what ours leave out for short: a heading above examples and errors, a field a name."""
    if not HEADED.search(text):
        text = EXAMPLE.sub("\n\nExamples\n--------\n", text, count=1)
    text = RAISES.sub(lambda m: f"\n\nRaises\n------\n{m[1]}\n    {' '.join(m[2].split())[:1].upper()}"
                                f"{' '.join(m[2].split())[1:]}", text)  # fmt: skip
    return SEVERAL.sub(lambda m: "".join(f"{n}{m[2] or ''}\n{m[3].rstrip()}\n" for n in m[1].split(", ")), text)


class Docstrings(griffe.Extension):
    """Docstrings and dataclasses of this project, as griffe knows them."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Complete a docstring."""
        if obj.docstring is not None:
            obj.docstring = griffe.Docstring(
                numpydoc(obj.docstring.value), parent=obj, parser="numpy", lineno=obj.docstring.lineno
            )

    def on_class_instance(self, *, cls: griffe.Class, **_: Any) -> None:
        """Tell that our dataclasses are some, so that they have a signature."""
        for decorator in cls.decorators:
            if decorator.callable_path == OURS:
                value = getattr(decorator.value, "arguments", [])
                decorator.value = griffe.ExprCall(griffe.ExprName(STANDARD), value)

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        """Give fields without a text below them the comment beside them."""
        if not any(d.callable_path == STANDARD for d in cls.decorators):
            return
        said = meanings.of_class(griffe.dynamic_import(cls.path))
        listed = "\nAttributes\n" in getattr(cls.docstring, "value", "")
        for name, field in cls.attributes.items():
            if field.docstring is None and name in said and not listed:
                field.docstring = griffe.Docstring(said[name], parent=field)
