"""Docstrings as griffe reads them: examples that end one become a section, and fields have the comments beside them."""

from __future__ import annotations

import re
from typing import Any

import griffe
import meanings
from griffe import dynamic_import

EXAMPLE = re.compile(r"\n\n(?=>>> )")
HEADED = re.compile(r"\nExamples\n-+\n")


class Docstrings(griffe.Extension):
    """What our docstrings leave out of numpydoc for short."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Put a heading above the examples."""
        if obj.docstring is not None and not HEADED.search(obj.docstring.value):
            text = EXAMPLE.sub("\n\nExamples\n--------\n", obj.docstring.value, count=1)
            obj.docstring = griffe.Docstring(text, parent=obj, parser="numpy", lineno=obj.docstring.lineno)

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        """Give fields without a text below them the comment beside them."""
        if "dataclass" not in cls.labels:
            return
        said = meanings.of_class(dynamic_import(cls.path))
        for name, field in cls.attributes.items():
            if field.docstring is None and name in said and "\nAttributes\n" not in (cls.docstring or "").value:
                field.docstring = griffe.Docstring(said[name], parent=field)
