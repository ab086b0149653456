"""What rooms hand on: each name is loaded from where it is declared, and importing a room loads none of them."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from waiting import LONG_S

from pipeline.system.lazy_exports import declared

ROOT = Path(__file__).resolve().parents[2]
ROOMS = sorted(p.parent.name for p in (ROOT / "pipeline").glob("*/__init__.py"))


@pytest.mark.parametrize("room", ROOMS)
def test_every_name_that_a_room_hands_on_is_one_of_its_own(room: str) -> None:
    package = import_module(f"pipeline.{room}")
    module_of = declared(str(ROOT / "pipeline" / room / "__init__.py"))
    assert module_of
    for name, module in module_of.items():
        assert module.startswith(f"pipeline.{room}.")
        assert getattr(package, name) is getattr(import_module(module), name), name


def test_importing_rooms_loads_none_of_their_modules() -> None:
    # One room has functions of its own, and their modules come with it.
    light = [room for room in ROOMS if room != "relations"]
    code = f"import json, sys\nfor r in {light}: __import__('pipeline.' + r)\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, timeout=LONG_S, check=True)
    loaded = {m for m in json.loads(done.stdout) if m.startswith("pipeline.") and m.count(".") > 1}
    assert loaded == {"pipeline.system.lazy_exports", "pipeline.system.version"}


def test_a_name_that_is_not_declared_is_none() -> None:
    with pytest.raises(AttributeError, match=r"module 'pipeline\.geometry' has no attribute 'nothing'"):
        import_module("pipeline.geometry").nothing  # noqa: B018
    with pytest.raises(ImportError):
        exec("from pipeline.geometry import nothing")
