"""Detic: masks pasted as detectron2 pastes them, names matched, boxes scaled back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto
from onnx_stubs import write_stub
from scenes import frame_of, upright

from pipeline.geometry import Frame
from pipeline.proposals import make_detector
from pipeline.proposals.class_names import read_class_names
from pipeline.proposals.detic import DeticDetector, paste_masks, resized_shape
from pipeline.system import InputError, UnknownClass

NAMES = ("cup", "dining_table", "hot dog", "cracker box", "dog", "cup")
FREE: dict[str, Any] = {"img": (TensorProto.FLOAT, (1, 3, "h", "w"))}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    return frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["cup"])


def detectron2_paste(masks: np.ndarray, boxes: np.ndarray, height: int, width: int) -> np.ndarray:
    """What `_do_paste_mask` of detectron2 does, over the whole picture."""
    torch = pytest.importorskip("torch")
    y = torch.arange(0, height, dtype=torch.float64) + 0.5
    x = torch.arange(0, width, dtype=torch.float64) + 0.5
    x0, y0, x1, y1 = torch.split(torch.as_tensor(boxes, dtype=torch.float64), 1, dim=1)
    y = (y[None] - y0) / (y1 - y0) * 2 - 1
    x = (x[None] - x0) / (x1 - x0) * 2 - 1
    grid = torch.stack(
        [x[:, None, :].expand(len(boxes), height, width), y[:, :, None].expand(len(boxes), height, width)], dim=3
    )
    values = torch.as_tensor(masks, dtype=torch.float64)[:, None]
    found = torch.nn.functional.grid_sample(values, grid, mode="bilinear", align_corners=False)
    return (found[:, 0] >= 0.5).numpy()


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(5, 60),
    width=st.integers(5, 60),
    cells=st.sampled_from([1, 7, 28]),
)
def test_masks_are_pasted_as_detectron2_does(seed: int, height: int, width: int, cells: int) -> None:
    random = np.random.default_rng(seed)
    corner = random.uniform(0, 0.8, (5, 2))
    end = corner + random.uniform(0.01, 1, (5, 2)) * (1 - corner)
    boxes = (np.concatenate([corner, end], axis=1) * np.array([width, height] * 2)).astype(np.float32)
    masks = random.random((5, cells, cells)).astype(np.float32)
    masks[0] = 1.0
    ours = paste_masks(masks, boxes, height, width)
    theirs = detectron2_paste(masks, boxes, height, width)
    # The two sum in another order: a value of just the threshold may fall on either side.
    assert (ours != theirs).sum() <= 1
    # A full mask fills all that is half a cell inside its box, and nothing outside of it.
    v, u = np.mgrid[:height, :width] + 0.5
    x0, y0, x1, y1 = boxes[0].astype(np.float64)
    edge_x, edge_y = (x1 - x0) / cells / 2 + 1e-6, (y1 - y0) / cells / 2 + 1e-6
    inner = (u > x0 + edge_x) & (u < x1 - edge_x) & (v > y0 + edge_y) & (v < y1 - edge_y)
    assert ours[0][inner].all()
    assert not ours[0][(u < x0) | (u > x1) | (v < y0) | (v > y1)].any()


def answer(boxes: list[list[float]], scores: list[float], classes: list[int]) -> dict[str, np.ndarray]:
    masks = np.zeros((len(boxes), 1, 28, 28), np.float32)
    masks[:, :, 7:21, 7:21] = 0.9
    return {
        "boxes": np.array(boxes, np.float32).reshape(-1, 4),
        "scores": np.array(scores, np.float32),
        "classes": np.array(classes, np.int64),
        "masks": masks,
    }


def named(path: Path) -> Path:
    path.with_suffix(".names.txt").write_text("\n".join(NAMES) + "\n", encoding="utf-8")
    return path


def test_names_scores_boxes_and_masks(tmp_path: Path, frame: Frame) -> None:
    height, width = resized_shape(frame.height, frame.width)
    assert (height, width) != (frame.height, frame.width)
    whole = [0.25 * width, 0.5 * height, 0.75 * width, 1.2 * height]
    found = answer([whole, [0, 0, 80, 80], [0, 0, 40, 40], [9, 9, 9, 30]], [0.5, 0.03, 0.019, 0.9], [5, 0, 0, 0])
    path = named(write_stub(tmp_path / "detic.onnx", FREE, found))
    detector = DeticDetector(path)
    assert detector.vocabulary == NAMES
    result = detector.detect(frame, ["cups"])
    # Both numbers of a name that stands twice; below 0.02 nothing; a box without area is none.
    assert result.labels == ("cup",)
    np.testing.assert_allclose(result.scores, [0.5, 0.03])
    assert result.ids.tolist() == [0, 1]
    expected = [0.25 * frame.width, 0.5 * frame.height, 0.75 * frame.width, frame.height]
    np.testing.assert_allclose(result.boxes[0], expected, atol=1e-3)
    assert result.masks is not None
    v, u = np.nonzero(result.masks[0])
    assert abs(u.min() - 0.375 * frame.width) <= 2
    assert abs(u.max() + 1 - 0.625 * frame.width) <= 2
    assert abs(v.min() - 0.625 * frame.height) <= 2
    assert len(DeticDetector(path, min_score=0.4).detect(frame, None)) == 1
    assert len(detector.detect(frame, ["dog"])) == 0
    with pytest.raises(UnknownClass, match="does not know the class 'zebra'"):
        detector.detect(frame, ["zebra"])
    assert len(make_detector("detic", model=path).detect(frame, ["cup"])) == 2


def test_the_input_is_what_detectron2_makes(tmp_path: Path, frame: Frame) -> None:
    from PIL import Image

    # (800, 1333) at most; detectron2 rounds each side by itself.
    for shape in ((480, 640), (1080, 1920), (640, 480), (100, 1000), (801, 799)):
        short, long = min(shape), max(shape)
        scale = 800 / short if 800 / short * long <= 1333 else 1333 / long
        assert resized_shape(*shape) == (int(shape[0] * scale + 0.5), int(shape[1] * scale + 0.5))
    # It scales twice, so that these are rounded down.
    assert [resized_shape(22, 124), resized_shape(1551, 2914)] == [(236, 1333), (709, 1333)]
    import onnx
    from onnx import helper, numpy_helper

    height, width = resized_shape(frame.height, frame.width)
    nodes = [
        helper.make_node("ReduceMean", ["img"], ["mean"], axes=[1, 2, 3], keepdims=0),
        helper.make_node("Div", ["mean", "many"], ["scores"]),
        *(helper.make_node("Identity", [f"{n}_value"], [n]) for n in ("boxes", "classes", "masks")),
    ]
    values = answer([[0, 0, 800, 800]], [0], [0])
    weights = [numpy_helper.from_array(values[n], f"{n}_value") for n in ("boxes", "classes", "masks")]
    weights.append(numpy_helper.from_array(np.array([255], np.float32), "many"))
    outputs = [
        helper.make_tensor_value_info(n, helper.np_dtype_to_tensor_dtype(values[n].dtype), list(values[n].shape))
        for n in ("boxes", "scores", "classes", "masks")
    ]
    given = helper.make_tensor_value_info("img", TensorProto.FLOAT, [1, 3, "h", "w"])
    graph = helper.make_graph(nodes, "mean", [given], outputs, weights)
    path = named(tmp_path / "mean.onnx")
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    resized = np.asarray(Image.fromarray(frame.rgb).resize((width, height), Image.Resampling.BILINEAR))
    score = DeticDetector(path, min_score=0).detect(frame, ["cup"]).scores[0]
    assert score == pytest.approx(resized.mean() / 255, rel=1e-5)


def test_the_class_names_stand_beside_the_model(tmp_path: Path, frame: Frame) -> None:
    path = write_stub(tmp_path / "detic.onnx", FREE, answer([[0, 0, 80, 80]], [0.5], [2]))
    with pytest.raises(InputError, match=r"class names of the Detic model are not known.*detic\.names\.txt"):
        DeticDetector(path)
    lvis = {"categories": [{"id": 3, "name": "c"}, {"id": 1, "name": "a"}, {"id": 2, "name": "b"}]}
    (tmp_path / "lvis_v1_val.json").write_text(json.dumps(lvis), encoding="utf-8")
    assert DeticDetector(path).vocabulary == ("a", "b", "c")
    other = tmp_path / "names.json"
    other.write_text('["x", "y", "z"]', encoding="utf-8")
    made = make_detector("detic", model=path, config=other)
    assert made.vocabulary == ("x", "y", "z")
    assert made.fingerprint() != DeticDetector(path).fingerprint()
    other.write_text('["x", "y"]', encoding="utf-8")
    with pytest.raises(InputError, match="not those of the model; got 2 names; expected more than 2"):
        make_detector("detic", model=path, config=other).detect(frame, None)


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("n.txt", "\ufeffmug\ncup\n"),
        ("n.json", '\ufeff["mug", "cup"]'),
        ("n.txt", "mug\r\ncup\r\n\r\n"),
    ],
)
def test_names_are_read_as_any_editor_writes_them(tmp_path: Path, file: str, content: str) -> None:
    (tmp_path / file).write_bytes(content.encode())
    assert read_class_names(tmp_path / file) == ("mug", "cup")
    (tmp_path / "odd.txt").write_bytes("mug\u2028x\ncup\n".encode())
    assert len(read_class_names(tmp_path / "odd.txt")) == 2


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        "{}",
        '{"categories": 3}',
        '{"categories": [{"id": 1}]}',
        "[1, 2]",
        "[",
        '["a", ""]',
        "null",
    ],
)
def test_a_file_without_names_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "names.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=r"names\.json"):
        read_class_names(path)


def test_outputs_that_do_not_fit_are_refused(tmp_path: Path, frame: Frame) -> None:
    for wrong in (
        {"scores": np.zeros(3, np.float32)},
        {"masks": np.zeros((2, 1, 28, 28), np.float32)},
        {"classes": np.array([77], np.int64)},
        {"classes": np.array([-1], np.int64)},
        {"boxes": np.full((1, 4), np.nan, np.float32)},
    ):
        path = named(write_stub(tmp_path / "detic.onnx", FREE, answer([[0, 0, 80, 80]], [0.5], [0]) | wrong))
        with pytest.raises(InputError) as caught:
            DeticDetector(path).detect(frame, None)
        assert "\n" not in str(caught.value)


def test_nothing_found_is_no_error(tmp_path: Path, frame: Frame) -> None:
    path = named(write_stub(tmp_path / "detic.onnx", FREE, answer([], [], [])))
    assert len(DeticDetector(path).detect(frame, None)) == 0
