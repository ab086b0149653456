"""Expressions from relations: one for every pair of which a relation holds, with all that it is true of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xxhash

from pipeline.labels.config import LabelConfig
from pipeline.labels.profiles import Judged
from pipeline.labels.wording import can_be_said
from pipeline.language.noun_phrase import same_names
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import T, U


def row_hash(seed: int, *parts: object) -> int:
    """64 bits that depend on nothing but the seed and what the row says."""
    return xxhash.xxh3_64_intdigest("\x1f".join(str(p) for p in parts).encode(), seed=seed & (2**64 - 1))


def candidate_expressions(
    frame: str,
    frame_index: int,
    ids: Sequence[int],
    labels: Sequence[str],
    usable: np.ndarray,
    judged: Judged,
    config: LabelConfig,
    up_source: str,
) -> dict[str, Any]:
    """All expressions that are true of a pair of usable objects of a frame, not yet put into words.

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
        Columns of the table `candidates`, in canonical order, one row for each
        pair and relation that is T; empty where there is none.
    """
    if len(ids) < 2:
        return {}
    same = same_names(labels)
    kinds = same.astype(np.int32)
    kind, rivals = same.argmax(axis=1), same.sum(axis=1)
    asked = usable & np.array([can_be_said(label) for label in labels], np.bool_)
    number = np.asarray(ids)
    names = [str(n) for n in ids]
    found: dict[str, list[Any]] = {name: [] for name in _OWN_COLUMNS}
    for relation in config.relations:
        k = PAIRWISE.index(relation)
        state = judged.states[..., k].copy()
        np.fill_diagonal(state, -1)
        # satisfied[a, b]: object a has the relation to some object of b's class.
        sure = (state == T).astype(np.int32) @ kinds > 0
        likely = (state >= U).astype(np.int32) @ kinds > 0
        targets, references = np.nonzero((state == T) & asked[:, None] & asked[None, :])
        answers: dict[tuple[int, int], tuple[list[int], list[int]]] = {}
        for a, b in zip(targets.tolist(), references.tolist(), strict=True):
            question = int(kind[a]), int(kind[b])
            if question not in answers:
                answers[question] = number[same[a] & sure[:, b]].tolist(), number[same[a] & likely[:, b]].tolist()
            strict, acceptable = answers[question]
            found["id"].append(f"{row_hash(config.seed, frame, names[a], relation, names[b]):016x}")
            found["target"].append(labels[a])
            found["reference"].append(labels[b])
            found["targets"].append(strict)
            found["acceptable"].append(acceptable)
            found["ambiguous"].append(len(acceptable) > 1)
            found["same_class"].append(int(rivals[a]))
        found["relation"] += [relation] * len(targets)
        found["target_object"] += number[targets].tolist()
        found["reference_object"] += number[references].tolist()
        found["margin"] += judged.margins[targets, references, k].tolist()
    n = len(found["id"])
    if not n:
        return {}
    shared = {
        "frame": frame, "frame_index": frame_index, "judged_in": "viewer", "up_source": up_source,
        "profile": config.profile,
    }  # fmt: skip
    return {**{name: [value] * n for name, value in shared.items()}, **found}


_OWN_COLUMNS = (
    "id", "target", "relation", "reference", "target_object", "reference_object", "targets", "acceptable",
    "ambiguous", "margin", "same_class",
)  # fmt: skip
