"""Paths of shipped files (beside the package in a checkout, inside it when installed) and of the cache folder."""

from __future__ import annotations

import os
from pathlib import Path

from pipeline.system.errors import InputError


def asset_path(*parts: str) -> Path:
    """Path of a shipped file or folder, for example ("srm", "rel14.onnx"); InputError if missing."""
    here = Path(__file__).resolve().parents[1]
    for root in (here / "assets", here.parent / "assets"):
        candidate = root.joinpath(*parts)
        if candidate.exists():
            return candidate
    raise InputError(f"{'/'.join(parts)} is not part of this installation", cause="reinstall spatialviz")


def cache_folder() -> Path:
    """Folder of cached results: SPATIALVIZ_CACHE, or the user's cache folder."""
    if told := os.environ.get("SPATIALVIZ_CACHE"):
        return Path(told)
    import platformdirs

    return Path(platformdirs.user_cache_dir("spatialviz"))
