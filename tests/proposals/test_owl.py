"""OWLv2 and OWL-ViT: pictures, texts, scores and boxes as the reference code has them, and files that do not fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from onnx import TensorProto
from onnx_stubs import OWL, write_stub
from scenes import camera_of, frame_of, upright

from pipeline.geometry import Frame
from pipeline.paper.systems import point_by_detector
from pipeline.proposals import make_detector
from pipeline.proposals.contracts import OWL_CONTRACTS
from pipeline.proposals.network import CLIP_MEAN, CLIP_STD, normalised, padded_square, pillow_resized
from pipeline.proposals.owl import OwlDetector
from pipeline.system import InputError

if TYPE_CHECKING:
    from open_vocabulary_models import Export

KINDS = ("owlv2", "owlvit")
NAMES = ["mug", "Hot_Dog", "dog", "tap"]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    return frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["mug"])


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Export]:
    """A random network of each kind."""
    from open_vocabulary_models import Export, export_owl, owl

    found = {}
    for kind in KINDS:
        folder = tmp_path_factory.mktemp(kind)
        model, tokenizer = owl(kind, folder)
        export_owl(model, folder / "model.onnx")
        found[kind] = Export(model, tokenizer, folder / "model.onnx")
    return found


def image_processor(kind: str, side: int) -> Any:
    from transformers.models.owlv2.image_processing_pil_owlv2 import Owlv2ImageProcessorPil
    from transformers.models.owlvit.image_processing_pil_owlvit import OwlViTImageProcessorPil

    return {"owlv2": Owlv2ImageProcessorPil, "owlvit": OwlViTImageProcessorPil}[kind](
        size={"height": side, "width": side}
    )


def reference_answer(export: Export, kind: str, frame: Frame, texts: list[str]) -> tuple[Any, Any, Any]:
    import torch
    from open_vocabulary_models import SIDE

    processor = image_processor(kind, SIDE)
    text = export.tokenizer(texts, padding="max_length", max_length=16, return_tensors="pt")
    pixels = processor(frame.rgb, return_tensors="pt")["pixel_values"].float()
    with torch.no_grad():
        answer = export.model(**text, pixel_values=pixels)
    return processor, answer, answer.logits.amax(-1).sigmoid()[0].numpy()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_detections_are_those_of_the_reference(exported: dict[str, Export], kind: Any, frame: Frame) -> None:
    texts = [f"a photo of a {n}" for n in ("mug", "hot dog", "dog", "tap")]
    processor, answer, scores = reference_answer(exported[kind], kind, frame, texts)
    ranked = np.sort(scores)
    low = len(ranked) // 4
    threshold = float(ranked[low:-low][np.diff(ranked[low : 1 - low]).argmax()] + 1e-3)
    expected = processor.post_process_object_detection(answer, threshold, [frame.rgb.shape[:2]])[0]
    found = OwlDetector(exported[kind].path, kind, min_score=threshold, nms_iou=1.0, k=1000).detect(frame, NAMES)

    patches = np.flatnonzero(scores > threshold)
    boxes = np.clip(expected["boxes"].numpy(), 0, [frame.width, frame.height] * 2)
    solid = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
    place = np.argsort(found.ids)
    assert 3 < len(found) < 36
    assert found.ids[place].tolist() == patches[solid].tolist()
    np.testing.assert_allclose(found.boxes[place], boxes[solid], atol=0.02)
    np.testing.assert_allclose(found.scores[place], expected["scores"].numpy()[solid], atol=1e-4)
    assert found.label_index[place].tolist() == expected["labels"].numpy()[solid].tolist()
    assert np.ptp(found.boxes, axis=0).min() > 5


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(480, 640), (97, 333), (641, 479), (30, 20), (96, 96), (2000, 1500)])
def test_pixel_values_are_those_of_the_reference(kind: str, size: tuple[int, int]) -> None:
    rgb = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    expected = image_processor(kind, 160)(rgb, return_tensors="np")["pixel_values"]
    image = padded_square(rgb, 160) if kind == "owlv2" else pillow_resized(rgb, 160, 160, cubic=True)
    ours = normalised(image, CLIP_MEAN, CLIP_STD)
    assert ours.shape == expected.shape
    np.testing.assert_allclose(ours, expected, atol=2e-5)


def test_the_older_padding_is_grey() -> None:
    image = padded_square(np.zeros((10, 20, 3), np.uint8), 20, fill=0.5)
    assert (image[:9] == 0).all()
    assert (image[11:] == 0.5).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_texts_are_tokenised_as_the_reference_does(exported: dict[str, Export], kind: Any) -> None:
    detector = OwlDetector(exported[kind].path, kind)
    for text in ("a photo of a mug", "dog", "<|endoftext|>", "it's, a dog"):
        expected = exported[kind].tokenizer([text.replace("<|", "< |")], padding="max_length", max_length=16)
        ours = detector._tokens(text, text)
        if "<|" in text:
            # What a person types ends no text.
            assert (ours == ours.max()).sum() == 1
        else:
            assert ours.tolist() == expected["input_ids"][0]
    with pytest.raises(InputError, match=r"too long for the model; got \d+ tokens.*at most 16"):
        detector._tokens("x", "a photo of a dog and a mug and a dog")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_found_does_not_depend_on_what_else_is_asked(
    exported: dict[str, Export], kind: Any, frame: Frame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    detector = OwlDetector(exported[kind].path, kind, min_score=0.0, nms_iou=1.0, k=1000)
    together = detector.detect(frame, NAMES)
    monkeypatch.setattr("pipeline.proposals.owl.MAX_QUERIES", 3)
    batches = detector.detect(frame, NAMES)
    assert batches.ids.tolist() == together.ids.tolist()
    np.testing.assert_allclose(batches.scores, together.scores, atol=1e-5)
    assert batches.label_index.tolist() == together.label_index.tolist()
    alone = [detector.detect(frame, [n]) for n in NAMES]
    best = np.max([a.scores[np.argsort(a.ids)] for a in alone], axis=0)
    np.testing.assert_allclose(together.scores[np.argsort(together.ids)], best, atol=1e-5)


@pytest.mark.slow
def test_a_file_for_a_fixed_number_of_names(exported: dict[str, Export], frame: Frame, tmp_path: Path) -> None:
    from open_vocabulary_models import export_owl

    export = exported["owlvit"]
    export_owl(export.model, tmp_path / "fixed.onnx", names=3)
    tokenizer = export.path.with_name("tokenizer.json")
    options: dict[str, Any] = {"tokenizer": tokenizer, "min_score": 0.0, "nms_iou": 1.0, "k": 1000}
    fixed = OwlDetector(tmp_path / "fixed.onnx", "owlvit", **options).detect(frame, NAMES)
    free = OwlDetector(export.path, "owlvit", **options).detect(frame, NAMES)
    assert fixed.ids.tolist() == free.ids.tolist()
    assert fixed.label_index.tolist() == free.label_index.tolist()
    np.testing.assert_allclose(fixed.scores, free.scores, atol=1e-5)


@pytest.mark.slow
def test_boxes_in_the_padding_are_no_detections(tmp_path: Path, exported: dict[str, Export]) -> None:
    wide = frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["mug"], camera=camera_of(width=320, height=160))
    logits = np.full((1, 4, 1), 2.0, np.float32)
    boxes = np.array([[[0.25, 0.25, 0.1, 0.2], [0.5, 0.75, 0.2, 0.2], [0.5, 0.5, 0.2, 0.2], [0.9, 0.1, 0.1, 0.1]]])
    outputs = {"logits": logits, "pred_boxes": boxes.astype(np.float32)}
    path = write_stub(tmp_path / "model.onnx", OWL, outputs)
    tokenizer = exported["owlv2"].path.with_name("tokenizer.json")
    found = OwlDetector(path, "owlv2", tokenizer=tokenizer).detect(wide, ["mug"])
    assert found.ids.tolist() == [0, 2, 3]
    # Shares of the longer side, 320, on both axes; the second ends where the picture does.
    np.testing.assert_allclose(found.boxes[:2], [[64, 48, 96, 112], [128, 128, 192, 160]], atol=1e-3)
    squashed = OwlDetector(path, "owlvit", tokenizer=tokenizer).detect(wide, ["mug"])
    assert len(squashed) == 4
    np.testing.assert_allclose(squashed.boxes[0], [64, 24, 96, 56], atol=1e-3)


@pytest.mark.slow
def test_objects_of_any_kind_where_the_file_knows_them(exported: dict[str, Export], frame: Frame) -> None:
    detector = OwlDetector(exported["owlv2"].path, min_score=0.0, nms_iou=1.0, k=1000)
    found = detector.detect(frame, None)
    _, answer, _ = reference_answer(exported["owlv2"], "owlv2", frame, ["a photo of a object"])
    expected = answer.objectness_logits.sigmoid()[0].numpy()
    assert set(found.labels) == {"object"}
    np.testing.assert_allclose(found.scores, expected[found.ids], atol=1e-4)
    named = make_detector("owlv2", model=exported["owlv2"].path, class_names=("mug", "dog"))
    assert named.detect(frame, None).labels == ("mug", "dog")
    with pytest.raises(InputError, match="by name"):
        make_detector("owlvit", model=exported["owlvit"].path).detect(frame, None)


@pytest.mark.slow
def test_a_whole_expression_is_asked_as_it_is(exported: dict[str, Export], frame: Frame) -> None:
    path = exported["owlvit"].path
    whole = make_detector("owlvit", model=path, min_score=0.0)
    (pointed, long) = point_by_detector(whole, frame, ["Mug of dog", "mug of the dog of the dog of the dog"])
    best = OwlDetector(path, "owlvit", min_score=0.0, prompt="{}").detect(frame, ["mug of dog"])
    assert pointed.box is not None
    np.testing.assert_allclose(pointed.box, best.boxes[0], atol=1e-3)
    assert "too long" in str(long.problem)
    # As a class name it is another question, and the cache does not mix the two up.
    named = whole.detect(frame, ["Mug of dog"])
    assert abs(float(named.scores[0]) - float(best.scores[0])) > 1e-5


def broken(kind: str, folder: Path) -> Path:
    path = folder / "model.onnx"
    inputs: dict[str, Any] = dict(OWL)
    outputs = {"logits": np.zeros((1, 9, 1), np.float32), "pred_boxes": np.full((1, 9, 4), 0.5, np.float32)}
    if kind == "no text":
        del inputs["input_ids"]
    if kind == "grounding":
        inputs["pixel_mask"] = TensorProto.INT64, (1, 96, 96)
    if kind == "oblong":
        inputs["pixel_values"] = TensorProto.FLOAT, (1, 3, 96, 128)
    if kind == "of owlvit":
        inputs["pixel_values"] = TensorProto.FLOAT, (1, 3, 768, 768)
    if kind == "no boxes":
        del outputs["pred_boxes"]
    if kind == "other names":
        outputs["logits"] = np.zeros((1, 9, 3), np.float32)
    if kind == "nan":
        outputs["logits"][0, 0] = np.nan
    write_stub(path, inputs, outputs, opset=99 if kind == "opset" else 17, external=kind == "external")
    if kind == "external":
        path.with_name(path.name + "_data").unlink()
    if kind == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        "no text",
        "grounding",
        "oblong",
        "of owlvit",
        "no boxes",
        "other names",
        "nan",
        "opset",
        "external",
        "truncated",
    ],
)
def test_a_broken_file_is_one_clear_line(
    kind: str, tmp_path: Path, exported: dict[str, Export], frame: Frame, capfd: pytest.CaptureFixture[str]
) -> None:
    path = broken(kind, tmp_path)
    with pytest.raises(InputError) as caught:
        OwlDetector(path, tokenizer=exported["owlv2"].path.with_name("tokenizer.json")).detect(frame, ["mug"])
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert ("use --detector owlvit" in str(caught.value)) == (kind == "of owlvit")
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.parametrize("kind", [TensorProto.FLOAT16, TensorProto.FLOAT])
def test_half_precision_and_open_sizes(tmp_path: Path, exported: dict[str, Export], frame: Frame, kind: int) -> None:
    dtype = np.float16 if kind == TensorProto.FLOAT16 else np.float32
    inputs: dict[str, Any] = dict(OWL)
    inputs |= {"pixel_values": (kind, ("B", 3, "H", "W")), "input_ids": (TensorProto.INT32, ("L", "S"))}
    outputs = {"logits": np.ones((1, 9, 1), dtype), "pred_boxes": np.full((1, 9, 4), 0.25, dtype)}
    path = write_stub(tmp_path / "model.onnx", inputs, outputs)
    tokenizer = exported["owlv2"].path.with_name("tokenizer.json")
    found = OwlDetector(path, "owlvit", tokenizer=tokenizer).detect(frame, ["mug"])
    assert found.ids.tolist() == [0]
    np.testing.assert_allclose(found.scores, 1 / (1 + np.exp(-1)), rtol=1e-3)


@pytest.mark.slow
def test_another_models_tokenizer_is_refused(tmp_path: Path) -> None:
    from transformers import BertTokenizer

    path = write_stub(
        tmp_path / "model.onnx",
        OWL,
        {"logits": np.zeros((1, 9, 1), np.float32), "pred_boxes": np.zeros((1, 9, 4), np.float32)},
    )
    with pytest.raises(InputError, match=r"no tokenizer.*tokenizer\.json"):
        OwlDetector(path)
    words = {w: n for n, w in enumerate(["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", "mug"])}
    BertTokenizer(vocab=words).backend_tokenizer.save(str(tmp_path / "tokenizer.json"))
    with pytest.raises(InputError, match="tokenizer is not CLIP's"):
        OwlDetector(path)


@pytest.mark.slow
def test_the_contracts_name_what_the_exports_declare(exported: dict[str, Export]) -> None:
    import onnxruntime as ort

    for contract, kind in zip(OWL_CONTRACTS, KINDS, strict=True):
        session = ort.InferenceSession(str(exported[kind].path))
        assert contract.option.endswith(kind)
        assert {i.name for i in session.get_inputs()} == {t.name for t in contract.inputs}
        assert {t.name for t in contract.outputs} <= {o.name for o in session.get_outputs()}
