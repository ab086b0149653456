"""The walls of the house: the core knows no screen, is light to import, and needs only what it declares."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import LONG_S

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted((ROOT / "pipeline").rglob("*.py"))
FORBIDDEN = ("viser", "spatialviz", "torch", "open3d", "scipy", "onnxruntime", "matplotlib", "h5py")

IMPORT_ALL = """
import importlib, json, pkgutil, sys
import pipeline
found = [m.name for m in pkgutil.walk_packages(pipeline.__path__, "pipeline.", onerror=lambda name: 1 / 0)]
for name in found:
    importlib.import_module(name)
print(json.dumps([found, sorted(sys.modules)]))
"""


@pytest.fixture(scope="module")
def imported() -> tuple[list[str], set[str]]:
    """(modules of the core, everything that importing them all brought in), seen by a fresh interpreter."""
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], cwd=ROOT, capture_output=True, text=True, timeout=LONG_S, check=False
    )
    assert done.returncode == 0, done.stderr
    ours, everything = json.loads(done.stdout.splitlines()[-1])
    return ours, set(everything)


def test_all_modules_of_the_core_are_walked(imported: tuple[list[str], set[str]]) -> None:
    files = {
        ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for p in SOURCES
        if p != ROOT / "pipeline" / "__init__.py"
    }
    assert set(imported[0]) == files
    assert {"pipeline.answering.ask", "pipeline.proposals.yolo_seg"} <= files


@pytest.mark.parametrize("library", FORBIDDEN)
def test_importing_the_core_does_not_import(imported: tuple[list[str], set[str]], library: str) -> None:
    assert not {m for m in imported[1] if m == library or m.startswith(library + ".")}


def test_no_module_of_the_core_names_the_screen() -> None:
    screen = re.compile(r"^\s*(?:import|from)\s+(viser|spatialviz)\b|import_module\(\s*['\"](viser|spatialviz)", re.M)
    assert len(SOURCES) > 20
    for path in SOURCES:
        assert not screen.search(path.read_text(encoding="utf-8")), path


def test_tests_exercise_the_core_alone_in_files_that_one_can_read() -> None:
    """What starts the command line, draws for people or needs a browser is tested in `.ci/`."""
    screen = re.compile(r"^\s*(?:import|from)\s+(viser|spatialviz)\b", re.M)
    files = {p: p.read_text(encoding="utf-8") for p in sorted((ROOT / "tests").rglob("*.py"))}
    assert len(files) > 100
    assert [p for p, text in files.items() if screen.search(text)] == []
    assert [p for p, text in files.items() if text.count("\n") > 450] == []


def test_tests_mirror_the_rooms() -> None:
    rooms = {p.parent.name for p in (ROOT / "pipeline").glob("*/__init__.py")}
    folders = {p.parent.name for p in (ROOT / "tests").glob("*/test_*.py")}
    assert folders == rooms


def test_no_machine_path_is_written_into_the_core() -> None:
    machine = re.compile(r"['\"](?:/work|/tmp|/home|/root|/Users)(?:/|['\"])")
    for path in SOURCES:
        assert not machine.search(path.read_text(encoding="utf-8")), path
