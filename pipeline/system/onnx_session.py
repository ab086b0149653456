"""ONNX Runtime sessions: opened, run within limits, and errors in one line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import xxhash

from pipeline.system.errors import InputError, require
from pipeline.system.execution import ACCELERATORS, CPU, is_verbose, wanted_accelerator, warn_once
from pipeline.system.frozen import dataclass
from pipeline.system.limits import LIMITS_OPTION, current_limits
from pipeline.system.onnx_contents import check_network, weight_files
from pipeline.system.safe_files import opened


@dataclass
class Running:
    """A computation; `stopped` once it was told to stop."""

    stopped: bool = False


@contextmanager
def stopped_after(seconds: float, stop: Callable[[], object]) -> Iterator[Running]:
    """Call `stop`, from another thread, where the block takes longer than so many seconds."""
    running = Running()

    def end() -> None:
        running.stopped = True
        stop()

    timer = Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield running
    finally:
        timer.cancel()


def open_session(path: Path, threads: int | None = None) -> Any:
    """Open an `onnxruntime.InferenceSession` on the wanted provider; InputError for a missing or malformed file.

    A graph beyond ONNX Runtime's optimisations, as of half-precision files, is loaded without them. `threads` is for a
    network so small that waking more threads, or another processor, costs more than it saves.
    """
    require(not path.is_dir(), "the model is a folder", expected="the ONNX file in it", path=path)
    require(path.exists(), "there is no model file", path=path, cause="give the path of an ONNX file")
    check_network(path)
    import onnxruntime as ort

    verbose = is_verbose()
    options = ort.SessionOptions()
    # Errors are raised as exceptions; the log would print them a second time.
    options.log_severity_level = 2 if verbose else 4
    if not verbose:
        ort.set_default_logger_severity(4)
    if threads is not None:
        options.intra_op_num_threads = threads
    if _limited_memory():
        options.add_session_config_entry("session.use_env_allocators", "1")
    # Threads that wait in a circle take from whatever else runs a fifth of its time, and more than they save.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    accelerator = wanted_accelerator(ort.get_available_providers()) if threads is None else None
    failure: Exception | None = None
    seconds = current_limits().seconds
    # Half of loading is computing what is constant.
    with stopped_after(seconds, lambda: options.set_load_cancellation_flag(True)) as loading:
        for level in (ort.GraphOptimizationLevel.ORT_ENABLE_ALL, ort.GraphOptimizationLevel.ORT_DISABLE_ALL):
            options.graph_optimization_level = level
            try:
                return _legible(_create(str(path), options, accelerator), path)
            except InputError:
                raise
            except Exception as error:  # ONNX Runtime raises its own classes, which differ between releases.
                failure = failure or error
    if loading.stopped:
        raise _endless("loading the model", seconds, path) from failure
    cause = _no_model(path) or _likely_cause(str(failure))
    raise InputError("ONNX Runtime cannot load the model", got=first_line(failure), cause=cause, path=path) from failure


@lru_cache(maxsize=1)
def _limited_memory() -> bool:
    """Share one arena of limited size among the networks of this process on the CPU; False if unsupported."""
    import onnxruntime as ort

    try:
        kind = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
        ort.create_and_register_allocator(kind, ort.OrtArenaCfg({"max_mem": current_limits().memory}))
    except Exception:  # ONNX Runtime raises its own classes, and releases differ in what they offer.
        return False
    return True


def _endless(what: str, seconds: float, path: Path) -> InputError:
    return InputError(
        f"{what} does not come to an end",
        got=f"more than {seconds} seconds",
        expected="less",
        cause=f"a slow machine? {LIMITS_OPTION} seconds={10 * seconds}",
        path=path,
    )


def run_limited(session: Any, outputs: Sequence[str] | None, feed: Mapping[str, np.ndarray], path: Path) -> list[Any]:
    """Run a session; errors are ONNX Runtime's, and InputError beyond the limit of seconds.

    ONNX Runtime looks between two operators for the order to stop: a loop ends, a single operator does not.
    """
    (found,) = run_blocks(session, [feed], path, outputs)
    return found


def run_blocks(
    session: Any, feeds: Iterable[Mapping[str, np.ndarray]], path: Path, outputs: Sequence[str] | None = None
) -> Iterator[list[Any]]:
    """Run a session on one input after the other within one limit of seconds; errors as of `run_limited`."""
    import onnxruntime as ort

    options, seconds = ort.RunOptions(), current_limits().seconds
    with stopped_after(seconds, lambda: setattr(options, "terminate", True)) as running:
        for feed in feeds:
            try:
                yield session.run(None if outputs is None else list(outputs), feed, options)
            except Exception as error:
                if running.stopped:
                    raise _endless("running the model", seconds, path) from error
                raise


def _legible(session: Any, path: Path) -> Any:
    """Check the session's declared names and shapes for text."""
    try:
        for value in (*session.get_inputs(), *session.get_outputs()):
            _ = value.name, value.shape
    except UnicodeDecodeError as error:
        raise InputError("the names in the model are no text", cause="the file is damaged", path=path) from error
    return session


def metadata(session: Any) -> dict[str, str]:
    """Metadata of the file; empty if no text."""
    try:
        return dict(session.get_modelmeta().custom_metadata_map)
    except UnicodeDecodeError:
        return {}


