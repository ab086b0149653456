"""Expressions from relations: one for every pair of which a relation holds, with all that it is true of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xxhash

from pipeline.errors import InputError
from pipeline.labels.config import LabelConfig
from pipeline.labels.profiles import Judged
from pipeline.labels.wording import expression_text
from pipeline.naming import same_class
from pipeline.relations import PAIRWISE, T, U


def row_hash(seed: int, *parts: object) -> int:
    """64 bits that depend on nothing but the seed and what the row says."""
    return xxhash.xxh3_64_intdigest("\x1f".join(str(p) for p in parts).encode(), seed=seed & (2**64 - 1))


def same_names(labels: Sequence[str]) -> np.ndarray:
    """(N, N) bool: objects whose class names mean the same."""
    names = list(dict.fromkeys(labels))
    alike = np.array([[a == b or same_class(a, b) for b in names] for a in names], np.bool_).reshape(len(names), -1)
    place = np.array([names.index(label) for label in labels], np.int64)
    return alike[np.ix_(place, place)]


def candidate_expressions(
    frame: str,
    frame_index: int,
    ids: Sequence[int],
    labels: Sequence[str],
    usable: np.ndarray,
    judged: Judged,
    config: LabelConfig,
    up_source: str,
) -> dict[str, list[Any]]:
    """All expressions that are true of a pair of usable objects of a frame.

    Parameters
    ----------
    ids, labels : sequences of N
        Numbers and class names of the objects that were judged.
    usable : (N,) bool
        Objects that may be asked for; the others still count as acceptable answers.
    judged : Judged

    Returns
    -------
    dict of str to list
        Columns of the table `expressions`, in canonical order, one row for each
        pair and relation that is T.
    """
    columns: dict[str, list[Any]] = {name: [] for name in EXPRESSION_COLUMNS}
    if len(ids) < 2:
        return columns
    same = same_names(labels)
    number = np.asarray(ids)
    for relation in config.relations:
        k = PAIRWISE.index(relation)
        state = judged.states[..., k].copy()
        np.fill_diagonal(state, -1)
        # satisfied[a, b]: object a has the relation to some object of b's class.
        kinds = same.astype(np.int32)
        sure = (state == T).astype(np.int32) @ kinds > 0
        likely = (state >= U).astype(np.int32) @ kinds > 0
        for a, b in zip(*np.nonzero((state == T) & usable[:, None] & usable[None, :]), strict=True):
            alike, target, reference = same[a], labels[int(a)], labels[int(b)]
            targets = number[alike & sure[:, b]].tolist()
            acceptable = number[alike & likely[:, b]].tolist()
            key = row_hash(config.seed, frame, number[a], relation, number[b])
            try:
                text = expression_text(target, relation, reference, key, style=config.style)
            except InputError:
                # A class name that no sentence can carry, such as one of white space.
                continue
            row = (
                frame, frame_index, f"{key:016x}", text, target, relation, reference, int(number[a]),
                int(number[b]), targets, acceptable, len(acceptable) > 1, float(judged.margins[a, b, k]), "viewer",
                up_source, config.profile,
            )  # fmt: skip
            for name, value in zip(EXPRESSION_COLUMNS, row, strict=True):
                columns[name].append(value)
    return columns


EXPRESSION_COLUMNS = (
    "frame", "frame_index", "id", "text", "target", "relation", "reference", "target_object", "reference_object",
    "targets", "acceptable", "ambiguous", "margin", "judged_in", "up_source", "profile",
)  # fmt: skip
