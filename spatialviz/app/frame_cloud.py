"""The cloud of the frame in one client's scene: sent with another frame, painted anew with other colours."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from spatialviz.app.frames import LoadedFrame
from spatialviz.app.paint import frame_colors
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_client import SceneClient
from spatialviz.app.state import State

WORDS_SECONDS = 0.05
"""Head start of the words of another frame: with it they are on the screen before the points arrive."""


class FrameCloud:
    """Keeps a client's cloud up to its state.

    Parameters
    ----------
    client : SceneClient
    scene : SceneView
    show_context : callable
        Shows the room around another frame.
    """

    def __init__(self, client: SceneClient, scene: SceneView, show_context: Callable[[], None]) -> None:
        self._client, self._scene, self._show_context = client, scene, show_context
        self._loaded: LoadedFrame | None = None
        self._painted: tuple[Any, ...] = ()
        self.place_anew = False
        """Whether the next frame is seen from its own place, though somebody has turned the view."""

    def clear(self) -> None:
        """Show nothing: the frame is broken."""
        self._loaded = None
        self._scene.clear()

    def follow(self, state: State) -> None:
        """Bring the cloud up to the state; the view is placed anew where it is asked for, or nobody has turned it."""
        loaded = state.loaded
        anew, self.place_anew = self.place_anew or self._scene.viewpoint.untouched, False
        if loaded is None or (loaded is self._loaded and self._painted == state.paint_key):
            return
        colors = frame_colors(state.colors, loaded, state.roles, state.dark)
        self._painted = state.paint_key
        if loaded is self._loaded:
            self._scene.recolor(colors)
            return
        # Words come first: a browser takes longer over the points of a frame than over all the panels.
        self._client.flush()
        time.sleep(WORDS_SECONDS)
        self._loaded = loaded
        self._scene.set_frame(loaded, colors)
        self._show_context()
        if anew:
            self._scene.viewpoint.place(state.camera)
