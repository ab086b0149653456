"""What tests of labels share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipeline.labels import SourceSpec, label_dataset

DEMO = SourceSpec("demo")
FRAMES = 6


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels of the first frames of the demo, made in this process in shards of two."""
    out = tmp_path_factory.mktemp("labels") / "demo"
    label_dataset(DEMO, out, limit=FRAMES, frames_a_shard=2)
    return out


def changed_within(path: Path) -> None:
    """Give a file other content of the same size, with the times of before."""
    state, content = path.stat(), bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
