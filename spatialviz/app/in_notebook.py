"""Page in a notebook whose browser may be on another machine: the address by which it gets here, the page as output."""

from __future__ import annotations

import json
import os
import sys
from html import escape
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from urllib.parse import urlsplit

from pipeline.system.errors import InputError
from spatialviz.app.outer_address import OuterAddress, outer_address

SECONDS = 3.0
"""Time for the notebook's server to answer."""
HEIGHT = 760
"""Pixels of the page in a notebook."""


def addresses_of_notebook() -> tuple[tuple[OuterAddress, ...], bool]:
    """Addresses at which this notebook's browser may reach the page, and whether the notebook can hold it as a frame.

    That of Jupyter with jupyter-server-proxy, which can, else those of VS Code in a browser and of Codespaces; none
    outside notebooks, or where nothing tells of another machine.
    """
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if not hasattr(shell, "kernel"):
        return (), False
    if base := _proxied_by_jupyter():
        # The name by which people reach Jupyter is rarely known to it.
        public = urlsplit(os.environ.get("JUPYTERHUB_PUBLIC_URL", ""))
        origin = f"{public.scheme}://{public.netloc}" if public.netloc else ""
        return (OuterAddress(origin, f"{base}proxy/{{port}}/"),), True
    name, domain = (os.environ.get(k, "") for k in ("CODESPACE_NAME", "GITHUB_CODESPACES_PORT_FORWARDING_DOMAIN"))
    found: list[OuterAddress] = []
    for text in (os.environ.get("VSCODE_PROXY_URI", ""), f"https://{name}-{{port}}.{domain}"):
        try:
            found.append(outer_address(text))
        except InputError:
            continue
    return tuple(dict.fromkeys(found)), False


def show_in_notebook(address: OuterAddress, token: str) -> None:
    """Show the page as output of the cell, in a frame of Jupyter's own address."""
    from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

    link = escape(f"{address.path}?token={token}")
    display(
        HTML(
            f'<iframe src="{link}" width="100%" height="{HEIGHT}" style="border:0" allow="clipboard-write; fullscreen">'
            f'</iframe><a href="{link}" target="_blank">in a tab of its own</a>'
        )
    )


def _proxied_by_jupyter() -> str:
    """Path of the Jupyter server whose kernel this is; "" for none, or one without jupyter-server-proxy."""
    from jupyter_core.paths import jupyter_runtime_dir  # pyright: ignore[reportMissingImports]

    file = Path(jupyter_runtime_dir()) / f"jpserver-{os.environ.get('JPY_PARENT_PID')}.json"
    if not file.is_file():
        return os.environ.get("JUPYTERHUB_SERVICE_PREFIX", "")
    server = json.loads(file.read_text("utf-8"))
    parts = urlsplit(server["url"])
    link = (HTTPSConnection if parts.scheme == "https" else HTTPConnection)(parts.netloc, timeout=SECONDS)
    try:
        # Who asks without a password is sent to log in, or told that there is no such page.
        link.request("GET", f"{parts.path}proxy/1")
        return "" if link.getresponse().status == HTTPStatus.NOT_FOUND else server["base_url"]
    except (OSError, HTTPException):
        return ""
    finally:
        link.close()
