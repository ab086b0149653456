"""The rooms of the core and their order: a room imports only rooms below it, and nothing runs in a circle."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import packages_distributions

from import_graph import ROOT, Imports, circles, imported, imports_of, modules

ROOMS = (
    "system",
    "geometry",
    "language",
    "metrics",
    "datasets",
    "synthetic",
    "proposals",
    "relations",
    "answering",
    "drawing",
    "scenes",
    "labels",
    "training",
    "diagnosis",
    "evaluation",
    "pictures",
    "corrections",
    "audit",
    "paper",
    "bench",
)
"""From the ground up."""


def core() -> dict[str, Imports]:
    """Every module of the core; read when the first test asks for it, and not at collection."""
    return modules("pipeline")


def packages(nodes: list[ast.Import | ast.ImportFrom]) -> Iterator[str]:
    """Top-level names of what these import."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (a.name.split(".")[0] for a in node.names)
        elif node.module and not node.level:
            yield node.module.split(".")[0]


def room(module: str) -> str:
    """ "geometry" of "pipeline.geometry.boxes"; "" of the package itself."""
    return module.split(".")[1] if "." in module else ""


def test_only_the_package_itself_stands_outside_the_rooms() -> None:
    folder = ROOT / "pipeline"
    assert [p.name for p in folder.glob("*.py")] == ["__init__.py"]
    assert {p.name for p in folder.iterdir() if (p / "__init__.py").exists()} == set(ROOMS)


def test_a_room_imports_only_rooms_below_it() -> None:
    upwards = [
        f"{name}:{line} imports {target}"
        for name, found in core().items()
        if name != "pipeline"
        for target, line in imported(found.everywhere, core())
        if room(target) and ROOMS.index(room(target)) > ROOMS.index(room(name))
    ]
    assert not upwards


def test_no_imports_run_in_a_circle() -> None:
    """Neither at the top nor within functions, for types, or by the name of a module."""
    assert circles(core(), without=("pipeline",)) == set()


def test_circles_are_found_however_they_are_hidden() -> None:
    sources = {
        "a": "from importlib import import_module\ndef f():\n    return import_module('b')",
        "b": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import c",
        "c": "def f():\n    import a",
        "above": "import a",
        "below": "import json",
        "kit.p": "from importlib import import_module\ndef f(x):\n    return import_module(f'kit.{x}')\nX = 'q.Name'",
        "kit.q": "import kit.p",
    }
    found = {name: imports_of(ast.parse(text), sources) for name, text in sources.items()}
    assert circles(found) == {"a", "b", "c", "kit.p", "kit.q"}
    assert circles({**found, "c": imports_of(ast.parse(""), sources)}) == {"kit.p", "kit.q"}


HEAVY = frozenset(
    [
        "pyarrow",
        "scipy",
        "matplotlib",
        "duckdb",
        "h5py",
        "pycocotools",
        "onnxruntime",
        "trimesh",
        "cv2",
        "PIL",
        "torch",
        "onnx",
        "embreex",
        "open3d",
        "ray",
        "ssl",
        "fsspec",
        "OpenEXR",
        "psycopg",
        "tokenizers",
        "huggingface_hub",
        "threadpoolctl",
        "platformdirs",
        "tomllib",
        "tomli",
        "xxhash",
        "numpy",
        "pydantic",
    ]
)
"""What takes long to load, or belongs to an extra: such imports may stand where they are needed."""
LAZY_PARTS = {
    "pipeline.answering.objects",
    "pipeline.proposals.registry",
    "pipeline.system.lazy_exports",
    "pipeline.system.plugins",
}
"""A pipeline starts 80 ms sooner where only the detector and the segmenter that are asked for are imported; whole boxes
are made for who asks for them; every process imports what hands names on; and to look for plugins brings a parser of
e-mail, 15 ms, that built-in parts do not need."""


def hidden(found: Imports) -> Iterator[tuple[str, int]]:
    """Modules that a module imports within functions, and in which line."""
    for node in found.everywhere:
        if node not in found.top:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "pipeline":
                wholes = {f"{node.module}.{a.name}" for a in node.names}
                names = sorted(wholes & core().keys()) or names
            yield from ((name, node.lineno) for name in names)


@cache
def brings_in(module: str) -> frozenset[str]:
    """Heavy packages that are loaded with a module of the core; there are no circles to run in."""
    tops = core()[module].always
    found = set(packages(tops))
    targets = {target for target, _ in imported(tops, core())} - {module, "pipeline"}
    return frozenset(found & HEAVY).union(*map(brings_in, targets))


def test_imports_within_functions_save_time_or_an_extra() -> None:
    needless = [
        f"{name}:{line} imports {target}"
        for name, found in core().items()
        if name != "pipeline" and name not in LAZY_PARTS
        for target, line in hidden(found)
        if target.split(".")[0] not in HEAVY and not (target in core() and brings_in(target) - brings_in(name))
    ]
    assert not needless


def test_every_library_that_the_core_imports_is_declared() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    table = text.split("[project.scripts]")[0]
    declared = {n.lower().replace("_", "-") for n in re.findall(r'^\s*"([A-Za-z0-9_-]+)(?=[<>=;"\[])', table, re.M)}
    declared |= {n.lower() for n in re.findall(r'"([A-Za-z0-9_-]+)(?:\[[^\]]*\])?[<>=][^"]*"', table)}
    owners = packages_distributions()
    missing = {}
    for module, found in core().items():
        for name in set(packages(found.everywhere)) - set(sys.stdlib_module_names) - {"pipeline"}:
            if not {d.lower().replace("_", "-") for d in owners.get(name, [name])} & declared:
                missing.setdefault(name, module)
    assert not missing, f"imported, but not among the dependencies of pyproject.toml: {missing}"
