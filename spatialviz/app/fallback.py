"""Plain viser widgets for what the HTML bridge does, shown only where the bridge does not answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from spatialviz.app.left import CAMERAS, COLORS
from spatialviz.app.state import State


class Fallback:
    """A folder with dropdowns for pairs, objects, colours and the camera."""

    def __init__(self, client: viser.ClientHandle, handle: Callable[[str], None]) -> None:
        self._client = client
        self._handle = handle
        self._pair: viser.GuiDropdownHandle[Any] | None = None
        self._object: viser.GuiDropdownHandle[Any] | None = None

    def show(self, state: State) -> None:
        """Build the widgets."""
        gui = self._client.gui
        with gui.add_folder("Without clickable lists"):
            gui.add_markdown("Lists on this page do not report clicks in this browser; use these instead.")
            pair: viser.GuiDropdownHandle[Any] = gui.add_dropdown("Pair", ("–",))
            object_: viser.GuiDropdownHandle[Any] = gui.add_dropdown("Object", ("–",))
            paint = gui.add_dropdown("Paint", tuple(COLORS))
            camera = gui.add_dropdown("From", tuple(CAMERAS))
        self._pair, self._object = pair, object_
        self._forward(pair, "pair")
        self._forward(object_, "object")
        self._forward(paint, "color")
        self._forward(camera, "camera")
        self.update(state)

    def _forward(self, box: viser.GuiDropdownHandle[Any], kind: str) -> None:
        @box.on_update
        async def _(event: viser.GuiEvent) -> None:
            # Lists that Python fills call back without a client; only a person's choice counts.
            if event.client_id is not None:
                self._handle(f"{kind}:{str(box.value).split('.')[0]}")

    def update(self, state: State) -> None:
        """Bring the lists up to the state."""
        if self._pair is None or self._object is None:
            return
        names = state.shown.names
        pairs = tuple(
            f"{i}. {names[a]} | {names[b]} {p.probability:.2f}"
            for i, p in enumerate(state.ranked)
            for a, b in [state.at(p)[:2]]
        )
        self._pair.options = pairs or ("–",)
        self._object.options = tuple(f"{i}. {n}" for i, n in enumerate(names)) or ("–",)
