"""What of the labels of a frame a person looks at while they correct them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.label_editor import EventLine, LabelEditor
from pipeline.corrections.object_card import ExpressionCard, expression_cards
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.scene import PairCard, labelled_box, pair_card
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import decode_run_length
from pipeline.proposals.annotations import box_mask


@dataclass(frozen=True)
class LabelView:
    """Labels of the shown frame, and what of them is selected."""

    frame: EffectiveFrame
    card: PairCard | None = None
    relation: str | None = None  # settled by the keys T, U and F
    item: ItemKey | None = None  # of the review queue
    said: str = ""  # result of the last action
    bad: bool = False  # not done
    expression: str | None = None  # id
    about: tuple[int, ...] = ()  # pair whose expressions are listed first
    expressions: tuple[ExpressionCard, ...] = ()
    history: tuple[EventLine, ...] = ()
    author: str = ""

    @property
    def sentence(self) -> ExpressionCard | None:
        """Selected expression."""
        return next((c for c in self.expressions if c.id == self.expression), None)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Standing objects in the order of display."""
        return tuple(sorted(self.frame.objects))

    def number(self, place: int | None) -> int | None:
        """Object at a place; None for none."""
        return None if place is None else dict(enumerate(self.numbers)).get(place)

    def place(self, number: int) -> int | None:
        """Place of an object."""
        numbers = self.numbers
        return numbers.index(number) if number in numbers else None

    def places(self, *numbers: int) -> tuple[int, ...] | None:
        """Places of objects; None for any rejected object."""
        found = tuple(place for place in map(self.place, numbers) if place is not None)
        return found if len(found) == len(numbers) else None

    @property
    def relations(self) -> list[str]:
        """Relations on the pair's card."""
        return [] if self.card is None else [line.relation for line in self.card.lines]

    def detailed(self, editor: LabelEditor, places: tuple[int, ...] | None, selected: int | None) -> LabelView:
        """Add card, expressions and history of the chosen pair and object, given by places."""
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
            found,
            relation=relation,
            about=about,
            expressions=expression_cards(self.frame, about),
            history=history,
            author=editor.author,
        )

    def as_labelled(self, number: int, size: tuple[int, int]) -> tuple[np.ndarray, Box3D | None] | None:
        """Mask (H, W) bool and 3D box (camera frame) by the labeller; None if unchanged, or added by a person."""
        before, after = self.frame.auto.objects.get(number), self.frame.objects[number]
        if before is None or all(before[name] == after[name] for name in ("mask", "bbox", "center", "R", "size")):
            return None
        bbox, line = np.array(before["bbox"], np.float32), before["mask"]
        return box_mask(bbox, *size) if line is None else decode_run_length(size, line), labelled_box(before)


def paired(pair: tuple[int, ...] | None, selected: int | None, before: int | None) -> tuple[int, ...] | None:
    """Pair after a selection: the selected object, and the object before."""
    if selected is None or (pair is not None and selected in pair):
        return pair
    other = next((i for i in (before, *(pair or ())) if i not in (None, selected)), None)
    return None if other is None else (selected, other)
