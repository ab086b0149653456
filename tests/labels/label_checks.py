"""What tests of labels share."""

from __future__ import annotations

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
