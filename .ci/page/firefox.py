"""Firefox on a screen in memory, driven by WebDriver BiDi over a websocket; WebGL is rendered in software."""

import contextlib
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from browser import SLOW
from websockets.sync.client import ClientConnection, connect

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
SCREEN = shutil.which("Xvfb")
"""Without a screen Firefox has no WebGL."""
PREFS: dict[str, bool | int | str] = {
    "webgl.force-enabled": True,
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "app.normandy.enabled": False,
    "app.update.enabled": False,
    "browser.aboutwelcome.enabled": False,
    "ui.systemUsesDarkTheme": 1,
}
KEYS = {"Enter": "\ue007", "Escape": "\ue00c", "Tab": "\ue004"}


class Tab:
    """The one page of a Firefox, and what goes wrong in it."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._number = socket, 0
        self.problems: list[str] = []
        self._send("session.new", capabilities={"alwaysMatch": {"acceptInsecureCerts": True}})
        self._send("session.subscribe", events=["log.entryAdded"])
        (first, *_) = self._send("browsingContext.getTree")["contexts"]
        self._context = first["context"]
        self._send("browsingContext.setViewport", context=self._context, viewport={"width": 1440, "height": 900})

    def _send(self, method: str, **params: Any) -> Any:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            said = json.loads(self._socket.recv(timeout=SLOW))
            if said.get("method") == "log.entryAdded":
                entry = said["params"]
                if entry["level"] == "error" and not _expected(entry):
                    self.problems.append(entry["text"] or "")
            elif said.get("id") == self._number:
                if said["type"] == "error":
                    raise RuntimeError(f"{method}: {said['error']}: {said['message']}")
                return said["result"]

    def open(self, address: str) -> "Tab":
        self._send("browsingContext.navigate", context=self._context, url=address, wait="complete")
        return self

    def evaluate(self, js: str) -> Any:
        """What an expression is, as JSON."""
        found = self._send(
            "script.evaluate",
            expression=f"(async () => JSON.stringify((await ({js})) ?? null))()",
            target={"context": self._context},
            awaitPromise=True,
        )
        if found["type"] == "exception":
            raise RuntimeError(found["exceptionDetails"]["text"])
        return json.loads(found["result"]["value"])

    def poll(self, js: str, seconds: float = SLOW) -> Any:
        """What an expression is as soon as it is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := self.evaluate(js):
                return found
            time.sleep(0.1)
        raise AssertionError(f"never so: {js}; {self.problems}")

    def press(self, *keys: str) -> None:
        """Press keys one after the other, as a person does."""
        pairs = [{"type": t, "value": KEYS.get(k, k)} for k in keys for t in ("keyDown", "keyUp")]
        keyboard = {"type": "key", "id": "keyboard", "actions": pairs}
        self._send("input.performActions", context=self._context, actions=[keyboard])

    def click(self, selector: str) -> None:
        """Click the middle of an element."""
        x, y = self.poll(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}), b = e?.getBoundingClientRect();"
            " return e?.checkVisibility() && b.width && [b.left + b.width / 2 | 0, b.top + b.height / 2 | 0]; })()"
        )
        moves = [
            {"type": "pointerMove", "x": x, "y": y},
            *({"type": f"pointer{d}", "button": 0} for d in ("Down", "Up")),
        ]
        mouse = {"type": "pointer", "id": "mouse", "actions": moves}
        self._send("input.performActions", context=self._context, actions=[mouse])

    def picture(self) -> str:
        """The page as a PNG, in base64."""
        return self._send("browsingContext.captureScreenshot", context=self._context)["data"]


def _expected(entry: Mapping[str, Any]) -> bool:
    """Tell what every browser says of viser's client: its sorter of splats, which the page's policy forbids."""
    return bool(re.search(r"blocked a JavaScript eval|call to Function\(\) blocked by CSP", entry["text"] or ""))


@contextlib.contextmanager
def firefox(**prefs: bool | int | str) -> Iterator[Tab]:
    """A Firefox with a profile of its own; `prefs` with "_" for "."."""
    given = PREFS | {name.replace("_", "."): value for name, value in prefs.items()}
    with contextlib.ExitStack() as stack:
        profile = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        lines = "".join(f"user_pref({json.dumps(k)}, {json.dumps(v)});\n" for k, v in given.items())
        (Path(profile) / "user.js").write_text(lines, "utf-8")
        screen = _running(stack, SCREEN, "-displayfd", "1", "-screen", "0", "1600x1000x24", "-nolisten", "tcp")
        display = {"DISPLAY": f":{_said(screen, '([0-9]+)')}", "LIBGL_ALWAYS_SOFTWARE": "1", "HOME": profile}
        asked = ("--no-remote", "--profile", profile, "--remote-debugging-port", "0")
        address = _said(_running(stack, FIREFOX, *asked, **display), r"BiDi listening on (ws://\S+)")
        yield Tab(stack.enter_context(connect(f"{address}/session", max_size=None)))


def _running(stack: contextlib.ExitStack, program: str | None, *words: str, **env: str) -> subprocess.Popen[str]:
    """A program that ends with the stack."""
    assert program is not None
    process = subprocess.Popen(
        [program, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | env
    )

    def end() -> None:
        process.terminate()
        process.communicate(timeout=30)

    stack.callback(end)
    return process


def _said(process: subprocess.Popen[str], pattern: str) -> str:
    """What a program says of itself, by a pattern with one group."""
    assert process.stdout is not None
    lines: list[str] = []
    for line in process.stdout:
        lines.append(line)
        if found := re.search(pattern, line):
            return found[1]
    raise AssertionError(f"{process.args}: {lines[-5:]}")
