"""The folder in which what was computed once is kept."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_folder() -> Path:
    """Where cached results live: SPATIALVIZ_CACHE, or the user's cache folder."""
    return Path(os.environ.get("SPATIALVIZ_CACHE") or platformdirs.user_cache_dir("spatialviz"))
