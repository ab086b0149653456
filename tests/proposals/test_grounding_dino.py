"""GroundingDINO: captions, scores and boxes as the reference code has them, and files that are something else."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from onnx import TensorProto
from onnx_stubs import GROUNDING, bert_vocabulary, grounding_outputs, write_stub
from scenes import frame_of, upright

from pipeline.geometry import Frame
from pipeline.paper.systems import point_by_detector
from pipeline.proposals import make_detector
from pipeline.proposals.contracts import GROUNDING_DINO_CONTRACTS
from pipeline.proposals.grounding_dino import GroundingDinoDetector, build_captions, span_scores, token_blocks
from pipeline.proposals.network import (
    IMAGENET_MEAN,
    IMAGENET_STD,
    load_tokenizer,
    normalised,
    pillow_resized,
    shortest_edge,
    sigmoid,
)
from pipeline.system import InputError, MissingExtra

if TYPE_CHECKING:
    from open_vocabulary_models import Export

NAMES = ["mug", "hot dog", "Coffee_Mug", "laptop"]
KEEP_ALL: dict[str, Any] = {"nms_iou": 1.0, "k": 1000}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    return frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["mug"])


@pytest.fixture(scope="session")
def transformers_export(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """A random network in the contract of transformers."""
    from open_vocabulary_models import Export, export_grounding_dino, grounding_dino

    folder = tmp_path_factory.mktemp("transformers")
    model, tokenizer = grounding_dino(folder)
    export_grounding_dino(model, folder / "model.onnx")
    return Export(model, tokenizer, folder / "model.onnx")


@pytest.fixture(scope="session")
def original_export(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The same network in the contract of the original code."""
    from open_vocabulary_models import Export, export_grounding_dino, grounding_dino

    folder = tmp_path_factory.mktemp("original")
    model, tokenizer = grounding_dino(folder)
    export_grounding_dino(model, folder / "model.onnx", outside=True)
    return Export(model, tokenizer, folder / "model.onnx")


@pytest.fixture(scope="session")
def exported(transformers_export: Export, original_export: Export) -> dict[str, Export]:
    return {"transformers": transformers_export, "original": original_export}


@pytest.fixture
def vocabulary(tmp_path: Path) -> Path:
    path = tmp_path / "vocab.txt"
    words = sorted(bert_vocabulary().items(), key=lambda item: item[1])
    path.write_text("\n".join(w for w, _ in words) + "\n", encoding="utf-8")
    return path


def processor_of(tokenizer: Any, size: dict[str, int]) -> Any:
    from transformers import GroundingDinoProcessor
    from transformers.models.grounding_dino.image_processing_pil_grounding_dino import GroundingDinoImageProcessorPil

    return GroundingDinoProcessor(GroundingDinoImageProcessorPil(size=size), tokenizer)


# Against the reference library.


