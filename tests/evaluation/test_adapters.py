"""Published files as predictions: each sample is written as its program writes it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from concept_graph_maps import corners, map_object, write_map
from scenes import frame_of, upright

from pipeline.answering import Header, Predictions, read_predictions
from pipeline.datasets import FrameNames, InMemoryDataset
from pipeline.evaluation.adapters import FORMATS, PredictionFormat, convert_predictions
from pipeline.evaluation.adapters.converting import is_published
from pipeline.labels.reading import arrow_schema, write_table
from pipeline.system import FrameUnusable, InputError, pa, plugins, sha256_of

IDS = ("000001/000000", "000001/000020", "000002/000003")
TWO = ("000001/000000", "000002/000000")
MUG = "mug left of the laptop"
ASKED = {IDS[0]: [MUG, "laptop right of the mug"], IDS[1]: [MUG]}


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Three frames and what the labels ask of two of them."""
    boxes = [upright((x, 0.9, 2), (0.3, 0.4, 0.3)) for x in (-0.6, 0.6)]
    frames = [frame_of(boxes, ["mug", "laptop"], name=i) for i in IDS]
    rows = [
        {"frame": frame, "text": text, "target": text.split()[0], "reference": text.split()[-1]}
        for frame, texts in ASKED.items()
        for text in texts
    ]
    every = [(frame.id, a.label, np.asarray(a.bbox, float).tolist()) for frame in frames for a in frame.annotations]
    root = tmp_path_factory.mktemp("labels")
    things = pa.table(dict(zip(("frame", "label", "bbox"), map(list, zip(*every, strict=True)), strict=True)))
    write_table(things.replace_schema_metadata(arrow_schema("objects").metadata), root / "objects.parquet")
    labels: Any = SimpleNamespace(expressions=pa.Table.from_pylist(rows), root=root)
    return {"dataset": InMemoryDataset(frames), "labels": labels}


def of_lines(path: Path, *rows: dict[str, Any]) -> Path:
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return path


