"""What commands import: each what it uses, since most of the time of a short one goes into imports."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from pipeline.datasets.demo import demo_labels

IMPORTED = """
import json, sys
from spatialviz.cli import main
try:
    main(sys.argv[1:])
finally:
    print(json.dumps(sorted(sys.modules)), file=sys.stderr)
"""
TABLES = {"pyarrow", "duckdb", "pydantic", "pandas"}
NETWORKS = {"torch", "onnx", "tokenizers", "openai", "huggingface_hub"}
PAGES = {"viser", "websockets", "trimesh", "open3d", "matplotlib", "scipy", "typeguard", "unittest"}
MODELS = {"onnxruntime", "cv2", "PIL", "rich", "platformdirs"}
ASKED = "mug left of the laptop"
MOST = [
    (("--help",), 19, {*TABLES, *NETWORKS, *PAGES, *MODELS, "numpy", "xxhash"}),
    (("ask", "demo", "0", ASKED), 145, {*TABLES, *NETWORKS, *PAGES, "rich"}),
    (("relations", "demo", "0"), 120, {*TABLES, *NETWORKS, *PAGES, "rich"}),
    (("frames", "demo"), 70, {*TABLES, *NETWORKS, *PAGES, "rich", "onnxruntime", "xxhash"}),
    (("check", str(demo_labels())), 115, {*NETWORKS, *PAGES, "onnxruntime"}),
]
"""Commands, the most modules of the program that each may import, and packages that none of them needs."""


@pytest.mark.parametrize(("words", "most", "absent"), MOST, ids=[words[0] for words, *_ in MOST])
def test_a_command_imports_what_it_uses(words: tuple[str, ...], most: int, absent: set[str]) -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTED, *words], capture_output=True, text=True, check=True)
    modules = json.loads(done.stderr.splitlines()[-1])
    own = [name for name in modules if name.partition(".")[0] in ("pipeline", "spatialviz")]
    assert len(own) <= most, "a command has come to import more: is it needed, and where it is imported?"
    assert sorted(absent & {name.partition(".")[0] for name in modules}) == []


def test_a_page_is_served_before_what_sessions_are_made_of_is_loaded() -> None:
    code = "import json, sys; import spatialviz.run_view; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = set(json.loads(done.stdout))
    assert "spatialviz.app.site" in modules
    assert not {"spatialviz.app.session", "spatialviz.app.labelling", "rich.table"} & modules
