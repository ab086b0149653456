"""Files and pictures that are odd, and still to be read right or refused in one clear line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from model_stubs import STUBS, change, write_model
from onnx import TensorProto
from onnx_stubs import write_stub
from scenes import frame_of, upright

from pipeline.geometry import Frame
from pipeline.geometry.picture_input import PictureInput, place_picture
from pipeline.proposals import detic, make_detector, make_segmenter, metadata_names, prompted
from pipeline.proposals.network import shortest_edge
from pipeline.system import InputError, metadata, model_hash, open_session


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    return frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["mug"])


def test_the_thinnest_picture_keeps_a_pixel() -> None:
    for height, width in ((1, 3000), (3000, 1)):
        for resized in (shortest_edge, detic.resized_shape, prompted.resized_shape):
            size = resized(height, width)
            assert min(size) == 1
            assert max(size) <= 1333
            assert (size[0] > size[1]) == (height > width)
        image, _ = place_picture(np.zeros((height, width, 3), np.uint8), 64, 64, PictureInput())
        assert (image[0] == 0).all(axis=0).sum() == 64


@pytest.mark.parametrize(
    ("kind", "to", "message"),
    [
        ("yolo-seg", TensorProto.BOOL, "'images' takes whole numbers"),
        ("efficientsam encoder", TensorProto.INT32, "'batched_images' takes whole numbers"),
        ("efficientsam encoder", TensorProto.BFLOAT16, r"'batched_images' cannot be given; got tensor\(bfloat16\)"),
        ("sam2 decoder", TensorProto.STRING, "cannot be given"),
    ],
)
def test_inputs_of_other_types_are_refused(kind: str, to: int, message: str, tmp_path: Path, frame: Frame) -> None:
    def edit(model: Any) -> None:
        for value in model.graph.input:
            value.type.tensor_type.elem_type = to

    path = write_model(kind, tmp_path)
    change(path, edit)
    with pytest.raises(InputError, match=message):
        used(kind, path, frame)


def used(kind: str, path: Path, frame: Frame) -> None:
    """Run a file of that kind, the other half of its pair being sound."""
    if "coder" not in kind:
        make_detector(kind, model=path).detect(frame, ["mug"])
        return
    name, part = kind.split()
    other = write_model(f"{name} {'decoder' if part == 'encoder' else 'encoder'}", path.parent)
    pair = (path, other) if part == "encoder" else (other, path)
    make_segmenter(name, model=pair).segment(frame, np.array([[20, 20, 90, 90]], np.float32), ["mug"])


def test_infinite_rows_are_one_clear_line(tmp_path: Path, frame: Frame) -> None:
    inputs, outputs = STUBS["yolo-seg"]()
    path = write_stub(tmp_path / "m.onnx", inputs, {n: np.full_like(v, np.inf) for n, v in outputs.items()})
    change(path, named("['mug']"))
    with pytest.raises(InputError, match="not finite"):
        make_detector("yolo-seg", model=path).detect(frame, ["mug"])


def named(text: str) -> Callable[[Any], None]:
    """Class names in a file's metadata."""

    def edit(model: Any) -> None:
        del model.metadata_props[:]
        entry = model.metadata_props.add()
        entry.key, entry.value = "names", text

    return edit


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ('{"0": "mug", "1": "cup"}', ("mug", "cup")),
        ("('mug', 'cup')", ("mug", "cup")),
        ("{1: 'mug'}", None),
        ("{[1]: 2}", None),
        ("{0: {}}", None),
        ("__import__('os').getcwd()", None),
        ("(" * 5000, None),
        ("mug", None),
    ],
)
def test_class_names_in_metadata(text: str, names: tuple[str, ...] | None, tmp_path: Path) -> None:
    path = write_model("yolo-seg", tmp_path)
    change(path, named(text))
    assert metadata_names(open_session(path)) == names


def test_what_is_no_text_is_told(tmp_path: Path) -> None:
    path = write_model("yolo-seg", tmp_path)
    content = path.read_bytes()
    path.write_bytes(content.replace(b"'mug'", b"'m\xff\xfe'"))
    assert metadata(open_session(path)) == {}
    path.write_bytes(content.replace(b"images", b"im\xff\xfees"))
    with pytest.raises(InputError, match="are no text"):
        open_session(path)


def test_a_name_given_twice_is_found_under_both_numbers(tmp_path: Path, frame: Frame) -> None:
    inputs, outputs = STUBS["yolo-seg"]()
    once = outputs["output0"]
    rows = np.concatenate([once[:, :4], np.zeros_like(once[:, :1]), once[:, 4:]], axis=1)
    path = write_stub(tmp_path / "m.onnx", inputs, {"output0": rows, "output1": outputs["output1"]})
    change(path, named("['mug', 'mug']"))
    found = make_detector("yolo-seg", model=path).detect(frame, ["mug"])
    assert [found.label(i) for i in range(len(found))] == ["mug"]
    assert len(make_detector("yolo-seg", model=path).detect(frame, [])) == 0


def test_prototypes_of_any_size_lie_in_the_same_place(tmp_path: Path, frame: Frame) -> None:
    inputs, outputs = STUBS["yolo-seg"]()
    rows = outputs["output0"].copy()
    rows[0, :4, 0] = 32, 32, 48, 48
    masks = []
    for cells in (16, 8):
        prototypes = np.ones((1, 32, cells, cells), np.float32)
        prototypes[..., cells // 2 :] = -1
        path = write_stub(tmp_path / f"{cells}.onnx", inputs, {"output0": rows, "output1": prototypes})
        change(path, named("['mug']"))
        masks.append(make_detector("yolo-seg", model=path).detect(frame, ["mug"]).masks)
    assert masks[0] is not None
    assert masks[0].any()
    assert np.array_equal(*masks)


def test_the_hash_holds_weights_under_any_name(tmp_path: Path) -> None:
    plain = write_model("yolo-seg", tmp_path)
    path = tmp_path / "m.onnx"
    onnx.save(onnx.load(plain), path, save_as_external_data=True, location="of any name.bin", size_threshold=0)
    before = model_hash(path)
    weights = tmp_path / "of any name.bin"
    weights.write_bytes(bytes(weights.stat().st_size))
    assert model_hash(path) != before
    assert "+" not in model_hash(plain)
