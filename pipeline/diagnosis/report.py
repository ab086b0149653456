"""What a run's folder holds of its diagnosis: tables, `diagnosis.json`, `slices.md`, pictures and one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.diagnosis.confusion import RELATION_RECORDS, Confusion, answer_confusion, network_confusion
from pipeline.diagnosis.slices import DIMENSIONS, Slices, slice_by, slice_table
from pipeline.diagnosis.summary import RunSummary, has_verdicts, oracle_table, summarise_run, verdict_table
from pipeline.evaluation.intervals import BootstrapConfig
from pipeline.evaluation.shared_makers import Share, titles_of, with_caveats
from pipeline.evaluation.tables import NOTHING_SHARED, Table, as_csv, caveats_html, markdown
from pipeline.labels.reading import Labels
from pipeline.staging import write_json

if TYPE_CHECKING:
    import pyarrow as pa

DIAGNOSIS_FILE = "diagnosis.json"
MOST = 20
"""Classes, scenes and frames of their own in files; the rest is one slice."""


@dataclass(frozen=True)
class RunDiagnosis:
    """The diagnosis of a run and of those beside it.

    Attributes
    ----------
    summaries : dict of str to RunSummary
        By system; those without verdicts are left out.
    slices : tuple of Slices
        By every dimension that the runs have.
    confusions : tuple of Confusion
        That of the answers first, then of each network.
    shares : mapping of str to sequence of Share
        What systems have in common with what made the labels.
    """

    summaries: dict[str, RunSummary]
    slices: tuple[Slices, ...]
    confusions: tuple[Confusion, ...]
    shares: Mapping[str, Sequence[Share]] = field(default_factory=dict)

    @property
    def tables(self) -> list[Table]:
        """Verdicts and oracles, where there are verdicts."""
        return self._said([verdict_table(self.summaries), oracle_table(self.summaries)] if self.summaries else [])

    def _said(self, tables: Sequence[Table]) -> list[Table]:
        return [with_caveats(table, {name: self.shares.get(name, ()) for name in self.summaries}) for table in tables]

    def record(self) -> dict[str, Any]:
        """As JSON: `diagnosis.json`."""
        return {
            "systems": {name: s.record() for name, s in self.summaries.items()},
            "slices": {s.dimension.name: s.record() for s in self.slices},
            "confusions": {c.key: c.record() for c in self.confusions},
        }

    def write(self, folder: Path, plots: bool = True) -> None:
        """Write `diagnosis.json`, `slices.md` and tables into a run's folder; with `plots` also pictures and a page."""
        write_json(folder / DIAGNOSIS_FILE, self.record())
        tables = self._said([*map(slice_table, self.slices), *(c.table() for c in self.confusions)])
        (folder / "slices.md").write_text(markdown(tables), encoding="utf-8")
        (folder / "tables").mkdir(exist_ok=True)
        for table in tables:
            (folder / "tables" / f"{table.key}.csv").write_text(as_csv(table), encoding="utf-8")
        if plots:
            from pipeline.diagnosis.plots import draw_diagnosis

            shares = {name: self.shares.get(name, ()) for name in self.summaries}
            draw_diagnosis(
                self.summaries, self.slices, self.confusions, folder / "plots", caveats_html(self.tables),
                titles_of(shares),
            )  # fmt: skip


def diagnose_run(
    systems: Mapping[str, pa.Table],
    labels: Labels | None = None,
    folder: Path | None = None,
    config: BootstrapConfig | None = None,
    shares: Mapping[str, Sequence[Share]] = NOTHING_SHARED,
) -> RunDiagnosis:
    """Summaries, slices and confusions of runs; the first is the run itself.

    Parameters
    ----------
    systems : mapping of str to pyarrow.Table
        Records by system.
    labels : Labels, optional
        Of the first run: needed for the confusion of its answers.
    folder : Path, optional
        Of the first run: `relation_records.parquet` there tells what the networks take for what.
    config : BootstrapConfig, optional
    shares : mapping of str to sequence of Share
        As `RunDiagnosis.shares`.
    """
    first = next(iter(systems.values()))
    confusions = [] if labels is None else [answer_confusion(first, labels)]
    if folder is not None:
        confusions += network_confusion(folder / RELATION_RECORDS)
    summaries = {name: summarise_run(r, config) for name, r in systems.items() if has_verdicts(r)}
    cuts = [d for d in DIMENSIONS.values() if all(not d.column or d.column in r.column_names for r in systems.values())]
    slices = tuple(slice_by(systems, d, config, most=MOST) for d in cuts)
    return RunDiagnosis(summaries, slices, tuple(confusions), shares)
