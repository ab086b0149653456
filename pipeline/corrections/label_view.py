"""What of the labels of a frame a person looks at while they correct them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.label_editor import EventLine, LabelEditor
from pipeline.corrections.object_card import ExpressionCard, expression_cards
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.scene import Moved, PairCard, labelled_box, pair_card
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import decode_run_length
from pipeline.proposals.annotations import box_mask


@dataclass(frozen=True)
class Target:
    """What of the labels is to be looked at.

    Attributes
    ----------
    frame : str
    objects : tuple of int
        Numbers: of one object, or of a pair.
    relation : str or None
    item : ItemKey or None
        The item of the review queue that it is.
    """

    frame: str
    objects: tuple[int, ...] = ()
    relation: str | None = None
    item: ItemKey | None = None


ANYTHING = Target("")
"""No frame in particular."""


@dataclass(frozen=True)
class LabelView:
    """The labels of the frame that is shown.

    Attributes
    ----------
    frame : EffectiveFrame
        Its objects, in the order of their numbers, are those that are shown.
    card : PairCard or None
        Of the chosen pair.
    relation : str or None
        The one that the keys T, U and F settle.
    item : ItemKey or None
        What of the review queue is looked at.
    said : str
        What came of the last action.
    bad : bool
        It was not done.
    moved : Moved or None
        What follows from the box that is being dragged.
    expression : str or None
        The id of the expression that is looked at.
    about : tuple of int
        Numbers of the pair whose expressions are listed first.
    expressions : tuple of ExpressionCard
        All of the frame.
    history : tuple of EventLine
        Of what is selected.
    author : str
        Who looks.
    """

    frame: EffectiveFrame
    card: PairCard | None = None
    relation: str | None = None
    item: ItemKey | None = None
    said: str = ""
    bad: bool = False
    moved: Moved | None = None
    expression: str | None = None
    about: tuple[int, ...] = ()
    expressions: tuple[ExpressionCard, ...] = ()
    history: tuple[EventLine, ...] = ()
    author: str = ""

    @property
    def sentence(self) -> ExpressionCard | None:
        """The expression that is looked at."""
        return next((c for c in self.expressions if c.id == self.expression), None)

    @property
    def numbers(self) -> tuple[int, ...]:
        """The objects that stand, in the order in which they are shown."""
        return tuple(sorted(self.frame.objects))

    def number(self, place: int | None) -> int | None:
        """The object that is shown at a place; None where there is none."""
        return None if place is None else dict(enumerate(self.numbers)).get(place)

    def place(self, number: int) -> int | None:
        """The place at which an object is shown."""
        numbers = self.numbers
        return numbers.index(number) if number in numbers else None

    def places(self, *numbers: int) -> tuple[int, ...] | None:
        """The places at which objects are shown; None where one of them stands no longer."""
        found = tuple(place for place in map(self.place, numbers) if place is not None)
        return found if len(found) == len(numbers) else None

    @property
    def relations(self) -> list[str]:
        """Those that the card of the pair has."""
        return [] if self.card is None else [line.relation for line in self.card.lines]

    def detailed(self, editor: LabelEditor, places: tuple[int, ...] | None, selected: int | None) -> LabelView:
        """With what is told of the chosen pair and of the selected object: its card, its expressions, its history.

        Both are given by the places at which they are shown; a thing alone, which stands twice, is no pair.
        """
        ends = None if places is None else (self.numbers[places[0]], self.numbers[places[1]])
        pair = None if ends is None or ends[0] == ends[1] else ends
        found, number = (
            replace(self, card=None if pair is None else pair_card(self.frame, *pair)),
            self.number(selected),
        )
        relation = self.relation if self.relation in found.relations else next(iter(found.relations), None)
        about = self.about if pair is None or (self.sentence is not None and self.sentence.is_of(pair)) else pair
        objects = () if number is None else (number,)
        history = editor.history(self.frame.frame, objects=objects, pair=pair, expression=self.expression)
        return replace(
            found, relation=relation, about=about, expressions=expression_cards(self.frame, about), history=history,
            author=editor.author,
        )  # fmt: skip

    def as_labelled(self, number: int, size: tuple[int, int]) -> tuple[np.ndarray, Box3D | None] | None:
        """An object's mask ((H, W) bool, of this `size`) and 3D box (camera frame) as the labeller had them.

        None where they are the same now, or a person has added it.
        """
        before, after = self.frame.auto.objects.get(number), self.frame.objects[number]
        if before is None or all(before[name] == after[name] for name in ("mask", "bbox", "center", "R", "size")):
            return None
        bbox, line = np.array(before["bbox"], np.float32), before["mask"]
        return box_mask(bbox, *size) if line is None else decode_run_length(size, line), labelled_box(before)


def paired(pair: tuple[int, ...] | None, selected: int | None, before: int | None) -> tuple[int, ...] | None:
    """The pair after a selection: what is selected now, and what was selected before it."""
    if selected is None or (pair is not None and selected in pair):
        return pair
    other = next((i for i in (before, *(pair or ())) if i not in (None, selected)), None)
    return None if other is None else (selected, other)
