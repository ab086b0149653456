"""Pictures without depth, for `--depth-model`: a folder of them, perhaps with poses and cameras, or a single one."""

from __future__ import annotations

from pathlib import Path

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.folder import FolderDataset
from pipeline.datasets.pairing import COLOR_SUFFIXES, Files, files_by_role
from pipeline.system.errors import needed


class PicturesDataset(FolderDataset):
    """Colour alone; poses, camera files and label pictures as in any recording in folders."""

    format = "pictures"

    def _files(self, folder: Path) -> Files:
        if folder.is_file():
            return Files(folder.parent, True, {"color": [folder.name]})
        return needed(files_by_role(folder, depth=False), "no pictures", path=folder)

    def _check(self) -> None:
        """Check nothing: colour alone has no unit, and the network or the user gives the focal length."""


def _recognised(root: Path) -> bool:
    return root.suffix.lower() in COLOR_SUFFIXES if root.is_file() else files_by_role(root, depth=False) is not None


FORMAT = DatasetFormat("pictures", "pictures: colour alone, with --depth-model", _recognised, PicturesDataset)
