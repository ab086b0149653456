"""A person's editors of the labels of several sources, opened when they are needed, all under one name."""

from __future__ import annotations

import getpass
from collections.abc import Callable, Mapping

from pipeline.answering.pipeline import Pipeline
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import LONGEST_NAME, plain_text
from pipeline.corrections.journal_location import JournalLocation
from pipeline.corrections.label_editor import LabelEditor
from pipeline.corrections.label_view import Target
from pipeline.system.errors import require


class LabelEditors:
    """Editors of one person for the labels of several sources, by name."""

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
        """Editor of a source, opened when first needed; None without labels."""
        if source not in self._open and source in self._journals:
            location = self._journals[source]
            dataset = self._sources[source].dataset
            self._open[source] = LabelEditor(location.labels, location, self._author, dataset)
        return self._open.get(source)

    def opened(self, source: str) -> LabelEditor | None:
        """Editor of a source where open; for any thread."""
        return self._open.get(source)

    def corrected(self, source: str, frame: str) -> EffectiveFrame | None:
        """The labels of a frame as they were corrected by now; None where nobody has corrected any."""
        editor = self.of(source)
        return None if editor is None else editor.corrected(frame)

    def greet(self, author: str) -> None:
        """Take a name used before, unless given; raises as `sign`."""
        if author and not self._given:
            self.sign(author)

    def sign_for_token(self, author: str) -> None:
        """Correct under a token's name; `sign` cannot change it."""
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
    """Login name of the user; "somebody" for none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # A container may know no name of its user.
        return "somebody"
