"""Detectors and segmenters that other packages add."""

from __future__ import annotations

import os
import shutil
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from pipeline.proposals import make_detector, make_segmenter
from pipeline.system import InputError, plugins


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


def test_what_is_installed_while_running_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is installed is read once, until a folder of the search path changes."""
    read: list[str] = []

    def counted(group: str) -> Any:
        read.append(group)
        return found(group=group)

    found = metadata.entry_points
    monkeypatch.setattr(metadata, "entry_points", counted)
    monkeypatch.syspath_prepend(tmp_path)

    def names() -> list[str]:
        return [point.name for point in plugins.entry_points("spatialviz.tested")]

    def changed(when: int) -> None:
        """Clocks of file systems tick slowly: two changes may be of one time."""
        os.utime(tmp_path, (when, when))

    changed(1)
    assert names() == names() == []
    package = tmp_path / "ours-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: ours\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[spatialviz.tested]\nmine = somewhere:made\n")
    changed(2)
    assert names() == names() == ["mine"]
    shutil.rmtree(package)
    changed(3)
    assert names() == []
    assert read == ["spatialviz.tested"] * 3
