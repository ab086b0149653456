"""A recording without labels, made of rendered frames, and what a detector found in it: for labelling by hand."""

import json
from pathlib import Path

import cv2
import numpy as np

from pipeline.datasets.demo import demo_path
from pipeline.datasets.opening import open_dataset
from pipeline.geometry.masks import encode_run_length


def write_recording(folder: Path, frames: int = 10) -> Path:
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
            {"label": a.label, "score": 0.9, "bbox": [float(x) for x in a.bbox], "id": a.index,
             "mask": {"size": list(a.mask.shape), "counts": encode_run_length(a.mask)}}
            for a in frame.annotations if a.mask is not None and np.count_nonzero(a.mask) > 400
        ]  # fmt: skip
    detections = folder.with_name("detections.json")
    detections.write_text(json.dumps({"frames": found}))
    return detections


if __name__ == "__main__":
    import sys

    print(write_recording(Path(sys.argv[1])))
