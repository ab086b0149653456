"""Maps of ConceptGraphs as its code pickles them, for tests."""

from __future__ import annotations

import gzip
import pickle
import zlib
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np

CFG = zlib.decompress(
    b64decode(
        "eNplkttT00AUxlug0G4r4AUUFW+gFlRA8Y6KSL2iHSZPectsNtvuapr0JBtGxtkZfXCE/9qzmxbT8Slns3t+33e+3Z9jLO7xLmVx1FkLJFOm"
        "kF3SwnI3L6G08gvKGsaabq1UKnk9rmhAFYXxQqtPU06wQVEZ8eTL4AiBCeytaJhsulXsTXjHU4d9DlMMPzLqkp3okEDVreNm7H/lTOX7NeZ5"
        "fiZDJSPPI8YXAWIRcV/JOKIh1I/ccVx/44fQaLsVLDsh7aZwSsO0S4ZLL4ljBTPH7rSVT+PwgCceo0xwmGUsDkPURGBKAt6hWahyrdOC/IYz"
        "Dpy1mqiR2zonqm4Df/CQ93g08DonqpnvTplo+jTB3zDftm0eJqPM+ryGC03baEJJucpdLRTyi+KApyaNNhYELmJslzRcbor/Qv6X7SIeuqLh"
        "alNMiaqotUX9SDTEgsAEromZYzEr7BjXHbiR+WJelN0J4+oAw1tifapEKH2yH6fy+z4uCCy7Zdxfh5v2nL3iW3Yuh/dDySjc/gNNB1ZwWjNe"
        "ynjEPRnAqjB272i4i3aFcXVPw9qoq1Xjar3gasOB+7krsWRvDyPpbcADhE8auEpkwGHToh9qeDREP9bwZBS9adBPC+hnDjwfovcqCDSvq5tS"
        "nDyRFO9jy1JfaHg5pL7SsD1K3TLU1wXqjgNvTgybl5fQHuwifc6ExVX+jrxOHAb4wiLa49CyOm81vBvqvNfwYVSnZXQ+FnQ+ObB3orM4cH7C"
        "T73lH4VRNHzO/Czz1/4ChPcqRw=="
    )
)
"""`pickle.dumps(OmegaConf.create({...}), protocol=2)` of settings such as the code saves beside the objects:
dataset_root (a Path), scene_id, stride, gsa_variant, and a name that is put together."""


def corners(center: Any, size: Any) -> np.ndarray:
    """(8, 3): as `np.asarray(OrientedBoundingBox.get_box_points())` of Open3D orders them."""
    order = [(-1, -1, -1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1), (1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)]
    return np.asarray(center) + np.array(order) / 2 * np.asarray(size)


def map_object(
    names: list[str], views: list[tuple[str, np.ndarray, float]], box: np.ndarray, **more: Any
) -> dict[str, Any]:
    """One entry of `MapObjectList.to_serializable()`; a view is a picture's path, a mask and a score."""
    n, rng = len(views), np.random.default_rng(0)
    rows = [np.flatnonzero(mask.any(1)) for _, mask, _ in views]
    columns = [np.flatnonzero(mask.any(0)) for _, mask, _ in views]
    return {
        "image_idx": list(range(n)),
        "mask_idx": [0] * n,
        "color_path": [path for path, _, _ in views],
        "class_name": names,
        "class_id": [0] * n,
        "num_detections": n,
        "mask": [mask for _, mask, _ in views],
        "xyxy": [np.array([c[0], r[0], c[-1] + 1, r[-1] + 1], np.float32) for r, c in zip(rows, columns, strict=True)],
        "conf": [np.float32(score) for _, _, score in views],
        "n_points": [5] * n,
        "pixel_area": [mask.sum() for _, mask, _ in views],
        "contain_number": [None] * n,
        "inst_color": rng.random(3),
        "is_background": False,
        "clip_ft": rng.random(16).astype(np.float32),
        "text_ft": rng.random(16).astype(np.float32),
        "pcd_np": rng.random((5, 3)),
        "bbox_np": box,
        "pcd_color_np": rng.random((5, 3)),
        **more,
    }


def write_map(path: Path, objects: list[dict[str, Any]], protocol: int = 4) -> Path:
    """`full_pcd_*.pkl.gz`: a dict of objects, bg_objects, cfg, class_names and class_colors."""
    whole = {"objects": objects, "bg_objects": None, "class_names": ["mug"], "class_colors": {"0": [0.1, 0.2, 0.3]}}
    body = pickle.dumps(whole, protocol=protocol)
    if protocol == 2:
        # The settings go into the same dict: memo numbers of the second pickle may repeat those of the first.
        body = body[:-1] + b"U\x03cfg" + CFG[2:-1] + b"s."
    with gzip.open(path, "wb") as file:
        file.write(body)
    return path
