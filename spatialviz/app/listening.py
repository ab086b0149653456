"""Server that listens: a page's files are answered at once, its sessions as soon as it is told what to show."""

from __future__ import annotations

import io
import socket
from concurrent.futures import Future
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

import rich
import viser

from pipeline.system.errors import InputError, require
from pipeline.system.freed_memory import return_freed_memory
from pipeline.system.frozen import dataclass
from spatialviz.app.access import Access
from spatialviz.app.site import MAX_CLIENTS, Pages, Site
from spatialviz.app.viser_socket import close_tunnels, served_by

if TYPE_CHECKING:
    from spatialviz.app.context import Shared


@dataclass(frozen=True)
class Listening:
    """Server on its own threads; what pages show is given later."""

    server: viser.ViserServer
    access: Access
    shared: Future[Shared]

    def stop(self) -> None:
        """End the server."""
        with redirect_stdout(io.StringIO()):
            self.server.stop()


def listen(
    access: Access,
    host: str = "127.0.0.1",
    port: int = 8080,
    dark: bool | None = None,
    max_clients: int = MAX_CLIENTS,
) -> Listening:
    """Start the server; `port` 0 lets the system choose, and a taken port becomes the next free. `max_clients` limits
    the open pages.

    InputError for an unusable address.
    """
    _check_address(host, port)
    return_freed_memory()
    shared: Future[Shared] = Future()
    pages = Pages(shared, access, max_clients)
    # In a notebook viser's own words are no lines of the standard output.
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        with served_by(Site(access, pages, dark)), redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=host, port=port, label="spatialviz", verbose=False)
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot listen on {host}:{port}", got=str(error)) from error
    finally:
        console.quiet = quiet
    access.listens(server.get_port())
    close_tunnels(server)
    server.gui.configure_theme(dark_mode=dark is not False, show_logo=False, show_share_button=False)
    server.scene.configure_environment_map(hdri=None)
    server.scene.configure_default_lights(True, cast_shadow=False)
    server.scene.world_axes.visible = False
    pages.listen(server)
    return Listening(server, access, shared)


def _check_address(host: str, port: int) -> None:
    """Reject an address foreign to this machine; viser would try a thousand ports."""
    require(0 <= port <= 65535, "there is no such port", got=port, expected="0 to 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError as error:
        raise InputError(
            f"cannot listen on {host}", got=error.strerror or str(error), cause="is it an address of this machine?"
        ) from error
