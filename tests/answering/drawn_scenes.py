"""Small scenes drawn from above, with sentences that choose among their things; `docs/choices.md` is made from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scenes import frame_of, upright

from pipeline.geometry import Frame

COLUMN, ROW, NEAREST, FLOOR = 0.15, 0.6, 1.8, 1.2
"""Metres between two columns and two rows, from the camera to the last row, and from it down to the floor."""
PICTURE = (40, 15)
"""Columns and rows of the picture as it is drawn."""


@dataclass(frozen=True)
class Thing:
    """A letter of a plan: its name, its size (width, height, depth) and how high it stands, in metres.

    What stands on another thing is not drawn from above: `on` is that thing's letter, `aside` the metres to its right.
    """

    name: str
    size: tuple[float, float, float]
    lift: float = 0.0
    on: str = ""
    aside: float = 0.0


@dataclass(frozen=True)
class Asked:
    """A sentence, the letter that it means, and the letter that it would mean judged the other way, if another."""

    kind: str
    text: str
    means: str
    judged: str
    otherwise: str = ""


@dataclass(frozen=True)
class Scene:
    """A plan, far things first and the camera below it, its things by letter, and what is asked."""

    title: str
    plan: str
    things: dict[str, Thing]
    asked: tuple[Asked, ...]

    @property
    def rows(self) -> list[str]:
        return self.plan.strip("\n").splitlines()

    def position(self, letter: str) -> tuple[float, float]:
        """Metres to the right of the camera, and in front of it."""
        if on := self.things[letter].on:
            x, z = self.position(on)
            return x + self.things[letter].aside, z
        row = next(k for k, line in enumerate(self.rows) if letter in line)
        middle = (max(map(len, self.rows)) - 1) / 2
        return (self.rows[row].index(letter) - middle) * COLUMN, NEAREST + (len(self.rows) - 1 - row) * ROW

    def order(self, key: str, judged: str) -> list[str]:
        """The letters in an order, judged by the plan ("3D") or by the picture alone ("picture")."""

        def value(letter: str) -> float:
            thing, (x, z) = self.things[letter], self.position(letter)
            top, away = FLOOR - thing.lift - thing.size[1] / 2, z if judged == "picture" else 1.0
            sizes = {"left": x / away, "high": top / away, "tall": -thing.size[1] / away}
            return sizes.get(key, -float(np.prod(thing.size)) / away**3)

        return sorted(self.things, key=value)

    def frame(self) -> Frame:
        boxes = []
        for letter, thing in self.things.items():
            x, z = self.position(letter)
            boxes.append(upright((x, FLOOR - thing.lift - thing.size[1] / 2, z), thing.size))
        return frame_of(boxes, [t.name for t in self.things.values()], floor=FLOOR, pitch=20)

    def picture(self) -> str:
        """The frame as it is seen, a letter for each thing."""
        frame = self.frame()
        columns, rows = PICTURE
        drawn = np.full((rows, columns), ".")
        for letter, annotation in zip(self.things, frame.annotations, strict=True):
            assert annotation.mask is not None
            v = np.arange(rows) * frame.height // rows + frame.height // rows // 2
            u = np.arange(columns) * frame.width // columns + frame.width // columns // 2
            drawn[annotation.mask[np.ix_(v, u)]] = letter
        return "\n".join("".join(line) for line in drawn)


MUG = Thing("mug", (0.25, 0.25, 0.25))
SCENES = (
    Scene(
        "Mugs on the floor",
        """
..a......d.
.....c.....
........e..
...b.......
""",
        dict.fromkeys("abcde", MUG),
        (
            Asked("extreme", "the leftmost mug", "b", "picture", "a"),
            Asked("extreme", "the rightmost mug", "e", "picture", "d"),
            Asked("extreme", "the mug furthest to the left", "b", "picture", "a"),
            Asked("ordinal", "the second mug from the left", "a", "picture", "b"),
            Asked("ordinal", "the third mug from the left", "c", "picture"),
            Asked("ordinal", "the second mug from the right", "d", "picture", "e"),
            Asked("ordinal", "the last mug from the left", "e", "picture", "d"),
            Asked("middle", "the middle mug", "c", "picture"),
            Asked("distance", "the closest mug", "b", "3D"),
            Asked("distance", "the mug nearest to the camera", "b", "3D"),
            Asked("distance", "the mug farthest from me", "d", "3D"),
            Asked("distance", "the second closest mug", "e", "3D"),
            Asked("side", "the mug at the bottom of the picture", "b", "picture"),
            Asked("side", "the mug at the back", "d", "3D"),
            Asked("corner", "the mug in the bottom left corner of the picture", "b", "picture"),
            Asked("corner", "the top left mug", "a", "picture"),
        ),
    ),
    Scene(
        "Boxes and lamps, a large one far away",
        """
