"""SAM, SAM 2 and EfficientSAM against the reference code, hostile files, batches, caches, the wiring."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sam_exports import SAM2_SIDE, Export, export_sam, export_sam2, save

from pipeline.answering import open_pipeline
from pipeline.datasets import Dataset
from pipeline.geometry import Frame
from pipeline.proposals import CachedSegmenter, make_segmenter
from pipeline.proposals.mismatch import SEGMENTERS
from pipeline.proposals.prompted import EfficientSamModel, PairModel, PromptedSegmenter, Sam2Model, SamModel
from pipeline.proposals.segmenter import mask_at, takes_points
from pipeline.system import InputError


@pytest.fixture(scope="session")
def sam(tmp_path_factory: pytest.TempPathFactory) -> Export:
    return export_sam(tmp_path_factory.mktemp("sam"))


@pytest.fixture(scope="session")
def sam2(tmp_path_factory: pytest.TempPathFactory) -> Export:
    return export_sam2(tmp_path_factory.mktemp("sam2"))


@pytest.fixture(scope="session")
def picture(demo_dataset: Dataset) -> Frame:
    return demo_dataset.load(demo_dataset.frame_ids[0])


def part(frame: Frame, height: int, width: int) -> Frame:
    """A frame of another shape."""
    camera = replace(frame.camera, height=height, width=width)
    rgb, depth = frame.rgb[:height, :width], frame.depth[:height, :width]
    return replace(frame, rgb=rgb, depth=depth, camera=camera, annotations=())


def boxes_in(height: int, width: int) -> np.ndarray:
    return np.array([[0.1, 0.2, 0.6, 0.9], [0.5, 0.05, 0.95, 0.5], [0.3, 0.3, 0.45, 0.62]], np.float32) * np.array(
        [width, height] * 2, np.float32
    )


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def assert_same(mask: np.ndarray, reference: np.ndarray, logits: np.ndarray, low_res: np.ndarray) -> None:
    assert 0.03 < reference.mean() < 0.97
    assert iou(mask, reference) > 0.99
    np.testing.assert_allclose(logits, low_res, rtol=0, atol=1e-4)


# Conformance.


@pytest.mark.slow
@pytest.mark.parametrize(("flavour", "shape"), [("inside", (480, 300)), ("square", (480, 640)), ("x", (480, 300))])
def test_sam_is_what_the_official_predictor_gives(
    sam: Export, picture: Frame, flavour: str, shape: tuple[int, int]
) -> None:
    from segment_anything import SamPredictor

    frame, boxes = part(picture, *shape), boxes_in(*shape)
    model = SamModel([sam.encoders[flavour], sam.decoders["four"]])
    segmenter = PromptedSegmenter(model)
    masks, has_mask = segmenter.segment(frame, boxes, ["thing"] * 3)
    assert has_mask.all()
    assert len(segmenter._features._kept) == 1
    predictor = SamPredictor(sam.model)
    predictor.set_image(frame.rgb)
    for mask, box in zip(masks, boxes, strict=True):
        reference, _, low_res = predictor.predict(box=box, multimask_output=False)
        logits = model.decode(segmenter._encoded(frame), box[None], *shape)[0]
        assert_same(mask, np.asarray(reference[0]), logits, np.asarray(low_res[0]))


@pytest.mark.slow
def test_a_point_is_what_the_official_predictor_makes_of_it(sam: Export, picture: Frame, tmp_path: Path) -> None:
    from segment_anything import SamPredictor

    frame = part(picture, 480, 640)
    segmenter = CachedSegmenter(PromptedSegmenter(SamModel([sam.encoders["square"], sam.decoders["four"]])), tmp_path)
    assert takes_points(segmenter)
    point = np.array([[310.0, 200.0]])
    predictor = SamPredictor(sam.model)
    predictor.set_image(frame.rgb)
    masks, scores, _ = predictor.predict(point_coords=point, point_labels=np.ones(1), multimask_output=True)
    assert iou(mask_at(segmenter, frame, point), np.asarray(masks[scores.argmax()])) > 0.99


@pytest.mark.slow
def test_an_export_of_one_mask_gets_the_padding_point(sam: Export, picture: Frame) -> None:
    import torch
    from segment_anything.utils.onnx import SamOnnxModel
    from segment_anything.utils.transforms import ResizeLongestSide

    # In picture size this file's masks are cropped at the aspect ratio of the export, 1500x2250.
    frame, boxes = part(picture, 480, 300), boxes_in(480, 300)
    model = SamModel([sam.encoders["inside"], sam.decoders["single"]])
    segmenter = PromptedSegmenter(model)
    masks, _ = segmenter.segment(frame, boxes, ["thing"] * 3)
    features = segmenter._encoded(frame)
    for mask, box in zip(masks, boxes, strict=True):
        points = ResizeLongestSide(1024).apply_coords(box.reshape(2, 2), (480, 300))
        with torch.no_grad():
            full, _, low_res = SamOnnxModel(sam.model, return_single_mask=True)(
                torch.from_numpy(features["image_embeddings"]),
                torch.from_numpy(np.vstack([points, [[0, 0]]])[None]).float(),
                torch.tensor([[2.0, 3.0, -1.0]]),
                torch.zeros(1, 1, 256, 256),
                torch.zeros(1),
                torch.tensor([480.0, 300.0]),
            )
        logits = model.decode(features, box[None], 480, 300)[0]
        assert_same(mask, full[0, 0].numpy() > 0, logits, low_res[0, 0].numpy())


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["samexporter", "transformers"])
def test_sam2_is_what_its_processor_and_model_give(sam2: Export, picture: Frame, flavour: str) -> None:
    import torch
    from transformers import Sam2ImageProcessor, Sam2Processor

    frame, boxes = part(picture, 300, 400), boxes_in(300, 400)
    model = Sam2Model([sam2.encoders[flavour], sam2.decoders[flavour]])
    segmenter = PromptedSegmenter(model)
    masks, has_mask = segmenter.segment(frame, boxes, ["thing"] * 3)
    assert has_mask.all()
    assert segmenter._batches
    side = {"height": SAM2_SIDE, "width": SAM2_SIDE}
    processor = Sam2Processor(Sam2ImageProcessor(size=side))
    asked = processor(images=frame.rgb, input_boxes=[boxes.tolist()], return_tensors="pt")
    with torch.no_grad():
        found = sam2.model(pixel_values=asked["pixel_values"], input_boxes=asked["input_boxes"], multimask_output=True)
    full = processor.post_process_masks(found.pred_masks, asked["original_sizes"])[0].numpy()
    best = found.iou_scores[0].argmax(-1).tolist()
    assert len(set(best)) > 1 or best[0] != 0  # The choice is put to the test.
    logits = model.decode(segmenter._encoded(frame), boxes, 300, 400)
    for k, choice in enumerate(best):
        assert_same(masks[k], full[k, choice], logits[k], found.pred_masks[0, k, choice].numpy())


@pytest.mark.parametrize("encoder", ["hwc", "nchw"])
def test_the_contract_stub_gives_the_boxes_back(shared_data: Path, picture: Frame, encoder: str) -> None:
    files = (shared_data / f"onnx/sam_encoder_{encoder}_stub.onnx", shared_data / "onnx/sam_decoder_stub.onnx")
    boxes = np.stack([a.bbox for a in picture.annotations]).astype(np.float32)
    masks, has_mask = PromptedSegmenter(SamModel(files)).segment(picture, boxes, ["thing"] * len(boxes))
    assert has_mask.all()
    v, u = np.mgrid[0 : picture.height, 0 : picture.width]
    for mask, (x0, y0, x1, y1) in zip(masks, boxes, strict=True):
        assert iou(mask, (u > x0) & (u < x1) & (v > y0) & (v < y1)) > 0.95


# EfficientSAM: the box of each query, drawn; the first and the last candidate are too small and too large.


def export_efficientsam(folder: Path, *, half: bool = False, queries: bool = True) -> tuple[Path, Path]:
    import torch

    class Encoder(torch.nn.Module):
        def forward(self, images: Any) -> Any:
            return torch.nn.functional.adaptive_avg_pool2d(images, 1).mean(1, keepdim=True).expand(1, 256, 64, 64) * 1

    class Decoder(torch.nn.Module):
        def forward(self, embeddings: Any, points: Any, labels: Any, size: Any) -> Any:
            first = (points * (labels == 2)[..., None]).sum(2)[..., None, None]
            last = (points * (labels == 3)[..., None]).sum(2)[..., None, None]
            v = torch.arange(size[0])[:, None].float()
            u = torch.arange(size[1])[None].float()
            inside = torch.minimum(
                torch.minimum(u - first[:, :, 0], last[:, :, 0] - u),
                torch.minimum(v - first[:, :, 1], last[:, :, 1] - v),
            )
            masks = torch.stack([inside - 9, inside + 9, inside], dim=2) + 0 * embeddings.float().mean()
            scores = torch.tensor([[[0.2, 0.5, 0.9]]]) + 0 * labels.sum(2, keepdim=True)
            return masks, scores

    kind = torch.float16 if half else torch.float32
    encoder = save(
        Encoder(),
        {"batched_images": torch.rand(1, 3, 48, 64, dtype=kind)},
        folder / "encoder.onnx",
        ["image_embeddings"],
        {"batched_images": {0: "batch", 2: "height", 3: "width"}},
    )
    free = {**({1: "num_queries"} if queries else {}), 2: "num_points"}
    decoder = save(
        Decoder(),
        {
            "image_embeddings": torch.rand(1, 256, 64, 64, dtype=kind),
            "batched_point_coords": torch.rand(1, 1, 2, 2) * 40,
            "batched_point_labels": torch.tensor([[[2.0, 3.0]]]),
            "orig_im_size": torch.tensor([48, 64]),
        },
        folder / "decoder.onnx",
        ["output_masks", "iou_predictions"],
        {"image_embeddings": {0: "batch"}, "batched_point_coords": free, "batched_point_labels": free},
    )
    return encoder, decoder


@pytest.mark.slow
@pytest.mark.parametrize(("half", "queries"), [(False, True), (True, False)])
def test_efficientsam_takes_picture_pixels_and_the_best_candidate(
    tmp_path: Path, picture: Frame, half: bool, queries: bool
) -> None:
    pytest.importorskip("torch")
    model = EfficientSamModel(export_efficientsam(tmp_path, half=half, queries=queries))
    segmenter = PromptedSegmenter(model)
    frame, boxes = part(picture, 300, 400), boxes_in(300, 400)
    assert model.boxes_at_once(300, 400) == (8 if queries else 1)
    masks, _ = segmenter.segment(frame, boxes, ["thing"] * 3)
    v, u = np.mgrid[0:300, 0:400]
    for mask, (x0, y0, x1, y1) in zip(masks, boxes, strict=True):
        assert np.array_equal(mask, (u > x0) & (u < x1) & (v > y0) & (v < y1))


# Batches and caches.


class Boxes(PairModel):
    """A model that marks boxes; with `first_only` it holds the first box it is given, as a badly traced graph does."""

    name = "boxes"

    def __init__(self, first_only: bool) -> None:
        self.first_only = first_only
        self.runs: list[int] = []

    def fingerprint(self) -> str:
        return "boxes"

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        return {"rgb": rgb}

    def boxes_at_once(self, height: int, width: int) -> int:
        return 4

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        self.runs.append(len(boxes))
        v, u = np.mgrid[0:height, 0:width].astype(np.float32)
        used = np.repeat(boxes[:1], len(boxes), axis=0) if self.first_only else boxes
        return np.stack([np.minimum(np.minimum(u - a, c - u), np.minimum(v - b, d - v)) for a, b, c, d in used])

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        return logits


@pytest.mark.parametrize(("first_only", "runs"), [(False, [1, 4, 2]), (True, [1, 4, 1, 1, 1, 1, 1])])
def test_boxes_go_together_only_where_that_is_the_same(picture: Frame, first_only: bool, runs: list[int]) -> None:
    frame = part(picture, 60, 80)
    boxes = np.concatenate([boxes_in(60, 80), boxes_in(60, 80)[:, [1, 0, 3, 2]]])
    model = Boxes(first_only)
    masks, _ = PromptedSegmenter(model).segment(frame, boxes, ["thing"] * 6)
    assert model.runs == runs
    for mask, box in zip(masks, boxes, strict=True):
        alone, _ = PromptedSegmenter(Boxes(False)).segment(frame, box[None], ["thing"])
        assert np.array_equal(mask, alone[0])


def test_masks_are_kept_on_disk_by_picture_models_and_box(tmp_path: Path, picture: Frame) -> None:
    frame, boxes = part(picture, 60, 80), boxes_in(60, 80)
    model = Boxes(False)
    first, _ = CachedSegmenter(PromptedSegmenter(model), tmp_path).segment(frame, boxes, ["a", "b", "c"])
    count = len(model.runs)
    again = CachedSegmenter(PromptedSegmenter(model), tmp_path)
    assert np.array_equal(again.segment(frame, boxes[::-1], ["a", "b", "c"])[0], first[::-1])
    assert len(model.runs) == count
    again.path(frame, boxes[1]).write_bytes(b"damaged")
    assert np.array_equal(again.segment(frame, boxes, ["a", "b", "c"])[0], first)
    assert len(model.runs) == count + 1
    again.segment(replace(frame, rgb=255 - frame.rgb), boxes[:1], ["a"])
    assert len(model.runs) == count + 2


@pytest.mark.slow
def test_the_fingerprint_holds_both_files(sam: Export) -> None:
    found = {
        SamModel([sam.encoders[e], sam.decoders[d]]).fingerprint() for e in ("square", "x") for d in ("single", "four")
    }
    assert len(found) == 4
    beside = sam.encoders["x"].with_name(sam.encoders["x"].name + ".data")
    beside.write_bytes(b"weights in a file of their own")
    try:
        assert SamModel([sam.encoders["x"], sam.decoders["four"]]).fingerprint() not in found
    finally:
        beside.unlink()


# Files that do not fit.


def assert_refused(name: str, files: Sequence[Path], *words: str) -> None:
    with pytest.raises(InputError) as caught:
        make_segmenter(name, model=tuple(files))
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


@pytest.mark.slow
def test_files_that_do_not_fit_are_explained(sam: Export, sam2: Export, tmp_path: Path) -> None:
    encoder, decoder = sam.encoders["x"], sam.decoders["four"]
    assert_refused("sam", [decoder, encoder], "the wrong way round", "expected --segmenter-model x.onnx four.onnx")
    assert_refused("sam", [encoder], "two model files")
    assert_refused("sam", [], "--segmenter-model ENCODER.onnx DECODER.onnx")
    assert_refused("sam", [encoder, encoder], "not the decoder", "this is the SAM or MobileSAM encoder")
    assert_refused("sam", [sam2.encoders["samexporter"], decoder], "SAM 2 encoder (samexporter)", "--segmenter sam2")
    assert_refused("sam2", [encoder, decoder], "use --segmenter sam")
    assert_refused("efficientsam", [encoder, decoder], "use --segmenter sam")
    assert_refused("sam2", [sam2.encoders["transformers"], sam2.decoders["samexporter"]], "do not belong together")
    assert_refused("depth", [encoder, decoder], "one file at most", "sam or sam2 or efficientsam")
    assert_refused("sam", [tmp_path / "none.onnx", decoder], "there is no model file")


@pytest.mark.slow
def test_damaged_files_are_refused_in_one_line(sam: Export, tmp_path: Path) -> None:
    import onnx

    encoder, decoder = sam.encoders["x"], sam.decoders["four"]
    (tmp_path / "short.onnx").write_bytes(encoder.read_bytes()[:100_000])
    assert_refused("sam", [tmp_path / "short.onnx", decoder], "cannot load", "damaged, incomplete")
    newer = onnx.load(encoder)
    newer.opset_import[0].version = 99
    onnx.save(newer, tmp_path / "newer.onnx")
    assert_refused("sam", [tmp_path / "newer.onnx", decoder], "cannot load", "opset")
    outside = onnx.load(encoder)
    onnx.save(outside, tmp_path / "outside.onnx", save_as_external_data=True, location="outside.bin", size_threshold=0)
    make_segmenter("sam", model=(tmp_path / "outside.onnx", decoder))
    (tmp_path / "outside.bin").unlink()
    assert_refused("sam", [tmp_path / "outside.onnx", decoder], "cannot load", "keep it beside the model")


def declare(path: Path, inputs: dict[str, Any], outputs: dict[str, Any]) -> Path:
    """A file that declares inputs and outputs ((ONNX type, shape) by name) and gives constants."""
    from onnx import TensorProto, helper, save_model

    def value(name: str, kind: str, shape: Sequence[Any]) -> Any:
        return helper.make_tensor_value_info(name, getattr(TensorProto, kind), shape)

    sizes = {n: [d if isinstance(d, int) else 1 for d in shape] for n, (_, shape) in outputs.items()}
    filled = [helper.make_tensor(f"shape of {n}", TensorProto.INT64, [len(s)], s) for n, s in sizes.items()]
    graph = helper.make_graph(
        [helper.make_node("ConstantOfShape", [f"shape of {n}"], [n]) for n in outputs],
        "declared",
        [value(n, *spec) for n, spec in inputs.items()],
        [value(n, "FLOAT", [None] * len(spec[1])) for n, spec in outputs.items()],
        filled,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    save_model(model, path)
    return path


def test_the_sam_of_transformers_js_is_refused_with_the_reason(tmp_path: Path) -> None:
    embeddings = ("FLOAT", ["b", 256, 64, 64])
    encoder = declare(
        tmp_path / "vision_encoder.onnx",
        {"pixel_values": ("FLOAT", ["b", 3, 1024, 1024])},
        {"image_embeddings": embeddings, "image_positional_embeddings": embeddings},
    )
    decoder = declare(
        tmp_path / "prompt_encoder_mask_decoder.onnx",
        {
            "image_embeddings": embeddings,
            "image_positional_embeddings": embeddings,
            "input_points": ("FLOAT", ["b", "p", "n", 2]),
            "input_labels": ("INT64", ["b", "p", "n"]),
        },
        {"iou_scores": ("FLOAT", ["b", "p", 3]), "pred_masks": ("FLOAT", ["b", "p", 3, 256, 256])},
    )
    for name in ("sam", "sam2"):
        assert_refused(name, [encoder, decoder], "transformers.js, whose decoder takes no box")


@pytest.mark.slow
def test_embeddings_of_another_size_are_refused(sam: Export, tmp_path: Path) -> None:
    square = {"x": ("FLOAT", [1, 3, 1024, 1024])}
    small = declare(tmp_path / "small.onnx", square, {"image_embeddings": ("FLOAT", [1, 256, 32, 32])})
    assert_refused("sam", [small, sam.decoders["four"]], "do not belong together", "[1, 256, 32, 32]")
    model = SamModel([sam.encoders["x"], sam.decoders["four"]])
    with pytest.raises(InputError, match=r"cannot be run; got .*image_embeddings"):
        model.decode({"image_embeddings": np.zeros((1, 256, 32, 32))}, boxes_in(30, 40)[:1], 30, 40)
    points = {"batched_point_coords": ("FLOAT", [1, 5, 1, 2]), "batched_point_labels": ("FLOAT", [1, 5, 1])}
    one_point = declare(
        tmp_path / "points.onnx",
        {"image_embeddings": ("FLOAT", ["b", 256, 64, 64]), **points, "orig_im_size": ("INT64", [2])},
        {"output_masks": ("FLOAT", [1, 5, 3, 8, 8]), "iou_predictions": ("FLOAT", [1, 5, 3])},
    )
    images = {"batched_images": ("FLOAT", ["b", 3, "h", "w"])}
    encoder = declare(tmp_path / "e.onnx", images, {"image_embeddings": ("FLOAT", [1, 256, 64, 64])})
    assert_refused("efficientsam", [encoder, one_point], "one point a query, and a box is two")


@pytest.mark.slow
def test_a_model_that_the_optimiser_spoils_is_loaded_without_it(sam: Export, monkeypatch: pytest.MonkeyPatch) -> None:
    import onnxruntime as ort

    real = ort.InferenceSession
    levels = []

    def spoilt(path: str, sess_options: Any, providers: Any) -> Any:
        levels.append(sess_options.graph_optimization_level)
        if levels[-1] != ort.GraphOptimizationLevel.ORT_DISABLE_ALL:
            raise RuntimeError("InsertedPrecisionFreeCast")
        return real(path, sess_options=sess_options, providers=providers)

    monkeypatch.setattr(ort, "InferenceSession", spoilt)
    SamModel([sam.encoders["x"], sam.decoders["four"]])
    assert len(levels) == 4


# The wiring.


@pytest.mark.slow
def test_a_question_is_answered_with_masks_of_sam(sam: Export, tmp_path: Path, picture: Frame) -> None:
    recording = {
        "frames": {
            picture.id: [
                {"label": a.label, "score": 0.9, "bbox": [float(v) for v in a.bbox]} for a in picture.annotations
            ]
        }
    }
    (tmp_path / "boxes.json").write_text(json.dumps(recording))
    files = (sam.encoders["inside"], sam.decoders["four"])
    source = open_pipeline(
        "demo", detector="recorded", model=tmp_path / "boxes.json", segmenter="sam", segmenter_model=files, srm="rule"
    )
    trace = source.ask(picture, "the mug left of the laptop")
    assert trace.timings["masks"] > 0
    assert {o.lifted.quality.mask_source for o in trace.objects} == {"segmenter"}
    assert trace.detector == "recorded+sam"


def test_every_contract_says_what_it_is() -> None:
    assert len({c.what for c in SEGMENTERS}) == len(SEGMENTERS)
    assert {c.option for c in SEGMENTERS} == {"--segmenter sam", "--segmenter sam2", "--segmenter efficientsam"}
    assert all(c.inputs and c.outputs for c in SEGMENTERS)
