"""A small dataset of each format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from avd_writer import write_scan
from dataset_writers import (
    write_bop,
    write_folder,
    write_redwood,
    write_scannet,
    write_seven_scenes,
    write_sunrgbd,
    write_tum,
    write_votenet,
)
from semantic_abstraction_writer import write_view

WRITERS: dict[str, Callable[[Path], object]] = {
    "bop": lambda root: write_bop(root, {"000001": [1, 2]}),
    "7-scenes": lambda root: write_seven_scenes(root, 2),
    "tum": lambda root: write_tum(root, 2),
    "scannet": lambda root: write_scannet(root, [0, 1]),
    "redwood": lambda root: write_redwood(root, ["00000", "00001"]),
    "sunrgbd": lambda root: write_sunrgbd(root, ["a", "b"]),
    "sunrgbd-votenet": lambda root: write_votenet(root, ["000001", "000002"]),
    "avd": lambda root: write_scan(root, steps=1),
    "semantic-abstraction": lambda root: write_view(root / "00001|FloorPlan1_physics.hdf5", points=4000),
    "folder": lambda root: write_folder(root, [1, 2]),
}
"""What writes a dataset of each format into a folder."""
