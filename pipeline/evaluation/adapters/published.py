"""Files that other pipelines publish, before they are read: what they are about, and what a format of them is."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.predictions import Header, Prediction
from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture
from pipeline.datasets.frame_names import FrameNames, Picture
from pipeline.evaluation.place_reading import PlaceReading
from pipeline.language.naming import match
from pipeline.system.frozen import dataclass
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
    # labelled: by frame the names and boxes ((N, 4) float64, pixels) of its labelled things
    labelled: Mapping[str, tuple[Sequence[str], np.ndarray]] = field(default_factory=dict)
    # places: what the user says of units and orders of answers
    places: Sequence[PlaceReading] = ()

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

    def things(self, frame: str, name: str | None = None) -> np.ndarray:
        """Boxes ((N, 4) float64, shares of the picture) of a frame's labelled things of a name, or of all of them."""
        names, boxes = self.labelled.get(frame, ((), np.zeros((0, 4))))
        meant = names if name is None else match(name, tuple(dict.fromkeys(names)))
        chosen = [k for k, known in enumerate(names) if known in meant]
        return np.ascontiguousarray(boxes[chosen] / np.tile(self.size(frame), 2)) if chosen else np.zeros((0, 4))

    def text(self, frame: str, candidates: Sequence[str]) -> str:
        """Expression of the labels in a question of any wording; else the first wording.

        "Point to the mug left of the laptop." has "mug left of the laptop"; of several the longest, if it is one. A
        question that was cut is the one expression that begins with it, which is noted.
        """
        known = self._texts.get(frame, {})
        asked = [words(text) for text in candidates]
        for text in asked:
            if text in known:
                return known[text]
        within = [short for short in known if any(short in text for text in asked)]
        longest = [short for short in within if len(short) == max(map(len, within))]
        if len(longest) == 1:
            return known[longest[0]]
        whole = {full for full in known for text in asked if len(text) > len(full) / 2 and full.startswith(text[:-1])}
        if len(whole) != 1:
            return candidates[0]
        meant = known[whole.pop()]
        self.notes.append(f"frame {frame}: the question {candidates[0]!r} was cut, and is taken as {meant!r}")
        return meant


def words(text: str) -> str:
    """The words of a text, in small letters, with a space around each."""
    return f" {' '.join(_WORD.findall(text.casefold()))} "


@dataclass(frozen=True)
class PredictionFormat:
    """A published format of predictions.

    >>> def read(published: Published) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    ...     lines = [line.split(";") for line in published.path.read_text().splitlines()]
    ...     return {"system": "mine"}, [{"frame": frame, "text": text, "answer": None} for frame, text in lines]
    >>> PredictionFormat(read, lambda content: False, "frame; question", level=0).level
    0
    """

    # read: the header and the lines of a file, also as the dicts that `docs/predictions.md` describes
    read: Callable[[Published], tuple[Header | dict[str, Any], Iterable[Prediction | dict[str, Any]]]]
    recognises: Callable[[Content], bool]  # whether a file's content is of the format. Must be fast and must not raise.
    description: str  # one line
    level: int  # what its lines reach
    needs: str = ""  # what must be given besides, with --key; empty for nothing
