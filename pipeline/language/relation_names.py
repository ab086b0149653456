"""The relations: their names, vocabularies, inverses and phrases."""

from __future__ import annotations

DIRECTIONAL = ("left", "right", "above", "below", "front", "behind")
PAIRWISE = (*DIRECTIONAL, "on", "in", "near")
"""Relations with a state for every ordered pair, in the order in which they are always shown."""
VOCABULARIES: dict[str, tuple[str, ...]] = {
    "avd": DIRECTIONAL,
    "semantic-abstraction": ("behind", "left", "right", "front", "on", "in"),
    "all": PAIRWISE,
}
INVERSE = {"left": "right", "right": "left", "above": "below", "below": "above", "front": "behind", "behind": "front"}
PHRASE = {
    "left": "left of",
    "right": "right of",
    "above": "above",
    "below": "below",
    "front": "in front of",
    "behind": "behind",
    "on": "on",
    "in": "in",
    "near": "near",
    "between": "between",
    "closest": "closest to",
    "farthest": "farthest from",
}
