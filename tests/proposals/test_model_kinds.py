"""Model files of every kind given to every adapter: the right one reads them, the wrong one says which is right."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from model_stubs import STUBS, change, grown, halved, loosened, poisoned, write_model
from onnx_stubs import OWL, write_stub
from scenes import frame_of, upright
from slow_cases import mostly_slow
from waiting import LONG_S

from pipeline.geometry import Frame
from pipeline.proposals import make_detector, make_segmenter, reads_annotations, recognise
from pipeline.proposals.base import detect_expression
from pipeline.proposals.ensemble import EnsembleDetector
from pipeline.proposals.mismatch import explain_mismatch
from pipeline.system import PROVIDER_VARIABLE, InputError, ProviderWarning, open_session, use_execution
from pipeline.system.execution import wanted_accelerator, warn_once

pytest.importorskip("tokenizers", reason="detectors that read text need the extra hub")
ROOT = Path(__file__).resolve().parents[2]
KINDS = tuple(STUBS)
DETECTORS = tuple(k for k in KINDS if "coder" not in k)
ENCODERS = {"sam": "sam encoder", "sam2": "sam2 encoder", "efficientsam": "efficientsam encoder"}
BROKEN = ("missing", "folder", "empty", "text", "truncated", "newer opset", "no weights")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv(PROVIDER_VARIABLE, raising=False)
    warn_once.cache_clear()


@pytest.fixture(scope="module")
def frame() -> Frame:
    return frame_of([upright((0.1, 0.9, 2), (0.3, 0.4, 0.3))], ["mug"])


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A sound file of every kind; not to be changed."""
    folder = tmp_path_factory.mktemp("models")
    return {kind: write_model(kind, folder) for kind in KINDS}


def option_of(kind: str) -> str:
    return f"--{'segmenter' if 'coder' in kind else 'detector'} {kind.split()[0]}"


def used(kind: str, path: Path, files: dict[str, Path], frame: Frame) -> int:
    """Make what the kind is for out of the file, run it, and say how much it found."""
    name = kind.split()[0]
    if "coder" not in kind:
        made = make_detector(name, model=path)
        assert not reads_annotations(made)
        return len(made.detect(frame, ["mug"]))
    pair = (path, files[f"{name} decoder"]) if "encoder" in kind else (files[f"{name} encoder"], path)
    box = np.array([[20, 20, 90, 90]], np.float32)
    return int(make_segmenter(name, model=pair).segment(frame, box, ["mug"])[1].sum())


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_file_is_read_and_recognised(kind: str, files: dict[str, Path], frame: Frame) -> None:
    assert used(kind, files[kind], files, frame) > 0
    found = recognise(open_session(files[kind]))
    assert found is not None
    assert option_of(kind) in found.options
    assert explain_mismatch(open_session(files[kind]), "--detector other").startswith("this looks like ")


@pytest.mark.parametrize("kind", KINDS)
def test_the_wrong_option_names_the_right_one(kind: str, files: dict[str, Path]) -> None:
    path = files[kind]
    for other in dict.fromkeys(k.split()[0] for k in DETECTORS):
        same = {kind.split()[0], other} <= {"owlv2", "owlvit"} or other == kind.split()[0]
        if same or other == "boxes":
            continue
        with pytest.raises(InputError) as caught:
            make_detector(other, model=path)
        message = str(caught.value)
        assert "\n" not in message
        assert f"{option_of(kind)}" in message, message
        assert "expected " in message
        assert "got " in message
    for name in ENCODERS:
        if kind.split()[0] == name:
            continue
        with pytest.raises(InputError) as caught:
            make_segmenter(name, model=(path, path))
        # What is a detector and a segmenter is told to a segmenter's user as one.
        right = option_of(kind).replace("--detector yolo", "--segmenter yolo")
        assert right in str(caught.value), str(caught.value)


def test_the_promised_words(tmp_path: Path, files: dict[str, Path]) -> None:
    with pytest.raises(InputError) as caught:
        make_detector("grounding-dino", model=files["yolo-seg"])
    message = str(caught.value)
    assert "got images [1, 3, 64, 64]" in message
    assert "expected pixel_values [1, 3, H, W], input_ids [1, S]" in message
    assert "this looks like a YOLO export with masks: use --detector yolo-seg)" in message


