"""Which objects of a labelled frame a noun phrase means: T surely, F surely not, U where the labels cannot say.

Kleene's logic of three values over the labels' own evidence: names, relations (T, U, F), colours of the pixels of the
masks, order in the picture and in 3D. What is near a threshold is U, and so is what hangs on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.geometry.boxes import Box3D
from pipeline.language.attributes import BASIC_COLORS, Attribute
from pipeline.language.naming import match, normal_form, same_class
from pipeline.language.noun_phrase import readable
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Attachment, Choice, Node
from pipeline.relations.attributes import SIZES, color_probabilities, object_colors, size_keys, size_probabilities
from pipeline.relations.relations import F, T, U

SIZED, UNLIKE = 0.95, 0.3
"""The probability from which on a thing is big among its like, and that up to which it has not an attribute."""
OTHERS, OTHERS_SHADED = 0.9, 0.6
"""A thing has its main colour if no other has more than this; gray and brown, which are also others in the shade, than
that."""
APART_PX = 0.03
"""Centres that differ by less of the picture's width, and a quarter of the smaller thing, are in no order."""
APART_M, APART_SHARE = 0.1, 0.05
"""Likewise of heights, and of distances, of which the share counts too."""
APART_LOG = {"volume": 0.75}
"""Log ratio of sizes that anybody sees; of a length 0.25."""
IN_HALF, IN_OTHER = 0.33, 0.55
"""Share of the picture up to which a centre is on a side, and from which it is not."""
REACHES = 0.55
"""How far a thing that is on a side may reach."""
HIDDEN = 0.1
"""Of its border, from which on what is seen of an object does not tell its size."""
_ALONG = {"left": (0, 1), "right": (0, -1), "top": (1, 1), "bottom": (1, -1)}
"""Axis of the picture, and which end of it is the side."""
_SEEN_AS = {"left": "left", "right": "right", "front": "near", "behind": "far", "above": "high", "below": "low"}
"""The order in which people may see a relation that does not hold by its rule."""
_VIEWER = {"closest": "near", "farthest": "far"}


