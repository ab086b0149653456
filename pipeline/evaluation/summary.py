"""A run in figures: how often each verdict, what each module costs (the accuracy that its truth would gain), what is
left over; where that cannot be worked out, why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import product
from math import factorial
from typing import Any

import numpy as np

from pipeline.diagnosis.oracles import NAMED_BY, ORACLES, SUBSETS, names_of, shown_oracle
from pipeline.diagnosis.verdict import VERDICTS, shown_detail, shown_verdicts
from pipeline.evaluation.grounding_tables import clusters_of, column
from pipeline.evaluation.records_file import text_codes
from pipeline.metrics.intervals import BootstrapConfig, Estimate, bootstrap, mean_estimate, ratio
from pipeline.metrics.tables import Cell, Row, Table
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

EVERY = SUBSETS - 1
"""The bits of all ORACLES."""
UNTOLD = "no relation probabilities are given"
"""Why costs cannot be worked out in records of before, which do not say it."""


@dataclass(frozen=True)
class Deltas:
    """Set-valued accuracy on the gold parse with parts of the pipeline replaced by the truth."""

    expressions: int
    value: np.ndarray  # (2^K,) float64: v(S) for each subset of the K oracles, without what is not known
    # v({m}) - v(none), not clipped: below 0 the module made up for an error of another. These do not add up.
    single: dict[str, Estimate]
    shapley: dict[str, Estimate]  # as by `shapley_weights`: these add up to v(all) - v(none)
    untold: dict[str, str]  # the oracles that the two do not hold, and why

    def record(self) -> dict[str, Any]:
        """Convert to JSON; null for costs without a basis."""
        nothing = dict.fromkeys(self.untold)
        value = {"+".join(names_of(s)) or "none": float(v) for s, v in enumerate(self.value)}
        told = {name: v if self.untold.keys().isdisjoint(name.split("+")) else None for name, v in value.items()}
        explained = float(sum(e.value for e in self.shapley.values()))
        return {
            "expressions": self.expressions,
            "value": told,
            "single": {m: e.record() for m, e in self.single.items()} | nothing,
            "shapley": {m: e.record() for m, e in self.shapley.items()} | nothing,
            "shapley_sum": explained,
            "loss_explained": explained if self.untold else float(self.value[-1] - self.value[0]),
            # What no oracle mends: bad labels, pairs excluded as one thing, ties.
            "residual": None if self.untold else float(1 - self.value[-1]),
            "untold": self.untold,
        }


def shapley_weights(n: int) -> np.ndarray:
    """(n, 2^n) float64: phi_m = sum over S without m of |S|! (n - 1 - |S|)! / n! (v(S + m) - v(S)) = weights @ v."""
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
    untold: Mapping[str, str] | None = None,
) -> Deltas:
    """The deltas of a run.

    `right_with` (E,) int, or (E, 2^K) float64: of each expression, bit s set where the answer is right with subset s;
    or 1 for it in column s. `clusters` (E,): what resembles each other, for the intervals: scenes, or frames.
    `oracles`: those that the subsets are of, in the order of their bits. `untold`: those whose costs are left out, and
    why.
    """
    right, subsets = np.asarray(right_with), 1 << len(oracles)
    if right.ndim < 2:
        right = ((right.astype(np.int64)[:, None] >> np.arange(subsets)) & 1).astype(np.float64)
    told = [(m, name) for m, name in enumerate(oracles) if name not in (untold or {})]
    single = {name: mean_estimate(right[:, 1 << m], clusters, other=right[:, 0], config=config) for m, name in told}
    weights = shapley_weights(len(oracles))
    shapley = {name: mean_estimate(right @ weights[m], clusters, config=config) for m, name in told}
    value = right.mean(axis=0) if len(right) else np.full(subsets, np.nan)
    return Deltas(len(right), value, single, shapley, dict(untold or {}))


@dataclass(frozen=True, eq=False)
class KnownOracles:
    """What is known of the expressions of a run."""

    right: np.ndarray  # (E, S) float64: 1 where right under a subset of the oracles that can be put in place
    known: np.ndarray  # (E,) int64: the bits of the oracles that can
    why: dict[str, np.ndarray]  # (E,) object, by oracle and PARSE: why it cannot, None where it can

    @staticmethod
    def of(records: pa.Table) -> KnownOracles:
        """Read `right_with` and `untold` of records; earlier records have no `untold`."""
        answered, right_with = column(records, "set_correct") > 0, column(records, "right_with")
        none = np.isnan(right_with)
        why = {m: np.where(none, UNTOLD, np.array(None, object)) for m in ORACLES}
        if "untold" in records.column_names and (said := records.column("untold")).null_count < len(said):
            for row, told in enumerate(said.to_pylist()):
                for oracle, reason in (part.split(": ", 1) for part in told or ()):
                    if oracle in why:
                        why[oracle][row] = reason
        known = sum((_none(why[m]).astype(np.int64) << k for k, m in enumerate(ORACLES)), 0 * none)
        why["PARSE"] = np.where(none & (column(records, "parse_ok") == 0), why[ORACLES[0]], np.array(None, object))
        bits = np.where(none, answered * ((1 << SUBSETS) - 1), right_with).astype(np.int64)
        right = (bits[:, None] >> (np.arange(SUBSETS) & known[:, None])) & 1
        return KnownOracles(right.astype(np.float64), known, why)

    @property
    def unmended(self) -> np.ndarray:
        """(E,) bool: wrong with all oracles in place."""
        return self.right[:, -1] == 0

    def untold(self, costs: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Costs ((E,) float64 by oracle and PARSE) without a basis, with the reasons.

        A cost is told where more is known of it than is not: 0 is never told for what nobody knows.
        """
        found = {}
        for name, cost in costs.items():
            reasons = self.why[name]
            missing = ~_none(reasons)
            open_ = missing & self.unmended
            if len(missing) and (missing.all() or open_.sum() > max(float(cost.sum()), 0.0)):
                counted = open_ if open_.any() else missing
                (why, n), *_ = Counter(reasons[counted].tolist()).most_common(1)
                wrong = int(self.unmended.sum())
                found[name] = str(why) if n == wrong or not open_.any() else f"{why} ({n} of {wrong} wrong answers)"
        return found


