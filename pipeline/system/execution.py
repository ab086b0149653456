"""Where ONNX Runtime computes, and whether its own messages are shown.

Both are asked of the environment, so that worker processes do as their parent does.
"""

from __future__ import annotations

import os
import warnings
from functools import lru_cache
from typing import Any, Literal

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
    """What was asked for cannot compute here, and the CPU does."""


def use_execution(provider: str | None = None, verbose: bool = False) -> None:
    """Set where models that are opened from now on compute, in this process and in those it starts.

    Parameters
    ----------
    provider : str, optional
        "auto", "cpu", "cuda", "coreml" or "directml"; None leaves it as it is.
    verbose : bool
        Let ONNX Runtime's own messages reach standard error.

    Raises
    ------
    InputError
        For another provider.
    """
    if provider is not None:
        os.environ[PROVIDER_VARIABLE] = _checked(provider)
    if verbose:
        os.environ[VERBOSE_VARIABLE] = "1"


def is_verbose() -> bool:
    """Whether ONNX Runtime's own messages are shown."""
    return os.environ.get(VERBOSE_VARIABLE, "") not in ("", "0")


def _checked(provider: str) -> str:
    known = ("auto", "cpu", *ACCELERATORS)
    require(provider in known, "there is no such provider", got=repr(provider), expected=" or ".join(known))
    return provider


def wanted_accelerator(available: list[str]) -> str | None:
    """ONNX Runtime's name of what computes besides the CPU; None for nothing, with one warning where it was asked for.

    Parameters
    ----------
    available : list of str
        What this ONNX Runtime was built with.
    """
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


def create_session(path: str, options: Any) -> Any:
    """A session on the wanted provider, or on the CPU with one warning; raises what ONNX Runtime raises."""
    import onnxruntime as ort

    accelerator = wanted_accelerator(ort.get_available_providers())
    if accelerator is None:
        return cpu_session(path, options)
    if accelerator == ACCELERATORS["directml"]:
        # DirectML refuses memory patterns and parallel execution.
        options.enable_mem_pattern = False
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    try:
        # ONNX Runtime's own fallback prints four lines to standard output.
        session = ort.InferenceSession(path, sess_options=options, providers=[accelerator, CPU], enable_fallback=0)
    except Exception as error:  # ONNX Runtime raises its own classes, which differ between releases.
        session = cpu_session(path, options)
        reason = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
        warn_once(f"{accelerator} cannot be used, the CPU computes: {reason}")
        return session
    if accelerator not in session.get_providers():
        warn_once(f"{accelerator} cannot be used, the CPU computes: its libraries are missing or do not fit")
    return session


def cpu_session(path: str, options: Any) -> Any:
    """The same on the CPU, whatever is wanted."""
    import onnxruntime as ort

    return ort.InferenceSession(path, sess_options=options, providers=[CPU])
