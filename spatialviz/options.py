"""What several commands share: numbers given as text, and printing for machines."""

from __future__ import annotations

import json
import sys
import warnings
from typing import TextIO

from pipeline.system.errors import InputError
from pipeline.system.execution import ProviderWarning


def print_json(record: dict) -> None:
    """One JSON object on a line."""
    print(json.dumps(record, ensure_ascii=False, allow_nan=False))


def one_line_warnings() -> None:
    """What computes in place of what was asked for is told in a line, without the place in the code."""
    shown = warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, ProviderWarning):
            print(f"spatialviz: {message}", file=sys.stderr)
        else:
            shown(message, category, filename, lineno, file, line)

    warnings.showwarning = show


def warn_skipped(frame_id: str, reason: str) -> None:
    """Tell of a frame that is left out."""
    print(f"spatialviz: skipped frame {frame_id}: {reason}", file=sys.stderr)


def four_numbers(text: str | None) -> tuple[float, float, float, float] | None:
    """fx,fy,cx,cy."""
    if text is None:
        return None
    try:
        fx, fy, cx, cy = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError("--intrinsics must be four numbers", got=repr(text), expected="fx,fy,cx,cy") from None
    return fx, fy, cx, cy


def task_of(text: str | None) -> tuple[int, int] | None:
    """k/N, both from 1."""
    if text is None:
        return None
    try:
        k, n = (int(part) for part in text.split("/"))
    except ValueError:
        raise InputError("--shard must be two numbers", got=repr(text), expected="k/N, such as 1/8") from None
    if not 1 <= k <= n:
        raise InputError("no such shard", got=text, expected=f"1/{max(n, 1)} to {max(n, 1)}/{max(n, 1)}")
    return k, n
