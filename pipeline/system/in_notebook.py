"""How a result looks in a notebook. The core makes no HTML: a face that does names the function here.

Importing the core must not bring in a face, so the function is named, and imported when something is first shown.
"""

from __future__ import annotations

from importlib import import_module
from typing import ClassVar


class InNotebook:
    """A result that shows itself where a notebook asks it to; as its `repr` where there is no face.

    Attributes
    ----------
    html_by : str
        The function, a result -> HTML, as "module:name"; empty for none.
    """

    html_by: ClassVar[str] = ""

    def _repr_html_(self) -> str | None:
        module, _, name = self.html_by.partition(":")
        return getattr(import_module(module), name)(self) if module else None
