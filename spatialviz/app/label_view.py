"""What of the labels one client looks at while they correct them, and its editors of them, all under one name."""

from __future__ import annotations

import getpass
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pipeline.answering.opening import Pipeline
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import LONGEST_NAME, plain_text
from pipeline.corrections.journal_location import JournalLocation
from pipeline.corrections.label_editor import EventLine, LabelEditor
from pipeline.corrections.object_card import ExpressionCard
from pipeline.corrections.review.items import ItemKey
from pipeline.corrections.scene import Moved, PairCard
from pipeline.system.errors import require


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


class LabelEditors:
    """What the parts of one page share that correct labels.

    Parameters
    ----------
    journals, sources : mapping of str
        By the names of the sources.
    author : str or None
        Under whose name corrections are saved; else as the browser has kept it, else the user's own.

    Attributes
    ----------
    wanted : Target or None
        What of the labels the frame that is opened next shows; None leaves it to what is shown now.
    said : (str, bool)
        What came of the last action, and whether it was not done.
    on_saved : list of callable
        Get the events of everything that this client saves or takes back.
    """

    def __init__(
        self, journals: Mapping[str, JournalLocation], sources: Mapping[str, Pipeline], author: str | None
    ) -> None:
        self._journals, self._sources = journals, sources
        self._open: dict[str, LabelEditor] = {}
        self._author = author or login_name()
        self._given, self._of_token = author is not None, False
        self.wanted: Target | None = None
        self.said: tuple[str, bool] = "", False
        self.on_saved: list[Callable[[tuple[Event, ...]], object]] = []

    def of(self, source: str) -> LabelEditor | None:
        """That of a source, opened when it is first needed; None where no labels of it are open."""
        if source not in self._open and source in self._journals:
            location = self._journals[source]
            dataset = self._sources[source].dataset
            self._open[source] = LabelEditor(location.labels, location, self._author, dataset)
        return self._open.get(source)

    def opened(self, source: str) -> LabelEditor | None:
        """That of a source, where it was needed before; any thread may ask."""
        return self._open.get(source)

    def corrected(self, source: str, frame: str) -> EffectiveFrame | None:
        """The labels of a frame as they were corrected by now; None where nobody has corrected any."""
        editor = self.of(source)
        return None if editor is None else editor.corrected(frame)

    def greet(self, author: str) -> None:
        """Take the name that a browser has kept, unless one was given; raises as `sign`."""
        if author and not self._given:
            self.sign(author)

    def sign_for_token(self, author: str) -> None:
        """Correct under the name of whoever's token it is; the page cannot change it."""
        self.sign(author)
        self._given = self._of_token = True

    def sign(self, author: str) -> None:
        """Save what follows under another name; InputError as `LabelEditor.sign`, and where a token has the name."""
        name = plain_text(author.strip(), "an author", LONGEST_NAME).strip()
        require(not self._of_token, "corrections are under the name of your token", got=name, expected=self._author)
        # All of them, or none.
        for step in (LabelEditor.check_name, LabelEditor.sign):
            for editor in self._open.values():
                step(editor, name)
        self._author = name


def login_name() -> str:
    """The name that the user is logged in with; "somebody" where there is none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # A container may know no name of its user.
        return "somebody"
