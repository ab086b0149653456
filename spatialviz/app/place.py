"""What one client looks at, kept by the browser's tab: a reload brings it back.

It cannot stand in the page's address: viser 1.1 takes a fragment for a part of
its server's name, and writes the values of a query back without escaping them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from urllib.parse import parse_qs, unquote, urlencode

LONGEST = 2000
"""A text of more characters is none of ours."""


@dataclass(frozen=True)
class Place:
    """A place to look at; None is what is not said.

    Attributes
    ----------
    source, frame : str or None
    text : str or None
        The question; "" where none is asked.
    """

    source: str | None = None
    frame: str | None = None
    text: str | None = None

    @classmethod
    def read(cls, said: str, sources: Collection[str]) -> Place:
        """The place that a text says. One of a dataset that is not open says nothing."""
        if len(said) > LONGEST:
            return cls()
        try:
            fields = parse_qs(said, keep_blank_values=True, max_num_fields=8)
        except ValueError:
            return cls()
        source, frame, text = (fields.get(key, [None])[0] for key in ("data", "frame", "ask"))
        return cls() if source is not None and source not in sources else cls(source, frame, text)

    @staticmethod
    def signed(said: str) -> tuple[str, str]:
        """What a browser says of itself: the place that its tab has kept, and the name of who corrects labels there."""
        place, _, author = said.partition("&author=")
        return place, unquote(author[: 3 * LONGEST])

    def said(self) -> str:
        """The text that says this place."""
        said = {"data": self.source, "frame": self.frame, "ask": self.text}
        return urlencode({key: value for key, value in said.items() if value is not None}, safe="/")
