"""Open an ONNX file with ONNX Runtime, and say plainly what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xxhash

from pipeline.errors import InputError


def open_session(path: Path, threads: int | None = None) -> Any:
    """An `onnxruntime.InferenceSession` on the CPU (or on CUDA where it is installed).

    Parameters
    ----------
    path : Path
    threads : int, optional
        For a network so small that waking more threads costs more than it saves.

    Raises
    ------
    InputError
        Where the file is missing or is not an ONNX model.
    """
    if not path.is_file():
        raise InputError("there is no model file", path=path, cause="give the path of an ONNX file")
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.log_severity_level = 3
    if threads is not None:
        options.intra_op_num_threads = threads
    available = ort.get_available_providers()
    providers = [p for p in ("CUDAExecutionProvider", "CPUExecutionProvider") if p in available]
    try:
        return ort.InferenceSession(str(path), sess_options=options, providers=providers)
    except Exception as error:  # ONNX Runtime raises its own classes, which differ between releases.
        # Some float16 and quantised graphs are spoilt by the optimiser and load without it.
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        try:
            return ort.InferenceSession(str(path), sess_options=options, providers=providers)
        except Exception:
            first = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                "ONNX Runtime cannot load the model", got=first[:200], cause=_likely_cause(str(error)), path=path
            ) from error


def _likely_cause(message: str) -> str | None:
    """What ONNX Runtime's words for a file that it cannot load come from."""
    words = message.lower()
    if any(part in words for part in ("external data", "external initializer", "_data", "model_path must not")):
        return "its weights are in a file of their own: keep it beside the model, under the name it was exported with"
    if "opset" in words:
        return "the file is newer than this ONNX Runtime: update onnxruntime, or export with an older opset"
    if "protobuf" in words or "parse" in words:
        return "the file is damaged, incomplete, or no ONNX file"
    return None


def signature(session: Any) -> str:
    """The declared inputs and outputs in one line, for messages."""

    def line(values: Any) -> str:
        return ", ".join(f"{v.name} {list(v.shape)}" for v in values)

    return f"{line(session.get_inputs())} -> {line(session.get_outputs())}"


def file_hash(path: Path) -> str:
    """Hash of a file's content."""
    digest = xxhash.xxh3_128()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
