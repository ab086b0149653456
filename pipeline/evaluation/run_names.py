"""Names of two runs that tell them apart: what differs in their settings, else how they or their folders are called."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.evaluation.run_folder import Run

WORDS = {
    "detector": "",
    "options.model": "",
    "options.predictions": "",
    "options.fuse": "fused with",
    "scorer": "relations by",
    "k": "K",
    "options.min_score": "minimum score",
    "rank.target_weight": "α",
    "rank.reference_weight": "β",
    "rank.relation_weight": "γ",
    "options.segmenter": "masks by",
    "options.up": "up",
}
"""Settings in the order in which they tell runs apart, with what stands before their values."""
MOST = 2
"""Settings in a name."""


def told_apart(first: Run, second: Run) -> tuple[str, str]:
    """Names of two runs: "K 10" and "K 2"."""
    one, other = dict(_settings(first)), dict(_settings(second))
    said = [(_said(key, one.get(key)), _said(key, other.get(key))) for key in dict.fromkeys((*WORDS, *one, *other))]
    names = tuple(
        " · ".join(words[:MOST]) for words in zip(*(pair for pair in said if pair[0] != pair[1]), strict=True)
    )
    for a, b in (names or ("", ""), (first.name, second.name), (first.folder.name, second.folder.name)):
        if a != b:
            return a, b
    return "first run", "second run"


def _settings(run: Run) -> Iterator[tuple[str, Any]]:
    """Settings of a run's manifest by dotted name."""
    manifest = run.manifest
    yield from (("detector", manifest.get("detector")), ("scorer", manifest.get("scorer")))
    yield from _flat(manifest.get("config") or {}, "")


def _flat(values: Mapping[str, Any], before: str) -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", None if value == "None" else value


def _said(key: str, value: Any) -> str:
    shown = "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
    # The file is enough of a path, and a fingerprint says nothing.
    shown = Path(shown).name if "/" in shown or "\\" in shown else shown.partition(":")[0] or shown
    return f"{WORDS.get(key, key.rpartition('.')[2].replace('_', ' '))} {shown}".strip()