@pytest.mark.slow
@pytest.mark.parametrize("contract", ["transformers", "original"])
def test_detections_are_those_of_the_reference(request: pytest.FixtureRequest, contract: str, frame: Frame) -> None:
    import torch
    from open_vocabulary_models import HEIGHT, WIDTH

    export = request.getfixturevalue(f"{contract}_export")
    processor = processor_of(export.tokenizer, {"height": HEIGHT, "width": WIDTH})
    plain = ["mug", "hot dog", "coffee mug", "laptop"]
    given = processor(images=frame.rgb, text=[plain], return_tensors="pt")
    with torch.no_grad():
        answer = export.model(**given)
    scores = np.sort(answer.logits.sigmoid().amax(-1)[0].numpy())
    threshold = float(scores[20:-5][np.diff(scores[20:-4]).argmax()] + 1e-3)
    expected = processor.post_process_grounded_object_detection(
        answer, given.input_ids, threshold=threshold, text_threshold=0.0, target_sizes=[frame.rgb.shape[:2]]
    )[0]
    detector = GroundingDinoDetector(export.path, min_score=threshold, text_threshold=0.0, **KEEP_ALL)
    found = detector.detect(frame, NAMES)

    queries = np.flatnonzero(answer.logits.sigmoid().amax(-1)[0].numpy() > threshold)
    boxes = np.clip(expected["boxes"].numpy(), 0, [frame.width, frame.height] * 2)
    solid = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
    queries, boxes, expected_scores = queries[solid], boxes[solid], expected["scores"].numpy()[solid]
    assert 5 < len(found) == len(queries) < 60
    place = np.argsort(found.ids)
    assert (found.ids[place] & 0xFFFF).tolist() == queries.tolist()
    np.testing.assert_allclose(found.boxes[place], boxes, atol=0.02)
    np.testing.assert_allclose(found.scores[place], expected_scores, atol=1e-5)
    # The names, from where the letters stand in the caption.
    text = "mug. hot dog. coffee mug. laptop."
    offsets = export.tokenizer(text, return_offsets_mapping=True)["offset_mapping"]
    starts = [text.index(n) if n != "mug" else 0 for n in plain]
    stretches = [(s, s + len(n)) for s, n in zip(starts, plain, strict=True)]
    inside = np.array([[s <= a < b <= e for a, b in offsets] for s, e in stretches])
    p = answer.logits.sigmoid()[0, queries, : len(offsets)].numpy()
    by_name = np.where(inside[None], p[:, None], 0).max(axis=2)
    assert found.label_index[place].tolist() == by_name.argmax(axis=1).tolist()
    assert len(set(found.label_index.tolist())) > 1


@pytest.mark.slow
def test_the_two_contracts_agree(exported: dict[str, Export], frame: Frame) -> None:
    one, other = (GroundingDinoDetector(exported[c].path).detect(frame, NAMES) for c in ("transformers", "original"))
    assert len(one) > 3
    assert one.ids.tolist() == other.ids.tolist()
    np.testing.assert_allclose(one.boxes, other.boxes, atol=0.02)
    np.testing.assert_allclose(one.scores, other.scores, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(480, 640), (97, 333), (641, 479), (30, 30), (800, 1000)])
