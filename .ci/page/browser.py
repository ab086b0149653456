"""The page in Chromium: tabs that know their scene's frame, and what goes wrong in them.

The content policy of the page forbids `eval`, and with it `page.wait_for_function`: `Tab.poll` asks again and again by
`page.evaluate`, which the policy does not bind.
"""

import contextlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from typing import Any, Literal

from playwright.sync_api import Browser, Error, Locator, Page, sync_playwright

# WebGL is rendered in software; what is not WebGL is painted without it, which takes a tenth of the time.
CHROMIUM = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-rasterization",
    "--disable-gpu-compositing",
]
SIZE = {"width": 1440, "height": 900}
SLOW = float(os.environ.get("SPATIALVIZ_CHECK_PATIENCE", "60"))
"""Seconds that something may take to appear; more on a machine that is busy with other things."""
# viser's client always makes the sorter of its Gaussian splats, a WebAssembly module whose glue (Emscripten's embind)
# builds its functions from strings. The page shows no splats, so nothing is missing where that is forbidden.
SORTER = "Evaluating a string as JavaScript violates the following Content Security Policy directive"
DRAWN = """(() => {
  const nodes = document.getElementById('view').contentWindow?.__viserMutable?.nodeRefFromName;
  return !!nodes && Object.keys(nodes).some(name => name.startsWith('/cloud/') && nodes[name]);
})()"""
Scene = Literal["painted", "unpainted", "absent"]
"""Whether a scene is rendered; has its nodes, its camera and its names, but nothing is painted; or is not loaded.

To render it in software takes half of a second of a processor for each picture, and one comes each second.
"""
UNPAINTED = """for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced']) {
  WebGL2RenderingContext.prototype[name] = () => {};
}"""
POLL = """async ([arg, most]) => {
  for (const end = performance.now() + most; performance.now() < end; await new Promise(go => setTimeout(go, 40))) {
    let found = (%s);
    if (typeof found === 'function') found = found(arg);
    if (found = await found) return found;
  }
}"""
ABSENT = "if (location.pathname.includes('/scene/')) stop();"


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
        self.poll(
            "document.getElementById('answer').childElementCount + "
            "document.getElementById('review-list').childElementCount > 0"
            " && document.querySelector('#timeline .frame-id')?.value"
        )
        return self

    def drawn(self) -> "Tab":
        """Wait until viser's client has the scene."""
        self.poll(DRAWN)
        return self

    def poll(self, js: str, arg: Any = None, seconds: float = SLOW) -> Any:
        """What an expression, or a function of `arg`, says as soon as it is true of the page."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                if found := self.page.evaluate(POLL % js, [arg, left * 1000]):
                    return found
            except Error as error:
                # A page that is left takes along what asks it.
                if "context was destroyed" not in error.message:
                    raise
        raise AssertionError(f"never so: {js} {arg or ''}; {self.problems}")

    def still(self, js: str, seconds: float = 0.5) -> Any:
        """What an expression says once it has said the same for so long."""
        end, found, since = time.monotonic() + SLOW, self.page.evaluate(js), time.monotonic()
        while time.monotonic() < since + seconds:
            assert time.monotonic() < end, f"never still: {js}"
            self.page.wait_for_timeout(40)
            if (now := self.page.evaluate(js)) != found:
                found, since = now, time.monotonic()
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
        if self.page.locator("#drawer.closed").count() and not self.page.locator("#drawer:visible").count():
            self.see('#scene-buttons [data-local="tab:Objects"]').click()
        self.see(f'#drawer-tabs [data-local="tab:{name}"]').click()

    @property
    def answered(self) -> str:
        """Names of the answer's card: "mug 3 · laptop 2"."""
        return " · ".join(self.page.locator(".pair-card.of-answer .thing b").all_inner_texts())

    def answers(self, target: str, reference: str = "") -> str:
        """Wait until the answer's card has things of such names."""
        for end, name in (("target", target), ("reference", reference)):
            if name:
                self.see(f".pair-card.of-answer .thing.{end}", name)
        return self.answered

    def send(self, command: str) -> None:
        """Send a command as an element does that is clicked; for those that have none on the page now."""
        self.page.evaluate(
            "command => { const made = document.body.appendChild(document.createElement('button'));"
            " made.dataset.do = command; made.click(); made.remove(); }",
            command,
        )

    def ask(self, text: str) -> None:
        """Type a question and press Enter."""
        self.page.locator("#ask-text").fill(text)
        self.page.locator("#ask-text").press("Enter")

    @property
    def question(self) -> str:
        return self.page.locator("#ask-text").input_value()

    @property
    def frame(self) -> str:
        return self.page.locator("#timeline .frame-id").input_value()

    def other_frame(self, than: str) -> str:
        """The frame that the page is at as soon as that is another one."""
        now = "document.querySelector('#timeline .frame-id')?.value"
        return self.poll(f"was => {now} !== was && {now}", than)

    def press(self, key: str) -> None:
        """Press a key where no field is being typed into."""
        self.page.evaluate("document.activeElement.blur()")
        self.page.keyboard.press(key)

    def closed(self) -> None:
        """Wait until no dialog is open."""
        self.poll("!document.getElementById('dialog-window')")

    def close(self) -> None:
        """Close it, with everything that its browser keeps."""
        self.page.context.close()


OpenTab = Callable[..., Tab]
"""What `open_tab` of conftest.py gives: (address, scene, options of the browser context) -> Tab."""


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    with sync_playwright() as play:
        # The shell is Chromium without windows, each of which costs half of a second. Where there is none, nor another
        # Chromium, the one of `playwright install` is taken.
        found = shutil.which("chromium-headless-shell") or shutil.which("chromium")
        browser = play.chromium.launch(executable_path=found, args=CHROMIUM)
        try:
            yield browser
        finally:
            browser.close()


def new_tab(browser: Browser, scene: Scene = "unpainted", **options: Any) -> Tab:
    """A tab in a context of its own: it shares neither cookies nor what is stored with another one."""
    page = browser.new_context(**({"viewport": SIZE, "color_scheme": "dark"} | options)).new_page()
    if scene != "painted":
        page.add_init_script(UNPAINTED if scene == "unpainted" else ABSENT)
    return Tab(page)
