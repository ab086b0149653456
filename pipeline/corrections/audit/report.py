"""The ranked list of an audit: what it counts, and the files that a maintainer can act on."""

from __future__ import annotations

import csv
import json
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from pipeline.corrections.audit.suspicion import KINDS, PRIOR, AuditItem
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.metrics.tables import Row, Table
from pipeline.system.whole_files import write_whole

LIKELY = 0.5
"""From this score on an item is more probably wrong than not."""
COLUMNS = ("rank", "score", "id", "frame", "text", "truth", "seems", "evidence", "look")


@dataclass(frozen=True)
class AuditReport:
    """Audited items, the most suspicious first; of equal ones in the order of the benchmark."""

    dataset: str
    """As it is named on the command line, for `look`."""
    items: tuple[AuditItem, ...]
    systems: Table | None = None
    """The systems that were compared, where the benchmark has a metric of its own."""

    @classmethod
    def ranked(cls, dataset: str, items: Iterable[AuditItem], systems: Table | None = None) -> AuditReport:
        return cls(dataset, tuple(sorted(items, key=lambda item: -item.score)), systems)

    @property
    def likely(self) -> int:
        """Number of items more probably wrong than not."""
        return sum(item.score >= LIKELY for item in self.items)

    @property
    def suspicious(self) -> tuple[AuditItem, ...]:
        """Items with evidence against their truth."""
        return tuple(item for item in self.items if item.score > PRIOR and item.reasons)

    @property
    def kinds(self) -> Table:
        """Suspicious items by kind of evidence, and by the strongest kind."""
        every = Counter(kind for item in self.suspicious for kind in {e.kind for e in item.reasons})
        first = Counter(item.reasons[0].kind for item in self.suspicious)
        rows = tuple(Row(kind, (every[kind], first[kind], words)) for kind, words in KINDS.items() if every[kind])
        return Table("audit", "What speaks against the truth", ("items", "foremost", "what it says"), rows)

    def look(self, item: AuditItem) -> str:
        """Command for opening the page on an item."""
        view = encode(ViewState(Path(self.dataset).name, item.frame, item.text))
        return shlex.join(["spatialviz", "view", self.dataset, "--state", view])

    def record(self) -> dict[str, Any]:
        """Counts as JSON."""
        return {
            "items": len(self.items), "suspicious": len(self.suspicious), "likely_wrong": self.likely,
            "expected_wrong": round(sum(item.score for item in self.items), 1),
            "unjudged": sum(item.unjudged is not None for item in self.items),
            "kinds": {row.name: row.cells[0] for row in self.kinds.rows},
        }  # fmt: skip

    def records(self) -> Iterator[dict[str, Any]]:
        """Every item by rank, as JSON."""
        return ({"rank": n, **item.record(self.look(item))} for n, item in enumerate(self.items, start=1))

    def write(self, path: Path) -> None:
        """Every item by rank: CSV where the file's name ends so, else JSON lines.

        Raises InputError: it cannot be written.
        """
        write_whole(path, (self._csv() if path.suffix == ".csv" else self._lines()).encode(), "the audit")

    def _lines(self) -> str:
        return "".join(json.dumps(record, ensure_ascii=False) + "\n" for record in self.records())

    def _csv(self) -> str:
        out = StringIO()
        rows: csv.DictWriter[str] = csv.DictWriter(out, COLUMNS, extrasaction="ignore", lineterminator="\n")
        rows.writeheader()
        for record in self.records():
            rows.writerow({**record, "evidence": "; ".join(e["text"] for e in record["evidence"])})
        return out.getvalue()
