"""Label pictures: a number per pixel, 0 for none, with names of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.datasets.files import numbered_lines
from pipeline.datasets.images import read_numbers
from pipeline.geometry.frame import Annotation
from pipeline.geometry.masks import mask_box
from pipeline.system.errors import InputError

NAME_FILES = ("labels.txt", "classes.txt", "image_sets/classes.txt", "label_names.txt")


@dataclass(frozen=True)
class LabelPicture:
    """Label picture of a frame."""

    path: Path
    names: Mapping[int, str]  # Of the numbers; one without a name is "object"

    def annotations(self, size: tuple[int, int], notes: list[str]) -> tuple[Annotation, ...]:
        """A mask for each number of a frame of (height, width) pixels; a note where the picture is broken."""
        try:
            numbers = read_numbers(self.path)
        except InputError as error:
            notes.append(f"no labels, {self.path.name}: {error.what}")
            return ()
        if numbers.shape != size:
            notes.append(f"no labels, {self.path.name}: not a picture of {size[1]}x{size[0]} with one channel")
            return ()
        found = []
        for index, number in enumerate(np.unique(numbers[numbers > 0]).tolist()):
            mask = numbers == number
            name = self.names.get(number, "object")
            found.append(Annotation(index, name, np.array(mask_box(mask)), mask, instance=number))
        return tuple(found)


def read_label_names(root: Path) -> dict[int, str]:
    """Names by number: lines "number name", or names alone counted from 1; empty without a file."""
    for name in NAME_FILES:
        if not (root / name).is_file():
            continue
        lines = [line.split(maxsplit=1) for _, line in numbered_lines(root / name)]
        if all(len(words) == 2 and words[0].isdecimal() for words in lines):
            return {int(number): text for number, text in lines}
        return {number: " ".join(words) for number, words in enumerate(lines, start=1)}
    return {}
