"""The page of one browser: what stands in each of its regions, what of it must be sent, and its dialog."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from spatialviz.app.channel import Address, Call, Outgoing, Patch
from spatialviz.app.markup import BAD, Child, Element, changed, h, note

LISTED_FRAMES = 1000
"""A list of more frames would be slow to open; around the current one are enough to pick from."""
KEPT_CALLS = (
    "tags",
    "keys",
    "theme",
    "task",
    "pixels",
    "pixelsPicture",
    "asking",
    "scale",
    "measure",
    "found",
    "chosen",
)
"""Calls that a page which comes back must hear again."""


def listed(ids: Sequence[str], current: str) -> tuple[str, ...]:
    """The frames that the list of frames offers."""
    if len(ids) <= LISTED_FRAMES:
        return tuple(ids)
    start = max(0, min(ids.index(current) - LISTED_FRAMES // 2, len(ids) - LISTED_FRAMES))
    return tuple(ids[start : start + LISTED_FRAMES])


class Page:
    """What one browser shows. Any thread may call it; what does not change sends nothing.

    Parameters
    ----------
    send : callable
        Sends a message, where the browser is there.
    """

    def __init__(self, send: Callable[[Outgoing], None]) -> None:
        self._send = send
        self._shown: dict[str, Element] = {}
        self._calls: dict[str, Any] = {}
        self._address: Address | None = None
        self._parts: list[tuple[str, str]] | None = None
        self._lock = threading.RLock()
        self.downloads: dict[str, tuple[str, bytes]] = {}
        """By a secret name: file name and content of what the browser is about to fetch."""

    def show(self, region: str, *content: Child) -> None:
        """Show this in a region of static/index.html, and nothing else there."""
        with self._lock:
            element, before = h.div(*content, id=region), self._shown.get(region)
            self._shown[region] = element
            parts = [(region, element.html)] if before is None else list(changed(before, element))
            if parts and self._parts is not None:
                self._parts += parts
            elif parts:
                self._send(Patch(tuple(parts)))

    @contextmanager
    def together(self) -> Iterator[None]:
        """What is shown meanwhile is sent as one."""
        with self._lock:
            outer, self._parts = self._parts, [] if self._parts is None else self._parts
            try:
                yield
            finally:
                parts, self._parts = self._parts, outer
                if outer is None and parts:
                    self._send(Patch(tuple(parts)))

    def call(self, name: str, data: Any = None) -> None:
        """Call a function of the page with what can be JSON."""
        with self._lock:
            if name in KEPT_CALLS:
                if name in self._calls and self._calls[name] == data:
                    return
                self._calls[name] = data
            self._send(Call(name, data))

    def toast(self, title: str, text: str, bad: bool = False) -> None:
        """Say something in the corner of the page, for some seconds."""
        self.call("toast", {"title": title, "text": text, "bad": bad})

    def download(self, name: str, data: bytes) -> None:
        """Have the browser save a file."""
        key = secrets.token_urlsafe(16)
        self.downloads[key] = name, data
        self.call("download", {"path": key, "name": name})

    def say_address(self, query: str, title: str, push: bool) -> None:
        """Have the address say what is shown."""
        address = Address(query, title, push)
        if self._address is None or (address.query, address.title) != (self._address.query, self._address.title):
            self._address = address
            self._send(address)

    def again(self) -> None:
        """Send all of it to a browser that has come back."""
        with self._lock:
            self._send(Patch(tuple((region, element.html) for region, element in self._shown.items())))
            for name, data in self._calls.items():
                self._send(Call(name, data))
            if self._address is not None:
                self._send(Address(self._address.query, self._address.title, False))


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
