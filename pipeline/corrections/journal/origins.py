"""Provenance: where the value of each field comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal

from pipeline.corrections.journal.events import Event

if TYPE_CHECKING:
    import pyarrow as pa

Source = Literal["auto", "human", "recomputed", "stale"]
ORIGIN_FIELDS = ("table", "frame", "frame_index", "key", "column", "origin", "author", "time", "event", "reason", "was")


@dataclass(frozen=True)
class Origin:
    """Where a value comes from.

    Attributes
    ----------
    source : str
        "auto": the labeller. "human": a person set it. "recomputed": it follows
        from a correction of something else. "stale": it does not yet follow
        from one, because the dataset was not at hand.
    author : str or None
        Who made the correction.
    time : datetime or None
        UTC.
    event : str or None
        ULID of that correction.
    reason : str
    made_by : str
        Of "auto": the model and the rule profile.
    """

    source: Source
    author: str | None = None
    time: datetime | None = None
    event: str | None = None
    reason: str = ""
    made_by: str = ""

    @classmethod
    def of(cls, source: Source, event: Event) -> Origin:
        """The origin of what an event set, or of what follows from it."""
        return cls(source, event.author, event.time, event.ulid, event.reason)

    def __str__(self) -> str:
        if self.source == "auto":
            return f"auto ({self.made_by})" if self.made_by else "auto"
        when = "" if self.time is None else self.time.strftime(" %Y-%m-%d %H:%M:%S UTC")
        if self.source == "human":
            return f"{self.author}{when}"
        verb = "recomputed from" if self.source == "recomputed" else "stale since"
        return f"{verb} {self.author}'s correction{when}"


@dataclass
class Origins:
    """The origins of one frame's values that are not the labeller's.

    Attributes
    ----------
    frame : str
    frame_index : int
    found : dict of (table, key, column) to (Origin, value that the labels had)
    """

    frame: str
    frame_index: int
    found: dict[tuple[str, str, str], tuple[Origin, Any]] = field(default_factory=dict)

    def put(self, table: str, key: str, column: str, origin: Origin, was: Any = None) -> None:
        """Note an origin; the last word on a value counts."""
        self.found[table, key, column] = origin, was

    def get(self, table: str, key: str, column: str) -> Origin | None:
        entry = self.found.get((table, key, column))
        return None if entry is None else entry[0]

    def rows(self) -> list[dict[str, Any]]:
        """As rows of the provenance table."""
        import json

        return [
            {
                "table": table,
                "frame": self.frame,
                "frame_index": self.frame_index,
                "key": key,
                "column": column,
                "origin": origin.source,
                "author": origin.author,
                "time": origin.time,
                "event": origin.event,
                "reason": origin.reason,
                "was": json.dumps(was, ensure_ascii=False),
            }
            for (table, key, column), (origin, was) in self.found.items()
        ]


def provenance_schema() -> pa.Schema:
    """The table of provenance: one row a value that is not the labeller's; `was` is the labeller's value as JSON."""
    import pyarrow as pa

    kinds = {"frame_index": pa.int32(), "time": pa.timestamp("us", "UTC")}
    return pa.schema([pa.field(name, kinds.get(name, pa.string())) for name in ORIGIN_FIELDS])
