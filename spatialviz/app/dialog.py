"""One dialog of a client at a time, closed by its button or by Escape."""

from __future__ import annotations

from collections.abc import Callable

from spatialviz.app.layout import Page
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.text import BAD, note


class Dialog:
    """Shows something over a client's page.

    Parameters
    ----------
    page : Page

    Attributes
    ----------
    title : str
        Of the dialog that is open; empty where none is.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self.title = ""
        self._parts: tuple[Element, Element] = h.div(), h.div()

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {"close-dialog": lambda _: self.close()}

    def show(self, title: str, content: Child, *buttons: Element) -> None:
        """Show content, with buttons and one more to close; the last of them does what the dialog is for."""
        row = [b.with_(cls="try go" if k == len(buttons) else "try") for k, b in enumerate(buttons, start=1)]
        close = h.button("Close", cls="try", do="close-dialog")
        self.title, self._parts = title, (h.div(content, cls="content"), h.div(row, close, cls="buttons"))
        self._draw()

    def copy(self) -> None:
        """Put the text of its field into the clipboard."""
        self._page.call("copy")

    def refuse(self, problem: str) -> None:
        """Say why something cannot be done: in the open dialog, else in the corner of the page."""
        if self.title:
            self._draw(note(problem, BAD))
        else:
            self._page.toast("Not possible", problem, bad=True)

    def close(self) -> None:
        """Hide it."""
        self.title = ""
        self._page.show("dialog")

    def _draw(self, problem: Element | None = None) -> None:
        content, buttons = self._parts
        # What is refused changes the remark alone: what was typed stays.
        remark = h.div(problem, id="dialog-problem", role="alert")
        title = h.h2(self.title, id="dialog-title")
        self._page.show(
            "dialog", h.dialog(title, content, remark, buttons, id="dialog-window", aria_labelledby="dialog-title")
        )
