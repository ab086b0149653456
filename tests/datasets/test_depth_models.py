"""Depth from colour alone: each known network's contract end to end, where the camera comes from, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from depth_graphs import FOCAL, HEIGHT, WIDTH, plane, write_network, write_picture

from pipeline.datasets import dataset_notes, network_names, open_dataset
from pipeline.datasets.depth import estimator
from pipeline.geometry import Frame
from pipeline.system import InputError, known_models

CAMERA = (FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    write_picture(tmp_path / "pictures" / "room.png")
    return tmp_path / "pictures"


def only(folder: Path, **options: Any) -> Frame:
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
        assert own.depth_source.endswith("focal length by the network")
    else:
        with pytest.raises(InputError, match=r"focal length is not known.*--intrinsics fx,fy,cx,cy"):
            open_dataset(picture, depth_model=f"{name}={file}")


@pytest.fixture(scope="module")
def indoor(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A network of metres that says nothing of the camera."""
    name = "depth-anything-v2-metric-indoor"
    return f"{name}={write_network(tmp_path_factory.mktemp('indoor') / 'net.onnx', name)}"


@pytest.fixture(scope="module")
def moge(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A network that gives the camera too, told by its outputs alone."""
    return str(write_network(tmp_path_factory.mktemp("moge") / "net.onnx", "moge-2"))


def test_the_focal_length_of_exif_is_used(tmp_path: Path, indoor: str, moge: str) -> None:
    write_picture(tmp_path / "room.png", mm=26)
    wanted = 26 * np.hypot(HEIGHT, WIDTH) / np.hypot(36, 24)
    for model in (indoor, moge):
        frame = only(tmp_path / "room.png", depth_model=model)
        assert frame.camera.fx == pytest.approx(wanted, rel=1e-4)
        assert any("EXIF, 26 mm as of 35 mm film" in note for note in frame.notes)
        assert frame.depth_source.endswith("focal length of the camera")
    told = only(tmp_path / "room.png", depth_model=indoor, intrinsics=CAMERA)
    assert told.camera.fx == FOCAL
    assert not any("EXIF" in note for note in told.notes)


def test_a_picture_stands_upright(tmp_path: Path, indoor: str) -> None:
    write_picture(tmp_path / "room.png", mm=26, turned=6)
    assert only(tmp_path / "room.png", depth_model=indoor).depth.shape == (WIDTH, HEIGHT)


def test_a_large_picture_is_made_smaller_with_its_camera(tmp_path: Path, indoor: str) -> None:
    write_picture(tmp_path / "room.png", height=120, width=4000, mm=26)
    stated = only(tmp_path / "room.png", depth_model=indoor)
    told = only(tmp_path / "room.png", depth_model=indoor, intrinsics=(4000, 4000, 1999.5, 59.5))
    assert (told.width, told.height) == (1600, 48)
    assert (told.camera.fx, told.camera.cx) == pytest.approx((1600, 799.5))
    assert stated.camera.fx == pytest.approx(26 * np.hypot(1600, 48) / np.hypot(36, 24), rel=1e-4)
    assert "colour of 4000x120 is resized to 1600x48 before its depth is estimated" in told.notes
    assert np.abs(told.depth / plane(48, 1600) - 1).max() < 0.01


@pytest.mark.slow
def test_depth_of_another_focal_length_is_in_proportion(picture: Path, tmp_path: Path) -> None:
    file = write_network(tmp_path / "net.onnx", "depth-pro", focal=FOCAL * 1536 / WIDTH)
    own = only(picture, depth_model=str(file))
    other = only(picture, depth_model=str(file), intrinsics=(2 * FOCAL, *CAMERA[1:]))
    assert np.allclose(other.depth, 2 * own.depth, rtol=1e-4)


def test_an_estimate_is_made_once(picture: Path, indoor: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first = only(picture, depth_model=indoor, intrinsics=CAMERA)

    def never(*_: object) -> None:
        raise AssertionError("the network ran again")

    monkeypatch.setattr(estimator, "run_session", never)
    assert np.array_equal(only(picture, depth_model=indoor, intrinsics=CAMERA).depth, first.depth)


def test_a_network_of_ones_own_is_described_beside_it(picture: Path, tmp_path: Path) -> None:
    file = write_network(tmp_path / "own.onnx", "depth-anything-v2-metric-indoor")
    described = tmp_path / "own.toml"
    described.write_text('[input]\nmean = [0.485, 0.456, 0.406]\nstd = [0.229, 0.224, 0.225]\nfit = "stretch"\n')
    with pytest.raises(InputError, match=r"wrong at output.*own\.toml"):
        open_dataset(picture, depth_model=str(file))
    with described.open("a") as text:
        text.write('[output]\ndepth = "depth"\n')
    assert near(only(picture, depth_model=str(file), intrinsics=CAMERA))
    described.write_text(described.read_text().replace('"depth"', '"metres"'))
    file.touch()
    with pytest.raises(InputError, match=r"the model has no output metres; got depth.*own\.toml"):
        open_dataset(picture, depth_model=str(file), intrinsics=CAMERA)
    described.write_text(described.read_text() + "speed = 1\n")
    with pytest.raises(InputError, match=r"wrong at output\.speed; got a field of another name; expected one of depth"):
        open_dataset(picture, depth_model=str(file))
    for line, words in (
        ("size = [1, 2]", r"at input\.size\.0; got 1; expected at least 8"),
        ("mean = [0, 1]", r"at input\.mean; got \[0, 1\]; expected 3 values"),
        ("scale = nan", r"at input\.scale; got NaN; expected a finite number"),
        ('fit = "crop"', r"""at input\.fit; got "crop"; expected 'letterbox', """),
        ("pad = 300", r"at input\.pad; got 300; expected at most 255 or a list"),
    ):
        described.write_text(f'[input]\n{line}\n[output]\ndepth = "depth"\n')
        with pytest.raises(InputError, match=f"{words}.*own\\.toml"):
            open_dataset(picture, depth_model=str(file))


def test_what_is_not_used_says_why(picture: Path, tmp_path: Path, moge: str) -> None:
    relative = write_network(tmp_path / "vits.onnx", "depth-anything-v2-metric-indoor")
    nan = write_network(tmp_path / "nan.onnx", "moge-2", nan=True)
    for model, words in (
        ("unidepth-v2=x.onnx", "CC BY-NC"),
        ("someone/UniDepth-onnx", "CC BY-NC"),
        (str(tmp_path / "vggt.onnx"), "relative"),
        ("depth-of-dreams", "no such depth model.*moge-2"),
        (str(relative), r"nothing says how.*metres.*NAME=FILE\.onnx.*relative depth"),
        (f"metric3d-v2={moge}", "other inputs than"),
        ("depth-anything-v2-metric-indoor", r"not on the model hub.*https://github\.com/fabio-sim"),
        (str(tmp_path / "gone.onnx"), "there is no model file"),
    ):
        with pytest.raises(InputError, match=f"(?s){words}"):
            open_dataset(picture, depth_model=model)
    with pytest.raises(InputError, match="'points' holds NaN"):
        only(picture, depth_model=str(nan))


def test_measured_depth_is_replaced_and_that_is_said(tmp_path: Path, indoor: str) -> None:
    for role in ("color", "depth"):
        (tmp_path / role).mkdir()
    write_picture(tmp_path / "color" / "1.png")
    assert cv2.imwrite(str(tmp_path / "depth" / "1.png"), np.full((HEIGHT, WIDTH), 3000, np.uint16))
    measured = open_dataset(tmp_path, intrinsics=CAMERA, depth_scale=1000)
    assert measured.load("1").depth_source == ""
    dataset = open_dataset(tmp_path, intrinsics=CAMERA, depth_model=indoor)
    assert near(dataset.load("1"))
    assert dataset_notes(dataset) == ("depth is estimated: none that a sensor measured is used",)


def test_the_option_is_named_where_it_would_help(tmp_path: Path, moge: str) -> None:
    write_picture(tmp_path / "rgb" / "1.png")
    (tmp_path / "pose").mkdir()
    (tmp_path / "pose" / "1.txt").write_text("1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    for path in (tmp_path, tmp_path / "rgb" / "1.png"):
        with pytest.raises(InputError, match="--depth-model NAME"):
            open_dataset(path)
    frame = only(tmp_path, depth_model=moge)
    assert frame.camera.T_world_camera is not None
    assert near(frame)


def test_pictures_are_looked_at_without_a_focal_length(picture: Path, indoor: str) -> None:
    frame = only(picture, depth_model=indoor, browse=True)
    assert frame.camera.untold == ("--intrinsics fx,fy,cx,cy",)
    assert any("nothing can be measured" in note for note in frame.notes)


def test_every_known_network_is_in_the_catalogue() -> None:
    known = {m.option for m in known_models() if m.option.startswith("--depth-model ")}
    assert known == {f"--depth-model {name}" for name in network_names()}
