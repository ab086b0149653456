"""Expressions worth asking of a frame: true, clear-cut, and preferably with something to confuse them with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.expression import parse
from pipeline.language.naming import normal_form
from pipeline.language.noun_phrase import alone, readable
from pipeline.language.relation_names import DIRECTIONAL, PHRASE
from pipeline.relations.scorer import RelationScores
from pipeline.system.errors import InputError


def suggest_expressions(
    objects: Sequence[SceneObject], scores: RelationScores, viewer: ViewerAxes, count: int = 3
) -> tuple[str, ...]:
    """Up to `count` expressions that have exactly one right answer in the frame; none where up is only assumed.

    Those whose target's class stands in the frame several times come first:
    there the relation decides. No class and no relation is repeated while there are others.
    """
    if viewer.up_source == "assumed":
        return ()
    labels = [o.label for o in objects]
    number = Counter(labels)
    single = {name for name, one in zip(labels, alone(labels).tolist(), strict=True) if one}
    found: list[tuple[float, str, str, str]] = []
    columns = [scores.relations.index(r) for r in DIRECTIONAL if r in scores.relations]
    for n in columns:
        relation = scores.relations[n]
        for target in sorted(number):
            rows = [i for i, name in enumerate(labels) if name == target]
            for reference in sorted(number):
                ends = [j for j, name in enumerate(labels) if name == reference]
                if target == reference or reference not in single:
                    continue
                column = scores.states[np.ix_(rows, ends)][..., n]
                likely = scores.probabilities[np.ix_(rows, ends)][..., n] >= 0.5
                # The rule and the scorer must agree on the one that is right.
                if (column == 1).sum() == 1 and (column == 0).sum() == 0 and (likely == (column == 1)).all():
                    pixels = min(objects[i].lifted.quality.mask_pixels for i in (*rows, *ends))
                    score = min(number[target], 3) + min(pixels, 3000) / 3000
                    found.append((score, target, relation, reference))
    chosen: list[str] = []
    used: Counter[str] = Counter()
    while found and len(chosen) < count:
        best = max(found, key=lambda f: (f[0] - 1.5 * (used[f[1]] + used[f[2]]) - 0.7 * used[f[3]], f[1:]))
        found.remove(best)
        _, target, relation, reference = best
        text = _worded(target, relation, reference, tuple(number))
        if text is None:
            continue
        used.update((target, relation, reference))
        chosen.append(text)
    return tuple(chosen)


def _worded(target: str, relation: str, reference: str, class_names: tuple[str, ...]) -> str | None:
    """The expression in words (`potted plant` for `potted_plant`), else with the names as they are spelled; None
    where the parser would understand neither as it is meant: class names may hold anything."""
    for a, b in ((readable(target, brief=False), readable(reference, brief=False)), (target, reference)):
        text = f"{a} {PHRASE[relation]} the {b}"
        try:
            said = parse(text, class_names=class_names).expression
        except InputError:
            continue
        meant = normal_form(target), normal_form(reference)
        if (normal_form(said.target), normal_form(said.reference or "")) == meant:
            return text
    return None
