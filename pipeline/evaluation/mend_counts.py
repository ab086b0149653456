"""Settings of a pipeline by which a failure may be mended, each counted over a run: how many it mends and breaks."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import lru_cache
from math import ceil, floor, log10
from time import perf_counter
from typing import Any

import numpy as np

from pipeline.answering.ask import AskConfig
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.run import Evaluator
from pipeline.evaluation.run_folder import Run
from pipeline.evaluation.systems import OWN
from pipeline.labels.cases import read_cases
from pipeline.system.frozen import dataclass

SECONDS = 60.0
"""Time to count in, by default."""
HEAVIEST = 10.0
"""A greater weight of the relation is not tried."""
SETTINGS = {
    "min_score": "minimum score",
    "k": "K",
    "relation_weight": "weight of the relation γ",
    "srm": "relations by",
}


@dataclass(frozen=True)
class SettingChange:
    """Setting of a whole pipeline."""

    name: str  # One of SETTINGS
    before: float | str | None
    after: float | str

    def __str__(self) -> str:
        before = "" if self.before is None else f" in place of {_shown(self.before)}"
        return f"{SETTINGS[self.name]} {_shown(self.after)}{before}"


@dataclass(frozen=True)
class MendCount:
    """What became of a run's expressions under another setting."""

    setting: SettingChange
    mended: int
    broken: int
    looked: int  # Of how many: all of the run, or so many as there was time for
    total: int
    this: bool | None  # The answer that was asked for is right now; None where it was not looked at

    @property
    def said(self) -> str:
        """Counts in words."""
        of = "" if self.looked == self.total else f" of {self.looked:,} looked at"
        here = {None: "", True: " This answer is correct, too.", False: " This answer stays wrong."}[self.this]
        return f"{self.setting}: {self.mended:,} mended, {self.broken:,} broken{of}.{here}"

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        return {**asdict(self), "said": self.said}


def mend_setting(run: Run, d: Diagnosis) -> SettingChange | None:
    """Setting to try against a failure of a run; None where no setting is of its kind, or the answers were imported.

    An object below the minimum score: the minimum just below its score. One beyond K: K as its rank. A pair that was
    outscored though its relation is more probable: the weight of the relation with which it wins. A misjudged relation:
    the other scorer.
    """
    source = d.evidence.answers.source
    if run.system != OWN or run.spec.options.get("predictions") is not None:
        return None
    if d.missed is not None:
        score, rank = d.missed.score, d.missed.rank
        if d.missed.kind == "THRESHOLD" and score:
            return SettingChange("min_score", run.spec.options.get("min_score"), _below(score))
        known = d.missed.kind == "RANK" and rank is not None and not d.missed.suppressed
        return (
            SettingChange("k", source.config.k, rank) if known and rank is not None and rank > source.config.k else None
        )
    if d.verdict == "SRM" and d.detail is None:
        rule = source.scorer.name == "rule"
        return SettingChange("srm", source.scorer.name, "trained" if rule else "rule")
    if d.verdict in ("OPM-CONF", "PRM") and d.winner is not None and d.right is not None:
        return _weight(source, d.winner, d.right)
    return None


def _weight(source: Pipeline, winner: ScoredPair, right: ScoredPair) -> SettingChange | None:
    """Weight of the relation with which the right pair wins, in tenths."""
    now, behind = source.config.rank.relation_weight, winner.log_score - right.log_score
    gain = right.log_factors["relation"] - winner.log_factors["relation"]
    needed = now + behind / gain if gain > 0 else np.inf
    after = floor(10 * needed + 1) / 10 if needed < HEAVIEST else HEAVIEST
    return SettingChange("relation_weight", now, after) if after < HEAVIEST else None


def _below(score: float) -> float:
    """Number of one digit just below a score."""
    step = 10.0 ** floor(log10(score))
    return round((ceil(score / step) - 1) * step, 12)


def under(run: Run, setting: SettingChange) -> Evaluator:
    """Evaluator of a run's expressions under another setting, without verdicts."""
    options = dict(run.spec.options)
    config: AskConfig = options.get("config") or AskConfig()
    match setting.name, setting.after:
        case "k", k:
            config = replace(config, k=int(k))
        case "relation_weight", weight:
            config = replace(config, rank=replace(config.rank, relation_weight=float(weight)))
        case name, value:
            options[name] = value
    return Evaluator(replace(run.spec, options={**options, "config": config}, verdicts=False))


@lru_cache(maxsize=64)
def _counts(run: Run, setting: SettingChange, seconds: float) -> dict[tuple[str, str], int]:
    """By frame and expression 1 for mended, -1 for broken, 0 for neither, of as many as there was time for."""
    start, evaluator = perf_counter(), under(run, setting)
    columns = (run.records.column(name).to_pylist() for name in ("frame", "id", "set_correct"))
    before = {(frame, expression): right for frame, expression, right in zip(*columns, strict=True)}
    frames = [
        truth for truth in read_cases(evaluator.labels, 0, len(evaluator.source.dataset.frame_ids)) if truth.cases
    ]
    found: dict[tuple[str, str], int] = {}
    # In no order of the recording, so that what there was time for is of all of it.
    for k in np.random.default_rng(0).permutation(len(frames)).tolist():
        if found and perf_counter() - start > seconds:
            break
        for row in evaluator.frame(frames[k]):
            key = row["frame"], row["id"]
            if key in before:
                found[key] = int(bool(row["set_correct"])) - int(bool(before[key]))
    return found


def count_mends(
    run: Run, setting: SettingChange, asked: tuple[str, str] | None = None, seconds: float = SECONDS
) -> MendCount:
    """Answer a run's expressions again under a setting, frame by frame while there is time; kept for the next call.

    `asked`: frame and id of the expression of which it is told whether it is right now. Raises InputError where the
    run's data, labels or models are not here.
    """
    found = _counts(run, setting, seconds)
    values = list(found.values())
    this = None if asked is None or asked not in found else found[asked] == 1
    return MendCount(setting, values.count(1), values.count(-1), len(found), run.records.num_rows, this)


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"
