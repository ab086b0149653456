"""viser's client of one page's scene. What is put into it stands until it is removed, also where the browser's
frame is not there yet, or has gone and comes back."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any

import numpy as np
import viser

from pipeline.geometry.palette import RGB

CAMERA = ("up_direction", "position", "look_at", "fov")
UNTURNED = {"aspect": 1.3, "fov": 0.8, **dict.fromkeys(CAMERA[:3], (0.0, 0.0, 0.0))}
"""What is said of a camera that no browser has yet."""


class Retained:
    """Stands for a handle of viser: has its values and callbacks, and passes both on while the handle is there.

    Parameters
    ----------
    values : dict
        What it has been given.
    unset : dict
        What it says of other values meanwhile.
    kept : tuple of str
        Values that a person may change in the browser.
    """

    def __init__(self, values: dict[str, Any], unset: dict[str, Any], kept: tuple[str, ...]) -> None:
        vars(self).update(values=values, _unset=unset, _kept=kept, _callbacks=[], handle=None)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("on_"):
            return partial(self._listen, name)
        return {**self._unset, **self.values}[name] if self.handle is None else getattr(self.handle, name)

    def __setattr__(self, name: str, value: Any) -> None:
        self.values[name] = value
        if self.handle is not None:
            setattr(self.handle, name, value)

    def _listen(self, event: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        self._callbacks.append((event, callback))
        if self.handle is not None:
            getattr(self.handle, event)(callback)
        return callback

    def show(self, handle: Any, names: Iterable[str]) -> None:
        """Stand for a handle, which takes the values of these names."""
        for name in names:
            setattr(handle, name, self.values[name])
        for event, callback in self._callbacks:
            getattr(handle, event)(callback)
        vars(self)["handle"] = handle

    def keep(self) -> None:
        """Remember what a person has changed; the handle has gone."""
        for name in self._kept:
            self.values[name] = getattr(self.handle, name)
        vars(self)["handle"] = None


class Node(Retained):
    """A node of the scene."""

    def __init__(self, owner: RetainedScene, make: str, values: dict[str, Any]) -> None:
        super().__init__(values, {}, ("position", "wxyz") if make == "add_transform_controls" else ())
        vars(self).update(_owner=owner, _make=make)

    def attach(self, scene: Any) -> None:
        """Stand in a scene."""
        make = getattr(scene, self._make)
        taken = {k: v for k, v in self.values.items() if k in inspect.signature(make).parameters}
        self.show(make(**taken), self.values.keys() - taken.keys())

    def remove(self) -> None:
        """Stand no longer."""
        self._owner.nodes.pop(self.values["name"], None)
        if self.handle is not None:
            self.handle.remove()
        vars(self)["handle"] = None


class RetainedScene:
    """The scene: viser's `add_…` methods, whose nodes are kept by their names."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self.shown: Any = None

    def __getattr__(self, make: str) -> Callable[..., Node]:
        return partial(self._add, make, inspect.signature(getattr(viser.SceneApi, make)))

    def _add(self, make: str, signature: inspect.Signature, *args: Any, **kwargs: Any) -> Node:
        bound = signature.bind(None, *args, **kwargs)
        bound.apply_defaults()
        values = {k: v for k, v in bound.arguments.items() if k not in ("self", "_deprecated_kwargs")}
        node = self.nodes[values["name"]] = Node(self, make, values)
        if self.shown is not None:
            node.attach(self.shown)
        return node


class SceneClient:
    """Stands for a `viser.ClientHandle`: `scene`, `camera`, `atomic`, `flush`."""

    def __init__(self) -> None:
        self.scene, self.camera = RetainedScene(), Retained({}, UNTURNED, CAMERA)
        self._clicks: list[Callable[[Any], Any]] = []
        self._client: viser.ClientHandle | None = None
        self._dark = True
        self._lock = threading.RLock()

    def attach(self, client: viser.ClientHandle) -> None:
        """Show everything to a browser's frame, seen from where it was seen last."""
        with self._lock:
            self.detach()
            for callback in self._clicks:
                client.scene.on_click()(callback)
            self.camera.show(client.camera, [name for name in CAMERA if name in self.camera.values])
            self._client = client
            self.set_dark(self._dark)
            with client.atomic():
                for node in list(self.scene.nodes.values()):
                    node.attach(client.scene)
            self.scene.shown = client.scene

    def detach(self, client: viser.ClientHandle | None = None) -> None:
        """The browser's frame has gone; another one may come."""
        with self._lock:
            if self._client is None or client not in (None, self._client):
                return
            for retained in (self.camera, *self.scene.nodes.values()):
                retained.keep()
            self._client = self.scene.shown = None

    def on_click(self, callback: Callable[[Any], Any]) -> None:
        """Have a click in the scene call this; to be said before a browser shows it."""
        self._clicks.append(callback)

    def set_dark(self, dark: bool) -> None:
        """A dark ground, or a light one; viser's own panels, logo and share button are never shown."""
        self._dark = dark
        if self._client is not None:
            self._client.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def lines(self, name: str, points: np.ndarray, color: RGB | np.ndarray, width: float) -> None:
        """Show segments ((N, 2, 3), metres) of a name, in a colour or one for each end; made once, and then changed."""
        node = self.scene.nodes.get(name)
        if node is not None and isinstance(color, np.ndarray) and len(node.points) != len(points):
            node.remove()
            node = None
        if node is not None:
            node.visible = bool(len(points))
        if len(points) and node is not None:
            node.points, node.colors = points, np.asarray(color, np.uint8)
        elif len(points):
            self.scene.add_line_segments(name, points, color, thickness=width, thickness_units="screen")

    def anchor(self, name: str, position: np.ndarray) -> str:
        """Put a point of a name, which a tag may follow, somewhere; returns its name."""
        if name in self.scene.nodes:
            self.scene.nodes[name].position = triple(position)
        else:
            self.scene.add_frame(name, show_axes=False, position=triple(position))
        return name

    def clear(self, root: str) -> None:
        """Remove the nodes whose names begin so."""
        for name in [name for name in self.scene.nodes if name.startswith(root)]:
            self.scene.nodes[name].remove()

    def atomic(self) -> AbstractContextManager[None]:
        """As viser's."""
        return nullcontext() if self._client is None else self._client.atomic()

    def flush(self) -> None:
        """As viser's."""
        if self._client is not None:
            self._client.flush()


def triple(v: np.ndarray) -> tuple[float, float, float]:
    """A vector as viser and JSON take it."""
    return float(v[0]), float(v[1]), float(v[2])
