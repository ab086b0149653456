"""What tests of proposals share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from scenes import frame_of, upright

from pipeline.geometry import Frame
from pipeline.proposals import Proposals

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    boxes = [upright((x, 0.9, 2), (0.3, 0.4, 0.3)) for x in (-0.6, 0.0, 0.6)]
    return frame_of(boxes, ["coffee mug", "laptop", "coffee mug"])


def equal(a: Proposals, b: Proposals) -> bool:
    same = all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("boxes", "scores", "label_index", "ids"))
    if a.masks is None or b.masks is None:
        return same and a.masks is b.masks and a.labels == b.labels
    return same and np.array_equal(a.masks, b.masks) and a.labels == b.labels
