"""Pages of the reference: all that the parser, the public face, the keys and the schemas have stands on them."""

from __future__ import annotations

import doctest
import json
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from command_line import spatialviz
from waiting import LONG_S

import spatialviz as sp
from pipeline.answering import prediction_schema
from pipeline.corrections.journal import batch, chain
from pipeline.datasets import settings
from pipeline.datasets.depth.contract import DepthContract
from pipeline.diagnosis.cases.manifest import CaseManifest
from pipeline.diagnosis.whatif import Edits
from pipeline.diagnosis.whatif.state import ViewState
from pipeline.evaluation.records import COLUMNS
from pipeline.labels.schema import TABLES, json_schemas
from pipeline.proposals.box_detector import BoxModel
from spatialviz.app.keys import KEYS, LABEL_KEYS, MOUSE, MOVE_KEYS
from spatialviz.cli import FORMS, GROUPS, OPTIONS

ROOT = Path(__file__).resolve().parents[2]
SITE = ROOT / ".ci" / "site"
griffe = pytest.importorskip("griffe")
sys.path.insert(0, str(SITE))


@cache
def page(name: str) -> str:
    """Markdown of a page, as the site is made of it."""
    return import_module(f"reference_{name}").page()


def section(name: str, heading: str) -> str:
    """What stands below a heading of a page, headings below it too."""
    level = re.search(rf"^(#+) {re.escape(heading)}$", page(name), re.M)
    assert level, f"{name} has no heading {heading}"
    return re.split(rf"^#{{1,{len(level[1])}}} ", page(name)[level.end() :], flags=re.M)[0]


def rows(text: str) -> dict[str, list[str]]:
    """Rows of the tables of a page by their first cell's names."""
    cells = [[c.strip() for c in line.strip("|").split(" | ")] for line in text.splitlines() if line.startswith("| ")]
    return {name: row for row in cells for name in re.findall(r"`([^`]+)`", row[0])}


@pytest.mark.parametrize("name", [n for group in GROUPS.values() for n in group] + list(FORMS))
def test_every_option_of_the_help_stands_with_its_meaning(name: str) -> None:
    said = next((" ".join(words) for words, own in OPTIONS.items() if own == name), name)
    printed = spatialviz(0, *said.split(), "--help").out
    options = set(re.findall(r"^│ (?:-h, )?(--[\w-]+)", printed, re.M)) - {"--help"}
    own = section("commands", said)
    shared = "".join(section("commands", title) for title in re.findall(r"\[([A-Z]\w+ options)\]", own))
    known = rows(own) | rows(shared)
    assert options - set(known) == set()
    assert [option for option in options if not known[option][-1]] == []


def test_commands_stand_in_the_groups_of_the_help() -> None:
    headings = re.findall(r"^## (.*)$", page("commands"), re.M)
    assert [h.lower() for h in headings[1:-1]] == list(GROUPS)


def test_examples_of_commands_are_lines_of_the_documents() -> None:
    shown = re.findall(r"^```sh\n(.*?)```", page("commands"), re.M | re.S)
    assert len(shown) > 15
    documents = "\n".join(" ".join(d.read_text().replace("\\\n", " ").split()) for d in (ROOT / "docs").glob("*.md"))
    assert [line for block in shown for line in block.splitlines() if line not in documents] == []


@pytest.fixture(scope="module")
def described() -> dict[str, Any]:
    loaded = griffe.load_extensions(import_module("docstrings").Docstrings)
    packages = {n: griffe.load(n, extensions=loaded, search_paths=[str(ROOT)]) for n in ("pipeline", "spatialviz")}
    paths = {name: import_module("reference_python").defined(name) for name in sp.__all__ if name != "__version__"}
    return {n: packages[p.partition(".")[0]][p.partition(".")[2]] for n, p in paths.items()}


@pytest.mark.parametrize("name", [n for n in sp.__all__ if n != "__version__"])
def test_every_public_name_stands_with_its_example_that_runs(described: dict[str, Any], name: str) -> None:
    path = import_module("reference_python").defined(name)
    assert f"::: {path}\n" in page("python")
    found = described[name].docstring
    assert found is not None
    assert found.parse("numpy", warnings=False)[-1].kind.value == "examples"


