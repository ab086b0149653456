"""Which objects of a labelled frame a noun phrase means: T surely, F surely not, U where the labels cannot say.

Kleene's logic of three values over the labels' own evidence: names, relations (T, U, F), colours of the pixels of the
masks, order in the picture and in 3D. What is near a threshold is U, and so is what hangs on it. Between T and F the
values are graded by how near (1 is T, -1 is F, and the lesser of two is "and"): that orders what is U, and labels take
none of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.answering.evidence import VIEWER_CHOICES
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.geometry.boxes import Box3D
from pipeline.language.attributes import BASIC_COLORS, Attribute
from pipeline.language.choices import SIDE_OR_PLACE
from pipeline.language.naming import match, normal_form, same_class
from pipeline.language.noun_phrase import readable
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.language.tree import Attachment, Choice, Node
from pipeline.relations.attributes import (
    SIZES,
    attribute_probabilities,
    color_probabilities,
    object_colors,
    size_keys,
    size_probabilities,
)
from pipeline.relations.relations import F, T, U
from pipeline.relations.scorer import between_states, distances

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
EXTREMES = ("closest", "farthest")
"""Relations that choose among the things of a name."""
_ALONG = {"left": (0, 1), "right": (0, -1), "top": (1, 1), "bottom": (1, -1)}
"""Axis of the picture, and which end of it is the side."""
_SEEN_AS = {"left": "left", "right": "right", "front": "near", "behind": "far", "above": "high", "below": "low"}
"""The order in which people may see a relation that does not hold by its rule."""
OUT_OF_MIDDLE = 0.25
"""Share of the picture's width from which on a centre is not in the middle."""
APART_NEAR_M = 0.3
"""Distances from a thing that differ by less are in no certain order: only the seen sides are measured."""
DOUBT, SEEN_AT_MOST = 0.9, 0.6
"""The highest degree that is in doubt; how much of it a relation has that only looks so in the picture, halved."""


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
        return states_of(self.graded(node))

    def graded(self, node: Node) -> np.ndarray:
        """(N,) float64: from -1, which is F, to 1, which is T."""
        if node not in self._known:
            named = self.named(node)
            self._known[node] = self.joined(named, [degree for _, degree in self.parts(node, named)])
        return self._known[node]

    def joined(self, named: np.ndarray, degrees: Sequence[np.ndarray]) -> np.ndarray:
        """(N,) float64: degrees of all that is said together, of things of a name ((N,) int8)."""
        return np.minimum.reduce([named, *degrees])

    def parts(self, node: Node, named: np.ndarray) -> list[tuple[str, np.ndarray]]:
        """What a noun phrase says of the things of its name ((N,) int8), each in words and with (N,) float64 degrees.

        Choices come last, for they are among those that all the rest fits.
        """
        alike = named >= U
        told = [(str(a), self._has(a, alike)) for a in node.attributes]
        told += [(f"not {other.label}", -self.graded(other)) for other in node.excluded]
        viewed = [a for a in node.attachments if not a.of_pairs and not a.negated and a.relation in VIEWER_CHOICES]
        extremes = [a for a in node.attachments if a.of_pairs and a.relation in EXTREMES]
        told += [(_said(a), self._stands(a)) for a in node.attachments if a not in viewed and a not in extremes]
        fitting = self.joined(named, [degree for _, degree in told])
        told += [(_said(a), self._extreme(a, fitting)) for a in extremes]
        choices = [*((c.text, c) for c in node.choices), *((_said(a), _of_viewer(a)) for a in viewed)]
        return told + [(text, self._chosen(choice, fitting)) for text, choice in choices]

    def named(self, node: Node) -> np.ndarray:
        """(N,) int8: state of each object under the name alone."""
        return np.full(len(self.objects), T, np.int8) if node.anything else self._named(node.name)

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
        plain = attachment.relation in ("between", *PAIRWISE) and not any(node.viewer for node in attachment.nodes)
        if not plain:
            return np.zeros(len(self.objects))
        if attachment.relation == "between":
            every = np.arange(len(self.objects))
            first, second = (self.graded(node) for node in attachment.nodes)
            states = between_states(*self._extents, every, every, every)
            found = np.minimum(np.minimum(states, first[:, None]), second[None, :]).max(axis=(1, 2), initial=F)
        else:
            state = self._state(attachment.relation)
            state = state.T if attachment.inverse else state
            side = SIDE_OR_PLACE.fullmatch(attachment.phrase)
            if side is not None and attachment.relation in _SEEN_AS:
                # On the left side of the desk is left of it, or on it and left of its middle.
                place = np.minimum(self.states[..., PAIRWISE.index("on")], self._before(_SEEN_AS[attachment.relation]))
                state = np.maximum(state, place)
            held = np.minimum(state, self.graded(attachment.nodes[0])[None])
            np.fill_diagonal(held, F)
            found = held.max(axis=1, initial=F)
        return -found if attachment.negated else found

    def _extreme(self, attachment: Attachment, fitting: np.ndarray) -> np.ndarray:
        """The closest to, or the farthest from, one of the references among the fitting things."""
        away = distances(*self._extents)
        sign = 1 if attachment.relation == "closest" else -1
        found = np.full(len(fitting), float(F))
        reference = self.graded(attachment.nodes[0])
        for k in np.flatnonzero(reference > F):
            mine = np.where(np.arange(len(fitting)) == k, F, fitting)
            before = _graded(sign * (away[None, :, k] - away[:, None, k]), APART_NEAR_M)
            np.fill_diagonal(before, F)
            found = np.maximum(found, np.minimum(_at_rank(before, mine, 1), reference[k]))
        return found

    def _state(self, relation: str) -> np.ndarray:
        """(N, N) float64: the labels' states; for some people left is what is farther left in the picture, whatever the
        rule says."""
        key = "relation", relation
        if key not in self._known:
            state = self.states[..., PAIRWISE.index(relation)]
            if relation in _SEEN_AS:
                seen = self._before(_SEEN_AS[relation])
                doubted = np.where(state == F, np.where(seen > F, SEEN_AT_MOST * (1 + seen) - DOUBT, F), DOUBT * seen)
            else:
                # On a book that lies on the table is on the table for some.
                other = self.states[..., PAIRWISE.index("above")] if relation == "on" else np.full_like(state, F)
                doubted = np.where((state == F) & (other == F), F, 0.0)
            self._known[key] = np.where(state == T, T, doubted)
        return self._known[key]

    def _has(self, attribute: Attribute, alike: np.ndarray) -> np.ndarray:
        if not attribute.judged:
            return np.zeros(len(alike))
        if attribute.kind == "size":
            if alike.sum() < 2:
                return np.zeros(len(alike))
            pairs, value = alike[:, None] & alike[None], attribute.value
            p = np.stack([size_probabilities(value, boxes, pairs, self.context.viewer) for boxes in self._boxes])
            return _within(p.mean(axis=0), UNLIKE, SIZED, (p >= SIZED).all(axis=0), (p <= UNLIKE).all(axis=0))
        if attribute.kind == "shape" or attribute.shade or attribute.value not in BASIC_COLORS:
            # People differ more about these than about basic colours: none is surely had.
            masks = [o.mask for o in self.objects]
            p = attribute_probabilities(
                attribute, self.context.frame.rgb, masks, self._boxes[0], np.ones((len(masks), len(masks)), np.bool_)
            )
            assert p is not None
            return _within(p, UNLIKE / 2, 1, np.zeros_like(alike), p <= UNLIKE / 2)
        mine = BASIC_COLORS.index(attribute.value)
        p, others = self._colored[mine], np.delete(self._colored, mine, axis=0).max(axis=0)
        most = OTHERS_SHADED if attribute.value in ("gray", "brown") else OTHERS
        return _within(p, UNLIKE, 1, (p > others) & (others <= most), p <= UNLIKE)

    def _chosen(self, choice: Choice, fitting: np.ndarray) -> np.ndarray:
        if choice.order == "middle":
            return self._in_middle(fitting)
        before = self._before(choice.order)
        if choice.rank is not None:
            return _at_rank(before, fitting, choice.rank)
        first = _at_rank(before, fitting, 1)
        if choice.order in _ALONG:
            place = self._at_side(choice.order)
            if (np.minimum(fitting, place) == T).any():
                return place
            # Where none is there for certain, the one of several that is farthest to that side may be meant.
            return DOUBT * (first if (fitting > F).sum() > 1 else place)
        # In front, at the back, high up: not what is the very last in that order.
        last = _at_rank(before.T, fitting, 1)
        others = (fitting > F)[:, None] & ~np.eye(len(fitting), dtype=np.bool_)
        most = -(before * others).sum(axis=0) / np.maximum(others.sum(axis=0), 1)
        return np.where(first == T, T, np.where((last == T) & (first == F), F, DOUBT * most))

    def _in_middle(self, fitting: np.ndarray) -> np.ndarray:
        """In the middle of the picture, or with as many of the fitting things to its left as to its right."""
        off = np.abs(self._bbox[:, [0, 2]].mean(axis=1) / self.context.frame.width - 0.5)
        found = np.clip(1 - off / OUT_OF_MIDDLE * 2, F, DOUBT)
        some = int((fitting > 0).sum())
        if some % 2 and some > 1:
            return np.maximum(found, _at_rank(self._before("left"), fitting, some // 2 + 1))
        return found

    def _at_side(self, order: str) -> np.ndarray:
        axis, sign = _ALONG[order]
        size = (self.context.frame.width, self.context.frame.height)[axis]
        ends = self._bbox[:, [axis, axis + 2]] / size
        ends = ends if sign > 0 else 1 - ends[:, ::-1]
        centre = ends.mean(axis=1)
        inside = (centre <= IN_HALF) & (ends[:, 1] <= REACHES)
        return _within(-centre, -IN_OTHER, -IN_HALF, inside, centre >= IN_OTHER)

    def _before(self, order: str) -> np.ndarray:
        """(N, N) float64: the first comes before the second in an order, by every measure of it and clearly."""
        key = "order", order
        if key not in self._known:
            agreed = np.mean(
                [_graded(keys[None] - keys[:, None], apart) for keys, apart in self._measures(order)], axis=0
            )
            np.fill_diagonal(agreed, F)
            self._known[key] = agreed
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

    @property
    def _extents(self) -> tuple[np.ndarray, np.ndarray]:
        lo, hi = (np.array([getattr(o.lifted, end) for o in self.objects], np.float64) for end in ("lo", "hi"))
        return lo.reshape(-1, 3), hi.reshape(-1, 3)

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


def states_of(degrees: np.ndarray) -> np.ndarray:
    """int8 states of degrees: all between T and F is U."""
    return np.trunc(degrees).astype(np.int8)


def _graded(ahead: np.ndarray, apart: np.ndarray | float) -> np.ndarray:
    """Degrees of differences, of which those from `apart` on are certain; 0 for unknown ones."""
    return np.nan_to_num(np.clip(ahead / apart, F, T))


def _within(value: np.ndarray, low: float, high: float, sure: Any, never: Any) -> np.ndarray:
    """Degrees of values; of those that are neither `sure` nor `never` ((N,) bool) by their place between two bounds."""
    between = np.clip((np.nan_to_num(value, nan=(low + high) / 2) - low) / (high - low) * 2 - 1, -DOUBT, DOUBT)
    return np.where(sure, T, np.where(never, F, between))


def _at_rank(before: np.ndarray, fitting: np.ndarray, rank: int) -> np.ndarray:
    """(N,) float64: degree of being the so-manieth of the fitting ones in an order ((N, N), `_before`).

    It is that of as many being before it and no more.
    """
    if rank > len(fitting):
        return np.full(len(fitting), float(F))
    ahead = np.sort(np.minimum(fitting[:, None], before), axis=0)[::-1]
    enough = ahead[rank - 2] if rank > 1 else np.ones(len(fitting))
    return np.minimum(enough, -ahead[rank - 1])


def _of_viewer(attachment: Attachment) -> Choice:
    return Choice(*VIEWER_CHOICES[attachment.relation])  # type: ignore[arg-type]


def _said(attachment: Attachment) -> str:
    ends = " and ".join("the viewer" if node.viewer else f"the {node.label}" for node in attachment.nodes)
    return f"{'not ' if attachment.negated else ''}{attachment.phrase or PHRASE[attachment.relation]} {ends}"
