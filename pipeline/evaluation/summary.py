"""A run in figures: how often each verdict, what each module costs, what is left over; and two runs compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import factorial
from typing import Any

import numpy as np

from pipeline.diagnosis.oracles import ORACLES, SUBSETS, names_of
from pipeline.diagnosis.verdict import VERDICTS, shown_verdicts
from pipeline.evaluation.grounding_tables import clusters_of, column
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, mean_estimate, ratio
from pipeline.metrics.tables import Cell, Row, Table
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import require

EXACT = 1e-9
"""Sums that must agree agree to this."""


@dataclass(frozen=True)
class Share:
    """How many expressions, and which share of those that were diagnosed.

    Attributes
    ----------
    count : int
    estimate : Estimate
    """

    count: int
    estimate: Estimate

    def record(self) -> dict[str, Any]:
        """As JSON: `count`, and `share` with its interval."""
        return {"count": self.count, "share": self.estimate.record()}


@dataclass(frozen=True)
class RunSummary:
    """A run's verdicts and deltas.

    Attributes
    ----------
    expressions : int
        That were diagnosed.
    unit : str
        What intervals are drawn over: "scene" or "frame".
    verdicts : dict of str to Share
        Each of VERDICTS, ATTRIBUTE where it occurs; the shares sum to one.
    details : dict of (str, str) to Share
        (verdict, detail) that occur, in the order of VERDICTS, the most frequent first.
    lucky : Share
        CORRECT with a pair that is not acceptable.
    accuracy : Estimate
        Set-valued, as answered.
    parse : Estimate
        v(none) - accuracy: what the gold parse would gain.
    deltas : Deltas or None
        None where no expression tells what the truth in place of a module would do: imported predictions without
        relation probabilities.
    residual : Estimate
        1 - v(all).
    residual_causes : dict of (str, str or None) to int
        Verdicts and details of the expressions that all oracles together do not mend.
    """

    expressions: int
    unit: str
    verdicts: dict[str, Share]
    details: dict[tuple[str, str], Share]
    lucky: Share
    accuracy: Estimate
    parse: Estimate
    deltas: Deltas | None
    residual: Estimate
    residual_causes: dict[tuple[str, str | None], int]

    @property
    def loss(self) -> dict[str, Estimate]:
        """What adds up to one: accuracy, PARSE, the Shapley value of each oracle, residual; empty without deltas."""
        if self.deltas is None:
            return {}
        return {"accuracy": self.accuracy, "PARSE": self.parse, **self.deltas.shapley, "residual": self.residual}

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "expressions": self.expressions,
            "clusters": self.unit,
            "verdicts": {v: s.record() for v, s in self.verdicts.items()},
            "shares_sum": float(sum(s.estimate.value for s in self.verdicts.values())),
            "details": [
                {"verdict": verdict, "detail": detail, **s.record()} for (verdict, detail), s in self.details.items()
            ],
            "lucky": self.lucky.record(),
            "accuracy": self.accuracy.record(),
            "parse": self.parse.record(),
            "oracles": None if self.deltas is None else self.deltas.record(),
            "residual": None if self.deltas is None else self.residual.record(),
            "residual_causes": [
                {"verdict": verdict, "detail": detail, "count": n}
                for (verdict, detail), n in self.residual_causes.items()
                if self.deltas is not None
            ],
        }


def has_verdicts(records: pa.Table) -> bool:
    """Whether a run's expressions were diagnosed: runs of other systems, and older ones, were not."""
    names = records.column_names
    return "verdict" in names and "right_with" in names and records.column("verdict").null_count < records.num_rows


def need_verdicts(records: pa.Table) -> None:
    """Raise InputError where a run has none."""
    cause = "only the pipeline's own runs have, without --no-verdicts" if records.num_rows else "it has no expressions"
    old = not {"verdict", "right_with"} <= set(records.column_names)
    require(
        has_verdicts(records),
        "this run has no verdicts",
        cause="it was made by an older release; run `eval` again" if old else cause,
    )


