"""Frames by picture names or numbers in other programs' files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import PurePosixPath

from pipeline.system.errors import FrameUnusable, require

Picture = str | int
"""A path or file name, or a number."""


def fit(frame_id: str, picture: Picture) -> int:
    """Match score of a picture and a frame; 0 for no match.

    Strongest is the whole id; then the id's last part as the file's name, surer with each other part among the folders;
    then the whole id among the folders; then a file name that is the same number; then a bare number.
    """
    *scene, last = frame_id.split("/")
    if isinstance(picture, int):
        return int(last.isdecimal() and int(last) == picture)
    path = PurePosixPath(picture.replace("\\", "/"))
    folders, stem = path.parts[:-1], path.stem
    if frame_id in (str(path), str(path.with_name(stem))):
        return 1000
    known = sum(1 if part in folders else -1 for part in scene)
    if last in (stem, path.name):
        return 300 + known
    if f"/{frame_id}/" in f"/{'/'.join(folders)}/":
        return 200
    return 100 + known if stem.isdecimal() and last.isdecimal() and int(stem) == int(last) else 0


class FrameNames:
    """The frames of a dataset, to be found by pictures' names.

    Parameters
    ----------
    ids : sequence of str
        All frames that a picture may mean.

    Examples
    --------
    >>> from pipeline.datasets import FrameNames
    >>> names = FrameNames(["000001/000000", "000001/000001"])
    >>> names.find("renders/000001/rgb/000001.jpg")
    '000001/000001'
    """

    def __init__(self, ids: Sequence[str]) -> None:
        self._known = frozenset(ids)
        self._alike: defaultdict[Picture | tuple[str, str], list[str]] = defaultdict(list)
        for frame_id in ids:
            *scene, last = frame_id.split("/")
            for key in (last, *((part, last) for part in scene)):
                self._alike[key].append(frame_id)
            if last.isdecimal():
                self._alike[int(last)].append(frame_id)

    def find(self, picture: Picture, where: str = "") -> str | None:
        """Frame of a picture named in a file, or None.

        Raises
        ------
        FrameUnusable
            Several frames fit equally well.
        """
        if picture in self._known:
            return str(picture)
        fits = {frame_id: fit(frame_id, picture) for frame_id in self._near(picture)}
        best = max(fits.values(), default=0)
        found = [frame_id for frame_id, how in fits.items() if best and how == best]
        require(
            len(found) <= 1,
            f"{where and f'{where}: '}the picture {picture!r} may be of several frames",
            got=" and ".join(found[:2]),
            expected="the frame's whole id, as in SCENE/FRAME.png",
            error=FrameUnusable,
        )
        return found[0] if found else None

    def _near(self, picture: Picture) -> list[str]:
        if isinstance(picture, int):
            return self._alike.get(picture, [])
        path = PurePosixPath(picture.replace("\\", "/"))
        *folders, name = path.parts or ("",)
        # Frames of one number stand in many scenes: those whose scene is named too go first.
        scenes = {(folder, last) for folder in folders for last in (path.stem, name)}
        others = {*path.parts, path.stem, *([int(path.stem)] if path.stem.isdecimal() else [])}
        return self._all(scenes) or self._all(others)

    def _all(self, keys: Iterable[Picture | tuple[str, str]]) -> list[str]:
        return list(dict.fromkeys(i for key in keys if key in self._alike for i in self._alike[key]))
