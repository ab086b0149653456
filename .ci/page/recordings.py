"""What the checks look at: recordings of rendered frames, a run of many rows, a second run, names that are markup."""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.datasets.demo import demo_path
from pipeline.datasets.opening import open_dataset
from pipeline.geometry.masks import encode_run_length

ASSETS = Path(__file__).parents[2] / "assets"
LABELS = ASSETS / "demo_run" / "labels"
RUN = ASSETS / "demo_run" / "run"
SIMULATED = ASSETS / "demo_run" / "simulated.toml"
LONG = 5000
"""Frames of the long recording."""
BARE = 10
"""Frames of the one without labels."""
ROWS = 50_000
"""Rows of the large run."""
MARKUP = "<img src=x onerror=document.title='hit'>"


def spatialviz(*words: object, fails: bool = False) -> str:
    """What the command line prints; where it `fails` it ends with 1, which says that something does not hold."""
    command = [sys.executable, "-m", "spatialviz", *map(str, words)]
    done = subprocess.run(command, capture_output=True, check=False, text=True)
    assert done.returncode in ((0, 1) if fails else (0,)), done.stderr
    return done.stdout


def events(labels: Path, *options: object) -> list[dict]:
    """What the journal of labels holds."""
    command = [sys.executable, "-m", "spatialviz", "journal", str(labels), "--json", *map(str, options)]
    told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return [json.loads(line) for line in told.splitlines()]


def write_recording(folder: Path, frames: int = BARE) -> Path:
    """Colour and depth of the first frames of the demo; the file of detections that stands beside the folder."""
    dataset = open_dataset(demo_path())
    found = {}
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for k, frame_id in enumerate(dataset.frame_ids[:frames]):
        frame = dataset.load(frame_id)
        cv2.imwrite(str(folder / "color" / f"{k:04d}.png"), cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR))
        cv2.imwrite(str(folder / "depth" / f"{k:04d}.png"), np.rint(frame.depth * 1000).astype(np.uint16))
        if k == 0:
            K = frame.camera.K
            text = f"intrinsics = [{K[0, 0]}, {K[1, 1]}, {K[0, 2]}, {K[1, 2]}]\ndepth_scale = 1000.0\n"
            (folder / "spatialviz.toml").write_text(text)
        found[f"{k:04d}"] = [
            {
                "label": a.label,
                "score": 0.9,
                "bbox": [float(x) for x in a.bbox],
                "id": a.index,
                "mask": {"size": list(a.mask.shape), "counts": encode_run_length(a.mask)},
            }
            for a in frame.annotations
            if a.mask is not None and np.count_nonzero(a.mask) > 400
        ]
    detections = folder.with_name("detections.json")
    detections.write_text(json.dumps({"frames": found}))
    return detections


def long_recording(folder: Path, frames: int = LONG) -> Path:
    """Many frames of a camera that goes round in a circle; all share the pixels of two files."""
    color, depth = folder / "color", folder / "depth"
    for made in (color, depth):
        made.mkdir(parents=True)
    rng = np.random.default_rng(0)
    cv2.imwrite(str(folder / "c.png"), rng.integers(0, 255, (48, 64, 3), np.uint8))
    cv2.imwrite(str(folder / "d.png"), np.full((48, 64), 1500, np.uint16))
    poses = []
    for k in range(frames):
        os.link(folder / "c.png", color / f"{k:06d}.png")
        os.link(folder / "d.png", depth / f"{k:06d}.png")
        a = 2 * math.pi * k / frames
        poses.append(f"{math.cos(a):.5f} {math.sin(a):.5f} 1 0 0 0 1")
    (folder / "pose.txt").write_text("\n".join(poses) + "\n")
    return folder


def one_frame(folder: Path) -> Path:
    """A recording of one frame, which shows a wall."""
    for kind, picture in (("color", np.zeros((48, 64, 3), np.uint8)), ("depth", np.full((48, 64), 1500, np.uint16))):
        (folder / kind).mkdir(parents=True)
        cv2.imwrite(str(folder / kind / "0.png"), picture)
    return folder


def markup_in_names(home: Path) -> Path:
    """The demo's first frames, with markup in the names of the dataset, of its folder and of a class."""
    root = home / MARKUP
    shutil.copytree(ASSETS / "demo", root, ignore=shutil.ignore_patterns("00000[234]"))
    models = root / "models" / "models_info.json"
    models.write_text(models.read_text("utf-8").replace('"mug"', json.dumps(MARKUP)), "utf-8")
    (root / "spatialviz.toml").write_text(f'name = "{MARKUP}"\nworld_up = [0, 0, 1]\n', "utf-8")
    return root


def second_run(folder: Path) -> Path:
    """The demo's sentences, answered with other options."""
    spatialviz(
        "eval",
        "demo",
        "--labels",
        LABELS,
        "--out",
        folder,
        "--detector",
        "simulated",
        "--model",
        SIMULATED,
        "--min-score",
        "0.015",
        "--k",
        "12",
        "--srm",
        "rule",
        "--name",
        "the other",
        "--tables",
        "grounding",
        "--no-plots",
    )
    return folder


def large_run(folder: Path, rows: int = ROWS) -> Path:
    """A run of 50,000 rows, synthetic: the demo's again and again under new ids."""
    records = pq.read_table(RUN / "records.parquet")
    table = pa.concat_tables([records] * (rows // records.num_rows + 1)).slice(0, rows)
    table = table.set_column(0, "id", pa.array([f"{k:06x}" for k in range(rows)]))
    folder.mkdir()
    pq.write_table(table.replace_schema_metadata(records.schema.metadata), folder / "records.parquet")
    manifest = json.loads((RUN / "run.json").read_text())
    manifest["expressions"] = rows
    manifest["spec"]["labels"] = str(LABELS)
    for key, value in manifest["spec"]["options"].items():
        if isinstance(value, str) and value.endswith(".toml"):
            manifest["spec"]["options"][key] = str(SIMULATED)
    (folder / "run.json").write_text(json.dumps(manifest).replace("../simulated.toml", str(SIMULATED)))
    return folder


if __name__ == "__main__":
    print(write_recording(Path(sys.argv[1])))
