"""A number of things in words."""

from __future__ import annotations


def counted(count: int, what: str) -> str:
    """Number of things in words: "1 scene", "2 classes", "12,345 objects"; the plural of `what` must end in s."""
    ending = "" if count == 1 else "es" if what.endswith("s") else "s"
    return f"{count:,} {what}{ending}"