.P......T.
..........
..........
..........
...Q..S...
""",
        {
            "P": Thing("box", (0.7, 0.7, 0.6)),
            "Q": Thing("box", (0.4, 0.45, 0.4)),
            "T": Thing("lamp", (0.3, 1.0, 0.3)),
            "S": Thing("lamp", (0.3, 0.5, 0.3)),
        },
        (
            Asked("extreme", "the biggest box", "P", "3D", "Q"),
            Asked("extreme", "the smallest box", "Q", "3D", "P"),
            Asked("extreme", "the tallest lamp", "T", "3D", "S"),
            Asked("comparison", "the bigger of the two boxes", "P", "3D", "Q"),
            Asked("comparison", "the smaller of the boxes", "Q", "3D", "P"),
            Asked("comparison", "the taller of the two lamps", "T", "3D", "S"),
            Asked("comparison", "the closer of the two lamps", "S", "3D"),
        ),
    ),
    Scene(
        "A jar on a cabinet that stands near, and jars on the floor",
        """
......y.
........
........
........
..C...z.
""",
        {
            "C": Thing("cabinet", (0.5, 0.5, 0.5)),
            "x": Thing("jar", (0.2, 0.2, 0.2), 0.5, on="C"),
            "y": Thing("jar", (0.2, 0.2, 0.2)),
            "z": Thing("jar", (0.2, 0.2, 0.2)),
        },
        (
            Asked("extreme", "the topmost jar", "x", "3D", "y"),
            Asked("extreme", "the highest jar", "x", "3D", "y"),
            Asked("side", "the jar at the top of the picture", "y", "picture", "x"),
            Asked("side", "the jar at the left of the picture", "x", "picture"),
        ),
    ),
    Scene(
        "Plates on a table, and stools beside it",
        """
u...T...w
""",
        {
            "T": Thing("table", (0.8, 0.4, 0.5)),
            "p": Thing("plate", (0.16, 0.05, 0.16), 0.4, on="T", aside=-0.25),
            "q": Thing("plate", (0.16, 0.05, 0.16), 0.4, on="T", aside=0.25),
            "u": Thing("stool", (0.2, 0.35, 0.2)),
            "w": Thing("stool", (0.2, 0.35, 0.2)),
        },
        (
            Asked("of the side", "the stool to the left of the table", "u", "3D"),
            Asked("of the side", "the stool on the right of the table", "w", "3D"),
            Asked("on the side", "the plate lying on the left side of the table", "p", "3D and picture"),
            Asked("on the side", "the plate that is placed on the right side of the table", "q", "3D and picture"),
            Asked("side", "the stool on the left side of the picture", "u", "picture"),
        ),
    ),
)


def page() -> str:
    """`docs/choices.md`."""
    lines = [
        "# Which one is meant",
        "",
        "*The leftmost mug*, *the second from the left*, *the taller of the two*: this page draws which thing each "
        "such wording means.",
        "",
        "Sides, corners, ordinals and what is leftmost are those of the picture; distance, height and size are judged",
        "in 3D. Each scene is drawn from above, the camera `^` below the plan, and as the picture shows it, with what",
        "stands on other things. *Otherwise* is the thing that would be meant if it were judged the other way. The",
        "tests ask these sentences in these scenes (`tests/answering/test_choices_drawn.py`), and this page is written",
        "from them (`page` in `drawn_scenes.py`).",
    ]
    for scene in SCENES:
        lines += ["", f"## {scene.title}", "", "```text", "from above"]
        lines += [*scene.rows, "^".center(max(map(len, scene.rows))).rstrip(), "", "the picture", scene.picture()]
        lines += ["```", "", "| kind | sentence | means | judged in | otherwise |", "|---|---|---|---|---|"]
        lines += [f"| {a.kind} | {a.text} | {a.means} | {a.judged} | {a.otherwise} |" for a in scene.asked]
    return "\n".join(lines) + "\n"
