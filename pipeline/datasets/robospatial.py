"""RoboSpatial-Home in the layout of the download script: `annotations.json` with `images/`, an item per picture with
depth.

https://github.com/chanhee-luke/RoboSpatial-Eval (download_benchmark.py). Neither the camera nor the depth's unit is in
the files: they are asked for. The tables of https://huggingface.co/datasets/chanhee-luke/RoboSpatial-Home, as they are
published, are opened as `parquet`.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import NOTHING
from pipeline.datasets.recording import Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.system.errors import InputError, as_input_error, first_line, require
from pipeline.system.safe_files import opened, read_json

FILE = "annotations.json"
KEYS = ("category", "question", "answer", "img")
_HEAD = 4096


class RoboSpatialDataset(Recording):
    """Frames of the items with depth; the id is the picture's name without `img_`: "context_0"."""

    format = "robospatial"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        entries = robospatial_entries(root / FILE)
        self._files = {item_name(e["img"]): (e["img"], e["depth_image"]) for e in entries if e.get("depth_image")}
        self.frame_ids = tuple(self._files)
        require(self.frame_ids, "no item has a depth image", path=root / FILE)
        seen = f"{len(self._files)} items with depth"
        self._ask_for(seen, NOTHING)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        color, depth = self._found(self._files, frame_id)
        return Listed(self.root / color, self.root / depth)


def item_name(picture: str) -> str:
    """ "context_0" of "images/img_context_0.png"."""
    return PurePosixPath(picture.replace("\\", "/")).stem.removeprefix("img_")


def robospatial_entries(path: Path) -> list[dict[str, Any]]:
    """Items of `annotations.json`, or of a file of answers in the same form."""
    with as_input_error("the items cannot be read", OSError, ValueError, got=first_line, path=path):
        entries = read_json(path)
    require(isinstance(entries, list) and entries, "no list of items", got=type(entries).__name__, path=path)
    for number, entry in enumerate(entries):
        lacks = next((k for k in KEYS if not isinstance(entry, dict) or not isinstance(entry.get(k), str)), None)
        require(lacks is None, f"item {number} lacks its {lacks}", expected=", ".join(KEYS), path=path)
        for name in ("img", "depth_image", "mask"):
            # A list of items from elsewhere must not read other files.
            inside = PurePosixPath(str(entry.get(name) or ""))
            leaves = inside.is_absolute() or ".." in inside.parts
            require(not leaves, f"item {number}: no path in the folder", got=str(inside), path=path)
    return entries


def _recognises(root: Path) -> bool:
    try:
        with opened(root / FILE, "unpacked") as file:
            head = file.read(_HEAD).decode("utf-8", "replace")
    except (OSError, InputError):
        return False
    return all(f'"{key}"' in head for key in KEYS)


FORMAT = DatasetFormat("robospatial", f"robospatial: {FILE} and images/", _recognises, RoboSpatialDataset)