_NO_MODEL = (
    ((b"version https://git-lfs",), "it is a pointer of Git LFS, not the file itself: `git lfs pull` fetches it"),
    ((b"<!doctype", b"<html", b"<?xml"), "it is a web page, not the file itself: download it again"),
)
_CAUSES = (
    (
        ("external data", "external initializer", "_data", "model_path must not"),
        "its weights are in a file of their own: keep it beside the model, under the name it was exported with",
    ),
    (("opset",), "the file is newer than this ONNX Runtime: update onnxruntime, or export with an older opset"),
    (("protobuf", "parse"), "the file is damaged, incomplete, or no ONNX file"),
)


def _no_model(path: Path) -> str | None:
    """Cause for a failed download in the file's place."""
    with opened(path, "model") as file:
        begin = file.read(64).lstrip().lower()
    return next((cause for begins, cause in _NO_MODEL if begin.startswith(begins)), None)


def _likely_cause(message: str) -> str | None:
    """Likely cause of ONNX Runtime's words."""
    words = message.lower()
    return next((cause for parts, cause in _CAUSES if any(part in words for part in parts)), None)


def first_line(error: object) -> str:
    """First line of an error without ONNX Runtime's own numbering, or else the class."""
    lines = re.sub(r"\[ONNXRuntimeError\] : \d+ : \w+ : |Load model from .*? failed:", "", str(error)).splitlines()
    return (lines[0][:200] if lines else "") or type(error).__name__


def run_session(session: Any, outputs: Sequence[str], feed: Mapping[str, np.ndarray], path: Path) -> list[np.ndarray]:
    """Run a session on inputs cast to the declared types; floating-point outputs are float32.

    Raises InputError for inputs beyond casting, a failure of ONNX Runtime, or NaN in an output.
    """
    cast = as_declared(session, feed, path)
    try:
        values = [np.asarray(v) for v in run_limited(session, outputs, cast, path)]
    except InputError:
        raise
    except Exception as error:  # As above.
        text = str(error)
        cause = None
        if "out of data bounds" in text or "out of bounds" in text:
            cause = "a token is not in the model's vocabulary: is the tokenizer that of another model?"
        if "smaller than requested bytes" in text:
            cause = f"it asks for more memory than networks may hold: {LIMITS_OPTION} memory=16G"
        raise InputError("the model cannot be run", got=first_line(text), cause=cause, path=path) from error
    values = [v.astype(np.float32) if v.dtype.kind == "f" else v for v in values]
    for name, value in zip(outputs, values, strict=True):
        require(
            not (value.dtype.kind == "f" and np.isnan(value).any()),
            f"the model's output {name!r} holds NaN",
            cause="half-precision files overflow on some processors: try the full-precision one",
            path=path,
        )
    return values


def as_declared(session: Any, feed: Mapping[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """Cast inputs to the types declared by the file; InputError for types without numbers, or rounded values."""
    types = {i.name: i.type for i in session.get_inputs()}
    cast = {}
    for name, value in feed.items():
        wanted = NUMPY_TYPES.get(types.get(name, ""))
        if wanted is None:
            got = types.get(name, "no such input")
            raise InputError(f"the model's input {name!r} cannot be given", got=got, expected="numbers", path=path)
        with np.errstate(invalid="ignore", over="ignore"):
            cast[name] = np.asarray(value, dtype=wanted, order="C")
        require(
            value.dtype.kind != "f" or cast[name].dtype.kind == "f" or np.array_equal(cast[name], value),
            f"the model's input {name!r} takes whole numbers, and what belongs there are none",
            got=types[name],
            expected="tensor(float)",
            cause="was the file quantised together with its inputs?",
            path=path,
        )
    return cast


NUMPY_TYPES: dict[str, type[np.generic]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(uint8)": np.uint8,
    "tensor(bool)": np.bool_,
}
"""ONNX Runtime's names of the types that inputs may have."""


def signature(session: Any) -> str:
    """Declared inputs and outputs on a line, for messages."""

    def line(values: Any) -> str:
        return ", ".join(f"{v.name} {list(v.shape)}" for v in values)

    return f"{line(session.get_inputs())} -> {line(session.get_outputs())}"


def file_hash(path: Path) -> str:
    """XXH3 hash of a file's content."""
    digest = xxhash.xxh3_128()
    with opened(path, "model") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def model_hash(path: Path) -> str:
    """XXH3 hash of a model file and of all separate files of weights."""
    companions = {path.with_name(path.name + ending): None for ending in ("_data", ".data")}
    companions |= {path.parent / name: None for name in weight_files(path)}
    return "+".join(file_hash(p) for p in (path, *companions) if p.is_file())


def _create(path: str, options: Any, accelerator: str | None) -> Any:
    """Session on an accelerator, or with a warning on the CPU; raises ONNX Runtime's errors."""
    import onnxruntime as ort

    if accelerator == ACCELERATORS["directml"]:
        # DirectML refuses memory patterns and parallel execution.
        options.enable_mem_pattern = False
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    if accelerator is not None:
        try:
            # ONNX Runtime's own fallback prints four lines to standard output.
            session = ort.InferenceSession(path, sess_options=options, providers=[accelerator, CPU], enable_fallback=0)
        except Exception as error:  # ONNX Runtime raises its own classes, which differ between releases.
            warn_once(f"{accelerator} cannot be used, the CPU computes: {first_line(error)[:160]}")
        else:
            if accelerator not in session.get_providers():
                warn_once(f"{accelerator} cannot be used, the CPU computes: its libraries are missing or do not fit")
            return session
    return ort.InferenceSession(path, sess_options=options, providers=[CPU])
