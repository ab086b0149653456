"""Counts, shares and names in words."""

from __future__ import annotations

from collections.abc import Mapping


def counted(count: int, what: str) -> str:
    """Number of things in words: "1 scene", "2 classes", "12,345 objects"; the plural of `what` must end in s."""
    ending = "" if count == 1 else "es" if what.endswith("s") else "s"
    return f"{count:,} {what}{ending}"


def listed(counts: Mapping[str, int], most: int | None = None) -> str:
    """Names with their counts, the rest summed up: "mug 3, book 2, 4 others 7"."""
    names = list(counts)
    found = [f"{short(name)} {counts[name]:,}" for name in names[:most]]
    if rest := names[len(found) :]:
        found.append(f"{len(rest):,} others {sum(counts[name] for name in rest):,}")
    return ", ".join(found)


def short(name: str, length: int = 28) -> str:
    """Name on one line, cut if long."""
    name = " ".join(name.split()) or "(blank)"
    return name if len(name) <= length else name[: length - 1] + "…"


def share_text(value: float | None) -> str:
    """Share as a percentage; a dash for none."""
    if value is None:
        return "–"
    return f"{value:.1%}" if 0 < value < 0.0995 else f"{value:.0%}"