EXACT = 1e-9
"""A share that is more than this is not 0."""
SHORT = {
    "PARSE": "reading the sentence",
    "RECALL": "finding the things",
    "LIFT": "from pixels to 3D",
    "SRM": "judging relations",
    "ATTRIBUTE": "judging looks",
    "CONF": "trusting detections",
    "residual": "what nothing mends",
    "unknown": "what cannot be worked out",
}
"""What of `RunSummary.loss` in words."""
LEAST_SAID = 0.05
"""Points that a sentence is worth: what is shown as 0.0 is not said."""
RANKING_ALONE = ("SCORE", "DEGENERATE")
"""Details of PRM that no oracle takes away: the ranking itself is wrong, with all that it ranks by true."""


@dataclass(frozen=True)
class Share:
    """How many expressions, and which share of those that were diagnosed."""

    count: int
    estimate: Estimate

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        return {"count": self.count, "share": self.estimate.record()}


@dataclass(frozen=True)
class RunSummary:
    """A run's verdicts and deltas."""

    expressions: int
    unit: str  # what intervals are drawn over: "scene" or "frame"
    verdicts: dict[str, Share]  # each of VERDICTS, ATTRIBUTE where it occurs; the shares sum to one
    details: dict[tuple[str, str], Share]  # (verdict, detail) that occur, by VERDICTS, the most frequent first
    lucky: Share  # CORRECT with a pair that is not acceptable
    accuracy: Estimate  # set-valued, as answered
    parse: Estimate  # v(none) - accuracy: what the gold parse would gain
    deltas: Deltas | None  # None where no expression tells what the truth in place of a module would do
    residual: Estimate  # what stays wrong with all oracles together
    residual_causes: dict[tuple[str, str | None], int]  # verdicts and details of these expressions
    unknown: Estimate  # what is lost to nobody knows which module: it is in none of the costs, and not in the residual
    untold: dict[str, str]  # the oracles, and PARSE, whose costs cannot be worked out, and why

    @property
    def loss(self) -> dict[str, Estimate]:
        """Parts of one: accuracy, PARSE, Shapley values, residual, and unknown where any; empty without deltas."""
        if self.deltas is None:
            return {}
        parse = {} if "PARSE" in self.untold else {"PARSE": self.parse}
        unknown = {"unknown": self.unknown} if abs(self.unknown.value) > EXACT else {}
        return {"accuracy": self.accuracy, **parse, **self.deltas.shapley, "residual": self.residual, **unknown}

    @property
    def failing(self) -> Counter[str]:
        """Count expressions by the oracle of their verdict; by the verdict itself without an oracle."""
        found = Counter[str]()
        for verdict, share in self.verdicts.items():
            beyond = sum(self.details[v, d].count for v, d in self.details if v == verdict and d in RANKING_ALONE)
            oracle = next((name for name, verdicts in NAMED_BY.items() if verdict in verdicts), verdict)
            if verdict not in ("CORRECT", "LABEL"):
                found[oracle] += share.count - beyond
                found[verdict] += beyond
        return +found

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
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
            "parse": None if "PARSE" in self.untold else self.parse.record(),
            "oracles": None if self.deltas is None else self.deltas.record(),
            "residual": None if self.deltas is None else self.residual.record(),
            "unknown": self.unknown.record(),
            "untold": self.untold,
            "in_words": cost_words(self),
            "residual_causes": [
                {"verdict": verdict, "detail": detail, "count": n}
                for (verdict, detail), n in self.residual_causes.items()
                if self.deltas is not None
            ],
        }


