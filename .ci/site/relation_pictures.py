"""Pictures of the relations: where each holds around a reference, computed by the program's own rule."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from svg import DOUBT, EDGE, HATCH, QUIET, REFERENCE, SURFACE, TARGET, TRUTH, Card, n

from pipeline.diagnosis.whatif.region import states_at
from pipeline.language.relation import DECLARED
from pipeline.relations.relations import Profile, letter
from pipeline.relations.scorer import between_states, superlative_states

RIGHT, UP, FORWARD = range(3)
Triple = tuple[float, float, float]
STEP = 0.01
"""Of the grid on which the rule is asked, metres."""
PANEL = (448, 300)
LAPTOP, MUG = (0.44, 0.30, 0.32), (0.16, 0.16, 0.16)
AT: Triple = (0.0, -0.5, 1.6)
"""Centre of the reference as seen from the camera: right, up, forward, metres."""
PHRASES = {r.name: r.phrase for r in DECLARED}


@dataclass(frozen=True)
class View:
    """One of the two views of a card: the axes that go to the right and up, and examples of a target."""

    title: str
    across: int
    along: int
    # Centres of targets, from the centre of the reference, along the two axes; the rule says T, U or F of each
    examples: Sequence[tuple[float, float]]
    # Of the third axis from the centre of the reference, metres, where the slice lies
    at: float = 0.0
    middle: tuple[float, float] = (0.0, 0.0)  # Of the view, from the centre of the reference, metres
    zoom: float = 165  # Pixels a metre
    words: str = ""  # Put behind the title


def above(*examples: tuple[float, float], **more: object) -> View:
    return View("seen from above", RIGHT, FORWARD, examples, **more)  # type: ignore[arg-type]


def ahead(*examples: tuple[float, float], **more: object) -> View:
    return View("as the viewer sees it", RIGHT, UP, examples, **more)  # type: ignore[arg-type]


def aside(*examples: tuple[float, float], **more: object) -> View:
    return View("seen from the right, viewer at the left", FORWARD, UP, examples, **more)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Scene:
    """What a card shows of a relation."""

    views: tuple[View, View]
    reference: str = "laptop"
    target: str = "mug"
    size: Triple = LAPTOP
    of_target: Triple = MUG


TABLE, CRATE = (1.0, 0.5, 0.7), (0.7, 0.44, 0.6)
SCENES: Mapping[str, Scene] = {
    "left": Scene((above((-0.85, 0.1), (-0.5, 0.62), (0.7, 0.1)), ahead((-0.8, 0.0), (-0.3, 0.45), (0.75, 0.2)))),
    "right": Scene((above((0.85, 0.1), (0.5, 0.62), (-0.7, 0.1)), ahead((0.8, 0.0), (0.3, 0.45), (-0.75, 0.2)))),
    "front": Scene((above((0.1, -0.68), (-0.85, -0.55), (0.1, 0.65)), aside((-0.75, 0.0), (-0.3, 0.4), (0.7, 0.1)))),
    "behind": Scene((above((0.1, 0.68), (0.85, 0.55), (0.1, -0.65)), aside((0.75, 0.0), (0.3, 0.4), (-0.7, 0.1)))),
    "above": Scene(
        (
            above((0.4, 0.05), (-0.5, 0.25), (-0.9, -0.2), (-1.25, 0.4), at=0.6, words=", 0.6 m higher"),
            ahead((0.05, 0.52), (-0.62, 0.42), (0.85, -0.2), middle=(0, 0.2)),
        )
    ),
    "below": Scene(
        (
            above((0.4, 0.05), (-0.5, 0.25), (-0.9, -0.2), (-1.25, 0.4), at=-0.6, words=", 0.6 m lower"),
            ahead((0.05, -0.52), (-0.62, -0.42), (0.85, 0.2), middle=(0, -0.2)),
        )
    ),
    "on": Scene(
        (
            above((0.25, 0.12), (-0.8, 0.2), at=0.33, words=", at the height of its top"),
            ahead((-0.25, 0.33), (0.3, 0.44), (0.8, 0.33), (-0.85, -0.15), middle=(0, 0.1)),
        ),
        "table",
        size=TABLE,
    ),
    "in": Scene(
        (
            above((0.05, 0.05), (-0.37, 0.1), (0.75, -0.3), zoom=185),
            ahead((0.05, -0.1), (-0.37, -0.05), (0.12, 0.4), zoom=185, middle=(0, 0.1)),
        ),
        "crate",
        "ball",
        size=CRATE,
        of_target=(0.18, 0.18, 0.18),
    ),
    "near": Scene((above((-0.45, -0.15), (0.7, 0.2), (-1.0, 0.5)), ahead((-0.4, 0.1), (0.7, 0.1), (-1.05, 0.5)))),
}


class Panel:
    """View on a card: x to the right and y up in metres, around the middle of the panel."""

    def __init__(self, card: Card, x: float, y: float, view: View, title: str = "") -> None:
        self.card, self.x, self.y, self.view = card, x, y, view
        card.box(x, y, *PANEL, fill=SURFACE, stroke=EDGE, radius=8)
        card.text(x + 2, y - 12, title or view.title + view.words, 18, QUIET)

    def place(self, a: float, b: float) -> tuple[float, float]:
        """Pixels of a place."""
        zoom, (across, along) = self.view.zoom, self.view.middle
        return self.x + PANEL[0] / 2 + (a - across) * zoom, self.y + PANEL[1] / 2 - (b - along) * zoom

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Places (R, C) of the panel, metres: across, and along from the top down."""
        zoom, (across, along) = self.view.zoom, self.view.middle
        half = np.array(PANEL) / 2 / zoom
        a = np.arange(-half[0] + STEP / 2, half[0], STEP) + across
        b = np.arange(half[1] - STEP / 2, -half[1], -STEP) + along
        return np.broadcast_arrays(a, b[:, None])[0], np.broadcast_arrays(a, b[:, None])[1]

    def region(self, states: np.ndarray) -> None:
        """Draw where states (R, C) of the grid are T and U."""
        for value, look in ((0, {"fill": "url(#hatch)", "line": 1.2}), (1, {"fill": TRUTH, "opacity": 0.34})):
            d = outline(states == value, STEP * self.view.zoom, self.x, self.y)
            if d:
                self.card.path(d, stroke=TRUTH, **look)  # type: ignore[arg-type]

    def thing(self, center: tuple[float, float], size: tuple[float, float], color: str, name: str = "") -> None:
        """Draw an object, with its name in it."""
        (x, y), zoom = self.place(*center), self.view.zoom
        width, height = size[0] * zoom, size[1] * zoom
        self.card.box(
            x - width / 2, y - height / 2, width, height, fill=color, stroke=color, line=2.5, radius=3, opacity=0.3
        )
        if name:
            self.card.text(x, y + height / 2 + 20, name, 17, REFERENCE, bold=True, anchor="middle", halo=True)

    def example(self, center: tuple[float, float], size: tuple[float, float], state: str) -> None:
        """Draw a target with what the rule says of it."""
        (x, y), zoom = self.place(*center), self.view.zoom
        width, height = size[0] * zoom, size[1] * zoom
        self.card.box(x - width / 2, y - height / 2, width, height, stroke=TARGET, line=2.5, radius=3)
        color = {"T": TRUTH, "U": DOUBT, "F": QUIET}[state]
        self.card.text(x, y + 7, state, 20, color, bold=True, anchor="middle", halo=True)

    def viewer(self) -> None:
        """Draw from where one looks, where it is seen."""
        x, y = self.x, self.y
        if self.view.along == FORWARD:
            self.eye(x + PANEL[0] / 2, y + PANEL[1] - 6, (0, -1))
        elif self.view.across == FORWARD:
            self.eye(x + 6, y + PANEL[1] / 2, (1, 0))

    def eye(self, x: float, y: float, way: tuple[int, int]) -> None:
        w, s = np.array(way) * 20.0, np.array([-way[1], way[0]]) * 11.0
        at = np.array([x, y])
        self.card.lines([at, at + w + s, at + w - s], close=True, fill=QUIET, opacity=0.55)

    def scale(self, metres: float = 0.5) -> None:
        """Draw how long half a metre is."""
        x, y, length = self.x + PANEL[0] - 16, self.y + PANEL[1] - 14, metres * self.view.zoom
        self.card.lines([(x - length, y), (x, y)], stroke=QUIET, line=2)
        self.card.text(x - length / 2, y - 8, f"{metres:g} m", 15, QUIET, anchor="middle", halo=True)


