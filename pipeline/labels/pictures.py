"""The dataset that labels were made from, opened again: for its pictures, and for what follows from corrections."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.datasets import Dataset, open_dataset
from pipeline.datasets.demo import DEMO_NAME, demo_path
from pipeline.labels.schema import Manifest
from pipeline.system.errors import InputError

Intrinsics = tuple[float, float, float, float]


def labelled_dataset(
    manifest: Manifest,
    path: str | None = None,
    *,
    intrinsics: Intrinsics | None = None,
    depth_scale: float | None = None,
    up: str | None = None,
    level_at: str | None = None,
) -> Dataset:
    """Open it where it was when it was labelled, or where it is now; its camera is the one that was said then.

    Parameters
    ----------
    manifest : Manifest
        Of the labels.
    path : str, optional
        Where it is now.
    intrinsics : tuple of float, optional
        fx, fy, cx, cy in pixels, instead of what was said then.
    depth_scale : float, optional
        Depth units in one metre, instead of what was said then.
    up, level_at : str, optional
        As for `open_dataset`, instead of what was said then.

    Raises
    ------
    InputError
        The labels do not name it, or it cannot be opened.
    """
    said = manifest.dataset
    where = path or said.get("path")
    if not where:
        raise InputError("the labels do not say which dataset they are of")
    if where == DEMO_NAME and not Path(where).exists():
        where = demo_path()
    options = dict(said.get("options") or {})
    if intrinsics is None and options.get("intrinsics"):
        intrinsics = _four(options["intrinsics"])
    if depth_scale is None and options.get("depth_scale") is not None:
        depth_scale = _number(options["depth_scale"])
    told = labelled_up(manifest, {"up": up, "level_at": level_at})
    return open_dataset(where, intrinsics=intrinsics, depth_scale=depth_scale, **told)


def labelled_up(manifest: Manifest, options: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `open_dataset`, with the up vector that was said when the labels were made where none is said."""
    said = manifest.dataset.get("options") or {}
    told = {n: str(said[n]) for n in ("up", "level_at") if said.get(n) is not None}
    return dict(options) if any(options.get(n) is not None for n in ("up", "level_at")) else {**options, **told}


def _four(said: Any) -> Intrinsics:
    numbers = said.strip("()[] ").split(",") if isinstance(said, str) else said
    try:
        fx, fy, cx, cy = (float(n) for n in numbers)
    except (TypeError, ValueError) as error:
        raise InputError("the labels name a camera that is none", got=repr(said)[:60]) from error
    return fx, fy, cx, cy


def _number(said: Any) -> float:
    try:
        return float(said)
    except (TypeError, ValueError) as error:
        raise InputError("the labels name a depth scale that is none", got=repr(said)[:60]) from error
