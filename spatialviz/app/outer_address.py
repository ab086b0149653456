"""Addresses at which a proxy serves the page outside this machine."""

from __future__ import annotations

import re
from urllib.parse import unquote, urlsplit

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

PORT = re.compile(r"\{\{?port\}?\}")
ADDRESS = re.compile(
    r"https?://([\w-]+(\.[\w-]+)*|\[[a-f\d:.]+\])(:\d{1,5})?(/[\w.~%@+:,=-]*)*", re.ASCII | re.IGNORECASE
)
OF_THE_PAGE = re.compile(r"/$|/app/|/scene/")
"""Beginnings of the page's own paths."""


@dataclass(frozen=True)
class OuterAddress:
    """Address of the page behind a proxy; {port} in it stands for the server's port.

    Without an origin the name is not known: it is the one at which a valid token comes.
    """

    origin: str  # As browsers write it: "https://hub.example.org", without the scheme's own port
    path: str  # From "/" to "/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Host headers of a request to this address, as proxies write them."""
        host = self.origin.partition("://")[2]
        return (host, host + _own_port(self.origin)) if host else ()

    def at(self, port: int) -> OuterAddress:
        """This address of a server at a port."""
        return OuterAddress(PORT.sub(str(port), self.origin), PORT.sub(str(port), self.path))

    def inside(self, path: str) -> str | None:
        """Path of the page by one in which the proxy has left this address's; None for any other."""
        own, asked = unquote(self.path)[:-1], unquote(path)
        rest = asked.removeprefix(own)
        return rest if own and rest != asked and OF_THE_PAGE.match(rest) else None

    def __str__(self) -> str:
        return self.origin + self.path


def outer_address(text: str) -> OuterAddress:
    """Address by its text; InputError if it is none."""
    require(
        ADDRESS.fullmatch(PORT.sub("8080", text)),
        "--outer-address is not an address",
        got=text,
        expected="http or https, a host and the path of the proxy, nothing else: https://hub.example.org/user/ann/proxy/8080/",
    )
    parts = urlsplit(text)
    origin = f"{parts.scheme}://{parts.netloc.lower()}"
    return OuterAddress(origin.removesuffix(_own_port(origin)), parts.path.rstrip("/") + "/")


def _own_port(origin: str) -> str:
    return ":443" if origin.startswith("https:") else ":80"
