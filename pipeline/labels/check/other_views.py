"""Rules on one object in several views: what does not change with the viewpoint, and does in the labels.

Objects are the same where their `instance` is. Their class and place are the same in all views; above, below, on, in
and near hold in every view in which both objects are well seen. Left, right, in front and behind change with the view,
as they should. Of each pair of objects only the strongest views are kept, so that memory grows with a scene's objects.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import field, replace

import numpy as np

from pipeline.geometry.camera import to_world
from pipeline.labels.check.view import RULES, Figure, Finding, FrameView
from pipeline.language.noun_phrase import same_names
from pipeline.relations.relations import F, T
from pipeline.system.frozen import dataclass

SAME_IN_ALL_VIEWS = ("above", "below", "on", "in", "near")
LEAST_MARGIN_M = 0.05
"""Both views are so sure: extents of what is seen differ by a few centimetres from view to view."""
MOST_OCCLUDED = 0.25
"""An object is well seen with a smaller share of its border occluded, and away from the picture's border."""
MOST_NAMED = 20
"""Frames that are kept of each class name of an object, and of each place."""
APART_SHARE, APART_M = 0.75, 0.1
"""Two views place an object apart whose centres are farther from each other than this share of its longest side and so
many metres: each sees another side of it. In clean labels no object has most of its views so far from one of them."""


@dataclass(frozen=True)
class SurestState:
    """A state of a relation in the surest frame, and in how many there are of it."""

    views: int
    margin: float  # Metres, without its sign
    frame: str | None
    a: int  # Numbers of the objects in the frame
    b: int
    text: str


@dataclass
class PlaceInView:
    """A place of an object in the world, and the views that show it there."""

    center: np.ndarray  # (3,), mean of the views', world, metres
    longest: float  # Side of their boxes, metres
    views: int = 0
    seen: list[tuple[str | None, int, str]] = field(default_factory=list)  # Frame, number and class there

    def holds(self, center: np.ndarray, longest: float) -> bool:
        """Tell a view of an object at this place."""
        apart = float(np.linalg.norm(self.center - center))
        return apart <= APART_SHARE * max(self.longest, longest) + APART_M


