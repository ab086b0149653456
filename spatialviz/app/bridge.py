"""From HTML in viser's panels back to Python: rows, chips, bars and pictures that can be clicked.

viser's HTML element shows content but reports no clicks. One hidden text input
serves as a bus: `sv('pair:3')` in the page sends its value, and `on_message` runs.
This leans on two internals of viser 1.1 (`window.__viserMutable.sendMessage` and the
uuid of a handle), which is why viser is pinned to that minor version, and why the
page says hello: where no hello comes, plain viser widgets take over.
"""

from __future__ import annotations

import html
import json
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from weakref import WeakSet

import viser

from spatialviz.app.beside_style import BESIDE_CSS
from spatialviz.app.label_object_style import OBJECT_CSS, OBJECT_SCRIPT
from spatialviz.app.label_style import LABEL_CSS
from spatialviz.app.pixels_script import PIXELS_SCRIPT
from spatialviz.app.pixels_style import PIXELS_CSS
from spatialviz.app.run_style import FIELD_SCRIPT, RUN_CSS
from spatialviz.app.sentences_style import SENTENCES_CSS, SENTENCES_SCRIPT
from spatialviz.app.style import CSS, SCRIPT

HELLO = "hello"
CALLED = ("svOverlay", "svOffer", "svFocusClass", "svNumbers")
"""Functions of the page that change a part of it where sending all of it again would be slow, or lose the focus."""
HELLO_SECONDS = 12.0


def script_html(script: str, number: int = 0) -> str:
    """HTML that runs JavaScript when it is mounted; where the same is to run again, the number tells them apart."""
    return f'<img src="" style="display:none" data-n="{number}" onerror="{html.escape(script, quote=True)}">'


def call_script(function: str, data: object) -> str:
    """JavaScript that calls a function of the page, where it is there, with what can be JSON."""
    return f"window.{function}&&{function}({json.dumps(data)})"


def call_html(function: str, data: object) -> str:
    """HTML that calls a function of the page when it is mounted."""
    return script_html(call_script(function, data))


@dataclass(frozen=True)
class Tag:
    """A coloured name that follows a node of the scene.

    Attributes
    ----------
    node : str
        Scene node.
    text, detail : str
    color : str
        "#rrggbb".
    strong : bool
    """

    node: str
    text: str
    detail: str
    color: str
    strong: bool


class Bridge:
    """The bus of one client. Messages are handled one at a time, in order, off viser's event loop."""

    def __init__(self, client: viser.ClientHandle, on_message: Callable[[str], None]) -> None:
        self._client = client
        self._on_message = on_message
        self._queue: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self.alive = threading.Event()
        self._tags: viser.GuiHtmlHandle | None = None
        self._shown_tags = ""
        self._memory: viser.GuiHtmlHandle | None = None
        self._errands: dict[str, viser.GuiHtmlHandle] = {}
        self._run = 0
        self._ended = False
        self._thread = threading.Thread(target=self._work, daemon=True, name=f"session-{client.client_id}")

    def install(self) -> None:
        """Put the bus, the style and the script into the page. Call inside the main panel."""
        gui = self._client.gui
        bus = gui.add_text("bus", "", visible=False)
        uuid = bus._impl.uuid
        parts = (SCRIPT.replace("BUS_UUID", uuid), FIELD_SCRIPT, PIXELS_SCRIPT, SENTENCES_SCRIPT, OBJECT_SCRIPT)
        script = script_html(";".join(parts).replace("\n", " "))
        styles = "".join((CSS, RUN_CSS, LABEL_CSS, PIXELS_CSS, SENTENCES_CSS, OBJECT_CSS, BESIDE_CSS))
        gui.add_html(styles + script, order=-1000)
        self._tags = gui.add_html("", order=1000)
        self._memory = gui.add_html("", order=1001)
        self._errands = {name: gui.add_html("", order=1002) for name in ("", *CALLED)}

        @bus.on_update
        async def _(event: viser.GuiEvent) -> None:
            message = str(bus.value).rsplit("#", 1)[0]
            if message.startswith(HELLO):
                # The page says hello again whenever its HTML is mounted anew.
                if not self.alive.is_set():
                    self.alive.set()
                    self.post(lambda: self._on_message(message))
            else:
                self.post(lambda: self._on_message(message))

    def start(self) -> None:
        """Begin to handle messages. The page may say hello while it is still being built; until now that waits."""
        self._thread.start()
        _STARTED.add(self)

    def post(self, job: Callable[[], None]) -> None:
        """Run something after everything that waits already."""
        self._queue.put(job)

    def close(self) -> None:
        self._queue.put(None)

    def end(self, until: float) -> None:
        """Finish what is being handled, at the latest at this time of the monotonic clock, and nothing that waits."""
        self._ended = True
        self.close()
        self._thread.join(max(0.0, until - time.monotonic()))

    def show_tags(self, tags: Sequence[Tag]) -> None:
        """Show these names in the scene, and no others."""
        shown = call_html("svTags", [asdict(t) for t in tags])
        if self._tags is None or shown == self._shown_tags:
            return
        self._shown_tags = self._tags.content = shown

    def call(self, name: str, data: object) -> None:
        """Call a function of the page, one of `CALLED`, with what can be JSON."""
        self.run_in_page(call_script(name, data), name)

    def run_in_page(self, script: str, errand: str = "") -> None:
        """Run JavaScript in the page, once; of those of one errand that wait to be run, only the last."""
        if errand in self._errands and self.alive.is_set():
            self._run += 1
            self._errands[errand].content = script_html(script, self._run)

    def remember(self, place: str) -> None:
        """Have the browser's tab keep a place; its next hello says it again. Waits until the page has said hello."""
        if self._memory is not None and self.alive.is_set():
            self._memory.content = script_html(f"sessionStorage.setItem('sv',{json.dumps(place)})")

    def _work(self) -> None:
        while (job := self._queue.get()) is not None and not self._ended:
            try:
                job()
            except Exception as error:  # One failed click must not end the session.
                self._client.add_notification(
                    "Something went wrong", html.escape(f"{type(error).__name__}: {error}"), color="red"
                )


_STARTED: WeakSet[Bridge] = WeakSet()


def end_all(seconds: float) -> None:
    """End the threads of all clients within so long: DuckDB prints its leaks where one is cut off in a query."""
    until = time.monotonic() + seconds
    for bridge in list(_STARTED):
        bridge.end(until)
