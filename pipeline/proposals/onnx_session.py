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
        raise InputError("there is no model file", path=path, cause="give the path of an ONNX file with --model")
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
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError("ONNX Runtime cannot load the model", got=first[:200], path=path) from error


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
