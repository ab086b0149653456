"""Which class names a detector can give, and which names of two detectors mean the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.language.naming import Synonyms, match, same_class
from pipeline.proposals.base import Detector


def known_names(detector: Detector) -> tuple[str, ...] | None:
    """The names that a detector gives where it is asked for everything; None where they may be any."""
    if detector.vocabulary is not None:
        return detector.vocabulary
    found: object = detector
    while found is not None:
        names = getattr(found, "default_labels", None)
        if names is not None:
            return tuple(names)
        # What wraps a detector (a cache, a segmenter) has it as this attribute.
        found = getattr(found, "detector", None)
    return None


def knows(names: Sequence[str] | None, label: str, synonyms: Synonyms | None = None) -> bool:
    """Whether a detector of these names (None: any) could find what `label` means."""
    return names is None or bool(match(label, names, synonyms))


def same_name(a: str, b: str, synonyms: Synonyms | None = None) -> bool:
    """Whether two detectors that say `a` and `b` of one thing say the same: one class, or a kind of it ("cracker box"
    and "box")."""
    return a == b or same_class(a, b, synonyms) or bool(match(a, [b], synonyms) or match(b, [a], synonyms))


def same_names(a: Sequence[str], b: Sequence[str], synonyms: Synonyms | None = None) -> np.ndarray:
    """(N, M) bool: `same_name` of every label of `a` with every one of `b`."""
    names_a, place_a = _distinct(a)
    names_b, place_b = _distinct(b)
    table = np.array([[same_name(x, y, synonyms) for y in names_b] for x in names_a], np.bool_)
    return table.reshape(len(names_a), len(names_b))[np.ix_(place_a, place_b)]


def name_groups(names: Sequence[str], synonyms: Synonyms | None = None) -> dict[str, str]:
    """The name that stands for each: shorter names first, each joins the first of them that says the same.

    It does not depend on the order of `names`.
    """
    chosen: list[str] = []
    stands: dict[str, str] = {}
    for name in sorted(set(names), key=lambda n: (len(n), n)):
        stands[name] = next((c for c in chosen if same_name(c, name, synonyms)), name)
        if stands[name] == name:
            chosen.append(name)
    return stands


def _distinct(labels: Sequence[str]) -> tuple[list[str], list[int]]:
    names = list(dict.fromkeys(labels))
    place = {name: i for i, name in enumerate(names)}
    return names, [place[label] for label in labels]