@pytest.mark.parametrize("broken", BROKEN)
@pytest.mark.parametrize("kind", KINDS)
def test_a_broken_file_is_one_clear_line(
    kind: str, broken: str, tmp_path: Path, files: dict[str, Path], frame: Frame, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write_model(kind, tmp_path, opset=99 if broken == "newer opset" else 17, external=broken == "no weights")
    content = path.read_bytes()
    if broken in ("missing", "folder"):
        path.unlink()
        if broken == "folder":
            path.mkdir()
    elif broken == "no weights":
        path.with_name(path.name + "_data").unlink()
    elif broken != "newer opset":
        path.write_bytes(
            {"empty": b"", "text": b"version https://git-lfs", "truncated": content[: len(content) // 2]}[broken]
        )
    with pytest.raises(InputError) as caught:
        used(kind, path, files, frame)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 600
    assert str(path) in message
    words = {
        "missing": "there is no model file",
        "folder": "the model is a folder",
        "newer opset": "opset",
        "no weights": "its weights are in a file of their own",
        "truncated": "damaged, incomplete, or no ONNX file",
        "text": "it is a pointer of Git LFS",
        "empty": "",
    }
    assert words[broken] in message, message
    assert capfd.readouterr() == ("", "")


EDITED = [*((kind, halved) for kind in KINDS), *((kind, loosened) for kind in KINDS)]
ALWAYS = [k for k, (kind, edit) in enumerate(EDITED) if edit is halved or kind in ("boxes", "yolo-seg")]


@pytest.mark.parametrize(("kind", "edit"), mostly_slow(EDITED, fast=ALWAYS, several=True))
def test_half_precision_and_open_sizes_are_read(
    kind: str, edit: Callable[[Any], None], tmp_path: Path, files: dict[str, Path], frame: Frame
) -> None:
    path = write_model(kind, tmp_path)
    change(path, edit)
    if kind == "boxes" and edit is loosened:
        with pytest.raises(InputError, match="the model takes any size; expected size"):
            used(kind, path, files, frame)
        toml = path.with_suffix(".toml")
        toml.write_text(toml.read_text(encoding="utf-8") + "[input]\nsize = [64, 64]\n", encoding="utf-8")
    assert used(kind, path, files, frame) > 0


@pytest.mark.parametrize("edit", [grown, poisoned])
@pytest.mark.parametrize("kind", KINDS)
def test_outputs_that_are_wrong_are_one_clear_line(
    kind: str, edit: Callable[[Any], None], tmp_path: Path, files: dict[str, Path], frame: Frame
) -> None:
    path = write_model(kind, tmp_path)
    change(path, edit)
    if kind.endswith("encoder") and edit is poisoned:
        pytest.skip("the stub of the decoder does not look at what it is given")
    with pytest.raises(InputError) as caught:
        used(kind, path, files, frame)
    assert "\n" not in str(caught.value)


def test_suppressed_exports_give_what_plain_ones_do(files: dict[str, Path], frame: Frame) -> None:
    found = [
        make_detector("yolo-seg", model=files[k]).detect(frame, ["mug"]) for k in ("yolo-seg", "yolo-seg suppressed")
    ]
    np.testing.assert_allclose(found[0].boxes, found[1].boxes, atol=1e-4)
    np.testing.assert_allclose(found[0].scores, found[1].scores)
    assert found[0].masks is not None
    assert found[1].masks is not None
    np.testing.assert_array_equal(found[0].masks, found[1].masks)
    assert found[0].masks.sum() > 1000


def test_names_from_a_file_stand_in_for_the_metadata(tmp_path: Path, files: dict[str, Path], frame: Frame) -> None:
    path = write_model("yolo-seg", tmp_path)

    def nameless(model: Any) -> None:
        del model.metadata_props[:]

    change(path, nameless)
    with pytest.raises(InputError, match="metadata hold no class names"):
        make_detector("yolo-seg", model=path)
    names = tmp_path / "names.txt"
    names.write_text("mug\n", encoding="utf-8")
    assert len(make_detector("yolo-seg", model=path, config=names).detect(frame, ["mug"])) == 1
    names.write_text("mug\ncup\n", encoding="utf-8")
    with pytest.raises(InputError, match="not those of the model; got 2; expected 1"):
        make_detector("yolo-seg", model=path, config=names)


def test_what_is_asked_for_and_missing_falls_back_with_one_line(
    files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PROVIDER_VARIABLE, "auto")
    assert wanted_accelerator(["CPUExecutionProvider"]) is None
    assert wanted_accelerator(["CPUExecutionProvider", "CUDAExecutionProvider"]) == "CUDAExecutionProvider"
    assert wanted_accelerator(["CoreMLExecutionProvider", "CPUExecutionProvider"]) == "CoreMLExecutionProvider"
    use_execution("cpu")
    assert wanted_accelerator(["CPUExecutionProvider", "CUDAExecutionProvider"]) is None
    with pytest.raises(InputError, match="no such provider; got 'tpu'"):
        use_execution("tpu")
    use_execution("directml")
    with pytest.warns(ProviderWarning, match="has no directml") as told:
        sessions = [open_session(files["detic"]) for _ in range(3)]
    assert len(told) == 1
    assert all(s.get_providers() == ["CPUExecutionProvider"] for s in sessions)


def test_a_provider_that_fails_falls_back_with_one_line(
    files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    import onnxruntime as ort

    real, tried = ort.InferenceSession, []

    def failing(path: str, sess_options: Any, providers: list[str], **more: Any) -> Any:
        tried.append(providers[0])
        if providers[0] != "CPUExecutionProvider":
            raise RuntimeError("CUDA failure 35: driver version is insufficient\nmore lines")
        return real(path, sess_options=sess_options, providers=providers)

    monkeypatch.setattr(ort, "InferenceSession", failing)
    monkeypatch.setattr(ort, "get_available_providers", lambda: ["CUDAExecutionProvider", "CPUExecutionProvider"])
    monkeypatch.setenv(PROVIDER_VARIABLE, "cuda")
    with pytest.warns(ProviderWarning, match="cannot be used, the CPU computes: CUDA failure 35") as told:
        assert open_session(files["detic"]).get_providers() == ["CPUExecutionProvider"]
    assert len(told) == 1
    assert "\n" not in str(told[0].message)
    assert tried == ["CUDAExecutionProvider", "CPUExecutionProvider"]
    # A network for which it costs more than it saves stays on the CPU.
    open_session(files["detic"], threads=1)
    assert tried[2:] == ["CPUExecutionProvider"]


def child(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "spatialviz", *arguments],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
    )


@pytest.mark.slow
def test_onnx_runtimes_own_messages_are_shown_only_where_asked_for(shared_data: Path) -> None:
    path = str(shared_data / "onnx" / "picodet_s_416_coco.onnx")
    quiet = child("models", path)
    assert quiet.stderr == ""
    assert "a detector of boxes" in quiet.stdout
    loud = child("models", path, SPATIALVIZ_VERBOSE="1")
    assert loud.stderr.count("appears in graph inputs") > 100
    assert loud.stdout == quiet.stdout


@pytest.mark.slow
def test_the_command_says_what_a_file_is(files: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "no.onnx").write_bytes(b"nothing")
    done = child("models", *(str(files[k]) for k in ("yolo-seg", "detic", "sam decoder")), "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["files"]
    assert [f["options"][0] for f in found] == ["--detector yolo-seg", "--detector detic", "--segmenter sam"]
    assert found[0]["class_names"] == 1
    assert found[1]["missing"] == []
    bad = child("models", str(tmp_path / "no.onnx"))
    assert bad.returncode == 1
    assert "damaged, incomplete, or no ONNX file" in bad.stdout


@pytest.mark.slow
def test_the_command_lists_what_there_is(tmp_path: Path) -> None:
    folder = tmp_path / "models" / "someone--a-model" / ("a" * 40)
    folder.mkdir(parents=True)
    (folder / "m.onnx").write_bytes(b"x")
    networks = tmp_path / "networks"
    networks.mkdir()
    (networks / "mine.onnx").write_bytes(b"x")
    done = child("models", "--json", SPATIALVIZ_CACHE=str(tmp_path), SPATIALVIZ_NETWORKS=str(networks))
    record = json.loads(done.stdout)
    assert [f["id"] for f in record["fetched"]] == [f"someone/a-model:m.onnx@{'a' * 40}"]
    assert [n["name"] for n in record["relation_networks"]] == ["mine"]
    assert "CPUExecutionProvider" in record["providers"]
    options = {a["option"] for a in record["adapters"]}
    assert {o for o in options if not o.startswith("--depth-model ")} == {option_of(k) for k in KINDS}
    assert all(a["contracts"] for a in record["adapters"])


def test_a_long_run_is_counted_and_keeps_its_memory(files: dict[str, Path], tmp_path: Path) -> None:
    from benchmarks.endurance import run_endurance

    from pipeline.answering import open_pipeline

    source = open_pipeline("demo", detector="yolo-seg", model=files["yolo-seg"], srm="rule")
    seen: list[tuple[int, int]] = []
    report = run_endurance(source, source.dataset.frame_ids[:3], 40, lambda done, total: seen.append((done, total)))
    assert seen == [(k, 40) for k in range(1, 41)]
    # No picture is one that the detector, or its cache, has seen.
    assert report.detections == report.pictures == 40
    assert report.frames_per_second > 0
    assert len(report.resident_mb) in (0, 20)
    if report.growth_mb is not None:
        assert abs(report.growth_mb) < 50
    # What it kept is gone, that of further detectors as well.
    fused = EnsembleDetector([make_detector(k, model=files[k]) for k in ("yolo-seg", "boxes")])
    assert run_endurance(replace(source, detector=fused), source.dataset.frame_ids[:1], 2).pictures == 2
    assert not list((tmp_path / "cache").rglob("*.npz"))
    assert json.loads(json.dumps(asdict(report)))["detector"] == "yolo-seg"


@pytest.mark.slow
def test_a_detector_is_made_of_a_model_on_a_hub(
    files: dict[str, Path], frame: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("huggingface_hub")
    from model_hub import running_hub

    with running_hub() as hub:
        monkeypatch.setenv("HF_ENDPOINT", hub.url)
        monkeypatch.setenv("NO_PROXY", "127.0.0.1")
        owl = files["owlv2"]
        tokenizer = owl.with_name("tokenizer.json").read_bytes()
        hub.put("x/owl", "c" * 40, onnx__model_dot_onnx=owl.read_bytes(), tokenizer_dot_json=tokenizer)
        made = make_detector("owlv2", model=Path("x/owl"))
        assert len(made.detect(frame, ["mug"])) > 0
        sam = {f"{k}_dot_onnx": files[f"sam {k}"].read_bytes() for k in ("encoder", "decoder")}
        hub.put("x/sam", "d" * 40, **sam)
        segmenter = make_segmenter("sam", model=(Path("x/sam:encoder.onnx"), Path("x/sam:decoder.onnx")))
        box = np.array([[20, 20, 90, 90]], np.float32)
        assert segmenter.segment(frame, box, ["mug"])[1].all()


@pytest.mark.parametrize(
    ("inputs", "outputs", "words"),
    [
        ({"images": (1, 3, 64, 64)}, {"output0": (1, 84, 8400)}, "a YOLO export without masks; describe its tensors"),
        ({"images": (1, 3, 64, 64)}, {"output0": (1, 300, 6)}, "a YOLO export without masks"),
        ({"images": (1, 3, 64, 64)}, {"dets": (1, 50, 5), "boxes": (1, 50, 4)}, "a detector of boxes; describe"),
        ({"images": (1, 3, 64, 64), "text_features": (1, 2, 512)}, {"scores": (1, 9, 2)}, "its text from outside"),
        ({"input_ids": (1, 16)}, {"text_embeds": (1, 512)}, "the text part of a model"),
        ({"x": (1, 7)}, {"y": (1, 7)}, "is it a file for another --detector?"),
        ({"image": (1, 3, 64, 64)}, {"class": (1, 1000)}, "is it a file for another --detector?"),
    ],
)
def test_relatives_are_told_what_they_lack(
    tmp_path: Path, inputs: dict[str, tuple[int, ...]], outputs: dict[str, tuple[int, ...]], words: str
) -> None:
    from onnx import TensorProto
    from onnx_stubs import write_stub

    path = write_stub(
        tmp_path / "m.onnx",
        {n: (TensorProto.FLOAT, shape) for n, shape in inputs.items()},
        {n: np.zeros(shape, np.float32) for n, shape in outputs.items()},
    )
    for name in ("grounding-dino", "owlv2", "yolo-seg", "detic"):
        with pytest.raises(InputError) as caught:
            make_detector(name, model=path)
        assert words in str(caught.value), str(caught.value)


def test_a_whole_expression_is_asked_apart_from_its_names(files: dict[str, Path], frame: Frame) -> None:
    detector = make_detector("owlv2", model=files["owlv2"], min_score=0.0)
    whole = detect_expression(detector, frame, "Mug of dog")
    assert set(whole.labels) == {"Mug of dog"}
    assert len(whole) == len(detect_expression(detector, frame, "Mug of dog")) > 0
    with pytest.raises(InputError, match="by name"):
        detector.detect(frame, None)
    twice = make_detector("grounding-dino", model=files["grounding-dino"]).detect(frame, ["mug", "Mug"])
    assert set(twice.labels) <= {"mug", "Mug"}


def test_a_file_of_the_other_owl_is_refused(tmp_path: Path, files: dict[str, Path]) -> None:
    inputs = {**OWL, "pixel_values": (OWL["pixel_values"][0], (1, 3, 768, 768))}
    outputs = {"logits": np.zeros((1, 9, 1), np.float32), "pred_boxes": np.full((1, 9, 4), 0.5, np.float32)}
    path = write_stub(tmp_path / "model.onnx", inputs, outputs)
    with pytest.raises(InputError, match=r"no tokenizer for the model|no .*tokenizer"):
        make_detector("owlvit", model=path)
    shutil.copy(files["owlv2"].with_name("tokenizer.json"), tmp_path)
    with pytest.raises(InputError, match="this is owlvit's: use --detector owlvit"):
        make_detector("owlv2", model=path)
    (tmp_path / "tokenizer.json").write_text("{}")
    with pytest.raises(InputError, match="the tokenizer cannot be read"):
        make_detector("owlvit", model=path)
