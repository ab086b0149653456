"""Evidence on single objects from a noun phrase: attributes, choices, negations, relations to the viewer.

Each is a probability, a factor of P(x | e) beside the detector's score. A choice depends on which other things fit:
the probability that a thing is the k-th in some order is that it fits, times that of k - 1 fitting things before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Literal

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.attributes import Attribute
from pipeline.language.tree import Choice
from pipeline.relations.attributes import SIZES, attribute_probabilities, size_keys
from pipeline.system.frozen import dataclass

Kind = Literal["attribute", "choice", "negation", "viewer"]
HOLDS = 0.5
"""A thing stands in a relation, or is chosen, where the probability is at least this."""
ATTRIBUTE_HOLDS = 0.3
"""A thing has an attribute from here on: of eleven colours the right one often has no more than .3."""
SOFT_EDGE = 0.08
"""How wide the middle of the picture is, as a share of its side, in which neither half is sure."""
SIDE_AT_MOST = 0.9
"""A thing at a side, of which there may be several, is less sure than the one farthest to that side."""
VIEWER_CHOICES = {
    "closest": ("near", 1),
    "farthest": ("far", 1),
    "near": ("near", None),
    "front": ("near", None),
    "left": ("left", None),
    "right": ("right", None),
    "above": ("high", None),
    "below": ("low", None),
}
"""The order and the rank in it of what stands in a relation to the viewer."""


@dataclass(frozen=True)
class Factor:
    """Statement of a noun phrase about a single object."""

    kind: Kind
    text: str  # The words that said it
    mention: int  # The number of the noun
    object: int  # Place in the list of objects
    probability: float

    @property
    def holds(self) -> bool:
        """True for a statement at least as probable as not."""
        return self.probability >= (ATTRIBUTE_HOLDS if self.kind == "attribute" else HOLDS)


class SceneEvidence:
    """Evidence on the objects of a question, computed on demand."""

    def __init__(self, objects: Sequence[SceneObject], frame: Frame, viewer: ViewerAxes) -> None:
        self.objects, self.frame, self.viewer = objects, frame, viewer

    def attribute(self, attribute: Attribute, index: np.ndarray) -> np.ndarray | None:
        """(K,) float64: P(attribute | x) of some objects, compared with each other; None where not judged."""
        some = [self.objects[i] for i in index]
        alike = np.ones((len(some), len(some)), np.bool_)
        given = np.array([o.given_attributes.get(str(attribute), np.nan) for o in some], np.float64)
        found = None
        if np.isnan(given).any() or not len(some):
            found = attribute_probabilities(
                attribute, self.frame.rgb, [o.mask for o in some], [o.size_box for o in some], alike, viewer=self.viewer
            )
        return found if np.isnan(given).all() else np.where(np.isnan(given), HOLDS if found is None else found, given)

    @cached_property
    def _positions(self) -> dict[str, np.ndarray]:
        """(N,) float64 by order, smallest first; NaN for unknown."""
        bbox = np.array([o.bbox for o in self.objects], np.float64).reshape(-1, 4)
        centers = np.array(
            [np.full(3, np.nan) if o.box is None else o.box.center for o in self.objects], np.float64
        ).reshape(-1, 3)
        u, v = bbox[:, [0, 2]].mean(axis=1), bbox[:, [1, 3]].mean(axis=1)
        distance = np.array([o.lifted.quality.distance for o in self.objects], np.float64).reshape(-1)
        height = centers @ self.viewer.up
        return {
            "left": u,
            "right": -u,
            "top": v,
            "bottom": -v,
            "near": distance,
            "far": -distance,
            "high": -height,
            "low": height,
        }

    @cached_property
    def _sizes(self) -> dict[str, np.ndarray]:
        return size_keys([o.size_box for o in self.objects], self.viewer)

    def order(self, order: str, index: np.ndarray, belief: np.ndarray) -> np.ndarray:
        """(K,) float64: sort keys of some objects in an order, smallest first, NaN for none."""
        if order in SIZES:
            key, sign = SIZES[order]
            return -sign * self._sizes[key][index]
        if order != "middle":
            return self._positions[order][index]
        u = self._positions["left"][index]
        before = (belief[None, :] * (u[None, :] < u[:, None])).sum(axis=1) - (belief.sum() - belief) / 2
        return np.abs(before)

    def side(self, order: str, index: np.ndarray) -> np.ndarray | None:
        """(K,) float64: belief of some objects lying in a part of the picture; None for no such part."""
        bbox = np.array([self.objects[i].bbox for i in index], np.float64).reshape(-1, 4)
        u, v = bbox[:, [0, 2]].mean(axis=1) / self.frame.width, bbox[:, [1, 3]].mean(axis=1) / self.frame.height
        if order == "middle":
            return np.exp(-(((u - 0.5) / 0.2) ** 2))
        along = {"left": 0.5 - u, "right": u - 0.5, "top": 0.5 - v, "bottom": v - 0.5}.get(order)
        return None if along is None else 1 / (1 + np.exp(-along / SOFT_EDGE))

    def choice(self, choice: Choice, index: np.ndarray, belief: np.ndarray) -> np.ndarray:
        """(K,) float64: P(x is chosen), given how surely each fits the rest.

        `index`: (K,) int64; `belief`: (K,) float64.
        """
        keys = self.order(choice.order, index, belief)
        if choice.rank is not None:
            return ranked_probability(keys, belief, choice.rank)
        first = ranked_probability(keys, belief, 1)
        share = self.side(choice.order, index)
        if share is None:
            others = np.where(np.isnan(keys), 0.0, belief)
            share = 1 - (others[None, :] * (keys[None, :] < keys[:, None])).sum(axis=1) / max(others.sum(), 1e-9)
        return np.maximum(SIDE_AT_MOST * share, first)

    def of_viewer(self, relation: str, index: np.ndarray, belief: np.ndarray) -> np.ndarray | None:
        """(K,) float64: relation to the viewer, as `closest to me`; None where not judged."""
        found = VIEWER_CHOICES.get(relation)
        if found is None:
            return None
        order, rank = found
        return self.choice(Choice(order, rank), index, belief)  # type: ignore[arg-type]


def ranked_probability(keys: np.ndarray, belief: np.ndarray, rank: int) -> np.ndarray:
    """(K,) float64: P(exactly rank - 1 of the fitting objects come before x) of each x.

    `keys`: (K,) float64: the smallest is first; NaN is in no order and never chosen; `belief`: (K,) float64: how surely
    each fits, independently of the others (a Poisson-binomial count); `rank`: from 1.
    """
    found = np.zeros(len(keys))
    count = np.zeros(rank)
    count[0] = 1.0
    for i in np.argsort(keys, kind="stable"):
        if np.isnan(keys[i]):
            break
        found[i] = count[rank - 1]
        b = belief[i]
        count = count * (1 - b) + np.concatenate([[0.0], count[:-1]]) * b
    return found
