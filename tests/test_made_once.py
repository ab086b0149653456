"""What is made once for many tests: one making, copies of one's own, and nothing left of what other code made."""

from __future__ import annotations

import shutil
from pathlib import Path

import made_once
import pytest
from made_once import made_once as made


def test_it_is_made_once_and_copied_to_whoever_asks(
    pytestconfig: pytest.Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, times = f"of_{tmp_path.name}", []

    def make(folder: Path) -> None:
        times.append(folder)
        (folder / "a.txt").write_text("as it was made")

    try:
        (made(pytestconfig, name, make, tmp_path / "first") / "a.txt").write_text("changed by its owner")
        assert (made(pytestconfig, name, make, tmp_path / "second") / "a.txt").read_text() == "as it was made"
        assert len(times) == 1
        monkeypatch.setattr(made_once, "source_key", lambda: "of other code")
        made(pytestconfig, name, make, tmp_path / "third")
        assert len(times) == 2
        home = times[0].parent
        assert [p.name for p in home.iterdir() if p.is_dir()] == ["of other code"]
    finally:
        shutil.rmtree(times[0].parent)


def test_the_key_is_of_the_code_that_makes_it() -> None:
    files = (p for pattern in made_once.SOURCES for p in made_once.ROOT.glob(pattern))
    sources = {p.relative_to(made_once.ROOT).as_posix() for p in files}
    assert {"pipeline/labels/labelling.py", "tests/label_sets.py", "tests/shared_fixtures.py"} <= sources
    assert any(name.startswith("assets/srm/") for name in sources)
