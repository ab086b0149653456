"""Detectors and segmenters that other packages add."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.proposals import make_detector, make_segmenter
from pipeline.system import plugins
from pipeline.system.errors import InputError


class Point:
    """An entry point, as far as `load_plugins` looks at one."""

    def __init__(self, name: str, loaded: object) -> None:
        self.name, self.value, self._loaded = name, f"somewhere:{name}", loaded

    def load(self) -> object:
        if isinstance(self._loaded, Exception):
            raise self._loaded
        return self._loaded


@pytest.mark.filterwarnings("ignore:.*is no Callable")
@pytest.mark.parametrize(("what", "make"), [("detector", make_detector), ("segmenter", make_segmenter)])
def test_a_plugin_adds_a_model_and_a_broken_one_takes_nothing_away(
    what: str, make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def ours(request: Any) -> str:
        asked.append(request)
        return "made"

    points = [
        Point("ours", ours),
        Point("broken", ImportError("no module")),
        Point("odd", 3),
        Point("yolo-seg", ours),
    ]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points if group == f"spatialviz.{what}s" else [])
    with pytest.warns(UserWarning, match=f"{what} plugin") as warned:
        assert make("ours") == "made"
    assert [str(w.message) for w in warned] == [
        f"{what} plugin somewhere:broken cannot be loaded: no module",
        f"{what} plugin somewhere:odd is no Callable",
    ]
    assert [request.model for request in asked] == [None]
    # A plugin does not take the place of what is built in.
    with pytest.raises(InputError, match="needs"):
        make("yolo-seg")
    with pytest.warns(UserWarning, match="no module"), pytest.raises(InputError, match=f"no {what} 'broken'.*ours"):
        make("broken")
