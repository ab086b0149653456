"""What of the labels one client looks at while they correct them."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.label_editor import EventLine
from pipeline.corrections.object_card import ExpressionCard
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.scene import Moved, PairCard


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
        Its objects, in the order of their numbers, are those of `State.shown`.
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
        """The objects that stand, as `State.shown` has them."""
        return tuple(sorted(self.frame.objects))

    def place(self, number: int) -> int | None:
        """Where an object is in `State.shown`."""
        numbers = self.numbers
        return numbers.index(number) if number in numbers else None

    def places(self, *numbers: int) -> tuple[int, ...] | None:
        """Where objects are in `State.shown`; None where one of them stands no longer."""
        found = tuple(place for place in map(self.place, numbers) if place is not None)
        return found if len(found) == len(numbers) else None


def paired(pair: tuple[int, ...] | None, selected: int | None, before: int | None) -> tuple[int, ...] | None:
    """The pair after a selection: what is selected now, and what was selected before it."""
    if selected is None or (pair is not None and selected in pair):
        return pair
    other = next((i for i in (before, *(pair or ())) if i not in (None, selected)), None)
    return None if other is None else (selected, other)
