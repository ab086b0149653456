"""Where the files that come with the program lie: beside the package in a checkout, inside it when installed."""

from __future__ import annotations

from pathlib import Path

from pipeline.system.errors import InputError


def asset_path(*parts: str) -> Path:
    """The path of a shipped file or folder, for example ("srm", "rel14.onnx").

    Raises
    ------
    InputError
        Where the installation lacks it.
    """
    here = Path(__file__).resolve().parents[1]
    for root in (here / "assets", here.parent / "assets"):
        candidate = root.joinpath(*parts)
        if candidate.exists():
            return candidate
    raise InputError(f"{'/'.join(parts)} is not part of this installation", cause="reinstall spatialviz")
