"""viser's client of one page's scene. What is put into it stands until it is removed, also where the browser's
frame is not there yet, or has gone and comes back."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import viser

from pipeline.geometry.palette import RGB

CAMERA = ("up_direction", "position", "look_at", "fov")


class Node:
    """A node of the scene, with the attributes and callbacks of viser's handle."""

    def __init__(self, owner: RetainedScene, make: str, values: dict[str, Any]) -> None:
        vars(self).update(_owner=owner, _make=make, _values=values, _callbacks=[], _handle=None)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("on_"):

            def listen(callback: Callable[..., Any]) -> Callable[..., Any]:
                self._callbacks.append((name, callback))
                if self._handle is not None:
                    getattr(self._handle, name)(callback)
                return callback

            return listen
        return self._values[name] if self._handle is None else getattr(self._handle, name)

    def __setattr__(self, name: str, value: Any) -> None:
        self._values[name] = value
        if self._handle is not None:
            setattr(self._handle, name, value)

    def attach(self, scene: Any) -> None:
        """Stand in a scene."""
        make = getattr(scene, self._make)
        taken = {k: v for k, v in self._values.items() if k in inspect.signature(make).parameters}
        handle = make(**taken)
        for name in self._values.keys() - taken.keys():
            setattr(handle, name, self._values[name])
        for name, callback in self._callbacks:
            getattr(handle, name)(callback)
        vars(self)["_handle"] = handle

    def keep(self) -> None:
        """Remember where a person has moved it; the scene has gone."""
        for name in ("position", "wxyz") if self._make == "add_transform_controls" else ():
            self._values[name] = getattr(self._handle, name)
        vars(self)["_handle"] = None

    def remove(self) -> None:
        """Stand no longer."""
        self._owner.nodes.pop(self._values["name"], None)
        if self._handle is not None:
            self._handle.remove()
        vars(self)["_handle"] = None


class RetainedScene:
    """The scene: viser's `add_…` methods, whose nodes are kept by their names."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self.clicks: list[Callable[[Any], Any]] = []
        self.shown: Any = None

    def __getattr__(self, make: str) -> Callable[..., Node]:
        signature = inspect.signature(getattr(viser.SceneApi, make))

        def add(*args: Any, **kwargs: Any) -> Node:
            bound = signature.bind(None, *args, **kwargs)
            bound.apply_defaults()
            values = {k: v for k, v in bound.arguments.items() if k not in ("self", "_deprecated_kwargs")}
            node = self.nodes[values["name"]] = Node(self, make, values)
            if self.shown is not None:
                node.attach(self.shown)
            return node

        return add

    def on_click(self) -> Callable[[Callable[[Any], Any]], Callable[[Any], Any]]:
        """As viser's."""

        def listen(callback: Callable[[Any], Any]) -> Callable[[Any], Any]:
            self.clicks.append(callback)
            return callback

        return listen


class RetainedCamera:
    """The camera, which stays where it was turned to."""

    def __init__(self) -> None:
        vars(self).update(values={}, callbacks=[], shown=None)

    def __getattr__(self, name: str) -> Any:
        if self.shown is not None:
            return getattr(self.shown, name)
        return self.values.get(name, {"aspect": 1.3, "fov": 0.8}.get(name, (0.0, 0.0, 0.0)))

    def __setattr__(self, name: str, value: Any) -> None:
        self.values[name] = value
        if self.shown is not None:
            setattr(self.shown, name, value)

    def on_update(self, callback: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """As viser's."""
        self.callbacks.append(callback)
        return callback


class SceneClient:
    """Stands for a `viser.ClientHandle`: `scene`, `camera`, `atomic`, `flush`."""

    def __init__(self) -> None:
        self.scene, self.camera = RetainedScene(), RetainedCamera()
        self._client: viser.ClientHandle | None = None
        self._dark = True
        self._lock = threading.RLock()

    @property
    def attached(self) -> bool:
        """Whether a browser shows it."""
        return self._client is not None

    def attach(self, client: viser.ClientHandle) -> None:
        """Show everything to a browser's frame, seen from where it was seen last."""
        with self._lock:
            self.detach()
            for callback in self.scene.clicks:
                client.scene.on_click()(callback)
            for name in CAMERA:
                if name in self.camera.values:
                    setattr(client.camera, name, self.camera.values[name])
            for callback in self.camera.callbacks:
                client.camera.on_update(callback)
            self._client = client
            self.set_dark(self._dark)
            vars(self.camera)["shown"] = client.camera
            with client.atomic():
                for node in list(self.scene.nodes.values()):
                    node.attach(client.scene)
            self.scene.shown = client.scene

    def detach(self, client: viser.ClientHandle | None = None) -> None:
        """The browser's frame has gone; another one may come."""
        with self._lock:
            if self._client is None or client not in (None, self._client):
                return
            for name in CAMERA:
                self.camera.values[name] = getattr(self._client.camera, name)
            self._client = self.scene.shown = vars(self.camera)["shown"] = None
            for node in self.scene.nodes.values():
                node.keep()

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
            if len(points):
                node.points, node.colors = points, np.asarray(color, np.uint8)
        elif len(points):
            self.scene.add_line_segments(name, points, color, thickness=width, thickness_units="screen")

    def anchor(self, name: str, position: np.ndarray) -> str:
        """Put a point of a name, which a tag may follow, somewhere; returns its name."""
        node = self.scene.nodes.get(name)
        if node is None:
            self.scene.add_frame(name, show_axes=False, position=triple(position))
        else:
            node.position = triple(position)
        return name

    def clear(self, root: str) -> None:
        """Remove the nodes whose names begin so."""
        for name in [name for name in self.scene.nodes if name.startswith(root)]:
            self.scene.nodes[name].remove()

    @contextmanager
    def atomic(self) -> Iterator[None]:
        """As viser's."""
        client = self._client
        if client is None:
            yield
        else:
            with client.atomic():
                yield

    def flush(self) -> None:
        """As viser's."""
        if self._client is not None:
            self._client.flush()


def triple(v: np.ndarray) -> tuple[float, float, float]:
    """A vector as viser and JSON take it."""
    return float(v[0]), float(v[1]), float(v[2])
