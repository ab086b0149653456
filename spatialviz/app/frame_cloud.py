"""The cloud of the frame in one client's scene: sent with another frame, painted anew with other colours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spatialviz.app.frames import LoadedFrame
from spatialviz.app.paint import frame_colors
from spatialviz.app.scene import SceneView
from spatialviz.app.state import State


class FrameCloud:
    """Keeps a client's cloud up to its state.

    Parameters
    ----------
    scene : SceneView
    show_context : callable
        Shows the room around another frame.
    post : callable
        Runs something after whatever the user does meanwhile.
    """

    def __init__(
        self, scene: SceneView, show_context: Callable[[], None], post: Callable[[Callable[[], None]], None]
    ) -> None:
        self._scene, self._show_context, self._post = scene, show_context, post
        self._loaded: LoadedFrame | None = None
        self._painted: tuple[Any, ...] = ()
        self._colors = np.zeros((0, 0, 3), np.uint8)
        self.place_anew = False
        """Whether the next frame is seen from its own place, though somebody has turned the view."""

    def clear(self) -> None:
        """Show nothing: the frame is broken."""
        self._loaded, self._colors = None, np.zeros((0, 0, 3), np.uint8)
        self._scene.clear()

    def follow(self, state: State) -> None:
        """Bring the cloud up to the state; the view is placed anew where it is asked for, or nobody has turned it."""
        loaded = state.loaded
        anew, self.place_anew = self.place_anew or self._scene.viewpoint.untouched, False
        if loaded is None or (loaded is self._loaded and self._painted == state.paint_key):
            return
        self._colors = colors = frame_colors(state.colors, loaded, state.roles, state.dark)
        self._painted = state.paint_key
        if loaded is self._loaded:
            self._scene.recolor(colors)
            return
        self._loaded = loaded
        self._scene.set_frame(loaded, colors)
        self._show_context()
        if anew:
            self._scene.viewpoint.place(state.camera)
        self._post(lambda: self._complete(state))

    def _complete(self, state: State) -> None:
        """Send the rest of a frame's cloud, unless another one is shown already."""
        loaded = state.loaded
        if loaded is not None and loaded is self._loaded:
            self._scene.complete(self._colors)
