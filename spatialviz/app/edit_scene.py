"""What the scene shows of edits: their boxes, where those were, the asked region, the decision map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np

from pipeline.diagnosis.whatif.decision_map import DecisionMap
from pipeline.diagnosis.whatif.placement import Placement, place_in_region
from pipeline.diagnosis.whatif.region import Region, region_of
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.palette import RGB, Role, palette
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE, RELATIONS
from pipeline.relations.relations import Profile, letter
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part
from spatialviz.app.frame_cloud import set_changed, unlit_glb
from spatialviz.app.markup import Element, dot, h
from spatialviz.app.scene import edges
from spatialviz.app.state import State

HOLDS: RGB = (38, 166, 154)
DOUBTFUL: RGB = (224, 152, 46)
FAILS: RGB = (229, 72, 77)
REGION_COLORS = {"T": HOLDS, "U": DOUBTFUL}
OPACITY = {"T": 0.30, "U": 0.16}
OUTLINE_GROWTH = 0.006
MAP_OPACITY = 0.8
MAP_LIFT = 0.008
"""The map lies a little above the points of the floor, metres."""
FLOOR_NOISE = 0.06
OTHERS: tuple[RGB, ...] = ((166, 122, 214), (84, 178, 160), (186, 170, 84), (208, 122, 150), (148, 156, 168))
"""Winners that are neither target nor reference: apart from orange and blue, and from each other."""


def winner_colors(found: DecisionMap, state: State) -> dict[int, RGB]:
    """A colour for each object that wins somewhere: the roles of the chosen pair, and others that are like neither."""
    colors, others = palette(state.dark), cycle(OTHERS)
    role_of: dict[str, Role] = {state.shown.names[i]: role for i, role in state.roles.items()}
    winners = (int(k) for k in np.unique(found.winner) if k >= 0)
    roles: dict[int, Role | None] = {k: role_of.get(state.named(found.keys[k])) for k in winners}
    return {k: next(others) if role is None else colors[role] for k, role in roles.items()}


class EditScene(Part):
    """Draws into one client's scene, beside what `SceneView` draws."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._of: tuple[object, ...] | None = None
        self._mapped: tuple[Any, ...] | None = None

    def draw(self, state: State, found: DecisionMap | None, keep_map: bool) -> None:
        """Bring all of it up to a state; `keep_map` leaves the map as it is."""
        with self.ctx.client.atomic():
            self._draw_boxes(state)
            self._draw_region(state)
            if not keep_map:
                self._draw_map(found, state)

    def _draw_boxes(self, state: State) -> None:
        """Edited objects in the edited colour; thin, the boxes that they had."""
        now: list[Box3D] = []
        were: list[Box3D] = []
        edited = state.edited
        if edited is not None:
            before = dict(zip(edited.before.keys, edited.before.trace.objects, strict=True))
            touched = {*state.edits.boxes, *state.edits.masks, *(key for _, key in state.edits.confidences)}
            for key, entry in zip(edited.after.keys, edited.after.trace.objects, strict=True):
                if key in touched and entry.lifted.box is not None:
                    now.append(self.ctx.scene.shown_box(entry.lifted.box))
            for key in (*state.edits.boxes, *state.edits.masks, *state.edits.hidden):
                box = before[key].lifted.box if key in before else None
                if box is not None:
                    were.append(self.ctx.scene.shown_box(box))
        color = palette(state.dark)["edited"]
        self.ctx.client.lines("/edit/now", edges(now, OUTLINE_GROWTH), color, 2.6)
        self.ctx.client.lines("/edit/before", edges(were), color, 1.0)

    def _draw_region(self, state: State) -> None:
        asked = asked_pair(state) if state.flags.region and state.loaded is not None else None
        marks = None if asked is None else (state.source, state.frame_id, state.dark, *asked.marks)
        if marks != self._of:
            self.ctx.client.clear("/region/")
            self._of = marks
            region = None if asked is None else asked.region
            if region is not None:
                self._add_region(region, state.dark)
        known = asked is not None and bool(np.isfinite(asked.target.lo).all())
        target = self.ctx.client.scene.nodes.get("/region/target")
        if target is None and known:
            target = self.ctx.client.scene.add_icosphere("/region/target", 0.014, cast_shadow=False)
        if target is not None:
            set_changed(target, visible=known)
        if target is not None and asked is not None and known:
            middle = asked.viewer.matrix.T @ (asked.target.lo + asked.target.hi) / 2
            target.position = self.ctx.scene.to_show @ middle
            target.color = {**REGION_COLORS, "F": FAILS}[letter(asked.placement.state)]

    def _add_region(self, region: Region, dark: bool) -> None:
        scene, lines, R = self.ctx.client.scene, self.ctx.client.lines, self.ctx.scene.to_show.T
        for patch in region.patches:
            corners = (patch.triangles @ R).reshape(-1, 3).astype(np.float32)
            scene.add_mesh_simple(
                f"/region/{patch.label}",
                corners,
                np.arange(len(corners)).reshape(-1, 3),
                color=REGION_COLORS[patch.label],
                opacity=OPACITY[patch.label],
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            if len(patch.lines):
                rim, color = (patch.lines @ R).astype(np.float32), REGION_COLORS[patch.label]
                lines(f"/region/{patch.label}-rim", rim, color, 1.6)
        if region.dead_zone > 0:
            strip = (_dead_zone(region) @ R).astype(np.float32)
            color = (245, 247, 250) if dark else (24, 26, 30)
            lines("/region/dead-zone", strip, color, 1.2)

    def _draw_map(self, found: DecisionMap | None, state: State) -> None:
        shown = None if found is None else (found, state.dark, tuple(winner_colors(found, state).items()))
        if (
            self._mapped is not None
            and shown is not None
            and self._mapped[0] is found
            and self._mapped[1:] == shown[1:]
        ):
            return
        self.ctx.client.clear("/map/")
        self._mapped = shown
        if found is None or state.loaded is None:
            return
        rows, columns = np.nonzero(found.winner >= 0)
        if not len(rows):
            return
        by_winner = np.zeros((len(found.keys), 3))
        for k, color in winner_colors(found, state).items():
            by_winner[k] = color
        strength = (0.4 + 0.6 * np.clip(found.margin[rows, columns], 0, 1))[:, None]
        background = 34.0 if state.dark else 244.0
        colors = by_winner[found.winner[rows, columns]] * strength + background * (1 - strength)
        corners = found.corners @ self.ctx.scene.to_show.T
        corners[..., 2] = over_floor(state.loaded.cloud.points, corners[0, 0], corners[-1, -1]) + MAP_LIFT
        steps = ((0, 0), (0, 1), (1, 1), (1, 0))
        vertices = np.stack([corners[rows + r, columns + c] for r, c in steps], axis=1).reshape(-1, 3)
        first = 4 * np.arange(len(rows))[:, None]
        faces = np.concatenate([first + np.array(half) for half in ((0, 1, 2), (0, 2, 3))])
        cells = np.repeat(np.round(colors).astype(np.uint8), 4, axis=0)
        data = unlit_glb(vertices.astype(np.float32), faces, cells, MAP_OPACITY)
        rims = (_rims(found.winner, corners) + np.array([0, 0, MAP_LIFT / 4])).astype(np.float32)
        self.ctx.client.scene.add_glb("/map/areas", data, cast_shadow=False, receive_shadow=False)
        self.ctx.client.lines("/map/rims", rims, (245, 247, 250) if state.dark else (24, 26, 30), 1.6)


def _dead_zone(region: Region) -> np.ndarray:
    """(2, 2, 3) camera frame: both edges of the doubtful strip beside the reference, across the relation's axis."""
    middle = region.axes[0, 0]
    right, up, forward = (axis[1] - axis[0] for axis in region.axes)
    axis, _ = RELATIONS[region.relation].axis or (1, 1)
    along, across = ((right, forward), (up, right), (forward, right))[axis]
    along, across = (v / np.linalg.norm(v) for v in (along, across))
    reach = across * REACH / 2
    edges = [middle + side * region.dead_zone * along for side in (-1, 1)]
    return np.array([[edge - reach, edge + reach] for edge in edges])


def over_floor(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """The height over which nearly none of the floor's points ((N, 3), shown frame) lie, between two of its corners.

    Depth is noisy: what lies in the floor itself shows as specks between its points.
    """
    floor, across = low[2], points[:, :2]
    near = (np.abs(points[:, 2] - floor) < FLOOR_NOISE) & ((across > low[:2]) & (across < high[:2])).all(axis=1)
    return float(np.percentile(points[near, 2], 98)) if near.any() else float(floor)


def _rims(winner: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N, 2, 3): the edges of cells between two winners, and around all of them."""
    padded = np.pad(winner, 1, constant_values=-1)
    across, along = padded[:-1, 1:-1] != padded[1:, 1:-1], padded[1:-1, :-1] != padded[1:-1, 1:]
    r, c = np.nonzero(across)
    v, h = np.nonzero(along)
    return np.concatenate(
        [np.stack([corners[r, c], corners[r, c + 1]], axis=1), np.stack([corners[v, h], corners[v + 1, h]], axis=1)]
    )


REACH = 1.0
"""Metres around the reference that are drawn."""


@dataclass(frozen=True)
class AskedPair:
    """What a region is of: "target RELATION reference", in the order in which it is judged.

    Attributes
    ----------
    relation : str
    target, reference : LiftedObject
    places : (int, int)
        In `shown.objects`.
    viewer : ViewerAxes
    profile : Profile
    """

    relation: str
    target: LiftedObject
    reference: LiftedObject
    places: tuple[int, int]
    viewer: ViewerAxes
    profile: Profile

    @property
    def region(self) -> Region | None:
        """Where the relation holds; None where the reference has no place in space."""
        try:
            size = self.target.hi - self.target.lo
            return region_of(self.reference, self.relation, size, self.viewer, self.profile, REACH)
        except InputError:
            return None

    @property
    def placement(self) -> Placement:
        """Where the target falls in it, and why."""
        return place_in_region(self.target, self.reference, self.relation, self.viewer, self.profile)

    @property
    def marks(self) -> tuple[object, ...]:
        """What the region depends on, to a tenth of a millimetre: a target that is only moved keeps it."""
        lengths = (self.reference.lo, self.reference.hi, self.target.hi - self.target.lo)
        ends = (tuple(np.round(v, 4).tolist()) for v in lengths)
        return self.relation, *ends, self.viewer.matrix.tobytes(), self.profile


def asked_pair(state: State) -> AskedPair | None:
    """The chosen pair under the asked relation; None where the relation is not of two objects."""
    trace, pair = state.trace, state.chosen
    if trace is None or pair is None or pair.reference is None or trace.relation not in PAIRWISE:
        return None
    a, b = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    return AskedPair(
        trace.relation,
        trace.objects[a].lifted,
        trace.objects[b].lifted,
        (state.shown.place[a], state.shown.place[b]),
        trace.viewer,
        replace(Profile(), **state.edits.profile),
    )


def map_legend(state: State, found: DecisionMap | None) -> Element | None:
    """Who wins where, with the share of the floor."""
    if found is None:
        return None
    colors = winner_colors(found, state)
    winners, counts = np.unique(found.winner, return_counts=True)
    rows = (
        h.li(
            dot(colors[w]) if w >= 0 else h.span(cls="dot none"),
            h.b(state.named(found.keys[w]) if w >= 0 else "no pair"),
            h.span(f"{n / found.winner.size:.0%}"),
        )
        for n, w in sorted(zip(counts.tolist(), winners.tolist(), strict=True), reverse=True)
    )
    return h.figure(
        h.figcaption("Who wins if ", h.b(state.named(found.key)), " stands there"),
        h.ul(rows),
        h.p("paler where the next is close", cls="dim"),
        cls="maplegend",
    )
