"""Depth from colour alone: each known network's contract end to end, where the camera comes from, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from depth_graphs import FOCAL, HEIGHT, WIDTH, plane, write_network, write_picture

from pipeline.datasets import open_dataset
from pipeline.datasets.depth.contract import network_names
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError

CAMERA = (FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    write_picture(tmp_path / "pictures" / "room.png")
    return tmp_path / "pictures"


def only(folder: Path, **options: object) -> Frame:
    dataset = open_dataset(folder, **options)
    return dataset.load(dataset.frame_ids[0])


def near(frame: Frame, share: float = 0.01) -> bool:
    """Whether the depth that there is is the plane's."""
    seen = frame.depth > 0
    return bool(seen.mean() > 0.8) and bool((np.abs(frame.depth / plane() - 1)[seen] < share).all())


FACTORS = {
    # What a camera of 80 pixels is in the network's input, of its canonical one.
    "metric3d-v2": 1000 / (FOCAL * 616 / HEIGHT),
    "depth-anything-3-metric": 300 / (FOCAL * (504 / WIDTH + 504 / HEIGHT) / 2),
}


@pytest.mark.parametrize("name", network_names())
def test_every_known_network_gives_metres(name: str, picture: Path, tmp_path: Path) -> None:
    size = (504, 504) if name == "depth-anything-3-metric" else None
    focal = FOCAL * 1536 / WIDTH if name == "depth-pro" else FOCAL
    file = write_network(tmp_path / "net.onnx", name, factor=FACTORS.get(name, 1.0), focal=focal, size=size)
    frame = only(picture, depth_model=f"{name}={file}", intrinsics=CAMERA)
    assert near(frame)
    assert frame.camera.fx == FOCAL
    assert name in frame.depth_source
    assert f"depth is {frame.depth_source}" in frame.notes
    assert (frame.depth[1] == 0).all() == (name in ("moge-2", "depth-anything-3-metric"))
    if name in ("moge-2", "depth-pro"):
        own = only(picture, depth_model=f"{name}={file}")
        assert near(own)
        assert own.camera.fx == pytest.approx(FOCAL, rel=0.01)
        assert own.camera.cx == (WIDTH - 1) / 2
        assert "the network's" in own.depth_source
    else:
        with pytest.raises(InputError, match=r"focal length is not known.*--intrinsics fx,fy,cx,cy"):
            open_dataset(picture, depth_model=f"{name}={file}")
