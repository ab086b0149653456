"""Rendered datasets: the same bytes by the same seed, written whole."""

from __future__ import annotations

import filecmp
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from room_checks import frame_of, room_of
from slow_cases import mostly_slow

from pipeline.geometry import Box3D
from pipeline.synthetic import dataset as dataset_module
from pipeline.synthetic import make_room, render, render_dataset
from pipeline.system import InputError, MissingExtra

SIZE: dict[str, Any] = {"width": 96, "height": 72}
MANY = render.CANDIDATES


def files_below(root: Path) -> list[str]:
    return sorted(str(path.relative_to(root)) for path in root.rglob("*") if path.is_file())


# Datasets


@pytest.fixture(scope="module", autouse=True)
def few_candidates() -> Iterator[None]:
    """Cameras are the best of few and not of many: choosing them costs most, and no test here is about them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipeline.synthetic.render.CANDIDATES", 6)
        yield


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("render") / "set"
    report = render_dataset(out, rooms=2, views=1, seed=3, **SIZE)
    assert (report.frames, report.rooms) == (2, 2)
    assert report.out == out
    return out


@pytest.mark.slow
def test_another_seed_gives_other_pictures(rendered: Path, tmp_path: Path) -> None:
    render_dataset(tmp_path / "other", rooms=1, views=1, seed=4, **SIZE)
    image = "000001/rgb/000000.jpg"
    assert (rendered / image).read_bytes() != (tmp_path / "other" / image).read_bytes()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_whatever_the_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Other processes know nothing of fewer candidates.
    monkeypatch.setattr("pipeline.synthetic.render.CANDIDATES", MANY)
    rendered = tmp_path / "one"
    render_dataset(rendered, rooms=2, views=2, seed=3, **SIZE)
    render_dataset(tmp_path / "two", rooms=2, views=2, seed=3, workers=2, **SIZE)
    names = files_below(rendered)
    assert names == files_below(tmp_path / "two")
    _, differ, errors = filecmp.cmpfiles(rendered, tmp_path / "two", names, shallow=False)
    assert (differ, errors) == ([], [])


def test_what_is_written_is_bop_and_agrees_with_the_room(rendered: Path) -> None:
    models = json.loads((rendered / "models" / "models_info.json").read_text())
    for number in (1, 2):
        scene = rendered / f"{number:06d}"
        room = make_room(3 * dataset_module.ROOMS_A_SEED + number - 1)
        cameras, gt, info = (
            json.loads((scene / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")
        )
        assert cameras.keys() == gt.keys() == info.keys() == {"0"}
        for image, camera in cameras.items():
            R, t = np.reshape(camera["cam_R_w2c"], (3, 3)), np.array(camera["cam_t_w2c"]) / 1000
            K = np.reshape(camera["cam_K"], (3, 3))
            depth = cv2.imread(str(scene / "depth" / f"{int(image):06d}.png"), cv2.IMREAD_UNCHANGED)
            assert depth is not None
            assert depth.dtype == np.uint16
            metres = depth * camera["depth_scale"] / 1000
            assert 0.5 < np.median(metres[metres > 0]) < 6
            assert len(gt[image]) == len(info[image]) >= 8
            union = np.zeros(depth.shape, dtype=int)
            for k, (entry, seen) in enumerate(zip(gt[image], info[image], strict=True)):
                stored = cv2.imread(str(scene / "mask_visib" / f"{int(image):06d}_{k:06d}.png"), 0)
                assert stored is not None
                mask = stored > 0
                union += mask
                assert mask.sum() == seen["px_count_visib"] >= 30
                assert 0 < seen["visib_fract"] <= 1
                v, u = np.nonzero(mask)
                assert seen["bbox_visib"] == [u.min(), v.min(), np.ptp(u) + 1, np.ptp(v) + 1]
                # The pose round trip: model -> camera -> world lands on an instance of that class.
                model = models[str(entry["obj_id"])]
                here = R.T @ (np.array(entry["cam_t_m2c"]) / 1000 - t)
                owner = min(room.instances, key=lambda i, here=here: float(np.linalg.norm(i.position - here)))
                assert np.linalg.norm(owner.position - here) < 1e-5
                assert owner.model.label == model["name"]
                turn = R.T @ np.reshape(entry["cam_R_m2c"], (3, 3))
                assert np.allclose(turn, owner.R, atol=1e-6)
                # The stored box holds what the noisy depth saw, up to its noise.
                low = np.array([model[f"min_{a}"] for a in "xyz"]) / 1000
                size = np.array([model[f"size_{a}"] for a in "xyz"]) / 1000
                z = metres[v, u]
                points = np.stack([(u - K[0, 2]) * z / K[0, 0], (v - K[1, 2]) * z / K[1, 1], z], -1)[z > 0]
                box = Box3D(R @ (owner.position + owner.R @ (low + size / 2)) + t, R @ owner.R, size)
                local = np.abs((points - box.center) @ box.R) - box.size / 2
                assert np.median(local.max(axis=1)) < 0.03
            assert union.max() == 1


@pytest.mark.slow
def test_visible_share_tells_hidden_things_from_open_ones() -> None:
    from pipeline.synthetic.raycast import silhouette

    frame = frame_of(1)
    room = room_of(1)
    for index in np.unique(frame.instances[frame.instances >= 0]):
        step, v, u = silhouette(room, int(index), frame.camera)
        inside = (v >= 0) & (v < 120) & (u >= 0) & (u < 160)
        whole = np.zeros((120, 160), dtype=bool)
        whole[v[inside], u[inside]] = True
        visible = frame.instances == index
        grid = np.zeros_like(visible)
        grid[::step, ::step] = True
        assert (visible & grid & ~whole).sum() <= 0.02 * visible.sum() + 1


def test_declares_its_world_up(rendered: Path) -> None:
    text = (rendered / "spatialviz.toml").read_text()
    assert "world_up = [0, 0, 1]" in text
    assert "seed = 3" in text
    assert "spatialviz render" in text


def test_refuses_a_folder_that_is_not_empty_and_leaves_it_alone(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        render_dataset(tmp_path, rooms=1, views=1, **SIZE)
    assert files_below(tmp_path) == ["note.txt"]
    with pytest.raises(InputError, match="file"):
        render_dataset(tmp_path / "note.txt", rooms=1, views=1, **SIZE)


@pytest.mark.parametrize(
    "bad", [{"rooms": 0}, {"views": 0}, {"seed": -1}, {"width": 4}, {"height": -480}, {"workers": 0}]
)
def test_refuses_arguments_without_sense(tmp_path: Path, bad: dict[str, int]) -> None:
    with pytest.raises(InputError):
        render_dataset(tmp_path / "set", **{"rooms": 1, "views": 1, **SIZE, **bad})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("failure", mostly_slow([KeyboardInterrupt, RuntimeError]))
def test_nothing_half_written_remains(tmp_path: Path, failure: type[BaseException]) -> None:
    def stop(done: int, total: int) -> None:
        assert any(tmp_path.iterdir())
        raise failure

    with pytest.raises(failure):
        render_dataset(tmp_path / "set", rooms=1, views=2, progress=stop, **SIZE)
    assert list(tmp_path.iterdir()) == []


def test_fills_an_empty_folder_and_reports_progress(tmp_path: Path) -> None:
    out = tmp_path / "set"
    out.mkdir()
    told: list[tuple[int, int]] = []
    report = render_dataset(out, rooms=1, views=2, progress=lambda done, total: told.append((done, total)), **SIZE)
    assert told == [(2, 2)]
    assert list(tmp_path.iterdir()) == [out]
    assert report.objects >= 16
    assert "laptop" in report.classes


def test_without_embree_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    with pytest.raises(MissingExtra, match=r"spatialviz\[render\]"):
        render_dataset(tmp_path / "set", rooms=1, views=1, seed=8, **SIZE)
    assert list(tmp_path.iterdir()) == []
