"""Page of a browser: content of each region, changes to send, and the dialog."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from spatialviz.app.channel import Call, Outgoing, PageAddress, Patch
from spatialviz.app.markup import Child, Element, button, changed, h, note

KEPT_CALLS = (
    "timeline",
    "frameAt",
    "oddFrames",
    "tags",
    "objects",
    "names",
    "selected",
    "keys",
    "hints",
    "theme",
    "task",
    "pixels",
    "pixelsPicture",
    "asking",
    "scale",
    "cloud",
    "lit",
    "measure",
    "found",
    "chosen",
)
"""Calls repeated to a reconnected page."""


class BrowserPage:
    """Content of a browser's page; thread-safe, and unchanged content sends nothing."""

    def __init__(self, send: Callable[[Outgoing], None]) -> None:
        self._send = send
        self._shown: dict[str, Element] = {}
        self._calls: dict[str, Any] = {}
        self._address: PageAddress | None = None
        self._parts: list[tuple[str, str]] | None = None
        self._lock = threading.RLock()
        self.downloads: dict[str, tuple[str, bytes]] = {}
        """Pending downloads by secret name: file name and content."""

    def show(self, region: str, *content: Child) -> None:
        """Replace the content of a region of static/index.html."""
        with self._lock:
            element, before = h.div(*content, id=region), self._shown.get(region)
            self._shown[region] = element
            parts = [(region, element.html)] if before is None else list(changed(before, element))
            with self.together() as patch:
                patch += parts

    def fill(self, regions: Mapping[str, Child]) -> None:
        """Replace the content of several regions at once."""
        with self.together():
            for region, content in regions.items():
                self.show(region, content)

    @contextmanager
    def together(self) -> Iterator[list[tuple[str, str]]]:
        """Batch the changes made meanwhile; yields the parts of the patch."""
        with self._lock:
            if self._parts is not None:
                yield self._parts
                return
            parts = self._parts = []
            try:
                yield parts
            finally:
                self._parts = None
                if parts:
                    self._send(Patch(tuple(parts)))

    def call(self, name: str, data: Any = None) -> None:
        """Call a function of the page with a JSON value."""
        with self._lock:
            if name not in self._calls or self._calls[name] != data:
                self._send(Call(name, data))
            if name in KEPT_CALLS:
                self._calls[name] = data

    def toast(self, title: str, text: str, bad: bool = False, undo: str = "") -> None:
        """Show a message in the corner of the page for some seconds; errors stay until closed. `undo` is a command."""
        self.call("toast", {"title": title, "text": text, "bad": bad, "undo": undo})

    def download(self, name: str, data: bytes, copy: bool = False) -> None:
        """Save a file by the browser; `copy`: a picture in PNG, into the clipboard if it may be."""
        key = secrets.token_urlsafe(16)
        self.downloads[key] = name, data
        self.call("download", {"path": key, "name": name, "copy": copy})

    def say_address(self, query: str, title: str, push: bool) -> None:
        """Set the address and title."""
        address, before = PageAddress(query, title, push), self._address
        if before is None or (before.query, before.title) != (query, title):
            self._address = address
            self._send(address)

    def again(self) -> None:
        """Send the whole page to a reconnected browser."""
        with self._lock:
            self._send(Patch(tuple((region, element.html) for region, element in self._shown.items())))
            for name, data in self._calls.items():
                self._send(Call(name, data))
            if self._address is not None:
                self._send(PageAddress(self._address.query, self._address.title, False))


class Dialog:
    """Dialog over a client's page."""

    def __init__(self, page: BrowserPage) -> None:
        self._page = page
        self.title = ""  # Empty if closed
        self._parts: tuple[Element, Element] = h.div(), h.div()

    def show(self, title: str, content: Child, *buttons: Element) -> None:
        """Show content with buttons and a close button; the last of the given buttons is the main action."""
        row = [b.with_(cls="try go" if k == len(buttons) else "try") for k, b in enumerate(buttons, start=1)]
        row.append(button("Close", "close-dialog"))
        self.title, self._parts = title, (h.div(content, cls="content"), h.div(row, cls="buttons"))
        self._draw()

    def refuse(self, problem: str) -> None:
        """Show a problem in the open dialog, else in the corner of the page."""
        if self.title:
            self._draw(note(problem, "bad"))
        else:
            self._page.toast("Not possible", problem, bad=True)

    def close(self) -> None:
        self.title = ""
        self._page.show("dialog")

    def _draw(self, problem: Element | None = None) -> None:
        content, buttons = self._parts
        # A refusal changes only the remark: typed text stays.
        remark = h.div(problem, id="dialog-problem", role="alert")
        parts = (h.h2(self.title, id="dialog-title"), content, remark, buttons)
        self._page.show("dialog", h.dialog(parts, id="dialog-window", aria_labelledby="dialog-title"))
