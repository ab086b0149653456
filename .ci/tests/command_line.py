"""The command line, in the process of the tests: what a command prints, and the status with which it ends."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from spatialviz.cli import main

Folder = pytest.TempPathFactory


@dataclass(frozen=True)
class Printed:
    """What a command printed."""

    out: str
    err: str

    @property
    def records(self) -> list[dict[str, Any]]:
        """The JSON objects, one a line."""
        return [json.loads(line) for line in self.out.splitlines()]

    @property
    def record(self) -> dict[str, Any]:
        """The only one."""
        (record,) = self.records
        return record


def spatialviz(status: int, *words: object) -> Printed:
    """Run a command that must end with this status: without a traceback, and where it is 2 with one line of error."""
    printed = _run(status, words)
    assert status != 2 or printed.err.count("spatialviz: error:") == 1, printed.err
    if "--json" in words and status != 2:
        assert printed.records, "--json printed nothing"
    return printed


def misused(*words: object) -> Printed:
    """Run a command whose words are refused by their usage, or by several lines: status 2, without a traceback."""
    return _run(2, words)


def _run(status: int, words: tuple[object, ...]) -> Printed:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            ended: Any = main([str(word) for word in words])
        except SystemExit as left:
            ended = left.code
    printed = Printed(out.getvalue(), err.getvalue())
    assert ended == status, printed
    assert "Traceback" not in printed.out + printed.err
    return printed


def label_three_frames(folder: Path) -> Path:
    """Labels of the demo's first three frames, as the command makes them."""
    spatialviz(0, "label", "demo", "--out", folder, "--limit", 3, "--workers", 1)
    return folder


def replaced(file: Path, old: str, new: str) -> None:
    """Write other words into a file in place of some that stand there."""
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