@dataclass
class OtherViews:
    """Objects with an instance as frames come in; `findings` after the last."""

    names: dict[tuple[str, int], dict[str, list[tuple[str | None, int]]]] = field(default_factory=dict)
    counts: defaultdict[tuple[str, int, str], int] = field(default_factory=lambda: defaultdict(int))
    states: dict[tuple[str, int, int, str], dict[int, SurestState]] = field(default_factory=dict)
    """By scene, instances and relation: the surest sighting of T and of F."""
    places: dict[tuple[str, int], list[PlaceInView]] = field(default_factory=dict)

    def add(self, view: FrameView) -> None:
        """Take the objects and relations of a frame in."""
        instances = view.objects["instance"]
        known = [k for k in range(len(view.ids)) if is_number(instances[k])]
        if not view.usable or not known:
            return
        scene = str(view.tables["frames"]["scene"][0])
        for k in known:
            named = self.names.setdefault((scene, int(instances[k])), {}).setdefault(view.labels[k], [])
            self.counts[scene, int(instances[k]), view.labels[k]] += 1
            if len(named) < MOST_NAMED:
                named.append((view.id, int(view.ids[k])))
        self._place(scene, view, known)
        well = ~view.objects["touches_border"].astype(bool) & (view.objects["occluded"] < MOST_OCCLUDED)
        chosen = np.array([k for k in known if well[k]], np.int64)
        for relation in SAME_IN_ALL_VIEWS if len(chosen) > 1 else ():
            if relation not in view.states:
                continue
            states, margins = view.states[relation], np.abs(view.margins[relation])
            sure = ((states == T) | (states == F)) & (margins >= LEAST_MARGIN_M)
            for a, b in np.argwhere(sure[np.ix_(chosen, chosen)]).tolist():
                i, j = int(chosen[a]), int(chosen[b])
                if instances[i] != instances[j]:
                    self._keep(scene, relation, view, i, j, int(states[i, j]), float(margins[i, j]))

    def _place(self, scene: str, view: FrameView, known: list[int]) -> None:
        pose = view.tables["frames"]["T_world_camera"][0].reshape(4, 4)
        centers, longest = to_world(view.objects["center"], pose), view.objects["size"].max(axis=1)
        for k in known:
            if not np.isfinite([*centers[k], longest[k]]).all():
                continue
            places = self.places.setdefault((scene, int(view.objects["instance"][k])), [])
            place = next((p for p in places if p.holds(centers[k], longest[k])), None)
            if place is None:
                place = PlaceInView(centers[k], float(longest[k]))
                places.append(place)
            place.views += 1
            place.center = place.center + (centers[k] - place.center) / place.views
            place.longest = max(place.longest, float(longest[k]))
            if len(place.seen) < MOST_NAMED:
                place.seen.append((view.id, int(view.ids[k]), view.labels[k]))

    def _keep(self, scene: str, relation: str, view: FrameView, i: int, j: int, state: int, margin: float) -> None:
        instances = view.objects["instance"]
        found = self.states.setdefault((scene, int(instances[i]), int(instances[j]), relation), {})
        before = found.get(state)
        if before is not None and margin <= before.margin:
            found[state] = replace(before, views=before.views + 1)
            return
        views = 1 if before is None else before.views + 1
        numbers = int(view.ids[i]), int(view.ids[j])
        found[state] = SurestState(views, margin, view.id, *numbers, view.relation_text(i, relation, j))

    def findings(self) -> Iterator[Finding]:
        """Find class names, places and relations that other views contradict."""
        for (scene, instance), named in self.names.items():
            yield from self._names(scene, instance, named)
        for places in self.places.values():
            yield from _misplaced(places)
        for (_, _, _, relation), found in self.states.items():
            if T in found and F in found:
                yield from _contradiction(relation, found[T], found[F])

    def _names(self, scene: str, instance: int, named: dict[str, list[tuple[str | None, int]]]) -> Iterator[Finding]:
        labels = list(named)
        counts = np.array([self.counts[scene, instance, label] for label in labels])
        # By name, how many views call it so or by a name of the same meaning.
        alike = same_names(labels) @ counts
        for k, label in enumerate(labels):
            others = int(counts.sum()) - 1
            best = int(np.where(same_names(labels)[k], 0, alike).argmax())
            if not others or same_names(labels)[k, best] or 2 * alike[best] <= others:
                continue
            message = f"{alike[best]} of {others} other views call it {labels[best]}"
            figures: dict[str, Figure] = {"name": labels[best], "views": int(alike[best]), "of": others}
            for frame, number in named[label]:
                yield Finding(
                    "object/other-views",
                    RULES["object/other-views"],
                    frame,
                    (number,),
                    f"{label} {number}: {message}",
                    figures,
                )


def _misplaced(places: list[PlaceInView]) -> Iterator[Finding]:
    """Find views of an object that most other views place elsewhere, of three or more."""
    most, others = max(places, key=lambda p: p.views), sum(p.views for p in places) - 1
    for place in places if others > 1 and 2 * most.views > others else ():
        if most.holds(place.center, place.longest):
            continue
        apart = float(np.linalg.norm(place.center - most.center))
        figures: dict[str, Figure] = {"apart": round(apart, 3), "views": most.views, "of": others}
        figures |= {} if most.seen[0][0] is None else {"other": most.seen[0][0]}
        for frame, number, label in place.seen:
            yield Finding(
                "object/other-places",
                RULES["object/other-places"],
                frame,
                (number,),
                f"{label} {number} is {apart:.2f} m from where {most.views} of {others} other views place this object, "
                f"such as {most.seen[0][0]}: it is another one, or was moved",
                figures,
            )


def _contradiction(relation: str, holds: SurestState, holds_not: SurestState) -> Iterator[Finding]:
    """Find the state that fewer views have, or both where as many have either; each names the other's frame."""
    for own, other in ((holds, holds_not), (holds_not, holds)):
        if own.views > other.views:
            continue
        says = "holds" if own is holds else "does not hold"
        other_says = "it does not" if own is holds else "it does"
        figures: dict[str, Figure] = {"relation": relation, "margin": round(own.margin, 4), "views": other.views}
        figures |= {"other_margin": round(other.margin, 4)} | ({} if other.frame is None else {"other": other.frame})
        yield Finding(
            "relation/other-views",
            RULES["relation/other-views"],
            own.frame,
            (own.a, own.b),
            f"{own.text}: {says} here by {100 * own.margin:.0f} cm, in {other.frame} {other_says} by "
            f"{100 * other.margin:.0f} cm, where the objects are {other.a} and {other.b}",
            figures,
        )


def is_number(value: object) -> bool:
    """Tell an instance from none."""
    return value is not None and value == value and int(value) >= 0  # pyright: ignore[reportArgumentType]
