"""Built-in demo dataset, with labels and a run of a simulated detector."""

from __future__ import annotations

from pathlib import Path

from pipeline.system.paths import asset_path

DEMO_NAME = "demo"
DEMO_EXPRESSION = "mug left of the laptop"
DEMO_RUN_NAME = "demo_run"


def demo_path() -> Path:
    """The folder of the built-in demo dataset.

    Raises
    ------
    InputError
        Where the installation lacks it.
    """
    return asset_path(DEMO_NAME)


def found_by_name(path: str | Path) -> str | Path:
    """A dataset's path; of "demo", where nothing is called so, the built-in one. Raises as `demo_path`."""
    return demo_path() if str(path) == DEMO_NAME and not Path(path).exists() else path


def demo_labels() -> Path:
    """Merged labels of the demo run."""
    return asset_path(DEMO_RUN_NAME, "labels")


def demo_run() -> Path:
    """The run folder: failures of every verdict; raises as `demo_path`."""
    return asset_path(DEMO_RUN_NAME, "run")
