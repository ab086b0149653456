"""The frames of a dataset as a sequence, and frames that are at hand as a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import overload

from pipeline.datasets.base import Dataset, resolve_frame, unknown_frame
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError


class Frames(Sequence[Frame]):
    """All frames of a dataset in its order, each decoded when it is asked for and not kept.

    `frames[0]`, `frames["000001/000000"]` (the keys of `resolve_frame`), `frames[-3:]`, `len(frames)`, and a loop.
    A broken frame raises InputError.
    """

    def __init__(self, dataset: Dataset, ids: tuple[str, ...] | None = None) -> None:
        self._dataset = dataset
        self.ids = dataset.frame_ids if ids is None else ids

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, key: int | str) -> Frame: ...
    @overload
    def __getitem__(self, key: slice) -> Frames: ...
    def __getitem__(self, key: int | str | slice) -> Frame | Frames:
        if isinstance(key, slice):
            return Frames(self._dataset, self.ids[key])
        # A sequence ends with an IndexError, which `resolve_frame` does not know.
        return self._dataset.load(resolve_frame(self._dataset, key) if isinstance(key, str) else self.ids[key])

    def __repr__(self) -> str:
        return f"<Frames {len(self)} of {self._dataset.root}>"


class InMemoryDataset:
    """Frames that are at hand, as a dataset (`pipeline.datasets.base.Dataset`).

    Parameters
    ----------
    frames : iterable of Frame
        At least one; their ids differ.

    Raises
    ------
    InputError
        No frame, or two of one id.
    """

    format = "memory"
    root = Path("memory")

    def __init__(self, frames: Iterable[Frame]) -> None:
        frames = tuple(frames)
        self._frames = {frame.id: frame for frame in frames}
        if not frames or len(self._frames) < len(frames):
            raise InputError(
                "frames of a dataset have ids of their own", got=", ".join(f.id for f in frames[:6]) or "no frame"
            )
        self.frame_ids = tuple(self._frames)
        self.class_names = tuple(sorted({a.label for f in frames for a in f.annotations}))

    def __repr__(self) -> str:
        return f"<InMemoryDataset of {len(self.frame_ids)} frames>"

    def load(self, frame_id: str) -> Frame:
        """The frame; see `Dataset.load`."""
        if frame_id not in self._frames:
            raise unknown_frame(self, frame_id)
        return self._frames[frame_id]