def summarise_run(records: pa.Table, config: BootstrapConfig | None = None) -> RunSummary:
    """Verdicts with clustered intervals, and where the accuracy goes.

    Parameters
    ----------
    records : pyarrow.Table
        A run's records; expressions without a verdict do not count.
    config : BootstrapConfig, optional

    Raises
    ------
    InputError
        The run has no verdicts, or unknown ones.
    """
    need_verdicts(records)
    if records.column("verdict").null_count:
        records = records.filter(pc.is_valid(records.column("verdict")))  # pyright: ignore[reportAttributeAccessIssue]
    clusters, unit = clusters_of(records)
    verdict = np.array(records.column("verdict").to_pylist(), object)
    detail = np.array(records.column("detail").to_pylist(), object)
    for name in sorted(set(verdict.tolist())):
        require(name in VERDICTS, "the run has a verdict that is not known", got=name, expected=", ".join(VERDICTS))
    lucky = column(records, "lucky") > 0
    pairs = [
        (str(v), str(d)) for v, d in dict.fromkeys(zip(verdict.tolist(), detail.tolist(), strict=True)) if d is not None
    ]
    kinds = shown_verdicts(set(verdict.tolist()))
    member = np.stack(
        [*(verdict == v for v in kinds), *((verdict == v) & (detail == d) for v, d in pairs), lucky], axis=1
    )
    shares = _shares(member, clusters, config)
    verdicts: dict[str, Share] = dict(zip(kinds, shares, strict=False))
    total = sum(s.estimate.value for s in verdicts.values())
    if sum(s.count for s in verdicts.values()) != len(verdict) or abs(total - 1) > EXACT:
        raise AssertionError(f"shares of verdicts sum to {total}, not to one")
    details = dict(zip(pairs, shares[len(kinds) :], strict=False))
    ordered = sorted(details, key=lambda p: (VERDICTS.index(p[0]), -details[p].count, p[1]))
    # Of imported predictions that do not tell: what is right stays so, and no oracle is known to mend the rest.
    answered, right_with = column(records, "set_correct"), column(records, "right_with")
    told = not np.isnan(right_with).all()
    right_with = np.where(np.isnan(right_with), (answered > 0) * ((1 << SUBSETS) - 1), right_with).astype(np.int64)
    deltas = oracle_deltas(right_with, clusters, config) if told else None
    explained = 0.0 if deltas is None else sum(e.value for e in deltas.shapley.values())
    if deltas is not None and abs(explained - (deltas.value[-1] - deltas.value[0])) > EXACT:
        raise AssertionError(f"Shapley values sum to {explained}, not to v(all) - v(none)")
    unmended = (right_with >> (SUBSETS - 1)) & 1 == 0
    causes = Counter(zip(verdict[unmended].tolist(), detail[unmended].tolist(), strict=True))
    return RunSummary(
        len(verdict),
        unit,
        verdicts,
        {p: details[p] for p in ordered},
        shares[-1],
        mean_estimate(answered, clusters, config=config),
        mean_estimate((right_with & 1).astype(np.float64), clusters, other=answered, config=config),
        deltas,
        mean_estimate(unmended.astype(np.float64), clusters, config=config),
        dict(sorted(causes.items(), key=lambda item: (-item[1], VERDICTS.index(item[0][0])))),
    )


def _shares(member: np.ndarray, clusters: np.ndarray, config: BootstrapConfig | None) -> list[Share]:
    """The share of each column of (N, K) bool, all from the same resamples."""
    rows = np.concatenate([member, np.ones((len(member), 1))], axis=1).astype(np.float64)
    found = bootstrap(rows, clusters, lambda sums: ratio(sums[:, :-1], sums[:, -1:]), config=config)
    return [Share(int(n), e) for n, e in zip(member.sum(axis=0), found, strict=True)]


def verdict_table(systems: Mapping[str, RunSummary]) -> Table:
    """The table "verdicts": verdicts and their details, two columns a system."""
    found = list(systems.values())
    pairs = {p: None for s in found for p in s.details}
    rows = []
    for verdict in shown_verdicts({v for s in found for v in s.verdicts}):
        rows.append(Row(verdict, _cells([s.verdicts.get(verdict) for s in found])))
        rows += [
            Row(f"{verdict}: {detail}", _cells([s.details.get((v, detail)) for s in found]))
            for v, detail in sorted(pairs, key=str)
            if v == verdict
        ]
        if verdict == "CORRECT":
            rows.append(Row("CORRECT: LUCKY", _cells([s.lucky for s in found])))
    sums = [(float(sum(x.estimate.value for x in s.verdicts.values())), s.expressions) for s in found]
    rows.append(Row("sum of verdicts", tuple(c for pair in sums for c in pair)))
    return Table(
        "verdicts",
        "Verdicts",
        tuple(c for name in systems for c in _heads(name, ("share", "n"), len(systems))),
        tuple(rows),
        "Percent of expressions. Each has one verdict, so that these sum to 100; rows after a colon are part of the "
        "verdict before it. CORRECT: the labelled target; LUCKY: with a pair of which the expression is not true; "
        "LABEL: AMBIGUOUS is another right answer, SUSPECT one that only the labels' relations call right. "
        f"Brackets: 95 % bootstrap intervals over {found[0].unit}s.",
    )


def summary_tables(systems: Mapping[str, RunSummary]) -> list[Table]:
    """Verdicts, and oracles where a system has them."""
    told = {name: s for name, s in systems.items() if s.deltas is not None}
    return [verdict_table(systems), *([oracle_table(told)] if told else [])] if systems else []


