"""What one client looks at, in the fragment of the page's address: a reload or a link brings it back.

viser 1.1 drops the fragment of an address that has a query; the tab's session storage keeps it, too.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from urllib.parse import parse_qs, urlencode

LONGEST = 2000
"""A fragment of more characters is none of ours."""


@dataclass(frozen=True)
class Address:
    """A place to look at; None is what the address does not say.

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
    def read(cls, fragment: str, sources: Collection[str]) -> Address:
        """The address that a fragment says. One of a dataset that is not open says nothing."""
        if len(fragment) > LONGEST:
            return cls()
        try:
            said = parse_qs(fragment.lstrip("#"), keep_blank_values=True, max_num_fields=8)
        except ValueError:
            return cls()
        source, frame, text = (said.get(key, [None])[0] for key in ("data", "frame", "ask"))
        return cls() if source is not None and source not in sources else cls(source, frame, text)

    def fragment(self) -> str:
        """The fragment that says this address, without the "#"."""
        said = {"data": self.source, "frame": self.frame, "ask": self.text}
        return urlencode({key: value for key, value in said.items() if value is not None}, safe="/")
