"""YCB-Video as distributed: colour, depth, label picture and `-meta.mat` of each frame in a folder.

https://rse-lab.cs.washington.edu/projects/posecnn/
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import inverse, or_note, rigid
from pipeline.datasets.files import as_floats, read_mat, readable
from pipeline.datasets.folder import FolderDataset, SceneFolder
from pipeline.datasets.pairing import Pair

OBJECTS = (
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "011_banana",
    "019_pitcher_base",
    "021_bleach_cleanser",
    "024_bowl",
    "025_mug",
    "035_power_drill",
    "036_wood_block",
    "037_scissors",
    "040_large_marker",
    "051_large_clamp",
    "052_extra_large_clamp",
    "061_foam_brick",
)
"""Its classes in the order of their numbers, from 1; `image_sets/classes.txt` has the same."""


class YcbVideoDataset(FolderDataset):
    """Frames of id `000001`, or `0001/000001` in the folder of all videos; the label picture gives masks and names.

    Intrinsics and the depth's unit stand in `-meta.mat`, and the camera's pose as world-to-camera; the objects' poses
    there are of models that are not beside them, so that they give no boxes.
    """

    format = "ycb-video"
    names: ClassVar = {number: name[4:].replace("_", " ") for number, name in enumerate(OBJECTS, start=1)}

    def _folders(self, root: Path) -> dict[str, Path]:
        return _scenes(root)

    def _pose(self, scene: SceneFolder, pair: Pair, notes: list[str]) -> np.ndarray | None:
        if pair.key not in scene.cameras:
            return None
        path = scene.files.root / scene.cameras[pair.key]

        def read() -> np.ndarray | None:
            found = read_mat(path, "rotation_translation_matrix").get("rotation_translation_matrix")
            if found is None:
                return None
            M = as_floats(found, 12, path, "rotation_translation_matrix").reshape(3, 4)
            return inverse(rigid(M[:, :3], M[:, 3]))

        return or_note(notes, "no camera pose: ", read)


def _scenes(root: Path) -> dict[str, Path]:
    if _is_scene(root):
        return {"": root}
    data = root / "data" if (root / "data").is_dir() else root
    return {name: data / name for name in readable(data)[0] if _is_scene(data / name)}


def _is_scene(folder: Path) -> bool:
    """Test whether the first files of a folder are a YCB-Video frame."""
    ends = {name.partition("-")[2] for name in readable(folder)[1][:12]}
    return {"depth.png", "label.png", "meta.mat"} <= ends


FORMAT = DatasetFormat(
    "ycb-video",
    "ycb-video: 000001-color.png, -depth.png, -label.png and -meta.mat, here or in <video>/",
    lambda root: bool(_scenes(root)),
    YcbVideoDataset,
)
