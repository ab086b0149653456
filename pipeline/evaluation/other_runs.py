"""Earlier runs on the same labels, as further rows of a run's tables."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.evaluation.compare import read_records
from pipeline.evaluation.run_folder import RUN_FILE
from pipeline.evaluation.shared_makers import Share, measured_of_run, shared_makers
from pipeline.labels.makers import Makers
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class OtherSystem:
    """The system of another run.

    Attributes
    ----------
    records : pyarrow.Table
    shares : tuple of Share
        What it has in common with what made the labels.
    """

    records: pa.Table
    shares: tuple[Share, ...]


def other_systems(runs: Sequence[Path], name: str, content_hash: str, makers: Makers) -> dict[str, OtherSystem]:
    """The systems of other runs by their names.

    A name that is taken is told apart by its run's folder, and by a number where that is not enough.

    Parameters
    ----------
    runs : sequence of Path
    name : str
        Of the run that they stand beside.
    content_hash : str
        Of the expressions that were asked.
    makers : Makers
        Of the labels.

    Raises
    ------
    InputError
        There is no run, or it is of other labels.
    """
    found: dict[str, OtherSystem] = {}
    taken = {name}
    for run in map(Path, runs):
        manifest = _manifest(run)
        asked = manifest.get("labels", {}).get("content_hash")
        if asked != content_hash:
            raise InputError(
                "a run on other labels cannot be a row beside this one", got=f"expressions {asked}",
                expected=f"expressions {content_hash}", path=run,
            )  # fmt: skip
        own = str(manifest["name"])
        choices = [own, f"{own} ({run.resolve().name})"]
        choices += [f"{own} ({run.resolve().name}, {k})" for k in range(2, len(runs) + 2)]
        own = next(n for n in choices if n not in taken)
        taken.add(own)
        found[own] = OtherSystem(read_records(run), shared_makers(makers, measured_of_run(manifest)))
    return found


def _manifest(run: Path) -> dict[str, Any]:
    path = run / RUN_FILE
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(manifest["name"], str) or not isinstance(manifest.get("labels", {}), dict):
            raise ValueError("no name of a system, or no labels")
    except FileNotFoundError as error:
        raise InputError("no evaluation run here", expected="a folder that `eval` wrote", path=run) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError("the run's manifest cannot be read", got=str(error), path=path) from error
    return manifest
