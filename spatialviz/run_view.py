"""Command opening the page: a server listens at once, while what pages are made of is loaded and the data is opened."""

from __future__ import annotations

from pipeline.system.errors import require
from pipeline.system.freed_memory import uncollected
from spatialviz.app.access import Access
from spatialviz.app.listening import listen
from spatialviz.app.outer_address import outer_address
from spatialviz.cli_ask import ViewCommand


def run_view(command: ViewCommand) -> None:
    require(command.author is None or command.author.strip(), "--author must not be empty")
    require(command.max_clients >= 1, "--max-clients is a count", got=command.max_clients, expected="at least 1")
    access = Access.of(command.host, command.tokens, [*map(outer_address, command.outer_address)])
    dark = None if command.theme is None else command.theme == "dark"
    listening = listen(access, command.host, command.port, dark, command.max_clients)
    try:
        with uncollected():
            from spatialviz.view_opening import open_view
        open_view(command, listening, dark)
    finally:
        listening.stop()