def oracle_table(systems: Mapping[str, RunSummary]) -> Table:
    """The table "oracles": single deltas, and Shapley values with what completes them to one; all have deltas."""
    found = list(systems.values())

    lines: dict[str, list[tuple[Cell, Cell]]] = {
        "as answered": [(None, s.accuracy) for s in found],
        "PARSE": [(s.parse, s.parse) for s in found],
        **{m: [(d.single[m], d.shapley[m]) for s in found if (d := s.deltas) is not None] for m in ORACLES},
        "residual": [(None, s.residual) for s in found],
        "sum": [(None, float(sum(e.value for e in s.loss.values()))) for s in found],
    }
    causes = " ".join(f"{name}: {residual_words(s)}." for name, s in systems.items())
    return Table(
        "oracles",
        "What each module costs",
        tuple(c for name in systems for c in _heads(name, ("alone", "Shapley"), len(systems))),
        tuple(Row(name, tuple(c for pair in cells for c in pair)) for name, cells in lines.items()),
        "Points of set-valued accuracy gained with a module replaced by the truth. Alone: by it only; these do not add "
        "up, since errors overlap and make up for each other, and one below 0 made up for another's. Shapley: its fair "
        "share over all orders of replacing; the second column adds up to 100 from top to bottom. PARSE: gained by the "
        f"gold parse. Residual: what all oracles together do not mend. {causes} "
        f"Brackets: 95 % bootstrap intervals over {found[0].unit}s.",
    )


def residual_words(summary: RunSummary) -> str:
    """Where the residual comes from, in words."""
    if not summary.residual_causes:
        return "no residual"
    causes = ", ".join(f"{v}{f' {d}' if d else ''} {n}" for (v, d), n in summary.residual_causes.items())
    return f"residual from {causes}"


def _cells(shares: Sequence[Share | None]) -> tuple[Cell, ...]:
    return tuple(c for s in shares for c in ((0.0, 0) if s is None else (s.estimate, s.count)))


def _heads(name: str, kinds: tuple[str, str], systems: int) -> tuple[str, ...]:
    return kinds if systems == 1 else tuple(f"{name}, {kind}" for kind in kinds)


@dataclass(frozen=True)
class Deltas:
    """Set-valued accuracy on the gold parse with parts of the pipeline replaced by the truth.

    Attributes
    ----------
    expressions : int
    value : (2^K,) float64
        v(S) for each subset of the K oracles.
    single : dict of str to Estimate
        v({m}) - v(none), not clipped: a negative one says that the module made up for an error of another.
        These do not add up.
    shapley : dict of str to Estimate
        phi_m = sum over S without m of |S|! (K - 1 - |S|)! / K! (v(S + m) - v(S)). These add up to v(all) - v(none).
    """

    expressions: int
    value: np.ndarray
    single: dict[str, Estimate]
    shapley: dict[str, Estimate]

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "expressions": self.expressions,
            "value": {"+".join(names_of(s)) or "none": float(v) for s, v in enumerate(self.value)},
            "single": {m: e.record() for m, e in self.single.items()},
            "shapley": {m: e.record() for m, e in self.shapley.items()},
            "shapley_sum": float(sum(e.value for e in self.shapley.values())),
            "loss_explained": float(self.value[-1] - self.value[0]),
            # What no oracle mends: bad labels, pairs excluded as one thing, ties.
            "residual": float(1 - self.value[-1]),
        }


def shapley_weights(n: int) -> np.ndarray:
    """(n, 2^n) float64: phi = weights @ v."""
    weights = np.zeros((n, 1 << n))
    for m, subset in product(range(n), range(1 << n)):
        others = (subset & ~(1 << m)).bit_count()
        share = factorial(others) * factorial(n - 1 - others) / factorial(n)
        weights[m, subset] = share if subset >> m & 1 else -share
    return weights


def oracle_deltas(
    right_with: np.ndarray,
    clusters: np.ndarray,
    config: BootstrapConfig | None = None,
    oracles: Sequence[str] = ORACLES,
) -> Deltas:
    """The deltas of a run.

    Parameters
    ----------
    right_with : (E,) int
        Of each expression, bit s set where the answer is right with subset s.
    clusters : (E,)
        What resembles each other, for the intervals: scenes, or frames.
    oracles : sequence of str
        Those that the subsets are of, in the order of their bits.
    """
    subsets = 1 << len(oracles)
    right = ((np.asarray(right_with, np.int64)[:, None] >> np.arange(subsets)) & 1).astype(np.float64)
    single = {
        name: mean_estimate(right[:, 1 << m], clusters, other=right[:, 0], config=config)
        for m, name in enumerate(oracles)
    }
    weights = dict(zip(oracles, shapley_weights(len(oracles)), strict=True))
    shapley = {name: mean_estimate(right @ own, clusters, config=config) for name, own in weights.items()}
    return Deltas(len(right), right.mean(axis=0) if len(right) else np.full(subsets, np.nan), single, shapley)
