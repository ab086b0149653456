"""The page in Chromium for the checks: a server of their own, tabs that know their scene's frame, and what goes wrong.

The content policy of the page forbids `eval`, and with it `page.wait_for_function`: `Tab.poll` asks again and again by
`page.evaluate`, which the policy does not bind.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

from playwright.sync_api import Browser, Locator, Page, sync_playwright

CHROMIUM = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = {"width": 1440, "height": 900}
SLOW = float(os.environ.get("SPATIALVIZ_CHECK_PATIENCE", "60"))
"""Seconds that something may take to appear; more on a machine that is busy with other things."""
ENDS_WITHIN = 30.0
# viser's client always makes the sorter of its Gaussian splats, a WebAssembly module whose glue (Emscripten's embind)
# builds its functions from strings. The page shows no splats, so nothing is missing where that is forbidden.
SORTER = "Evaluating a string as JavaScript violates the following Content Security Policy directive"
DRAWN = """(() => {
  const nodes = document.getElementById('view').contentWindow?.__viserMutable?.nodeRefFromName;
  return !!nodes && Object.values(nodes).filter(Boolean).length > 5;
})()"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Server:
    """`spatialviz view` with these words, on a port of its own unless one is given; it ends with its block."""

    def __init__(self, *words: object, port: int = 0) -> None:
        self.port = port or free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        command = [sys.executable, "-m", "spatialviz", "view", *map(str, words)]
        command += ["--port", str(self.port), "--no-open-browser"]
        self.started = time.monotonic()
        # What was corrected in the demo before is not what a check begins with, and what it corrects is nobody's.
        self._home = tempfile.TemporaryDirectory()
        own = {**os.environ, "XDG_DATA_HOME": self._home.name, "PYTHONFAULTHANDLER": "1"}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=own)

    def served(self, within: float = 30.0) -> float:
        """Seconds until it answered."""
        while time.monotonic() - self.started < within:
            try:
                with urllib.request.urlopen(self.address, timeout=1):
                    return time.monotonic() - self.started
            except urllib.error.HTTPError:
                return time.monotonic() - self.started
            except OSError:
                time.sleep(0.05)
        raise SystemExit(f"the page was not served within {within} s")

    def end(self) -> list[str]:
        """Stop it; the lines that it has said."""
        self.process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.communicate(timeout=ENDS_WITHIN)[0].decode().splitlines()
        # What holds it up is said by the fault handler.
        self.process.send_signal(signal.SIGABRT)
        said = self.process.communicate(timeout=ENDS_WITHIN)[0].decode()
        raise SystemExit(f"the page did not end within {ENDS_WITHIN} s:\n{said}")

    def __enter__(self) -> "Server":
        self.served(90)
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.end()


class Tab:
    """A page of the browser, and what went wrong in it: errors of scripts, of the console, requests that failed."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.problems: list[str] = []
        page.set_default_timeout(SLOW * 1000)
        page.on("pageerror", lambda error: self._problem(str(error)))
        page.on("console", lambda said: self._problem(said.text) if said.type == "error" else None)
        page.on("requestfailed", lambda request: self._problem(f"{request.url}: {request.failure}"))

    def _problem(self, text: str) -> None:
        # A request of a page that is left is given up.
        if not text.startswith(SORTER) and "net::ERR_ABORTED" not in text:
            self.problems.append(text)

    def open(self, address: str) -> "Tab":
        """Go to an address and wait until its words stand."""
        self.page.goto(address)
        return self.words()

    def words(self) -> "Tab":
        """Wait until the server has filled the page."""
        self.poll("document.getElementById('answer').childElementCount + "
                  "document.getElementById('review-list').childElementCount > 0")  # fmt: skip
        return self

    def drawn(self) -> "Tab":
        """Wait until viser's client shows the scene."""
        self.poll(DRAWN)
        return self

    def poll(self, js: str, arg: Any = None, seconds: float = SLOW) -> Any:
        """What an expression, or a function of `arg`, says as soon as it is true of the page."""
        end = time.monotonic() + seconds
        while not (found := self.page.evaluate(js, arg)):
            if time.monotonic() > end:
                raise AssertionError(f"never so: {js} {arg or ''}; {self.problems}")
            self.page.wait_for_timeout(40)
        return found

    def see(self, selector: str, words: str = "") -> Locator:
        """The first such element that is visible, as soon as there is one."""
        found = self.page.locator(f"{selector}:visible", has_text=words).first
        found.wait_for(timeout=SLOW * 1000)
        return found

    def click(self, command: str) -> None:
        """Click the element that sends a command."""
        self.see(f'[data-do="{command}"]').click()

    def drawer(self, name: str) -> None:
        """Open a tab of the drawer, by the name that its command has."""
        self.see(f'#drawer-tabs [data-local="tab:{name}"]').click()

    def send(self, command: str) -> None:
        """Send a command as an element does that is clicked; for those that have none on the page now."""
        self.page.evaluate(
            "command => { const made = document.body.appendChild(document.createElement('button'));"
            " made.dataset.do = command; made.click(); made.remove(); }", command,
        )  # fmt: skip

    def ask(self, text: str) -> None:
        """Type a question and press Enter."""
        self.page.locator("#ask-text").fill(text)
        self.page.locator("#ask-text").press("Enter")

    @property
    def question(self) -> str:
        return self.page.locator("#ask-text").input_value()

    @property
    def frame(self) -> str:
        return self.page.locator("#where .frame-id").input_value()

    def press(self, key: str) -> None:
        """Press a key where no field is being typed into."""
        self.page.evaluate("document.activeElement.blur()")
        self.page.keyboard.press(key)


class Timed:
    """Runs checks, and says of each how long it took."""

    def __init__(self) -> None:
        self.seconds: dict[str, int] = {}

    def __call__(self, check: Callable[..., Any], *given: object) -> Any:
        started = time.monotonic()
        try:
            return check(*given)
        finally:
            self.seconds[check.__name__] = round(time.monotonic() - started)

    def __str__(self) -> str:
        return json.dumps(self.seconds)


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=CHROMIUM)
        try:
            yield browser
        finally:
            browser.close()


def new_tab(browser: Browser, **options: Any) -> Tab:
    return Tab(browser.new_page(**({"viewport": SIZE} | options)))
