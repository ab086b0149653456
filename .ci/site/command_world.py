"""What the documents' placeholders stand for: a small recording, its labels, a run, networks, files of every kind."""

from __future__ import annotations

import json
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

import command_runs
import numpy as np

ROOT = command_runs.ROOT
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests/proposals"), str(ROOT / "tests/datasets")]
FRAME, QUESTION = "000001/000000", "mug left of the laptop"
SELECTION = 12
"""The seed by which the labels have a sentence of a mug left of a laptop, as the snippets do."""
ALSO = {
    "DATASET": ("ROOMS", "RECORDING", "PATH/TO/DATASET"),
    "recording": (),
    "RUN": ("OTHER_RUN", "RUN1", "RUN2", "RUN_A", "RUN_B"),
    "cases": ("CASES",),
    "FILE.onnx": ("A.onnx", "B.onnx", "yolov8n-seg.onnx"),
    "predictions.jsonl": ("later.jsonl",),
    "sentences.jsonl": ("FILE.jsonl",),
}
"""Further names of the same."""


def make_world(folder: Path) -> None:
    """Make everything in a new folder; RuntimeError with what was printed where something fails."""
    folder.mkdir(parents=True)
    command_runs.enter(folder)
    # Nothing is loaded and used in this process: threads of libraries do not live on in forks of it.
    _done(command_runs.ended(command_runs.started(_files, folder / "log"), folder / "log"))
    done = [f"label DATASET --out LABELS --sentences --selection-seed {SELECTION}"]
    done += ["eval DATASET --labels LABELS --detector simulated --out RUN"]
    done += ["export-run RUN --out predictions.jsonl", "map DATASET --out MAP"]
    done += [f"save-case demo 0 '{QUESTION}' --detector simulated --out cases/wrong"]
    done += ["correct LABELS --edits SET.json --author ben"]
    for line in done:
        _done(command_runs.command(shlex.split(line), folder / "log"))
    shutil.copy("LABELS/sentences.jsonl", ".")
    for name, others in ALSO.items():
        for other in others:
            Path(other).parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if Path(name).is_dir() else shutil.copy)(name, other)


def _done(ran: command_runs.Ran) -> None:
    if ran.status or ran.wrong:
        raise RuntimeError(f"{ran.wrong} {ran.out}{ran.err}")


def _files() -> None:
    """Recordings, pictures, networks and edits."""
    import cv2

    from pipeline.datasets import open_dataset
    from pipeline.datasets.demo import demo_path
    from pipeline.diagnosis import Edits, edits_record

    shutil.copytree(demo_path(), "DATASET", ignore=shutil.ignore_patterns("000003", "000004"))
    shutil.copytree(ROOT / "docs" / "gallery", "docs/gallery")
    for name in ("recording/color", "recording/depth", "pictures"):
        Path(name).mkdir(parents=True)
    shutil.copy(ROOT / "docs" / "bench.json", "docs")
    dataset = open_dataset("DATASET")
    for k, frame_id in zip((0, 1, 12), dataset.frame_ids, strict=False):
        frame = dataset.load(frame_id)
        picture = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)
        cv2.imwrite(f"recording/color/{k:06d}.png", picture)
        cv2.imwrite(f"recording/depth/{k:06d}.png", np.rint(frame.depth * 1000).astype(np.uint16))
        cv2.imwrite(f"pictures/{k:06d}.jpg", picture)
    frame = dataset.load(FRAME)
    camera = [float(frame.camera.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
    Path("recording/spatialviz.toml").write_text(f"intrinsics = {camera}\ndepth_scale = 1000\n")
    shutil.copy("pictures/000000.jpg", "photo.jpg")
    _networks(frame)
    Path("EDITS.json").write_text(json.dumps(edits_record(Edits(k=5))))
    fix = {"edit": "relation", "frame": FRAME, "a": 3, "b": 2, "relation": "above", "to": "T", "reason": "stands on it"}
    Path("FIXES.json").write_text(json.dumps([fix]))
    Path("SET.json").write_text(json.dumps([{"edit": "class", "frame": FRAME, "object": 14, "to": "lamp"}]))


def _networks(frame: Any) -> None:
    """Networks that find, in every picture, what stands in one; and one that reads depth off the picture's red."""
    import onnx
    from depth_graphs import write_network
    from model_stubs import change
    from onnx_stubs import write_stub

    from pipeline.datasets.depth.contract import CONTRACTS

    height, width = frame.depth.shape
    seen = [a for a in frame.annotations if a.mask is not None]
    names = sorted({a.label for a in seen} | {"cup", "chair"})
    rows = np.zeros((1, 4 + len(names) + 32, len(seen)), np.float32)
    for k, a in enumerate(seen):
        x0, y0, x1, y1 = a.bbox
        rows[0, :4, k] = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0
        rows[0, 4 + names.index(a.label), k] = 0.9
        rows[0, 4 + len(names), k] = 4
    inputs = {"images": (onnx.TensorProto.FLOAT, (1, 3, height, width))}
    masks = np.ones((1, 32, height // 4, width // 4), np.float32)

    def name_classes(model: Any) -> None:
        entry = model.metadata_props.add()
        entry.key, entry.value = "names", str(dict(enumerate(names)))

    change(write_stub(Path("FILE.onnx"), inputs, {"output0": rows, "output1": masks}), name_classes)
    boxes = rows[:, : 4 + 2]
    boxes[:, 4:] = 0.9
    write_stub(Path("mine.onnx"), inputs, {"output0": boxes.transpose(0, 2, 1)})
    write_network(Path("moge.onnx"), "moge-2")
    write_network(Path("own.onnx"), "depth-anything-v2-metric-indoor")
    shutil.copy(CONTRACTS / "depth-anything-v2-metric-indoor.toml", "own.toml")


def words(world: Path) -> dict[str, str]:
    """What stands for a word, and is no file: SENTENCE is one that the labels have, and the run with them."""
    first = json.loads((world / "predictions.jsonl").read_text("utf-8").splitlines()[1])
    return {"FRAME": first["frame"], "SENTENCE": first["text"], "NAME": "ann"}


def python_names(world: Path) -> dict[str, Any]:
    """What stands in the snippets for the reader's own: arrays of his detector, ids, questions, edits."""
    import spatialviz as sp

    asked = sp.open_labels(world / "LABELS").expressions.to_pylist()
    about = ("mug", "left", "laptop")
    questions = [(e["frame"], e["text"]) for e in asked if (e["target"], e["relation"], e["reference"]) == about]
    assert questions, "the labels have no sentence of a mug left of a laptop: choose another SELECTION"
    boxes, scores = np.array([[290.0, 180, 330, 230]]), np.array([0.9])
    masks = np.zeros((1, 480, 640), bool)
    masks[0, 180:230, 290:330] = True
    names: dict[str, Any] = {"sp": sp, "frame": FRAME, "text": QUESTION, "questions": questions}
    names |= {"boxes": boxes, "scores": scores, "masks": masks, "my_ids": [7]}
    names |= {"other_boxes": boxes + 100, "other_scores": scores, "edits": {"k": 5}}
    return names | {"c": np.array([0.1, 0.2, 1.4]), "s": np.array([0.08, 0.1, 0.08]), "R": np.eye(3)}
