"""What an adapter is given and gives: a published file with the dataset and labels it is about; predictions."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from pipeline.answering.predictions import Header, Prediction
from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture
from pipeline.datasets.frame_names import FrameNames, Picture
from pipeline.system.reading import Content, read_content

_WORD = re.compile(r"[^\W_]+")


@dataclass(frozen=True)
class Published:
    """A published file, and what it is about."""

    path: Path  # a file or folder
    key: Path | None  # the file that says what the first leaves open: pictures and classes by number, questions by id
    dataset: Dataset
    # sentences: the labels' expressions by frame, each with the names that it asks for
    sentences: Mapping[str, Mapping[str, tuple[str, ...]]]
    notes: list[str] = field(default_factory=list)  # for an adapter to add what the user should know
    # elsewhere: the pictures that the dataset does not hold, each with where the file names it
    elsewhere: list[str] = field(default_factory=list)

    @cached_property
    def content(self) -> Content:
        """Read the file as JSON, JSON lines or CSV; InputError for anything else."""
        return read_content(self.path)

    @cached_property
    def _frames(self) -> FrameNames:
        return FrameNames(self.dataset.frame_ids)

    @cached_property
    def _sizes(self) -> dict[str, tuple[int, int]]:
        return {}

    @cached_property
    def _texts(self) -> dict[str, dict[str, str]]:
        return {frame: {words(text): text for text in found} for frame, found in self.sentences.items()}

    def frame(self, picture: Picture, where: str) -> str | None:
        """Frame of a picture named at `where`; None, and noted, for an unknown picture.

        The adapter leaves out what is about such a picture. FrameUnusable where it may be of several frames.
        """
        found = self._frames.find(picture, where)
        if found is None:
            self.elsewhere.append(f"{where}, {picture}")
        return found

    def size(self, frame: str) -> tuple[int, int]:
        """Width and height of a frame, pixels; InputError for an unreadable frame."""
        if frame not in self._sizes:
            loaded = load_picture(self.dataset, frame)
            self._sizes[frame] = loaded.width, loaded.height
        return self._sizes[frame]

    def text(self, frame: str, candidates: Sequence[str]) -> str:
        """Expression of the labels in a question of any wording; else the first wording.

        "Point to the mug left of the laptop." has "mug left of the laptop"; of several the longest, if it is one.
        """
        known = self._texts.get(frame, {})
        asked = [words(text) for text in candidates]
        for text in asked:
            if text in known:
                return known[text]
        within = [short for short in known if any(short in text for text in asked)]
        longest = [short for short in within if len(short) == max(map(len, within))]
        return known[longest[0]] if len(longest) == 1 else candidates[0]


def words(text: str) -> str:
    """The words of a text, in small letters, with a space around each."""
    return f" {' '.join(_WORD.findall(text.casefold()))} "


@dataclass(frozen=True)
class PredictionFormat:
    """A published format of predictions."""

    # read: the header and the lines of a file, also as the dicts that `docs/predictions.md` describes
    read: Callable[[Published], tuple[Header | dict[str, Any], Iterable[Prediction | dict[str, Any]]]]
    recognises: Callable[[Content], bool]  # whether a file's content is of the format. Must be fast and must not raise.
    description: str  # one line
    level: int  # what its lines reach
    needs: str = ""  # what must be given besides, with --key; empty for nothing
