"""viser's own inputs on the page, turned into the commands that its HTML sends, too."""

from __future__ import annotations

import threading
from collections.abc import Callable

import viser

from spatialviz.app.layout import Page


def forward_inputs(page: Page, post: Callable[[str], None], bridge_alive: threading.Event) -> None:
    """Send a command for every press and every choice of a person."""

    @page.ask.on_click
    async def _(event: viser.GuiEvent) -> None:
        post("again")

    @page.form.on_submit
    async def _(event: viser.GuiEvent) -> None:
        # Where the bridge is alive it has sent the text itself: viser drops
        # a keystroke that comes within 50 ms before Enter.
        if not bridge_alive.is_set():
            post("again")

    # viser calls back for values that Python sets, too; those carry no client.
    @page.frame.on_update
    async def _(event: viser.GuiEvent) -> None:
        if event.client_id is not None:
            post(f"open:{page.frame.value}")

    @page.dataset.on_update
    async def _(event: viser.GuiEvent) -> None:
        if event.client_id is not None:
            post(f"data:{page.dataset.value}")
