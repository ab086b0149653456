"""The reference libraries that adapters are compared with."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest


@lru_cache(maxsize=1)
def missing_operators() -> Any:
    """Lets torchvision be imported where its compiled part is for another build of PyTorch.

    Both reference libraries import it, and use of it only what is Python. What is returned must be kept.
    """
    import torch

    spec = find_spec("torchvision")
    if spec is None or not spec.submodule_search_locations:
        return None
    try:
        for library in Path(spec.submodule_search_locations[0]).glob("_C*.so"):
            torch.ops.load_library(str(library))
    except OSError:
        operators = torch.library.Library("torchvision", "FRAGMENT")
        for name in ("nms", "qnms"):
            operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        return operators


def import_reference(name: str) -> Any:
    """A reference library, or the test is skipped."""
    missing_operators()
    pytest.importorskip("torchvision", reason="the reference code needs torchvision: pip install 'spatialviz[dev]'")
    return pytest.importorskip(name, reason=f"the reference code {name} is not installed")
