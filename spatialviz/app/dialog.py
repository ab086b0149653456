"""One dialog of a client at a time: HTML over the page, closed by its button or by Escape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from spatialviz.app.text import BAD, note, panel


class Dialog:
    """Shows HTML over a client's page.

    Parameters
    ----------
    client : viser.ClientHandle

    Attributes
    ----------
    title : str
        Of the dialog that is open; empty where none is.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._modal: Any = None
        self.title = ""
        self._said: viser.GuiHtmlHandle | None = None

    def commands(self) -> dict[str, Callable[[str], None]]:
        """What the page may ask for, by the first word of its message."""
        return {"close-dialog": lambda _: self.close()}

    def show(self, title: str, content: str, *buttons: tuple[str, str]) -> None:
        """Show HTML, with buttons as (label, JavaScript as it stands in an attribute), and one to close.

        The last one does what the dialog is for.
        """
        self.close()
        self._modal, self.title = self._client.gui.add_modal(title), title
        row = "".join(
            f'<span class="try{" go" if k == len(buttons) else ""}" role="button" onclick="{script}">{label}</span>'
            for k, (label, script) in enumerate(buttons, start=1)
        )
        close = '<span class="try" role="button" onclick="sv(\'close-dialog\')">Close</span>'
        with self._modal:
            self._client.gui.add_html(panel(content, style="padding:0"))
            self._said = self._client.gui.add_html("")
            self._client.gui.add_html(panel(f'<div class="buttons">{row}{close}</div>', style="padding:0"))

    def refuse(self, problem: str) -> None:
        """Say why something cannot be done: in the open dialog, else in the corner of the page."""
        if self._said is not None:
            self._said.content = panel(note(problem, BAD), style="padding:0")
        else:
            self._client.add_notification("Not possible", problem, color="red", auto_close_seconds=12)

    def close(self) -> None:
        """Hide it."""
        if self._modal is not None:
            self._modal.close()
        self._modal = self._said = None
        self.title = ""
