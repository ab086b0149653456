"""Tables of Markdown, from plain texts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def cell(text: str) -> str:
    """Return a text on one line, with nothing that ends a cell or reads as markup; code in backticks stays."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    # A bar inside code does not end a cell.
    return "".join(p if k % 2 else re.sub(r"([*_\[\]])", r"\\\1", _plain(p)) for k, p in enumerate(parts))


def _plain(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("|", "&#124;")


def code(text: str) -> str:
    """Return a text as code; empty stays empty."""
    return f"`{text}`" if text else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose cells are Markdown; a column without any text is left out."""
    found = [tuple(row) for row in rows]
    used = [k for k in range(len(head)) if any(row[k] for row in found)]
    lines = [[head[k] for k in used], ["---"] * len(used), *([row[k] for k in used] for row in found)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