def has_verdicts(records: pa.Table) -> bool:
    """Tell whether a run's expressions were diagnosed; runs of other systems, and older runs, were not."""
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

    `records`: a run's records; expressions without a verdict do not count.

    Raises InputError: the run has no verdicts, or unknown ones.
    """
    need_verdicts(records)
    if records.column("verdict").null_count:
        records = records.filter(pc.is_valid(records.column("verdict")))  # pyright: ignore[reportAttributeAccessIssue]
    clusters, unit = clusters_of(records)
    (names, verdict), (told, detail) = (text_codes(records.column(name)) for name in ("verdict", "detail"))
    named = list(map(str, names))
    for name in sorted(named):
        require(name in VERDICTS, "the run has a verdict that is not known", got=name, expected=", ".join(VERDICTS))
    lucky = column(records, "lucky") > 0
    both = verdict.astype(np.int64) * len(told) + detail
    occurring, first = np.unique(both, return_index=True)
    # In the order in which they first occur.
    codes = [code for code in occurring[np.argsort(first)].tolist() if told[code % len(told)] is not None]
    pairs = [(named[code // len(told)], str(told[code % len(told)])) for code in codes]
    kinds = shown_verdicts(set(named))
    of_kinds = (verdict == named.index(v) if v in named else np.zeros(len(verdict), np.bool_) for v in kinds)
    member = np.stack([*of_kinds, *(both == code for code in codes), lucky], axis=1)
    shares = _shares(member, clusters, config)
    verdicts: dict[str, Share] = dict(zip(kinds, shares, strict=False))
    details = dict(zip(pairs, shares[len(kinds) :], strict=False))
    ordered = sorted(details, key=lambda p: (VERDICTS.index(p[0]), -details[p].count, p[1]))
    answered, oracles = column(records, "set_correct"), KnownOracles.of(records)
    right, unmended, whole = oracles.right, oracles.unmended, oracles.known == EVERY
    costs: dict[str, np.ndarray] = dict(zip(ORACLES, (right @ shapley_weights(len(ORACLES)).T).T, strict=True))
    costs["PARSE"] = right[:, 0] - answered
    untold = oracles.untold(costs)
    deltas = None
    if oracles.known.any():
        without = {name: why for name, why in untold.items() if name in ORACLES}
        deltas = oracle_deltas(right, clusters, config, untold=without)
    unknown = (unmended & ~whole) + sum((costs[name] for name in untold), np.zeros(len(right)))
    left = unmended & whole
    causes = Counter({(named[c // len(told)], told[c % len(told)]): n for c, n in Counter(both[left].tolist()).items()})
    return RunSummary(
        len(verdict),
        unit,
        verdicts,
        {p: details[p] for p in ordered},
        shares[-1],
        mean_estimate(answered, clusters, config=config),
        mean_estimate(right[:, 0], clusters, other=answered, config=config),
        deltas,
        mean_estimate(left.astype(np.float64), clusters, config=config),
        dict(sorted(causes.items(), key=lambda item: (-item[1], VERDICTS.index(item[0][0])))),
        mean_estimate(unknown, clusters, config=config),
        untold,
    )


def _none(values: np.ndarray) -> np.ndarray:
    """(N,) bool: which of (N,) objects are None."""
    return np.equal(values, np.array(None, object)).astype(np.bool_)


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
            Row(f"{verdict}: {shown_detail(detail)}", _cells([s.details.get((v, detail)) for s in found]))
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
        "LABEL: AMBIGUOUS is another correct answer, SUSPECT one that only the labels' relations call correct. "
        f"{''.join(f'{name}: {untold_words(s)} ' for name, s in systems.items() if s.deltas is None)}"
        f"Brackets: 95 % bootstrap intervals over {found[0].unit}s.",
    )


def summary_tables(systems: Mapping[str, RunSummary]) -> list[Table]:
    """Tables of verdicts, and of oracles where a system has any."""
    told = {name: s for name, s in systems.items() if s.deltas is not None}
    return [verdict_table(systems), *([oracle_table(told)] if told else [])] if systems else []


def oracle_table(systems: Mapping[str, RunSummary]) -> Table:
    """Table "oracles": single deltas, and Shapley values with the remainder to 100; of summaries with deltas."""
    found = list(systems.values())

    def cost(summary: RunSummary, name: str) -> tuple[Cell, Cell]:
        assert summary.deltas is not None
        return summary.deltas.single.get(name), summary.deltas.shapley.get(name)

    lines: dict[str, list[tuple[Cell, Cell]]] = {
        "as answered": [(None, s.accuracy) for s in found],
        "PARSE": [(None, None) if "PARSE" in s.untold else (s.parse, s.parse) for s in found],
        **{shown_oracle(m): [cost(s, m) for s in found] for m in ORACLES},
        "residual": [(None, s.residual) for s in found],
        **({"not worked out": [(None, s.unknown) for s in found]} if any("unknown" in s.loss for s in found) else {}),
        "sum": [(None, float(sum(e.value for e in s.loss.values()))) for s in found],
    }
    causes = " ".join(f"{name}: {residual_words(s)}. {untold_words(s)}".strip() for name, s in systems.items())
    return Table(
        "oracles",
        "What each module costs",
        tuple(c for name in systems for c in _heads(name, ("alone", "Shapley"), len(systems))),
        tuple(Row(name, tuple(c for pair in cells for c in pair)) for name, cells in lines.items()),
        "Points of set-valued accuracy gained with a module replaced by the truth, under the verdicts that this takes "
        "away. Alone: by it only; these do not add up, since errors overlap and make up for each other, and one below "
        "0 made up for another's. Shapley: its fair share over all orders of replacing; the second column adds up to "
        "100 from top to bottom. PARSE: gained by the gold parse. Residual: what all oracles together do not mend. "
        f"{causes} Brackets: 95 % bootstrap intervals over {found[0].unit}s.",
    )


def untold_words(summary: RunSummary, said: str | None = None) -> str:
    """Sentences on costs without a basis and the reasons, but for the reason `said`; empty for none."""
    reasons: dict[str, list[str]] = {}
    for name, why in summary.untold.items():
        reasons.setdefault(why, []).append(shown_oracle(name))
    reasons.pop(said or "", None)
    return " ".join(f"What {', '.join(names)} cost cannot be worked out: {why}." for why, names in reasons.items())


def cost_words(summary: RunSummary) -> str:
    """Sentences on where the accuracy goes, in agreement with the verdicts or with the reason for a difference."""
    right = summary.accuracy.value
    labelled = summary.verdicts["CORRECT"].estimate.value
    shares = tuple(
        f"{100 * share:.1f}" if 100 * share >= LEAST_SAID else "none"
        for share in (right, 1 - right, labelled, right - labelled)
    )
    by = f"{shares[2]} by the labelled thing", f"{shares[3]} by another that fits too"
    how = f" ({', '.join(by)})" if 100 * (right - labelled) >= LEAST_SAID else ""
    text = f"Of 100 expressions {shares[0]} are answered rightly{how}, {shares[1]} are not."
    parts = {name: e.value for name, e in summary.loss.items() if name != "accuracy" and 100 * e.value >= LEAST_SAID}
    if (unknown := parts.pop("unknown", 0.0)) > 0:
        text += f" What {100 * unknown:.1f} of them cost by module cannot be worked out."
    worst = sorted(parts, key=lambda name: -parts[name])[:2]
    if worst:
        codes = {name: f" ({shown_oracle(name)})" if name in NAMED_BY else "" for name in worst}
        said = [f"{SHORT[name]}{codes[name]} {100 * parts[name]:.1f}" for name in worst]
        most = "Most of them by" if sum(parts[name] for name in worst) > (1 - right) / 2 else "The largest parts:"
        text += f" {most} {' and '.join(said)}."
    named = summary.failing.most_common(1)
    if named and named[0][0] not in worst[:1]:
        name, count = named[0]
        of = f"{shown_oracle(name)} most often ({count} of {summary.failing.total()})"
        why = "an answer that several modules would mend counts for each of them in part"
        if name in summary.untold:
            why = f"what that costs cannot be worked out: {summary.untold[name]}"
        elif name not in NAMED_BY:
            why = "that is no module whose truth would mend it alone"
        text += f" Verdicts name {of}; {why}."
    rest = untold_words(summary, summary.untold.get(named[0][0]) if named else None)
    return f"{text} {rest}" if rest else text


def residual_words(summary: RunSummary) -> str:
    """Sentence on the causes of the residual."""
    if not summary.residual_causes:
        return "no residual"
    causes = ", ".join(f"{v}{f' {d}' if d else ''} {n}" for (v, d), n in summary.residual_causes.items())
    return f"residual from {causes}"


def _cells(shares: Sequence[Share | None]) -> tuple[Cell, ...]:
    return tuple(c for s in shares for c in ((0.0, 0) if s is None else (s.estimate, s.count)))


def _heads(name: str, kinds: tuple[str, str], systems: int) -> tuple[str, ...]:
    return kinds if systems == 1 else tuple(f"{name}, {kind}" for kind in kinds)