def test_pixel_values_are_those_of_the_reference(transformers_export: Export, size: tuple[int, int]) -> None:
    rgb = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    for wanted in ({"shortest_edge": 800, "longest_edge": 1333}, {"height": 96, "width": 128}):
        processor = processor_of(transformers_export.tokenizer, wanted)
        expected = processor.image_processor(rgb, return_tensors="np")["pixel_values"]
        height, width = shortest_edge(*size) if "height" not in wanted else (96, 128)
        ours = normalised(pillow_resized(rgb, height, width), IMAGENET_MEAN, IMAGENET_STD)
        assert ours.shape == expected.shape
        np.testing.assert_allclose(ours, expected, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("ids", [
    [101, 200, 201, 1012, 202, 1012, 102], [101, 200, 102], [101, 102], [101, 1012, 102], [200, 201, 1029, 202],
    [101, 200, 1012, 102, 0, 0, 0], [101, 200, 1012, 1012, 201, 202, 203, 1029, 102], [101, 200, 201],
])  # fmt: skip
def test_token_blocks_are_those_of_the_reference(ids: list[int]) -> None:
    import torch
    from transformers.models.grounding_dino.modeling_grounding_dino import (
        generate_masks_with_special_tokens_and_transfer_map as blocks_of,
    )

    reference: Any = blocks_of
    mask, positions = reference(torch.tensor([ids]), torch.tensor([101, 102, 1012, 1029]))
    ours = token_blocks(np.array(ids))
    assert ours[0].tolist() == mask[0].tolist()
    assert ours[1].tolist() == positions[0].tolist()


@pytest.mark.slow
def test_captions_are_tokenised_as_the_reference_does(transformers_export: Export, vocabulary: Path) -> None:
    export = transformers_export
    for path in (export.path.with_name("tokenizer.json"), vocabulary):
        (caption,) = build_captions(["T.V. stand", "mug", "MUG", "hot-dog", "[SEP] cat?"], load_tokenizer(path))
        assert caption.text == "tv stand. mug. hot-dog. [sep] cat."
        assert caption.names.tolist() == [0, 1, 3, 4]
        expected = export.tokenizer("tv stand. mug. hot-dog. ")["input_ids"][:-1]
        assert caption.ids[: len(expected)].tolist() == expected
        assert (caption.ids == 102).sum() == 1
        words = vocabulary.read_text(encoding="utf-8").splitlines()
        spans = [" ".join(words[t] for t in caption.ids[a:b]) for a, b in caption.spans]
        assert spans == ["tv stand", "mug", "hot - dog", "[ sep ] cat"]


# Scores.


def test_sigmoid_survives_the_infinities() -> None:
    x = np.array([-np.inf, -1e30, -100, -2, 0, 3, 100, np.inf], np.float32)
    with np.errstate(all="raise"):
        y = sigmoid(x)
    assert y[[0, -1]].tolist() == [0, 1]
    np.testing.assert_allclose(y[3:6], 1 / (1 + np.exp([2, 0, -3.0])), rtol=1e-6)


def test_a_name_scores_by_its_own_tokens() -> None:
    rng = np.random.default_rng(3)
    p = rng.uniform(size=(7, 12))
    spans = np.array([[1, 3], [4, 5], [6, 10]])
    expected = np.stack([p[:, a:b].max(axis=1) for a, b in spans], axis=1)
    assert np.array_equal(span_scores(p, spans), expected)


def stub(folder: Path, vocabulary: Path, outputs: dict[str, np.ndarray], **options: Any) -> Path:
    assert vocabulary.parent == folder
    return write_stub(folder / "model.onnx", options.pop("inputs", GROUNDING), outputs, **options)


def test_a_low_text_threshold_merges_no_names(tmp_path: Path, vocabulary: Path, frame: Frame) -> None:
    # [CLS] mug . dog . [SEP]: the second query is above 0.10 for both names, the third above 0.15 for a stop only.
    hits = {(0, 1): 2.0, (1, 1): -1.0, (1, 3): 0.5, (2, 2): 3.0, (2, 1): -2.0, (3, 2): 3.0, (4, 3): -1.8}
    boxes = {0: (0.25, 0.5, 0.3, 0.4), 1: (0.7, 0.5, 0.2, 0.6), 2: (0.5, 0.5, 0.9, 0.9), 4: (0.5, 0.5, 0.1, 0.1)}
    found = GroundingDinoDetector(stub(tmp_path, vocabulary, grounding_outputs(hits, boxes))).detect(
        frame, ["mug", "dog"]
    )
    assert found.labels == ("mug", "dog")
    assert found.masks is None
    # The fourth query has no name, the fifth is below the box threshold.
    assert [found.label(i) for i in range(len(found))] == ["mug", "mug", "dog"]
    assert (found.ids & 0xFFFF).tolist() == [2, 0, 1]
    np.testing.assert_allclose(found.scores, 1 / (1 + np.exp([-3, -2, -0.5])), rtol=1e-5)
    w, h = frame.width, frame.height
    np.testing.assert_allclose(found.boxes[2], [0.6 * w, 0.2 * h, 0.8 * w, 0.8 * h], rtol=1e-5)


def test_the_weaker_of_two_boxes_goes_within_a_name_only(tmp_path: Path, vocabulary: Path, frame: Frame) -> None:
    hits = {(q, t): v for q, t, v in ((0, 1, 2.0), (1, 1, 1.0), (2, 3, 1.5), (3, 1, 0.5), (4, 1, 0.4))}
    boxes = dict.fromkeys(range(3), (0.5, 0.5, 0.4, 0.4)) | {3: (0.1, 0.1, 0.1, 0.1), 4: (0.9, 0.9, 0.1, 0.1)}
    path = stub(tmp_path, vocabulary, grounding_outputs(hits, boxes))
    found = GroundingDinoDetector(path).detect(frame, ["mug", "dog"])
    assert (found.ids & 0xFFFF).tolist() == [0, 2, 3, 4]
    best = GroundingDinoDetector(path, k=1).detect(frame, ["mug", "dog"])
    assert (best.ids & 0xFFFF).tolist() == [0, 2]
    none = GroundingDinoDetector(path, min_score=0.95).detect(frame, ["mug", "dog"])
    assert len(none) == 0


def test_many_names_go_into_several_captions(vocabulary: Path, tmp_path: Path, frame: Frame) -> None:
    tokenizer = load_tokenizer(vocabulary)
    names = [f"cat {'dog ' * k}mug" for k in range(60)]
    captions = build_captions(names, tokenizer)
    assert len(captions) > 5
    assert all(len(c.ids) <= 256 for c in captions)
    assert np.concatenate([c.names for c in captions]).tolist() == list(range(60))
    for caption in captions:
        for name, (a, b) in zip(caption.names, caption.spans, strict=True):
            assert caption.ids[a:b].tolist() == tokenizer.encode(names[name]).ids
            assert caption.ids[b] == 1012
    assert len(build_captions(names[:8], tokenizer, limit=256)) == 1
    # Each run answers for its own names; every query's first token is the first name of its caption.
    path = stub(tmp_path, vocabulary, grounding_outputs({(0, 1): 2.0}, {0: (0.5, 0.5, 0.2, 0.2)}))
    found = GroundingDinoDetector(path).detect(frame, names)
    assert sorted(found.label_index.tolist()) == [int(c.names[0]) for c in captions]
    assert len(set(found.ids.tolist())) == len(captions)
    # So many are whole numbers to every reader of JSON.
    assert 0 <= found.ids.min() <= found.ids.max() < 2**53


@pytest.mark.parametrize(("name", "message"), [
    ("dog " * 300, "too long for the model; got 300 tokens"), ("..?", "no words"), ("", "no words"),
    ("龍", "knows no word"),
])  # fmt: skip
def test_a_name_that_cannot_be_asked_for_is_refused(vocabulary: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        build_captions(["mug", name], load_tokenizer(vocabulary))


def test_without_names_the_datasets_are_looked_for(tmp_path: Path, vocabulary: Path, frame: Frame) -> None:
    path = stub(tmp_path, vocabulary, grounding_outputs({(0, 3): 2.0}, {0: (0.5, 0.5, 0.2, 0.2)}))
    detector = make_detector("grounding-dino", model=path, class_names=("mug", "laptop"))
    assert detector.vocabulary is None
    assert [detector.detect(frame, None).label(0)] == ["laptop"]
    assert len(detector.detect(frame, [])) == 0
    with pytest.raises(InputError, match="by name"):
        make_detector("grounding-dino", model=path).detect(frame, None)


@pytest.mark.slow
def test_a_whole_expression_is_one_phrase(transformers_export: Export, frame: Frame) -> None:
    detector = make_detector("grounding-dino", model=transformers_export.path, min_score=0.01)
    (pointed, unknown) = point_by_detector(detector, frame, ["The mug left of the laptop.", "???"])
    best = detector.detect(frame, ["the mug left of the laptop"])
    assert pointed.box is not None
    np.testing.assert_allclose(pointed.box, best.boxes[0], atol=1e-3)
    assert unknown.box is None
    assert "no words" in str(unknown.problem)


# Files.


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("sizes", [("H", "W", "S"), (800, 800, "S"), (96, 128, 64), ("H", "W", 256)])
def test_sizes_and_types_are_what_the_file_declares(
    tmp_path: Path, vocabulary: Path, frame: Frame, dtype: Any, sizes: tuple[Any, Any, Any]
) -> None:
    height, width, tokens = sizes
    kind = TensorProto.FLOAT16 if dtype == np.float16 else TensorProto.FLOAT
    shapes = {"pixel_values": (1, 3, height, width), "pixel_mask": (1, height, width)}
    inputs: dict[str, Any] = {n: (t, shapes.get(n, (1, tokens))) for n, (t, _) in GROUNDING.items()}
    inputs["pixel_values"] = kind, shapes["pixel_values"]
    inputs["attention_mask"] = TensorProto.INT32, (1, tokens)
    outputs = grounding_outputs({(0, 1): 2.0}, {0: (0.5, 0.5, 0.25, 0.5)}, dtype=dtype)
    path = stub(tmp_path, vocabulary, outputs, inputs=inputs)
    detector = GroundingDinoDetector(path)
    found = detector.detect(frame, ["mug"])
    np.testing.assert_allclose(found.scores, [1 / (1 + np.exp(-2.0))], rtol=1e-3)
    w, h = frame.width, frame.height
    np.testing.assert_allclose(found.boxes, [[0.375 * w, 0.25 * h, 0.625 * w, 0.75 * h]], rtol=1e-3)
    if tokens == 64:
        with pytest.raises(InputError, match=r"too long.*at most 61"):
            detector.detect(frame, ["dog " * 62])


def test_a_graph_that_fails_optimised_is_loaded_as_it_is(
    tmp_path: Path, vocabulary: Path, frame: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    import onnxruntime as ort

    path = stub(tmp_path, vocabulary, grounding_outputs({(0, 1): 2.0}, {0: (0.5, 0.5, 0.2, 0.2)}))
    real, levels = ort.InferenceSession, []

    def picky(*args: Any, sess_options: Any, **options: Any) -> Any:
        levels.append(sess_options.graph_optimization_level)
        if sess_options.graph_optimization_level != ort.GraphOptimizationLevel.ORT_DISABLE_ALL:
            raise RuntimeError("InsertedPrecisionFreeCast_x has no shape")
        return real(*args, sess_options=sess_options, **options)

    monkeypatch.setattr(ort, "InferenceSession", picky)
    assert len(GroundingDinoDetector(path).detect(frame, ["mug"])) == 1
    assert len(levels) == 2


def broken(kind: str, folder: Path) -> Path:
    """A file that is no usable GroundingDINO."""
    path, outputs = folder / "model.onnx", grounding_outputs({(0, 1): 2.0}, {})
    inputs: dict[str, Any] = dict(GROUNDING)
    if kind == "other picture":
        inputs = {"images": (TensorProto.FLOAT, (1, 3, 640, 640))}
    if kind == "no text":
        del inputs["input_ids"]
    if kind == "grey":
        inputs["pixel_values"] = TensorProto.FLOAT, (1, 1, "H", "W")
    if kind == "unknown input":
        inputs["prompt_embeds"] = TensorProto.FLOAT, (1, 8)
    if kind == "no boxes":
        del outputs["pred_boxes"]
    if kind == "nan":
        outputs["logits"][0, 0, 0] = np.nan
    if kind == "few tokens":
        outputs["logits"] = outputs["logits"][:, :, :2]
    if kind == "batch of two":
        inputs["pixel_values"] = TensorProto.FLOAT, (2, 3, "H", "W")
    if kind == "missing file":
        return path
    write_stub(path, inputs, outputs, opset=99 if kind == "opset" else 17, external=kind == "external")
    if kind == "external":
        path.with_name(path.name + "_data").unlink()
    if kind == "truncated":
        path.write_bytes(path.read_bytes()[:-200])
    if kind == "empty":
        path.write_bytes(b"")
    if kind == "text":
        path.write_text("version https://git-lfs.github.com/spec/v1\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", [
    "other picture", "no text", "grey", "unknown input", "no boxes", "nan", "few tokens", "batch of two",
    "missing file", "opset", "external", "truncated", "empty", "text",
])  # fmt: skip
def test_a_broken_file_is_one_clear_line(
    kind: str, tmp_path: Path, vocabulary: Path, frame: Frame, capfd: pytest.CaptureFixture[str]
) -> None:
    path = broken(kind, tmp_path)
    with pytest.raises(InputError) as caught:
        GroundingDinoDetector(path).detect(frame, ["mug"])
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert capfd.readouterr() == ("", "")
    assert vocabulary.is_file()


@pytest.mark.slow
def test_another_models_tokenizer_is_refused(tmp_path: Path, vocabulary: Path, transformers_export: Export) -> None:
    words = vocabulary.read_text(encoding="utf-8").splitlines()
    vocabulary.write_text("\n".join(words[1:]) + "\n", encoding="utf-8")
    path = stub(tmp_path, vocabulary, grounding_outputs({}, {}))
    with pytest.raises(InputError, match=r"not the one of GroundingDINO.*\[CLS\] = 100.*bert-base-uncased"):
        GroundingDinoDetector(path)
    vocabulary.write_text("\n".join(w.replace("[UNK]", "[unk]") for w in words) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="no token for unknown words"):
        GroundingDinoDetector(path)
    vocabulary.unlink()
    with pytest.raises(InputError, match=r"no tokenizer.*tokenizer.json or vocab.txt"):
        GroundingDinoDetector(path)
    (tmp_path / "tokenizer.json").write_text('{"version": "1.0"}', encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read"):
        GroundingDinoDetector(path)
    # As the hubs lay models out: the tokenizer stands above the folder of the weights.
    (tmp_path / "onnx").mkdir()
    os.replace(path, tmp_path / "onnx" / "model.onnx")
    (tmp_path / "tokenizer.json").write_bytes(transformers_export.path.with_name("tokenizer.json").read_bytes())
    assert GroundingDinoDetector(tmp_path / "onnx" / "model.onnx").tokenizer_path == tmp_path / "tokenizer.json"


@pytest.mark.slow
def test_a_token_beyond_the_models_vocabulary_is_explained(
    transformers_export: Export, tmp_path: Path, vocabulary: Path
) -> None:
    longer = tmp_path / "longer" / "vocab.txt"
    longer.parent.mkdir()
    longer.write_text(vocabulary.read_text(encoding="utf-8") + "zebra\n", encoding="utf-8")
    detector = GroundingDinoDetector(transformers_export.path, tokenizer=longer)
    frame = frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["mug"])
    with pytest.raises(InputError, match="tokenizer that of another model"):
        detector.detect(frame, ["zebra"])


def test_a_missing_library_is_named(tmp_path: Path, vocabulary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = stub(tmp_path, vocabulary, grounding_outputs({}, {}))
    monkeypatch.setitem(__import__("sys").modules, "tokenizers", None)
    with pytest.raises(MissingExtra, match=r"spatialviz\[hub\]"):
        GroundingDinoDetector(path)


@pytest.mark.slow
def test_the_contracts_name_what_the_exports_declare(exported: dict[str, Export]) -> None:
    import onnxruntime as ort

    for contract, export in zip(GROUNDING_DINO_CONTRACTS, exported.values(), strict=True):
        declared = {i.name: (i.type, len(i.shape)) for i in ort.InferenceSession(str(export.path)).get_inputs()}
        types = {"tensor(float)": "float32", "tensor(int64)": "int64", "tensor(bool)": "bool"}
        wanted = {t.name: (t.dtype, len(t.shape)) for t in contract.inputs}
        assert {n: (types[t], rank) for n, (t, rank) in declared.items()} == wanted


def test_the_shared_stub(shared_data: Path, frame: Frame) -> None:
    found = make_detector("grounding-dino", model=shared_data / "onnx" / "gdino_stub.onnx").detect(
        frame, ["cat", "dog"]
    )
    assert [found.label(i) for i in range(len(found))] == ["cat", "dog", "dog"]
    np.testing.assert_allclose(found.scores, 1 / (1 + np.exp([-2, -1, -0.5])), rtol=1e-5)
    w, h = frame.width, frame.height
    np.testing.assert_allclose(found.boxes[0], [0.1 * w, 0.3 * h, 0.4 * w, 0.7 * h], rtol=1e-5)
