"""What a model file must declare to be one that an adapter reads."""

from __future__ import annotations

from dataclasses import dataclass


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
