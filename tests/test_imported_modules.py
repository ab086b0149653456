"""What the core imports for a job: as much as it uses, since that takes most of the time of a short one."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

QUESTION = """
import pipeline
pipeline.open("demo").ask(0, "mug left of the laptop")
"""
RELATIONS = """
from pipeline.answering import open_pipeline, relate_frames
list(relate_frames(open_pipeline("demo", srm="rule"), 0))
"""
FRAMES = """
from pipeline.datasets import demo_path, open_dataset, survey
list(survey(open_dataset(demo_path())))
"""
CHECK = """
from pipeline.datasets import demo_labels
from pipeline.labels import check_labels, open_labels
list(check_labels(open_labels(demo_labels())))
"""
SCREEN = {"spatialviz", "tyro", "rich", "viser", "open3d", "matplotlib"}
NEVER = {*SCREEN, "torch", "onnx", "scipy", "trimesh", "duckdb", "openai", "tokenizers", "asyncio"}
READERS = {"pydantic", "pyarrow", "email"}


@pytest.mark.parametrize(
    ("job", "most", "absent"),
    [
        (QUESTION, 135, READERS),
        (RELATIONS, 106, {*READERS, "onnxruntime"}),
        (FRAMES, 48, {*READERS, "onnxruntime", "xxhash"}),
        (CHECK, 98, {"onnxruntime"}),
    ],
    ids=["question", "relations", "frames", "check"],
)
def test_a_job_imports_what_it_uses(job: str, most: int, absent: set[str]) -> None:
    code = f"{job}\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = json.loads(done.stdout)
    own = [name for name in modules if name.partition(".")[0] == "pipeline"]
    assert len(own) <= most, "a job has come to import more: is it needed, and where it is imported?"
    assert sorted({*NEVER, *absent} & {name.partition(".")[0] for name in modules}) == []
