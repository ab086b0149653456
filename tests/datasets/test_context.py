"""The mesh of the frames around a frame: where it lies, what it leaves out, what it needs."""

from __future__ import annotations

import importlib
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.datasets import Dataset, demo_path, export_mesh, fuse_context, open_dataset
from pipeline.datasets.scene_mesh import HIDDEN_M, ContextMesh, neighbours
from pipeline.geometry import project, to_world
from pipeline.system import FrameUnusable, InputError, MissingExtra

needs_open3d = pytest.mark.usefixtures("open3d_installed")


@pytest.fixture(scope="module")
def open3d_installed() -> None:
    """Skips where the extra is missing; a run that must not skip sets SPATIALVIZ_REQUIRE_EXTRAS."""
    try:
        importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        if os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS"):
            raise
        pytest.skip(f"Open3D is not installed: {error}")


@pytest.fixture(scope="module")
def demo() -> Dataset:
    return open_dataset(demo_path())


@pytest.fixture(scope="module")
def fused(demo: Dataset, open3d_installed: None) -> ContextMesh:
    return fuse_context(demo, demo.load("000002/000000"))


def test_neighbours_are_of_the_same_sequence_and_nearest_first(demo: Dataset) -> None:
    assert neighbours(demo, "000002/000000", 12) == ("000002/000001", "000002/000002")
    assert neighbours(demo, "000002/000002", 1) == ("000002/000001",)


@needs_open3d
def test_the_mesh_lies_on_what_the_other_frames_saw(demo: Dataset, fused: ContextMesh) -> None:
    assert fused.frames == 2
    assert len(fused.faces) > 10_000
    frame = demo.load("000002/000000")
    assert frame.camera.T_world_camera is not None
    world = to_world(fused.vertices.astype(np.float64), frame.camera.T_world_camera)
    explained = np.zeros(len(world), bool)
    for other in ("000002/000001", "000002/000002"):
        seen = demo.load(other)
        assert seen.camera.T_world_camera is not None
        local = to_world(world, np.linalg.inv(seen.camera.T_world_camera))
        pixel = np.round(np.nan_to_num(project(local, seen.camera), nan=-1.0)).astype(int)
        inside = ((pixel >= 0) & (pixel < [seen.width, seen.height])).all(axis=1)
        depth = np.zeros(len(world))
        depth[inside] = seen.depth[pixel[inside, 1], pixel[inside, 0]]
        explained |= (depth > 0) & (np.abs(depth - local[:, 2]) < 0.06)
    assert explained.mean() > 0.9


@needs_open3d
def test_the_mesh_leaves_out_what_the_frame_itself_shows(demo: Dataset, fused: ContextMesh) -> None:
    frame = demo.load("000002/000000")
    pixel = np.round(np.nan_to_num(project(fused.vertices, frame.camera), nan=-1.0)).astype(int)
    inside = ((pixel >= 0) & (pixel < [frame.width, frame.height])).all(axis=1)
    depth = frame.depth[pixel[inside, 1], pixel[inside, 0]]
    z = fused.vertices[inside, 2]
    assert not ((depth > 0) & (z < depth + HIDDEN_M)).any()
    assert fused.faces.min() == 0
    assert fused.faces.max() == len(fused.vertices) - 1


def _no_open3d(name: str) -> object:
    raise ImportError(f"no module named {name}")


def test_without_open3d_the_error_says_how_to_get_it(demo: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib, "import_module", _no_open3d)
    with pytest.raises(MissingExtra, match=r"spatialviz\[open3d\]"):
        fuse_context(demo, demo.load("000001/000000"))


def test_a_frame_without_a_pose_has_no_context(demo: Dataset) -> None:
    frame = demo.load("000001/000000")
    lost = replace(frame, camera=replace(frame.camera, T_world_camera=None))
    with pytest.raises(FrameUnusable, match="no pose"):
        fuse_context(demo, lost)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_an_exported_mesh_reads_back(tmp_path: Path, suffix: str) -> None:
    import trimesh

    vertices = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 2]], np.float32)
    mesh = ContextMesh(vertices, np.array([[0, 1, 2], [1, 3, 2]], np.int32), np.full((4, 3), 90, np.uint8), 1)
    path = tmp_path / f"room{suffix}"
    export_mesh(mesh, path)
    read: Any = trimesh.load(path, force="mesh", process=False)
    np.testing.assert_allclose(np.sort(read.vertices, axis=0), np.sort(vertices, axis=0), atol=1e-6)
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_a_mesh_of_another_kind_or_place_is_refused(tmp_path: Path) -> None:
    mesh = ContextMesh(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8), 1)
    with pytest.raises(InputError, match="ply"):
        export_mesh(mesh, tmp_path / "room.txt")
    with pytest.raises(InputError, match="written"):
        export_mesh(mesh, tmp_path / "nowhere" / "room.ply")
