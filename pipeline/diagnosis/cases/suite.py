"""Many cases, one after another: a regression suite. A damaged case does not stop the rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.diagnosis.cases.opening import open_case
from pipeline.diagnosis.cases.replay import TOLERANCE, Replay, replay_case, update_case
from pipeline.relations import make_scorer
from pipeline.system.errors import InputError

Status = Literal["same", "changed", "updated", "damaged"]


@dataclass(frozen=True)
class Result:
    """What came of one case.

    Attributes
    ----------
    path : Path
    status : str
        same, changed, updated (changed, and taken over) or damaged (could not be run).
    replay : Replay or None
        None where it could not be run.
    problem : str or None
        Why not.
    """

    path: Path
    status: Status
    replay: Replay | None
    problem: str | None = None


def replay_all(
    folders: Sequence[Path],
    *,
    srm: str | Path | None = None,
    vectors: Path | None = None,
    tolerance: float = TOLERANCE,
    update: bool = False,
    detector: str | None = None,
    model: Path | None = None,
    min_score: float | None = None,
) -> Iterator[Result]:
    """Run cases again, one at a time.

    Parameters
    ----------
    folders : sequence of Path
    srm, vectors
        As for `open_case`.
    tolerance : float
        As for `replay_case`.
    update : bool
        Take the answers of now as the expected ones.
    detector, model, min_score
        A detector that looks at the pictures now; None for the kept detections.

    Raises
    ------
    InputError
        The relation scorer that was asked for cannot be used with any case.
    """
    if srm is not None:
        # Said once, and not of every case: none of them is damaged by it.
        make_scorer(srm, vectors)
    for folder in folders:
        try:
            opened = open_case(folder, srm=srm, vectors=vectors)
            if detector is not None:
                opened = opened.with_detector(detector, model, min_score)
            replay = replay_case(opened, tolerance, live=detector is not None)
            moved = replay.record != opened.manifest.expected
            if update and moved:
                update_case(opened, replay)
        except InputError as error:
            yield Result(folder, "damaged", None, str(error))
            continue
        yield Result(folder, "updated" if update and moved else "same" if replay.same else "changed", replay)
