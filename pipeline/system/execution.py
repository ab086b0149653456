"""Providers that networks compute on, and whether ONNX Runtime's own messages are shown.

Both stand in the environment, so that worker processes do as their parent does.
"""

from __future__ import annotations

import os
import warnings
from functools import lru_cache
from typing import Literal

from pipeline.system.errors import require

Provider = Literal["auto", "cpu", "cuda", "coreml", "directml"]
PROVIDER_VARIABLE = "SPATIALVIZ_PROVIDER"
VERBOSE_VARIABLE = "SPATIALVIZ_VERBOSE"
CPU = "CPUExecutionProvider"
ACCELERATORS = {
    "cuda": "CUDAExecutionProvider",
    "directml": "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
}
"""ONNX Runtime's names, the first that it has first."""
PACKAGES = {"cuda": "onnxruntime-gpu", "directml": "onnxruntime-directml", "coreml": "onnxruntime on macOS"}
"""The builds of ONNX Runtime that hold them."""


class ProviderWarning(UserWarning):
    """Wanted provider missing: the CPU computes."""


def use_execution(provider: str | None = None, verbose: bool = False) -> None:
    """Set where models compute from now on, in this process and its children; `verbose` shows ONNX Runtime's messages.

    `provider` is "auto", "cpu", "cuda", "coreml" or "directml" (InputError for another); None leaves it as it is.
    """
    if provider is not None:
        os.environ[PROVIDER_VARIABLE] = _checked(provider)
    if verbose:
        os.environ[VERBOSE_VARIABLE] = "1"


def is_verbose() -> bool:
    """Return True if ONNX Runtime's own messages are shown."""
    return os.environ.get(VERBOSE_VARIABLE, "") not in ("", "0")


def _checked(provider: str) -> str:
    known = ("auto", "cpu", *ACCELERATORS)
    require(provider in known, "there is no such provider", got=repr(provider), expected=" or ".join(known))
    return provider


def wanted_accelerator(available: list[str]) -> str | None:
    """Wanted accelerator in ONNX Runtime's name, among the `available`; None, with a warning, for the CPU."""
    provider = _checked(os.environ.get(PROVIDER_VARIABLE) or "auto")
    if provider == "cpu":
        return None
    if provider == "auto":
        return next((name for name in ACCELERATORS.values() if name in available), None)
    if ACCELERATORS[provider] not in available:
        warn_once(f"this ONNX Runtime has no {provider} ({PACKAGES[provider]} does): the CPU computes")
        return None
    return ACCELERATORS[provider]


@lru_cache(maxsize=64)
def warn_once(message: str) -> None:
    """Warn; the same words only once in a process."""
    warnings.warn(message, ProviderWarning, stacklevel=3)