def test_the_examples_of_the_face_run() -> None:
    """Those of the core are run by `tests/test_examples.py`."""
    code = "import doctest, spatialviz.face as face; print(doctest.testmod(face))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=LONG_S, cwd=ROOT)
    assert re.search(r"failed=0, attempted=[1-9]", done.stdout), done.stdout


def test_docstrings_are_completed_for_the_site() -> None:
    numpydoc = import_module("docstrings").numpydoc
    text = "Do it.\n\nParameters\n----------\na, b : int\n    Both.\n\nRaises InputError: none of them.\n\n>>> 1\n1"
    found = {s.kind.value: s for s in griffe.Docstring(numpydoc(text)).parse("numpy", warnings=False)}
    assert [(p.name, p.description.strip()) for p in found["parameters"].value] == [("a", "Both."), ("b", "Both.")]
    assert [(e.annotation, e.description.strip()) for e in found["raises"].value] == [("InputError", "None of them.")]
    assert doctest.DocTestParser().get_examples(found["examples"].value[0][1])


@pytest.mark.parametrize("groups", [KEYS, LABEL_KEYS, {"Moves": MOVE_KEYS}, MOUSE])
def test_every_key_that_is_bound_stands_with_what_it_does(groups: dict[str, Any]) -> None:
    for group, bound in groups.items():
        listed = section("keys", group)
        for key, does, _ in bound:
            pressed = "+".join(f"<kbd>{part}</kbd>" for part in key.split("+"))
            assert f"| {pressed} | {does} |" in listed


FIELDS: dict[str, list[str]] = {
    **{f"{name}.parquet": list(json_schemas()[name]["properties"]) for name in TABLES},
    "manifest.json": list(json_schemas()["manifest"]["properties"]),
    "records.parquet": list(COLUMNS),
    "Header": list(prediction_schema.Header.__dataclass_fields__),
    "Prediction": list(prediction_schema.Prediction.__dataclass_fields__),
    "spatialviz-case.json": list(CaseManifest.model_fields),
    "Actions": list(batch.KINDS),
    "Edits of a what-if": list(Edits.__dataclass_fields__),
    "Marks": ["frame", "id", "mark"],
    "Columns of an event": [*chain.CONTENT, "hash"],
    "spatialviz.toml": list(settings.KEYS),
    "Detector of boxes": list(BoxModel.model_fields),
    "Depth network": list(DepthContract.model_fields),
    "View strings": list(ViewState.__dataclass_fields__),
}


@pytest.mark.parametrize("heading", FIELDS)
def test_every_field_of_a_schema_stands_with_its_meaning(heading: str) -> None:
    text = section("formats", heading)
    known = rows(re.split(r"^#", text, flags=re.M)[0])
    assert [name for name in FIELDS[heading] if not known.get(name, [""])[-1]] == []


def test_every_row_of_the_formats_has_a_meaning() -> None:
    assert [line for line in page("formats").splitlines() if line.startswith("| ") and line.endswith("|  |")] == []


def test_keys_of_answers_are_those_that_the_command_prints() -> None:
    printed = spatialviz(
        0, "ask", "demo", 3, "laptop to the left of the office chair", "--run", "demo", "--json"
    ).record
    formats = import_module("reference_formats")
    for title, (place, *_) in formats.PARTS_OF_ANSWERS.items():
        known = rows(section("formats", title))
        seen = {name for one in formats.parts_at(printed, place) for name in one}
        assert seen - set(known) == set(), title


def test_the_walkthrough_is_kept_without_what_it_prints() -> None:
    cells = json.loads((ROOT / "docs" / "walkthrough.ipynb").read_text(encoding="utf-8"))["cells"]
    code = [c for c in cells if c["cell_type"] == "code"]
    assert len(code) > 12
    assert all(c["outputs"] == [] and c["execution_count"] is None for c in code)
    assert max(len(line) for c in code for line in "".join(c["source"]).splitlines()) <= 88