def outline(cells: np.ndarray, step: float, x: float, y: float) -> str:
    """SVG path around cells (R, C) bool of a grid whose corner is at (x, y)."""
    larger = np.kron(np.pad(cells, 1), np.ones((4, 4), np.uint8))
    found, _ = cv2.findContours(larger, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parts = []
    width, height = cells.shape[1] * step, cells.shape[0] * step
    for line in found:
        line = cv2.approxPolyDP(line, 3, True)[:, 0].astype(np.float64)
        if len(line) > 2:
            ends = ((line + 0.5) / 4 - 1) * step
            ends = np.clip(ends, 1, np.minimum([width, height], PANEL) - 1) + np.array([x, y])
            parts.append("M" + "L".join(f"{n(a)} {n(b)}" for a, b in ends) + "Z")
    return "".join(parts)


def legend(card: Card, y: float, *, region: bool = True) -> None:
    """Write below what is drawn how."""
    x = 24.0
    if region:
        for fill, opacity, words in (
            (TRUTH, 0.34, "T: it holds"),
            ("url(#hatch)", 1.0, "U: too close to call"),
            ("none", 1.0, "F: elsewhere"),
        ):
            card.box(x, y - 15, 26, 18, fill=fill, stroke=TRUTH if fill != "none" else QUIET, radius=3, opacity=opacity)
            x += 34 + card.text(x + 34, y, words, 18, QUIET) + 18
    for color, words in ((TARGET, "target"), (REFERENCE, "reference")):
        card.box(x, y - 15, 18, 18, fill=color, stroke=color, radius=3, opacity=0.3)
        x += 26 + card.text(x + 26, y, words, 18, QUIET) + 18
    card.lines([(x, y - 15), (x + 22, y - 15), (x + 11, y + 4)], close=True, fill=QUIET, opacity=0.55)
    card.text(x + 30, y, "viewer", 18, QUIET)


def relation_card(relation: str) -> Card:
    """Picture of a relation of two objects."""
    scene = SCENES[relation]
    lo, hi = np.array(AT) - np.array(scene.size) / 2, np.array(AT) + np.array(scene.size) / 2
    phrase = f"{scene.target} {PHRASES[relation]} the {scene.reference}"
    card = Card(960, 444, f"Where “{phrase}” holds, by the rule")
    card.add(HATCH)
    card.text(24, 44, f"“{phrase}”", 26, bold=True)
    card.text(936, 43, "green: where the middle of the target may be", 18, QUIET, anchor="end")

    def said(places: np.ndarray) -> np.ndarray:
        size = np.array(scene.of_target)
        return states_at(places.reshape(-1, 3), lo, hi, relation, size, Profile()).reshape(places.shape[:-1])

    for number, view in enumerate(scene.views):
        panel = Panel(card, 24 + number * (PANEL[0] + 16), 90, view)
        third = 3 - view.across - view.along
        a, b = panel.grid()

        def around(a: np.ndarray, b: np.ndarray, view: View = view, third: int = third) -> np.ndarray:
            places = np.empty((*np.shape(a), 3))
            for axis, value in ((view.across, a), (view.along, b), (third, view.at)):
                places[..., axis] = AT[axis] + value
            return places

        panel.region(said(around(a, b)))
        panel.viewer()
        panel.thing((0, 0), (scene.size[view.across], scene.size[view.along]), REFERENCE, scene.reference)
        for center in view.examples:
            state = letter(int(said(around(*np.array(center)))))
            panel.example(center, (scene.of_target[view.across], scene.of_target[view.along]), state)
        panel.scale()
    legend(card, 424)
    return card


def beyond_card() -> Card:
    """Picture of the relations of more than two objects."""
    card = Card(960, 444, "Where “between” holds, and which mug is closest and farthest, by the rule")
    card.add(HATCH)
    card.text(24, 44, "“mug between laptop and lamp”", 24, bold=True)
    card.text(488, 44, "“mug closest to the laptop”, “farthest”", 24, bold=True)
    view = above()
    panel = Panel(card, 24, 90, view)
    a, b = panel.grid()
    ends = np.array([[-0.75, 0, -0.2], [0.75, 0, 0.3]])
    sizes = np.array([(0.4, 0.3, 0.3), (0.22, 0.5, 0.22)])

    def said(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        places = np.stack([np.ravel(a), np.zeros(np.size(a)), np.ravel(b)], axis=1)
        middle, half = np.concatenate([places, ends]), np.concatenate([np.tile(MUG, (len(places), 1)), sizes]) / 2
        count = len(places)
        return between_states(middle - half, middle + half, range(count), [count], [count + 1])[:, 0, 0]

    panel.region(said(a, b).reshape(a.shape))
    panel.viewer()
    for center, size, name in zip(ends, sizes, ("laptop", "lamp"), strict=True):
        panel.thing((center[0], center[2]), (size[0], size[2]), REFERENCE, name)
    for center in ((0.0, 0.05), (-0.2, 0.5), (0.55, -0.55)):
        panel.example(center, (MUG[0], MUG[2]), letter(int(said(*map(np.array, center))[0])))
    panel.scale()

    panel = Panel(card, 488, 90, view, "seen from above")
    mugs = np.array([(-0.42, 0, 0.05), (0.1, 0, 0.4), (0.75, 0, -0.35), (-1.02, 0, 0.55), (0.95, 0, 0.62)])
    middle = np.concatenate([mugs, np.zeros((1, 3))])
    half = np.concatenate([np.tile(MUG, (len(mugs), 1)), [LAPTOP]]) / 2
    panel.thing((0, 0), (LAPTOP[0], LAPTOP[2]), REFERENCE, "laptop")
    both = [
        superlative_states(middle - half, middle + half, range(len(mugs)), [len(mugs)], farthest=far)[:, 0]
        for far in (False, True)
    ]
    for center, near, far in zip(mugs, *both, strict=True):
        at = center[0], center[2]
        panel.example(at, (MUG[0], MUG[2]), letter(max(near, far)))
        words = "closest" if near > 0 else "farthest" if far > 0 else ""
        x, y = panel.place(*at)
        card.text(x, y - 20, words, 17, TRUTH, bold=True, anchor="middle", halo=True)
    panel.viewer()
    panel.scale()
    legend(card, 424)
    return card


PICTURES: Mapping[str, Callable[[], Card]] = {
    **{f"relation-{name}": lambda name=name: relation_card(name) for name in SCENES},
    "relation-beyond": beyond_card,
}
