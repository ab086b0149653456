"""The built-in demo's frames, decoded and lifted once in a session: most tests ask something of the same twelve.

What is remembered is what the product's own functions gave, and may not be written to. A dataset anywhere else (a copy
of the demo too) is decoded, and lifted, as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xxhash

from pipeline.datasets import demo_path
from pipeline.datasets.bop import BopDataset
from pipeline.geometry import Frame, lifting


@contextmanager
def demo_remembered() -> Iterator[None]:
    """While it holds, a frame of the demo is decoded once, and each of its masks lifted once."""
    demo = demo_path().resolve()
    load, lift = BopDataset._decoded, lifting._lifted
    frames: dict[Any, Frame] = {}
    depths: set[int] = set()
    objects: dict[Any, lifting.LiftedObject] = {}

    def load_once(self: BopDataset, frame_id: str, annotated: bool = True) -> Frame:
        if Path(self.root).resolve() != demo:
            return load(self, frame_id, annotated)
        key = frame_id, annotated, repr(self._settings)
        if key not in frames:
            frames[key] = unwritable(load(self, frame_id, annotated))
            depths.add(id(frames[key].depth))
        return frames[key]

    def lift_once(
        depth: np.ndarray,
        camera: Any,
        masks: Any,
        viewer: Any,
        config: Any,
        sources: Any,
        edges: np.ndarray,
        boxes: bool,
        thin: Any,
    ) -> tuple[lifting.LiftedObject, ...]:
        def lifted(some: list[int]) -> tuple[lifting.LiftedObject, ...]:
            own, kinds, flat = ([values[k] for k in some] for values in (masks, sources, thin))
            return lift(depth, camera, own, viewer, config, kinds, edges, boxes, flat)

        if id(depth) not in depths:
            return lifted([*range(len(masks))])
        frame = id(depth), *map(_content, (camera, viewer, config, edges, boxes))
        keys = [(frame, *map(_content, own)) for own in zip(masks, sources, thin, strict=True)]
        fresh = [k for k, key in enumerate(keys) if key not in objects]
        objects.update(zip((keys[k] for k in fresh), map(unwritable, lifted(fresh)), strict=True))
        return tuple(objects[key] for key in keys)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BopDataset, "_decoded", load_once)
        patch.setattr(lifting, "_lifted", lift_once)
        yield


def unwritable(value: Any) -> Any:
    """The same value, every array in it closed to writing."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, tuple):
        _each(unwritable, value)
    elif is_dataclass(value):
        _each(unwritable, (getattr(value, f.name) for f in fields(value)))
    return value


def _each(do: Callable[[Any], Any], values: Any) -> None:
    for value in values:
        do(value)


def _content(value: Any) -> Any:
    """What tells one argument of lifting from another."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, xxhash.xxh3_128_digest(np.ascontiguousarray(value).tobytes())
    if is_dataclass(value):
        return type(value), *(_content(getattr(value, f.name)) for f in fields(value))
    return value
