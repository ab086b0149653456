"""The runners of faults and of hostile inputs, a few seconds of each: their promises hold, and a broken one is seen."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROBUST = Path(__file__).parents[1] / "robust"


@pytest.mark.parametrize(
    ("runner", "kinds"),
    [
        ("faults.py", "kill-correct,kill-export-run,closed-output"),
        ("fuzz.py", "expression,view,vec,whatif,detections,toml"),
    ],
)
def test_promises_hold(runner: str, kinds: str, tmp_path: Path) -> None:
    words = [sys.executable, ROBUST / runner, "--seconds", "1", "--seed", "1", "--only", kinds, "--json"]
    words += ["--out", tmp_path / "out.json"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((tmp_path / "out.json").read_text())
    assert record["times"] > 0
    assert len(record["kinds"]) >= len(kinds.split(","))


def test_a_broken_promise_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.syspath_prepend(str(ROBUST))
    from promises import NotRun, Tally, promise  # pyright: ignore[reportMissingImports]

    tally = Tally("x", 0)
    with tally.watching("a"):
        promise(True, "kept")
    with tally.watching("b", again="this"):
        promise(False, "nothing is lost", 3)
    with tally.watching("c"):
        raise NotRun("it is not installed")
    assert tally.end(None, as_json=False) == 1
    said = capsys.readouterr().out
    assert "BROKEN b: nothing is lost; got 3" in said
    assert "not run: it is not installed" in said
