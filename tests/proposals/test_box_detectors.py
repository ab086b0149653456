"""Detectors of boxes described in a TOML file: every form against a plain reading of it, PicoDet on real pictures."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto
from onnx_stubs import write_stub
from scenes import frame_of, upright

from pipeline.datasets import open_dataset
from pipeline.geometry import Frame, iou_2d, place_picture
from pipeline.proposals import make_detector
from pipeline.proposals.box_detector import BoxDetector, BoxInput, read_box_model
from pipeline.system import InputError

EXAMPLES = Path(read_box_model.__code__.co_filename).with_name("detectors")
PICTURE: dict[str, Any] = {"image": (TensorProto.FLOAT, (1, 3, 64, 128))}
NAMES = 'names = ["cup", "table"]\n'


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    """A picture of 640 x 480."""
    camera = frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["cup"]).camera
    rgb = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    return Frame("frame", rgb, np.ones((480, 640), np.float32), replace(camera, height=480, width=640))


def detector(
    folder: Path, toml: str, outputs: Mapping[str, np.ndarray], inputs: Mapping[str, Any] | None = None
) -> BoxDetector:
    path = write_stub(folder / "model.onnx", inputs or PICTURE, outputs)
    (folder / "model.toml").write_text(toml, encoding="utf-8")
    return BoxDetector(path)


def array(*rows: list[float]) -> np.ndarray:
    return np.array(rows, np.float32)


# One box, from (32, 16) to (64, 48) in an input of 128 x 64, in every way it may be written.
# Letterboxed, the picture is 85 x 64 and begins at 21: 640 / 85 picture pixels for one of the input.
STRETCHED = [160.0, 120.0, 320.0, 360.0]
CORNERS, CENTRE, SIZED = [32.0, 16, 64, 48], [48.0, 32, 32, 32], [32.0, 16, 32, 32]
SHARES = [0.25, 0.25, 0.5, 0.75]
STRETCH = NAMES + '[input]\nfit = "stretch"\n[output]\n'


@pytest.mark.parametrize(
    ("said", "outputs"),
    [
        ('form = "rows"\nrows = "o"', {"o": array([*CORNERS, 0.1, 0.75])[None]}),
        ('form = "rows"\nrows = "o"', {"o": array([*CORNERS, 0.1, 0.75])[None].transpose(0, 2, 1)}),
        ('form = "rows"\nrows = "o"\nbox = "cxcywh"', {"o": array([*CENTRE, 0.1, 0.75])}),
        ('form = "rows"\nrows = "o"\nbox = "xywh"', {"o": array([*SIZED, 0.1, 0.75])}),
        ('form = "rows"\nrows = "o"\nbox = "yxyx"', {"o": array([16, 32, 48, 64, 0.1, 0.75])}),
        (
            'form = "rows"\nrows = "o"\ncolumns = ["box", "objectness", "scores"]',
            {"o": array([*CORNERS, 0.75, 0.1, 1.0])},
        ),
        ('form = "rows"\nrows = "o"\ncolumns = ["class", "score", "box"]', {"o": array([1, 0.75, *CORNERS])}),
        ('form = "rows"\nrows = "o"\nactivation = "sigmoid"', {"o": array([*CORNERS, -5, np.log(3)])}),
        ('form = "rows"\nrows = "o"\nactivation = "softmax"', {"o": array([*CORNERS, 0, np.log(3)])}),
        ('form = "rows"\nrows = "o"\nbackground = "last"', {"o": array([*CORNERS, 0.1, 0.75, 0.15])}),
        ('form = "rows"\nrows = "o"\nbackground = "first"', {"o": array([*CORNERS, 0.15, 0.1, 0.75])}),
        (
            'form = "separate"\nboxes = "b"\nscores = "s"\nunits = "share"',
            {"b": array(SHARES)[None], "s": array([0.1, 0.75])[None]},
        ),
        ('form = "separate"\nboxes = "b"\nscores = "s"', {"b": array(CORNERS)[None], "s": array([0.1], [0.75])[None]}),
        (
            'form = "separate"\nboxes = "b"\nscores = "s"\nclasses = "c"\nunits = "picture"',
            {"b": array(STRETCHED)[None], "s": array([0.75]), "c": np.array([[1]], np.int64)},
        ),
        (
            'form = "separate"\nboxes = "b"\nscores = "s"\nclasses = "c"',
            {"b": array(CORNERS, CORNERS)[None], "s": array([0.75, 0.9]), "c": np.array([[1, -1]], np.int32)},
        ),
    ],
)
def test_every_form_gives_the_same_box(
    tmp_path: Path, frame: Frame, said: str, outputs: Mapping[str, np.ndarray]
) -> None:
    found = detector(tmp_path, STRETCH + said, outputs).detect(frame, None)
    assert [found.label(i) for i in range(len(found))] == ["table"]
    np.testing.assert_allclose(found.boxes, [STRETCHED], atol=1e-3)
    np.testing.assert_allclose(found.scores, [0.75], atol=1e-6)
    assert found.masks is None
    assert found.ids.tolist() == [0]


@pytest.mark.parametrize(("fit", "left"), [("letterbox", 21), ("letterbox-top-left", 0)])
def test_boxes_come_out_of_the_letterbox(tmp_path: Path, frame: Frame, fit: str, left: int) -> None:
    toml = NAMES + f'[input]\nfit = "{fit}"\n[output]\nform = "rows"\nrows = "o"'
    found = detector(tmp_path, toml, {"o": array([left + 17, 16, left + 34, 48, 0.9, 0.1])}).detect(frame, ["cups"])
    np.testing.assert_allclose(found.boxes, [[17 * 640 / 85, 120, 34 * 640 / 85, 360]], rtol=1e-5)


def test_the_input_is_made_as_it_is_said() -> None:
    random = np.random.default_rng(0)
    rgb = random.integers(0, 256, (20, 40, 3), np.uint8)
    config = BoxInput(colour="BGR", scale=0.5, mean=(1, 2, 3), std=(4, 5, 6), fit="letterbox-top-left", pad=7)
    tensor, placement = place_picture(rgb, 40, 40, config)
    assert tensor.shape == (1, 3, 40, 40)
    assert tensor.dtype == np.float32
    assert (placement.left, placement.top, placement.scale_x, placement.scale_y) == (0, 0, 1, 1)
    for channel in range(3):
        mean, std = config.mean[channel], config.std[channel]
        expected = (rgb[..., 2 - channel] * 0.5 - mean) / std
        np.testing.assert_allclose(tensor[0, channel, :20], expected, rtol=1e-5)
        np.testing.assert_allclose(tensor[0, channel, 20:], (3.5 - mean) / std, rtol=1e-5)
    last, _ = place_picture(rgb, 40, 40, config.model_copy(update={"layout": "NHWC"}))
    np.testing.assert_array_equal(last.transpose(0, 3, 1, 2), tensor)


def test_the_inputs_reach_the_network(tmp_path: Path, frame: Frame) -> None:
    """The network gives its other inputs back as a box: width, height of the picture, of the input, and the scales."""
    import onnx
    from onnx import helper, numpy_helper

    sizes = ["width", "height", "input_width", "input_height"]
    toml = NAMES + (
        f'[input]\nname = "image"\nsize = [96, 128]\nfit = "stretch"\nlayout = "NHWC"\n[input.extra]\nsizes = {sizes}\n'
        'scales = ["scale_x", "scale_y"]\n[output]\nform = "separate"\nboxes = "b"\nscores = "s"\nunits = "picture"\n'
        'box = "xywh"\n'
    )
    values = [
        helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, "h", "w", 3]),
        helper.make_tensor_value_info("sizes", TensorProto.INT64, [1, 4]),
        helper.make_tensor_value_info("scales", TensorProto.FLOAT16, [1, 2]),
    ]
    nodes = [
        helper.make_node("Cast", ["sizes"], ["floats"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["floats", "tenth"], ["b"]),
        helper.make_node("Cast", ["scales"], ["s"], to=TensorProto.FLOAT),
    ]
    outputs = [
        helper.make_tensor_value_info("b", TensorProto.FLOAT, [1, 4]),
        helper.make_tensor_value_info("s", TensorProto.FLOAT, [1, 2]),
    ]
    tenth = numpy_helper.from_array(np.array([0.1], np.float32), "tenth")
    graph = helper.make_graph(nodes, "echo", values, outputs, [tenth])
    path = tmp_path / "echo.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    path.with_suffix(".toml").write_text(toml, encoding="utf-8")
    found = BoxDetector(path, min_score=0.1).detect(frame, None)
    np.testing.assert_allclose(found.boxes, [[64, 48, 64 + 12.8, 48 + 9.6]], rtol=1e-5)
    np.testing.assert_allclose(found.scores, [0.2], rtol=1e-3)


def test_rivals_are_suppressed_within_a_name(tmp_path: Path, frame: Frame) -> None:
    rows = array([*CORNERS, 0.9, 0.0], [33, 16, 64, 48, 0.8, 0.0], [33, 16, 64, 48, 0.0, 0.7], [90, 0, 99, 9, 0.6, 0.0])
    toml = STRETCH + 'form = "rows"\nrows = "o"\n'
    found = detector(tmp_path, toml, {"o": rows})
    np.testing.assert_allclose(found.detect(frame, None).scores, [0.9, 0.7, 0.6])
    np.testing.assert_allclose(
        detector(tmp_path, toml + "nms = false", {"o": rows}).detect(frame, ["cup"]).scores, [0.9, 0.8, 0.6]
    )
    assert found.detect(frame, ["table"]).ids.tolist() == [2]
    assert len(detector(tmp_path, toml + "min_score = 0.85", {"o": rows}).detect(frame, None)) == 1


def test_distances_are_decoded_cell_by_cell(tmp_path: Path, frame: Frame) -> None:
    random = np.random.default_rng(1)
    strides, bins = (16, 32), 5
    outputs: dict[str, np.ndarray] = {}
    expected, scores = [], []
    for k, stride in enumerate(strides):
        height, width = -(-64 // stride), -(-128 // stride)
        logits = random.normal(size=(height * width, 4, bins)).astype(np.float32)
        chance = random.uniform(0.3, 1, (height * width, 2)).astype(np.float32)
        outputs |= {f"s{k}": chance[None], f"d{k}": logits.reshape(1, height * width, -1)}
        for cell in range(height * width):
            row, column = divmod(cell, width)
            reach = []
            for side in range(4):
                weights = np.exp(logits[cell, side].astype(np.float64))
                reach.append(sum(b * w for b, w in enumerate(weights)) / weights.sum() * stride)
            x, y = (column + 0.5) * stride, (row + 0.5) * stride
            box = np.array([x - reach[0], y - reach[1], x + reach[2], y + reach[3]])
            expected.append(np.clip(box * [5, 7.5, 5, 7.5], 0, [640, 480, 640, 480]))
            scores.append(chance[cell])
    toml = STRETCH + (
        'form = "distances"\nscores = ["s0", "s1"]\ndistances = ["d0", "d1"]\nstrides = [16, 32]\nnms = false\n'
    )
    made = detector(tmp_path, toml, outputs)
    for name, place in (("cup", 0), ("table", 1)):
        found = made.detect(frame, [name])
        assert len(found) == len(expected)
        np.testing.assert_allclose(found.boxes, np.array(expected)[found.ids], atol=1e-3)
        np.testing.assert_allclose(found.scores, np.array(scores)[found.ids, place])


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("", "wrong at output"),
        ("[output", "cannot be read"),
        (NAMES + '[output]\nform = "lines"', "wrong at output.form"),
        (NAMES + '[output]\nform = "rows"', "the form 'rows' needs the output `rows`"),
        (NAMES + '[output]\nform = "separate"\nboxes = "o"', "the form 'separate' needs"),
        (NAMES + '[output]\nform = "distances"\nscores = ["o"]\nstrides = [8]', "the form 'distances' needs"),
        (NAMES + '[output]\nform = "rows"\nrows = "o"\ncolumns = ["box", "score"]', "`score` and `class`"),
        (NAMES + '[output]\nform = "rows"\nrows = "o"\nthreshold = 1', "wrong at output.threshold.*one of form, rows"),
        (NAMES + '[output]\nform = "rows"\nrows = "p"', "no output p; got o"),
        (
            NAMES + '[input]\nname = "picture"\n[output]\nform = "rows"\nrows = "o"',
            "other inputs than the TOML file says",
        ),
        (NAMES + '[input]\nlayout = "NHWC"\n[output]\nform = "rows"\nrows = "o"', 'not NHWC.*layout = "NCHW"'),
        (NAMES + '[input]\nsize = [32, 32]\n[output]\nform = "rows"\nrows = "o"', r"another size; got \[32, 32\]"),
        (NAMES + '[input]\nstd = [0, 1, 1]\n[output]\nform = "rows"\nrows = "o"', r"wrong at input\.std"),
        (NAMES + '[input.extra]\nim_shape = ["height"]\n[output]\nform = "rows"\nrows = "o"', "other inputs"),
        ('[output]\nform = "rows"\nrows = "o"', "class names of the detector are not known"),
        (NAMES + 'names_file = "x"\n[output]\nform = "rows"\nrows = "o"', "class names twice"),
        ('names_file = "x.txt"\n[output]\nform = "rows"\nrows = "o"', "class names cannot be read"),
        (
            'names = ["a", "b", "c"]\n[output]\nform = "rows"\nrows = "o"',
            "another number of columns.*7: 4 of box, 3 of",
        ),
        (NAMES + '[output]\nform = "rows"\nrows = "o"\nunits = "metres"', "wrong at output.units"),
        (
            NAMES + '[output]\nform = "rows"\nrows = "o"\ncolumns = ["box", "score", "class"]\nactivation = "softmax"',
            "one score in all",
        ),
        (
            NAMES + '[output]\nform = "separate"\nboxes = "b"\nscores = "s"\nclasses = "c"\nactivation = "softmax"',
            "one score in all",
        ),
    ],
)
def test_what_is_wrong_in_the_toml_file_is_one_line(tmp_path: Path, frame: Frame, toml: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        detector(tmp_path, toml, {"o": array([*CORNERS, 0.1, 0.75])}).detect(frame, None)
    assert "\n" not in str(caught.value)
    assert "model.toml" in str(caught.value) or "x.txt" in str(caught.value)


def test_inputs_of_bytes_are_given_whole_numbers_only(tmp_path: Path, frame: Frame) -> None:
    inputs = {"image": (TensorProto.UINT8, (1, 64, 128, 3))}
    said = NAMES + '[output]\nform = "rows"\nrows = "o"\n[input]\nlayout = "NHWC"\n'
    outputs = {"o": array([*CORNERS, 0.1, 0.75])}
    assert len(detector(tmp_path, said + "scale = 1", outputs, inputs).detect(frame, None)) == 1
    with pytest.raises(InputError, match="'image' takes whole numbers"):
        detector(tmp_path, said, outputs, inputs).detect(frame, None)


def test_logits_are_not_taken_for_probabilities(tmp_path: Path, frame: Frame) -> None:
    made = detector(tmp_path, STRETCH + 'form = "rows"\nrows = "o"', {"o": array([*CORNERS, -3, 4.5])})
    with pytest.raises(InputError, match=r"no probabilities; got -3 to 4\.5.*activation"):
        made.detect(frame, None)


def test_the_toml_file_is_found_beside_the_model(tmp_path: Path, frame: Frame) -> None:
    outputs = {"o": array([*CORNERS, 0.1, 0.75])}
    path = write_stub(tmp_path / "model.onnx", PICTURE, outputs)
    with pytest.raises(InputError, match=r"expected model\.toml beside it, or --model-config"):
        make_detector("boxes", model=path)
    text = STRETCH + 'form = "rows"\nrows = "o"\n'
    (tmp_path / "other.toml").write_text(text, encoding="utf-8")
    assert len(make_detector("boxes", model=path).detect(frame, ["table"])) == 1
    (tmp_path / "third.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="beside it"):
        make_detector("boxes", model=path)
    first = make_detector("boxes", model=path, config=tmp_path / "other.toml")
    (tmp_path / "third.toml").write_text(text + 'activation = "sigmoid"\n', encoding="utf-8")
    second = make_detector("boxes", model=path, config=tmp_path / "third.toml")
    assert first.fingerprint() != second.fingerprint()
    with pytest.raises(InputError, match="takes no --model-config; expected yolo-seg or detic or boxes"):
        make_detector("annotations", config=tmp_path / "third.toml")


def test_the_examples_can_be_read(tmp_path: Path) -> None:
    for path in sorted(EXAMPLES.glob("*.toml")):
        copy = Path(shutil.copy(path, tmp_path))
        (tmp_path / "coco.txt").write_text("person\nbicycle\n", encoding="utf-8")
        assert read_box_model(copy).output.form in ("rows", "separate", "distances")
    assert len(read_box_model(EXAMPLES / "picodet.toml").names) == 80


# A real network.

GOLDEN = {
    "slambook-diningroom": [
        ("chair", 0.8461, [504.0, 169.5, 609.2, 251.8]),
        ("chair", 0.8037, [111.9, 142.0, 215.5, 291.0]),
        ("chair", 0.5746, [352.3, 272.5, 521.3, 473.5]),
        ("dining table", 0.5486, [221.7, 185.3, 638.5, 476.6]),
    ],
    "7scenes-redkitchen": [
        ("chair", 0.7532, [420.1, 146.0, 548.9, 210.4]),
        ("cup", 0.6841, [366.7, 163.7, 401.1, 203.3]),
        ("dining table", 0.6557, [208.5, 159.6, 639.9, 461.3]),
        ("chair", 0.6442, [177.3, 127.1, 305.3, 445.8]),
    ],
}
"""The best of the first picture: names, scores, boxes."""


@pytest.mark.slow
@pytest.mark.parametrize("name", GOLDEN)
def test_picodet_on_real_pictures(shared_data: Path, name: str) -> None:
    camera: dict[str, Any] = {"intrinsics": (518, 519, 325.5, 253.5), "depth_scale": 1000}
    dataset = open_dataset(shared_data / "real" / name, **(camera if "slambook" in name else {}))
    frame = dataset.load(dataset.frame_ids[0])
    picodet = BoxDetector(shared_data / "onnx" / "picodet_s_416_coco.onnx", config=EXAMPLES / "picodet.toml")
    found = picodet.detect(frame, None)
    for k, (label, score, box) in enumerate(GOLDEN[name]):
        assert found.label(k) == label
        assert found.scores[k] == pytest.approx(score, abs=2e-3)
        np.testing.assert_allclose(found.boxes[k], box, atol=0.5)
    # Another network of another contract sees the same things.
    yolo = make_detector("yolo-seg", model=shared_data / "onnx" / "yolov8n_seg_480x640.onnx").detect(frame, None)
    overlap = iou_2d(found.boxes[:4], yolo.boxes)
    for k in range(4):
        same = [yolo.label(j) == found.label(k) for j in range(len(yolo))]
        assert overlap[k][same].max() > 0.6
