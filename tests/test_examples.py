"""Examples in the docstrings of `pipeline` run and print what stands below them."""

import doctest
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import LONG_S

ROOT = Path(__file__).resolve().parent.parent
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in ROOT.glob("pipeline/**/*.py")
    if ">>>" in path.read_text("utf-8")
)


@pytest.mark.parametrize("name", MODULES)
def test_a_copied_example_prints_what_its_docstring_says(name: str) -> None:
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted, f"the examples of {name} stand where nobody's help() or doctest finds them"
    assert not result.failed, f"{result.failed} lines of the examples of {name} print something else (shown above)"


def test_examples_import_neither_torch_nor_open3d() -> None:
    code = "import importlib, json, sys; [importlib.import_module(m) for m in {}]; print(json.dumps([*sys.modules]))"
    done = subprocess.run(
        [sys.executable, "-c", code.format(MODULES)], cwd=ROOT, capture_output=True, text=True, timeout=LONG_S
    )
    assert not {"torch", "open3d"} & set(json.loads(done.stdout))
