"""What a model file must declare to be one that an adapter reads."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class TensorSpec:
    """An input or output as a file declares it.

    Attributes
    ----------
    name : str
    dtype : str
        As NumPy names it; "float32" stands for float16 too.
    shape : tuple of int or str
        A word where the size is the file's own.
    """

    name: str
    dtype: str
    shape: tuple[int | str, ...]


@dataclass(frozen=True)
class Contract:
    """One kind of model file.

    Attributes
    ----------
    option : str
        How it is asked for, such as "--segmenter sam".
    what : str
        One line of what it is.
    inputs, outputs : tuple of TensorSpec
        Those that tell it from others; a file may declare more outputs.
    """

    option: str
    what: str
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]


_DTYPES = {
    "tensor(float)": "float32",
    "tensor(float16)": "float16",
    "tensor(double)": "float64",
    "tensor(int64)": "int64",
    "tensor(int32)": "int32",
    "tensor(uint8)": "uint8",
    "tensor(bool)": "bool",
}


def declared(values: Iterable[Any]) -> tuple[TensorSpec, ...]:
    """Inputs or outputs of a session."""

    def shape(value: Any) -> tuple[int | str, ...]:
        return tuple(size if isinstance(size, int) else str(size or "?") for size in value.shape)

    return tuple(TensorSpec(v.name, _DTYPES.get(v.type, str(v.type)), shape(v)) for v in values)


def follows(session: Any, contract: Contract) -> bool:
    """Whether a file declares what a contract wants: the same inputs, and at least its outputs."""
    inputs = {s.name: s for s in declared(session.get_inputs())}
    outputs = {s.name: s for s in declared(session.get_outputs())}
    if set(inputs) != {s.name for s in contract.inputs}:
        return False
    if not all(_fits(inputs[s.name], s) for s in contract.inputs):
        return False
    if len(contract.outputs) == len(outputs) == 1:
        return len(next(iter(outputs.values())).shape) in (0, len(contract.outputs[0].shape))
    return all(s.name in outputs for s in contract.outputs)


def _fits(found: TensorSpec, wanted: TensorSpec) -> bool:
    if len(found.shape) != len(wanted.shape):
        return False
    if wanted.dtype == "int64" and found.dtype not in ("int64", "int32"):
        return False
    return all(
        a == b or isinstance(a, str) or isinstance(b, str) for a, b in zip(found.shape, wanted.shape, strict=True)
    )
