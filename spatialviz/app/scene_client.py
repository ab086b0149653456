"""Scene client on viser: nodes stay until removed, also before a browser connects or after a reconnect."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any

import numpy as np
import viser

from pipeline.geometry.palette import RGB

CAMERA = ("up_direction", "position", "look_at", "fov")
UNTURNED = {"aspect": 1.3, "fov": 0.8, **dict.fromkeys(CAMERA[:3], (0.0, 0.0, 0.0))}
"""Camera values without a browser."""


class Retained:
    """Stand-in for a handle of viser, keeping values and callbacks, forwarded while the handle exists."""

    def __init__(self, values: dict[str, Any], unset: dict[str, Any], kept: tuple[str, ...]) -> None:
        # `unset` are values of a missing handle, `kept` names of values changeable in the browser.
        vars(self).update(values=values, _unset=unset, _kept=kept, _callbacks=[], handle=None)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("on_"):
            return partial(self._listen, name)
        return {**self._unset, **self.values}[name] if self.handle is None else getattr(self.handle, name)

    def __setattr__(self, name: str, value: Any) -> None:
        self.values[name] = value
        if self.handle is not None:
            setattr(self.handle, name, value)

    def change(self, **values: Any) -> None:
        """Set only differing values; viser sends every assignment."""
        for name, value in values.items():
            if not np.array_equal(getattr(self, name), value):
                setattr(self, name, value)

    def _listen(self, event: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        self._callbacks.append((event, callback))
        if self.handle is not None:
            getattr(self.handle, event)(callback)
        return callback

    def show(self, handle: Any) -> None:
        """Attach a handle."""
        for event, callback in self._callbacks:
            getattr(handle, event)(callback)
        vars(self)["handle"] = handle

    def keep(self) -> None:
        """Save the values changed by a person, after loss of the handle."""
        for name in self._kept:
            self.values[name] = getattr(self.handle, name)
        vars(self)["handle"] = None


class SceneClient:
    """Stand-in for a `viser.ClientHandle`: `camera`, `atomic`, `flush`, and the nodes of the scene by name."""

    def __init__(self) -> None:
        self.nodes: dict[str, Retained] = {}
        self.camera = Retained({}, UNTURNED, CAMERA)
        self._made_by: dict[str, str] = {}
        self._drawn: dict[str, object] = {}
        self._clicks: list[Callable[[Any], Any]] = []
        self._client: viser.ClientHandle | None = None
        self._dark = True
        self._lock = threading.RLock()

    def attach(self, client: viser.ClientHandle) -> None:
        """Send everything to a browser's frame, seen from the last view."""
        with self._lock:
            self.detach()
            for callback in self._clicks:
                client.scene.on_click()(callback)
            for name in CAMERA:
                if name in self.camera.values:
                    setattr(client.camera, name, self.camera.values[name])
            self.camera.show(client.camera)
            self._client = client
            self.set_dark(self._dark)
            with client.atomic():
                for name in self.nodes:
                    self._stand(name, client)

    def detach(self, client: viser.ClientHandle | None = None) -> None:
        """Release the browser's frame; another may come."""
        with self._lock:
            if self._client is None or client not in (None, self._client):
                return
            for retained in (self.camera, *self.nodes.values()):
                retained.keep()
            self._client = None

    def _stand(self, name: str, client: viser.ClientHandle) -> None:
        node = self.nodes[name]
        node.show(getattr(client.scene, f"add_{self._made_by[name]}")(**node.values))

    def copy_to(self, scene: viser.SceneApi) -> None:
        """Make all nodes in a scene that nobody changes any more."""
        for name, node in self.nodes.items():
            getattr(scene, f"add_{self._made_by[name]}")(**node.values)

    def on_click(self, callback: Callable[[Any], Any]) -> None:
        """Register the callback of clicks in the scene, before a browser shows it."""
        self._clicks.append(callback)

    def set_dark(self, dark: bool) -> None:
        """Set a dark or a light ground; viser's own panels, logo and share button stay hidden."""
        self._dark = dark
        if self._client is not None:
            self._client.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def put(self, kind: str, name: str, **values: Any) -> Retained:
        """Make or change a named node by the values of viser's `add_KIND`."""
        if name in self.nodes:
            self.nodes[name].change(**values)
        else:
            kept = ("position", "wxyz") if kind == "transform_controls" else ()
            self.nodes[name], self._made_by[name] = Retained({"name": name, **values}, {}, kept), kind
            if self._client is not None:
                self._stand(name, self._client)
        return self.nodes[name]

    def change(self, name: str, **values: Any) -> None:
        """Change the node of a name, if present."""
        if name in self.nodes:
            self.nodes[name].change(**values)

    def lines(self, name: str, points: np.ndarray, color: RGB | np.ndarray, width: float) -> None:
        """Show named segments ((N, 2, 3), metres), in a colour or a colour for each end; none are hidden."""
        colors, node = np.asarray(color, np.uint8), self.nodes.get(name)
        if node is not None and colors.ndim > 1 and len(node.points) != len(points):
            self.clear(name)
        if len(points):
            how = {"thickness": width, "thickness_units": "screen", "visible": True}
            self.put("line_segments", name, points=points, colors=colors, **how)
        else:
            self.change(name, visible=False)

    def anchor(self, name: str, position: np.ndarray) -> str:
        """Place a named point, as an anchor of tags; returns the node's name."""
        self.put("frame", name, show_axes=False, position=triple(position))
        return name

    def clear(self, root: str) -> None:
        """Remove the nodes with a prefix."""
        for name in [name for name in self.nodes if name.startswith(root)]:
            node = self.nodes.pop(name)
            if node.handle is not None:
                node.handle.remove()

    def outdated(self, root: str, key: object) -> bool:
        """True, with the nodes removed, if the nodes with a prefix were drawn for another key."""
        if self._drawn.get(root) == key:
            return False
        self.clear(root)
        self._drawn[root] = key
        return True

    def atomic(self) -> AbstractContextManager[None]:
        return nullcontext() if self._client is None else self._client.atomic()

    def flush(self) -> None:
        if self._client is not None:
            self._client.flush()


def triple(v: np.ndarray) -> tuple[float, float, float]:
    """Vector as a tuple, for viser and JSON."""
    return float(v[0]), float(v[1]), float(v[2])
