"""One Chromium a session, one server for each kind of data, and for each check a browser context of its own."""

from collections.abc import Iterator
from typing import Any

import pytest
from browser import OpenTab, Scene, Tab, chromium, new_tab
from playwright.sync_api import Browser
from servers import KINDS, Server, Servers

_SERVERS = pytest.StashKey[Servers]()


def _servers(config: pytest.Config) -> Servers:
    if _SERVERS not in config.stash:
        config.stash[_SERVERS] = Servers()
    return config.stash[_SERVERS]


def pytest_collection_finish(session: pytest.Session) -> None:
    """Start what the chosen checks need, in the order in which they need it, beside the first of them."""
    # Each worker of several runs some of them alone.
    if session.config.option.collectonly or hasattr(session.config, "workerinput"):
        return
    for item in session.items:
        for kind in getattr(item, "fixturenames", ()):
            if kind in KINDS:
                _servers(session.config).begin(kind)


def pytest_unconfigure(config: pytest.Config) -> None:
    """End also those that no check has come to."""
    if _SERVERS in config.stash:
        config.stash[_SERVERS].end()


@pytest.fixture(scope="session")
def servers(request: pytest.FixtureRequest) -> Iterator[Servers]:
    found = _servers(request.config)
    yield found
    odd = found.end()
    assert not odd, "\n".join(f"the server of {kind} said: {line}" for kind, lines in odd.items() for line in lines)


def _served(kind: str) -> Any:
    @pytest.fixture(scope="session", name=kind)
    def served(servers: Servers) -> Server:
        return servers.get(kind)

    return served


for _kind in KINDS:
    globals()[f"served_{_kind}"] = _served(_kind)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with chromium() as running:
        yield running


@pytest.fixture
def open_tab(browser: Browser) -> Iterator[OpenTab]:
    """Opens tabs, at an address where one is given. At the end nothing may have gone wrong in any of them."""
    tabs: list[Tab] = []

    def opened(address: str = "", scene: Scene = "unpainted", **options: Any) -> Tab:
        tabs.append(new_tab(browser, scene, **options))
        return tabs[-1].open(address) if address else tabs[-1]

    yield opened
    problems = [problem for tab in tabs for problem in tab.problems]
    for tab in tabs:
        tab.close()
    assert not problems, "\n".join(problems)
