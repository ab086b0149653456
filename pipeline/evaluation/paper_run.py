"""The paper's tables of a run: of one that is being made, and of one that is there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.datasets.settings import read_settings
from pipeline.evaluation.compare import read_records
from pipeline.evaluation.paper_tables import Evaluated, paper_tables
from pipeline.evaluation.relation_records import FILE, read_pair_names, read_relation_records
from pipeline.evaluation.run_folder import RECORDS_FILE, open_run
from pipeline.evaluation.shared_makers import shares_of_run, title_of
from pipeline.labels.profiles import GIVEN
from pipeline.metrics.intervals import BootstrapConfig
from pipeline.metrics.tables import NOTHING_SHARED, Table
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from pipeline.labels.reading import Labels


def tables_of_folder(
    folder: Path,
    labels: Labels,
    systems: Mapping[str, pa.Table],
    shares: Mapping[str, str] = NOTHING_SHARED,
    *,
    held_out: bool = False,
    config: BootstrapConfig | None = None,
) -> list[Table]:
    """The paper's tables of a run's folder; relations where it has their records.

    `systems` are the records of expressions by system, `shares` as in `Evaluated`.
    """
    root = Path(str(labels.manifest.dataset.get("path", "")))
    dataset = (read_settings(root).name if root.is_dir() else None) or root.name
    stored = folder / FILE
    relations = read_relation_records(stored) if stored.exists() else None
    pairs = read_pair_names(stored) if stored.exists() else ()
    vocabulary, layout = str(labels.manifest.config["vocabulary"]), str(labels.manifest.dataset.get("format"))
    ruled = labels.manifest.profile.get("name") != GIVEN
    evaluated = Evaluated(vocabulary, dataset, layout, ruled, shares)
    return paper_tables(evaluated, systems, relations, pairs, held_out=held_out, config=config)


def tables_of_run(folder: str | Path) -> list[Table]:
    """The paper's tables of a run that is there; its labels must be too.

    Raises
    ------
    InputError
        No run there, no labels, or neither expressions nor relations in it.
    """
    run = open_run(folder)
    if not (run.folder / RECORDS_FILE).exists() and not (run.folder / FILE).exists():
        raise InputError("the run has neither records of expressions nor of relations", path=run.folder)
    systems = {run.name: read_records(run.folder)} if (run.folder / RECORDS_FILE).exists() else {}
    how = run.manifest.get("relations") or {}
    own = title_of(shares_of_run(run.manifest, run.labels.root))
    blocks = dict.fromkeys(systems, own) | {n: str(s["title"]) for n, s in how.get("shares", {}).items()}
    return tables_of_folder(run.folder, run.labels, systems, blocks, held_out=how.get("pairs") == "held-out")
