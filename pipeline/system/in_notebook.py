"""Notebook display of a result, by a function of the face.

The function is named, and imported at the first display: the core makes no HTML and imports no face.
"""

from __future__ import annotations

from importlib import import_module
from typing import ClassVar


class InNotebook:
    """Result with HTML in a notebook, or its `repr` without a face.

    `html_by` names the function from a result to HTML as "module:name"; empty for none.
    """

    html_by: ClassVar[str] = ""

    def _repr_html_(self) -> str | None:
        module, _, name = self.html_by.partition(":")
        return getattr(import_module(module), name)(self) if module else None