def of_json(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def converted(path: Path, world: dict[str, Any], **more: Any) -> Predictions:
    out = path.parent / f"{path.name}.predictions"
    report = convert_predictions(path, out, **world, **more)
    found = read_predictions(out)
    assert report.lines == len(found.lines)
    assert FORMATS[report.format].level <= max(line.level for line in found.lines.values())
    return found


def refused(path: Path, world: dict[str, Any], message: str, **more: Any) -> None:
    with pytest.raises(InputError, match=message) as error:
        convert_predictions(path, path.parent / "refused.predictions", **world, **more)
    assert "\n" not in str(error.value)
    (path.parent / "refused.predictions").unlink(missing_ok=True)


def answer(found: Predictions, frame: str = IDS[0], text: str = MUG) -> Any:
    return found.lines[frame, text].answer


# Which frame a picture is.


def test_pictures_find_their_frames() -> None:
    names = FrameNames((*IDS, "office/a.b", "kv2/000103_x"))
    for picture, frame in (
        (IDS[1], IDS[1]),
        (f"{IDS[1]}.png", IDS[1]),
        ("data/000001/rgb/000020.jpg", IDS[1]),
        ("000020.jpg", IDS[1]),
        (20, IDS[1]),
        ("20.png", IDS[1]),
        ("000001\\rgb\\000020.jpg", IDS[1]),
        ("a.b", "office/a.b"),
        ("a.b.png", "office/a.b"),
        ("SUN/kv2/000103_x/image/0000103.jpg", "kv2/000103_x"),
        ("none.png", None),
        (7, None),
    ):
        assert names.find(picture) == frame, picture
    for picture in ("000020.jpg", 20):
        with pytest.raises(FrameUnusable, match=r"may be of several frames; got 000001/000020 and 000003/000020"):
            FrameNames((*IDS, "000003/000020")).find(picture)
    assert FrameNames((*IDS, "000003/000020")).find("000003/rgb/20.jpg") == "000003/000020"


# Answers.


def roborefer(**change: Any) -> dict[str, Any]:
    return {
        "question_id": 0,
        "prompt": "Please point to the mug left of the laptop.",
        "object_name": "the mug",
        "suffix": "Your answer should be formatted as a list of tuples, i.e. [(x1, y1)], between 0 and 1.",
        "instruction": "…",
        "text": "[(0.25, 0.5)]",
        "model_id": "RoboRefer-8B-SFT",
        "rgb_path": "image/000001/0.png",
        "mask_path": "mask/0.png",
        "category": "location",
        "step": 1,
        **change,
    }


def test_answers_of_roborefer(tmp_path: Path, world: dict[str, Any]) -> None:
    other = roborefer(
        question_id=1, rgb_path="image/000001/20.png", text="[(0.1, 0.2), (0.3, 0.4)]", prompt="Point to it."
    )
    path = of_lines(tmp_path / "Location.jsonl", roborefer(), other)
    found = converted(path, world)
    assert found.header == Header(system="RoboRefer-8B-SFT", box_unit="shares")
    assert answer(found).point == (0.25, 0.5)
    # A question that holds no expression of the labels keeps its words, and the first of several places is taken.
    assert answer(found, IDS[1], "Point to it.").point == (0.1, 0.2)
    assert "more than one place in 1 answer" in " ".join(convert_predictions(path, tmp_path / "x", **world).notes)
    for model, text, point in (
        ("Qwen2.5-VL", "(77, 126)", (0.25, 0.5)),  # of 308x252, as it sees a picture of 320x240
        ("RoboRefer", "(80, 120)", (0.25, 0.5)),
        ("Molmo-7B", '<point x="61.5" y="40.4" alt="mug">mug</point>', (0.615, 0.404)),
        ("Gemini25Pro", '```json\n[{"point": [500, 250], "label": "mug"}]\n```', (0.25, 0.5)),
    ):
        path = of_lines(tmp_path / "one.jsonl", roborefer(text=text, model_id=model))
        (tmp_path / "one.jsonl.predictions").unlink(missing_ok=True)
        assert answer(converted(path, world)).point == pytest.approx(point)
    # Lines about pictures that the dataset does not hold are left out, unless there are no others.
    away = roborefer(rgb_path="image/99.png")
    held = convert_predictions(of_lines(path, roborefer(), away, away), tmp_path / "held", **world)
    assert held.lines == 1
    told = "about pictures that the dataset does not hold (first: line 2, image/99.png)"
    assert held.notes[1:] == (f"left out: 2 of 3 lines, {told}",)
    shares = "1 answer written as (a, b) is shares, x first: 1 of 1 in the picture, 1 of 1 on a thing of the asked name"
    assert shares in held.notes[0]
    several = roborefer(rgb_path="data/000000.png")
    world_of_two = world | {"dataset": InMemoryDataset([replace(world["dataset"].load(IDS[0]), id=i) for i in TWO])}
    refused(of_lines(path, away, several), world_of_two, "line 2: the picture .* may be of several frames")
    refused(of_lines(path, away), world, r"holds no picture .*; got line 1, image/99.png; expected such as 00000")
    refused(of_lines(path, roborefer(), roborefer(question_id=1)), world, f"two lines ask '{MUG}' of frame")
    refused(of_lines(path, roborefer(prompt="", object_name="", instruction="")), world, "line 1: no question")
    path.write_text(json.dumps(roborefer()) + '\n{"question_id": 1,\n')
    refused(path, world, "line 2: not JSON")
    refused(of_lines(path, roborefer()), world, "the format roborefer needs no --key", key=path)


def test_answers_of_spatialrgpt(tmp_path: Path, world: dict[str, Any]) -> None:
    row = {
        "question_id": "a",
        "image": "rgb/000001/000000.jpg",
        "question": "Is Region [0] behind Region [1]?",
        "pred": "Yes, Region [0] is behind Region [1].",
        "gt": "No.",
        "model_id": "SpatialRGPT-VILA1.5-8B",
        "qa_info": {"type": "qualitative", "category": "behind_predicate"},
    }
    far = row | {"question_id": "b", "question": "How tall is Region [0]?", "pred": "6.91 feet"}
    found = converted(of_lines(tmp_path / "answers.jsonl", row, far), world)
    assert answer(found, text=row["question"]).yes is True
    line = found.lines[IDS[0], far["question"]]
    assert line.answer is None
    assert line.problem == "no place, and neither yes nor no: '6.91 feet'"


def test_answers_of_llava_take_pictures_from_their_questions(tmp_path: Path, world: dict[str, Any]) -> None:
    row = {
        "question_id": 5,
        "prompt": MUG,
        "text": "[0.1, 0.2, 0.3, 0.4]",
        "answer_id": "Ab3",
        "model_id": "llava",
        "metadata": {},
    }
    path = of_lines(tmp_path / "answers.jsonl", row)
    key = of_lines(tmp_path / "questions.jsonl", {"question_id": 5, "image": f"{IDS[1]}.jpg", "text": MUG})
    assert answer(converted(path, world, key=key), IDS[1]).box == (0.1, 0.2, 0.3, 0.4)
    refused(path, world, "line 1: nothing names the picture; expected --key ITEMS")
    of_lines(key, {"question_id": 6, "image": f"{IDS[1]}.jpg", "text": MUG})
    refused(path, world, "line 1, question_id: --key has no item of the id 5", key=key)
    of_lines(key, *[{"question_id": 5, "image": "x"}] * 2)
    refused(path, world, "line 2: the id 5 stands twice", key=key)


def test_predictions_of_spatialclaw(tmp_path: Path, world: dict[str, Any]) -> None:
    rows = [
        {"sample_id": "7", "content": "\\boxed{B}", "ground_truth": "A", "result": 0.0, "usage": {"total_tokens": 5}},
        {"sample_id": "8", "content": "A", "ground_truth": "A", "result": 1.0},
    ]
    path = of_lines(tmp_path / "predictions.jsonl", *rows)
    assert is_published(path)
    choices = ["Yes", "No, it is not"]
    items = [{"id": 7, "images": [f"{IDS[0]}.png"], "question": f"Is there a {MUG}?", "choices": choices}]
    items.append({"id": 8, "images": [f"{IDS[1]}.png"], "choices": dict(zip("AB", choices, strict=True))})
    key = of_json(tmp_path / "samples.json", items)
    refused(path, world, "line 2: no question", key=key)
    # The trace beside the file has the question.
    session = tmp_path / "session-8"
    session.mkdir()
    instruction = f"Is there a {MUG}?\n\nAnswer with a letter.\nA. Yes\nB. No, it is not"
    event = {"event_type": "init", "kernel_id": "k", "instruction": instruction, "system_prompt": "…", "timestamp": "…"}
    of_lines(session / "trace.jsonl", event, {"event_type": "llm_call", "step_index": 0})
    found = converted(path, world, key=key)
    assert (answer(found).yes, answer(found, IDS[1]).yes) == (False, True)


def test_samples_of_lmms_eval(tmp_path: Path, world: dict[str, Any]) -> None:
    ask = "Point to the mug left of the laptop. The coordinates should be integers between 0 and 999."
    row = {
        "doc_id": 1,
        "target": "",
        "filtered_resps": "[(500, 250)]",
        "doc_hash": "0f",
        "token_counts": [None],
        "refspatial_acc": {"id": 4, "pred": "[(500, 250)]", "accuracy": 1.0},
        "input": ask,
    }
    path = of_lines(tmp_path / "20251111_202127_samples_refspatial.jsonl", row)
    documents = [{"id": 3, "image": "000003.png"}, {"id": 4, "image": {"path": f"{IDS[1]}.png"}}]
    found = converted(path, world, key=of_json(tmp_path / "documents.json", documents))
    assert answer(found, IDS[1]).point == (0.5, 0.25)
    raw = {**row, "resps": [["<think>(1, 2)</think><answer>(0.5, 0.25)</answer>"]], "filtered_resps": ""}
    for change in (raw, {k: v for k, v in raw.items() if k != "filtered_resps"}):
        one = of_lines(tmp_path / "raw_samples.jsonl", change | {"input_media": [f"{IDS[1]}.png"]})
        (tmp_path / "raw_samples.jsonl.predictions").unlink(missing_ok=True)
        assert answer(converted(one, world), IDS[1]).point == (0.5, 0.25)
    seen = of_lines(tmp_path / "media.jsonl", row | {"input_media": [f"data/{IDS[0]}.png"], "filtered_resps": ["no"]})
    assert answer(converted(seen, world)).yes is False
    # As `--log_samples` wrote it before #1103: the document inside, of which RefCOCO's answer is the expression.
    doc = {"answer": MUG, "question": "a caption for the area", "file_name": f"{IDS[0]}.png", "image_width": 320}
    nested = {"doc_id": 0, "doc": doc, "target": "", "resps": [["(0.5, 0.25)"]], "filtered_resps": ["(0.5, 0.25)"]}
    assert answer(converted(of_lines(tmp_path / "nested.jsonl", nested), world)).point == (0.5, 0.25)


def test_tables_of_vlmevalkit(tmp_path: Path, world: dict[str, Any]) -> None:
    """index, question, answer, prediction (open-compass/VLMEvalKit, vlmeval/smp/file.py with PRED_FORMAT=tsv)."""
    table = "index\timage_path\tquestion\tanswer\tprediction\n"
    table += f"0\t{IDS[0]}.png\tWhere is the {MUG}? Answer with a point.\t\t(0.5, 0.25)\n"
    path = tmp_path / "model_bench.tsv"
    path.write_text(table, encoding="utf-8")
    assert answer(converted(path, world)).point == (0.5, 0.25)
    (tmp_path / "model_bench.xlsx").write_bytes(b"PK\x03\x04")
    refused(tmp_path / "model_bench.xlsx", world, "a table of Excel; expected the same saved as .tsv or .csv")


@pytest.mark.parametrize(
    ("text", "given", "told"),
    [
        ("<think>(0.9, 0.9)</think> (0.5, 0.25)", {"point": (0.5, 0.25)}, ""),
        ("◁think▷(0.9, 0.9)◁/think▷ (0.5, 0.25)", {"point": (0.5, 0.25)}, ""),
        ("[THINK](0.9, 0.9)[/THINK] (0.5, 0.25)", {"point": (0.5, 0.25)}, ""),
        ("I see (0.9, 0.9). <answer>(0.5, 0.25)</answer>", {"point": (0.5, 0.25)}, ""),
        ("[160, 60]", {"point": (0.5, 0.25)}, "pixels"),
        ('[{"point_2d": [500, 250]}]', {"point": (0.5, 0.25)}, "thousandths"),
        ("It is at (0.1, 0.2, 0.3, 0.4).", {"box": (0.1, 0.2, 0.3, 0.4)}, ""),
        ("<box>(100,200),(300,400)</box>", {"box": (0.1, 0.2, 0.3, 0.4)}, ""),
        ('<points coords="1 1 500 250">mug</points>', {"point": (0.5, 0.25)}, ""),
        ("<loc0256><loc0128><loc0512><loc0768> mug", {"box": (0.125, 0.25, 0.75, 0.5)}, ""),
        ("[100, 50, 200, 100]", {"box": (0.1, 0.05, 0.3, 0.15)}, "thousandths,xywh"),
        ("No, it is not.", {"yes": False}, ""),
    ],
)
def test_places_are_read_in_many_ways(
    text: str, given: dict[str, Any], told: str, tmp_path: Path, world: dict[str, Any]
) -> None:
    path = of_lines(tmp_path / "one.jsonl", roborefer(text=text, model_id="x", prompt="Where is it?", object_name="it"))
    found = converted(path, world, places=[told] if told else [])
    (name,) = given
    assert getattr(answer(found, text="Where is it?"), name) == pytest.approx(given[name])


def test_a_question_that_was_cut_is_its_expression(tmp_path: Path, world: dict[str, Any]) -> None:
    path = of_lines(tmp_path / "cut.jsonl", roborefer(prompt="laptop right of the m", object_name=""))
    notes = convert_predictions(path, tmp_path / "out", **world).notes
    assert "the question 'laptop right of the m' was cut, and is taken as 'laptop right of the mug'" in notes[0]
    assert answer(converted(path, world), text="laptop right of the mug").point == (0.25, 0.5)


# Detections.


def test_detections_give_proposals_and_no_answer(tmp_path: Path, world: dict[str, Any]) -> None:
    mug, laptop = world["dataset"].load(IDS[0]).annotations
    rows = [
        {
            "x_min": 1.0,
            "y_min": 2.0,
            "x_max": 30.0,
            "y_max": 40.0,
            "class_id": 0,
            "confidence": 0.5,
            "tracker_id": "",
            "class_name": name,
            "image": f"{IDS[0]}.png",
        }
        for name in ("coffee mug", "person")
    ]
    found = converted(of_json(tmp_path / "rows.json", rows), world)
    more = of_json(tmp_path / "more.json", [*rows, rows[0] | {"image": "99.png"}])
    notes = convert_predictions(more, tmp_path / "more", **world).notes
    assert notes[1] == "left out: 1 picture of the file that the dataset does not hold (first: 99.png)"
    line = found.lines[IDS[0], MUG]
    assert (line.level, line.answer, line.problem) == (1, None, "the file holds detections and no answers")
    assert line.proposals is not None
    assert [(p.name, p.box, p.score) for p in line.proposals["mug"]] == [("coffee mug", (1, 2, 30, 40), 0.5)]
    assert (tuple(line.proposals), line.unknown) == (("mug",), {"laptop": "the file has no such name"})
    assert found.lines[IDS[1], MUG].problem == f"the recording has no detections for frame {IDS[1]}"
    # Its masks stand where an object is named first; a map's boxes are the world's.
    paths = [f"/data/{frame}.jpg" for frame in IDS[:2]]
    things = [
        map_object([a.label], [(path, a.mask, 0.5) for path in paths], corners((k, 0, 2), (1, 1, 1)))
        for k, a in enumerate((mug, laptop))
    ]
    found = converted(write_map(tmp_path / "full_pcd_ram.pkl.gz", things, 2), world)
    assert found.header.coordinates == "world"
    line = found.lines[IDS[0], "laptop right of the mug"]
    assert line.boxes_3d is not None
    assert line.boxes_3d[1] is not None
    np.testing.assert_allclose(np.array(line.boxes_3d[1].corners), corners((1, 0, 2), (1, 1, 1)))
    assert line.level == found.level == 2


def test_a_recording_and_a_folder_of_arrays_are_detections_too(tmp_path: Path, world: dict[str, Any]) -> None:
    entry = {"label": "mug", "score": 0.5, "bbox": [1, 2, 30, 40]}
    recording = of_json(tmp_path / "found.json", {"made_by": "yolo: abc", "frames": {IDS[0]: [entry]}})
    assert converted(recording, world).header.system == "yolo: abc"
    # As LangSAM's results are saved by `np.savez(FRAME.npz, **result)`.
    mask = world["dataset"].load(IDS[0]).annotations[0].mask
    result = {
        "scores": np.array([0.5]),
        "boxes": np.array([[1, 2, 30, 40.0]]),
        "labels": ["mug"],
        "masks": mask[None].astype(float),
    }
    folder = tmp_path / "arrays"
    folder.mkdir()
    np.savez(folder / f"{IDS[0].replace('/', '__')}.npz", **result, mask_scores=np.array([0.9]))
    proposals = converted(folder, world).lines[IDS[0], MUG].proposals
    assert proposals is not None
    code = proposals["mug"][0].mask
    assert code is not None
    np.testing.assert_array_equal(code.decoded(mask.shape, "mask"), mask)


# Formats.


def test_a_file_that_does_not_say_what_it_is_is_refused(tmp_path: Path, world: dict[str, Any]) -> None:
    for name, content, message in (
        ("odd.json", {"a": 1}, "does not say of which format it is; expected --format spatialviz | roborefer"),
        ("empty.json", [], "does not say of which format"),
        ("text.json", "hello", "does not say of which format"),
    ):
        refused(of_json(tmp_path / name, content), world, message)
    refused(tmp_path / "none.json", world, "there are no predictions")
    odd = tmp_path / "odd.json"
    refused(odd, world, "no such format of predictions; got 'cocoo'; expected .*coco", format="cocoo")
    refused(odd, world, "not follow the format at the top", format="coco")
    odd.write_bytes(b"\xff\xfe\x00")
    refused(odd, world, "the file is not UTF-8")
    own = of_json(tmp_path / "own.jsonl", {"spatialviz_predictions": 1})
    assert not is_published(own)
    before = sha256_of(own)
    with pytest.raises(InputError, match="the file exists"):
        convert_predictions(of_lines(tmp_path / "a.jsonl", roborefer()), own, **world)
    assert sha256_of(own) == before


def test_a_plugin_adds_a_format(tmp_path: Path, world: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def read(published: Any) -> Any:
        frame = published.frame(published.content.value["picture"], "picture")
        return {"system": "ours"}, [{"frame": frame, "text": published.text(frame, [f"the {MUG}"]), "problem": problem}]

    problem: Any = "none"
    ours = PredictionFormat(read, lambda content: "picture" in content.first, "ours", 0)
    point = SimpleNamespace(name="ours", value="ours:FORMAT", load=lambda: ours)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point] if group == "spatialviz.predictions" else [])
    path = of_json(tmp_path / "ours.json", {"picture": "000020.png"})
    for k, format in enumerate((None, "ours")):
        found = convert_predictions(path, tmp_path / f"{k}.predictions", **world, format=format)
        assert (found.format, found.header.system, found.lines, found.answers) == ("ours", "ours", 1, 0)
        assert (IDS[1], MUG) in read_predictions(found.path).lines
    problem = 5
    refused(path, world, "line 2, problem: not as the schema has it")