class TreeTruth:
    """A labelled frame, as noun phrases see it.

    `objects`: those whose pairs were judged. `states` (N, N, R) int8: T, U and F in the order of PAIRWISE. `usable`:
    the others may be what is meant or not. `occluded`: share of the border beside which something is nearer.
    """

    def __init__(
        self,
        context: PreparedFrame,
        objects: Sequence[SceneObject],
        states: np.ndarray,
        usable: Sequence[bool],
        occluded: Sequence[float],
    ) -> None:
        self.context, self.objects, self.states = context, objects, states
        self.usable, self.occluded = np.array(usable, np.bool_), np.array(occluded, np.float64)
        self._known: dict[Any, np.ndarray] = {}

    def means(self, node: Node) -> np.ndarray:
        """(N,) int8: state of each object under the whole noun phrase."""
        if node not in self._known:
            found = self._named(node.name)
            alike = found >= U
            for attribute in node.attributes:
                found = np.minimum(found, self._has(attribute, alike))
            viewed = [a for a in node.attachments if not a.of_pairs and not a.negated]
            for attachment in node.attachments:
                if attachment not in viewed:
                    found = np.minimum(found, self._stands(attachment))
            chosen = [*node.choices, *(Choice(_VIEWER[a.relation]) for a in viewed)]  # type: ignore[arg-type]
            picked = [self._chosen(choice, found) for choice in chosen]
            self._known[node] = np.minimum.reduce([found, *picked])
        return self._known[node]

    def _named(self, name: str) -> np.ndarray:
        key = "name", name
        if key not in self._known:
            said = normal_form(readable(name))
            found = np.array([self._is_called(o.label, name, said) for o in self.objects], np.int8)
            self._known[key] = np.where(self.usable, found, np.minimum(found, U))
        return self._known[key]

    @staticmethod
    def _is_called(label: str, name: str, said: str) -> int:
        if label == name or same_class(label, name):
            return T
        form = normal_form(readable(label))
        return U if form == said or form.endswith(f" {said}") or match(name, (label,)) else F

    def _stands(self, attachment: Attachment) -> np.ndarray:
        (end,) = attachment.nodes
        held = np.minimum(self._state(attachment.relation), self.means(end)[None])
        np.fill_diagonal(held, F)
        found = held.max(axis=1, initial=F)
        return -found if attachment.negated else found

    def _state(self, relation: str) -> np.ndarray:
        """The labels' states; for some people left is what is farther left in the picture, whatever the rule says."""
        key = "relation", relation
        if key not in self._known:
            state = self.states[..., PAIRWISE.index(relation)]
            seen = np.full_like(state, F)
            if relation in _SEEN_AS:
                seen = self._before(_SEEN_AS[relation])
            elif relation == "on":
                # On a book that lies on the table is on the table for some.
                seen = self.states[..., PAIRWISE.index("above")]
            self._known[key] = np.where((state == F) & (seen >= U), U, state)
        return self._known[key]

    def _has(self, attribute: Attribute, alike: np.ndarray) -> np.ndarray:
        if attribute.kind == "color":
            mine = BASIC_COLORS.index(attribute.value)
            p, others = self._colored[mine], np.delete(self._colored, mine, axis=0).max(axis=0)
            most = OTHERS_SHADED if attribute.value in ("gray", "brown") else OTHERS
            return np.where((p > others) & (others <= most), T, np.where(p <= UNLIKE, F, U)).astype(np.int8)
        pairs = alike[:, None] & alike[None]
        p = np.stack([size_probabilities(attribute.value, boxes, pairs, self.context.viewer) for boxes in self._boxes])
        return np.where((p >= SIZED).all(axis=0), T, np.where((p <= UNLIKE).all(axis=0), F, U)).astype(np.int8)

    def _chosen(self, choice: Choice, fitting: np.ndarray) -> np.ndarray:
        if choice.rank is not None:
            before = np.minimum(fitting[:, None], self._before(choice.order))
            sure, may = (before == T).sum(axis=0), (before >= U).sum(axis=0)
            wanted = choice.rank - 1
            never = (sure > wanted) | (may < wanted)
            return np.where((sure == wanted) & (may == wanted), T, np.where(never, F, U)).astype(np.int8)
        place = self._at_side(choice.order)
        # Where none is there for certain, the one that is farthest to that side may be meant.
        return place if (np.minimum(fitting, place) == T).any() else np.full_like(place, U)

    def _at_side(self, order: str) -> np.ndarray:
        axis, sign = _ALONG[order]
        size = (self.context.frame.width, self.context.frame.height)[axis]
        ends = self._bbox[:, [axis, axis + 2]] / size
        ends = ends if sign > 0 else 1 - ends[:, ::-1]
        centre = ends.mean(axis=1)
        inside = (centre <= IN_HALF) & (ends[:, 1] <= REACHES)
        return np.where(inside, T, np.where(centre >= IN_OTHER, F, U)).astype(np.int8)

    def _before(self, order: str) -> np.ndarray:
        """(N, N) int8: the first comes before the second in an order, by every measure of it and clearly."""
        key = "order", order
        if key not in self._known:
            told = []
            for keys, apart in self._measures(order):
                ahead = keys[None] - keys[:, None]
                told.append(np.where(ahead >= apart, T, np.where(ahead <= -apart, F, U)))
            found = np.stack(told).astype(np.int8)
            agreed = np.where((found == T).all(axis=0), T, np.where((found == F).all(axis=0), F, U))
            np.fill_diagonal(agreed, F)
            self._known[key] = agreed.astype(np.int8)
        return self._known[key]

    def _measures(self, order: str) -> list[tuple[np.ndarray, np.ndarray | float]]:
        """Keys, the smallest first, NaN for unknown, and how far apart they must be."""
        if order in _ALONG:
            axis, sign = _ALONG[order]
            wide = self._bbox[:, 2:] - self._bbox[:, :2]
            apart = APART_PX * self.context.frame.width + np.minimum(wide[:, None, axis], wide[None, :, axis]) / 4
            return [(sign * (self._bbox[:, axis] + self._bbox[:, axis + 2]) / 2, apart)]
        if order in ("near", "far"):
            sign = 1 if order == "near" else -1
            ways = (np.array([o.lifted.quality.distance for o in self.objects]), self._least_forward)
            return [(sign * d, APART_M + APART_SHARE * np.fmax(d[:, None], d[None])) for d in ways]
        if order in ("high", "low"):
            sign = -1 if order == "high" else 1
            return [(sign * self._centres(boxes) @ self.context.viewer.up, APART_M) for boxes in self._boxes]
        key, sign = SIZES[order]
        sizes = (size_keys(boxes, self.context.viewer)[key] for boxes in self._boxes)
        return [(-sign * np.log(np.maximum(s, 1e-9)), APART_LOG.get(key, 0.25)) for s in sizes]

    @staticmethod
    def _centres(boxes: Sequence[Box3D | None]) -> np.ndarray:
        return np.array([np.full(3, np.nan) if b is None else b.center for b in boxes], np.float64).reshape(-1, 3)

    @property
    def _least_forward(self) -> np.ndarray:
        return np.array([o.lifted.lo[2] for o in self.objects], np.float64)

    @cached_property
    def _bbox(self) -> np.ndarray:
        return np.array([o.bbox for o in self.objects], np.float64).reshape(-1, 4)

    @cached_property
    def _colored(self) -> np.ndarray:
        """(11, N) float64: P(colour | object) by the pixels of the labels' masks."""
        colors = object_colors(self.context.frame.rgb, [o.mask for o in self.objects])
        return np.stack([color_probabilities(Attribute("color", name), colors) for name in BASIC_COLORS])

    @cached_property
    def _boxes(self) -> tuple[list[Box3D | None], list[Box3D | None]]:
        exact = {a.index: a.box for a in self.context.frame.annotations}
        lifted = [o.box for o in self.objects]
        known = []
        for o, hidden in zip(self.objects, self.occluded.tolist(), strict=True):
            own = exact.get(o.id)
            known.append(own or (None if o.lifted.quality.touches_border or hidden > HIDDEN else o.box))
        return lifted, known
