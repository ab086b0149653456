"""Data blocks of documents: JSON, TOML and YAML, read by what reads such files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from command_blocks import Block


def wrong_with(block: Block, printed: list[Any] | None) -> str:
    """What is wrong with a block of data; `printed`: the JSON objects of the command of the block above, if any."""
    check = {"json": _json, "toml": _toml, "yaml": _yaml}[block.language]
    try:
        return check(block.text, printed)
    except Exception as error:
        return str(error).splitlines()[0]


def _json(text: str, printed: list[Any] | None) -> str:
    try:
        values = [json.loads(text)]
    except ValueError:
        # A part of an object, or an object a line.
        part = re.match(r'\s*"\w+":', text)
        values = [json.loads(f"{{{text}}}")] if part else [json.loads(line) for line in text.splitlines()]
    for value in values:
        if printed and isinstance(value, dict):
            unlike = [_unlike(value, record) for record in printed]
            if all(unlike):
                return f"the command above prints other keys: {unlike[0]}"
    return ""


def _unlike(shown: dict[str, Any], record: Any) -> str:
    """Keys that only one of both has; a key "..." or "…" stands for all that are left out."""
    known = set(record) if isinstance(record, dict) else set()
    left_out = {"...", "…"} & set(shown)
    return ", ".join(sorted(set(shown) - left_out - known if left_out else set(shown) ^ known))


def _toml(text: str, printed: list[Any] | None) -> str:
    from pipeline.datasets.depth.contract import read_contract
    from pipeline.datasets.settings import FILE_NAME, read_settings
    from pipeline.proposals.box_detector import read_box_model

    folder = Path("toml")
    folder.mkdir(exist_ok=True)
    (folder / FILE_NAME).write_text(text, "utf-8")
    if "[output]" not in text:
        read_settings(folder)
    elif re.search(r"^form = ", text, re.M):
        read_box_model((folder / FILE_NAME).rename("mine.toml"))
    else:
        read_contract((folder / FILE_NAME).rename("own.toml"))
    return ""


def _yaml(text: str, printed: list[Any] | None) -> str:
    """What it says of the action is checked with the action, in `.ci/tests/test_replay_action.py`."""
    import yaml

    yaml.safe_load(text)
    return ""
