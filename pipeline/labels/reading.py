"""Opening merged labels: the four tables and the manifest, each checked when it is read."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from pipeline.labels.schema import SCHEMA_VERSION, TABLES, Manifest
from pipeline.labels.tables import read_table
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

MANIFEST_FILE = "manifest.json"


@dataclass(frozen=True)
class Labels:
    """Merged labels of a dataset; tables are read when they are first asked for.

    Attributes
    ----------
    root : Path
    manifest : Manifest
    """

    root: Path
    manifest: Manifest

    def __repr__(self) -> str:
        counts = ", ".join(f"{self.manifest.tables[name].rows} {name}" for name in TABLES)
        return f"<Labels {self.root.name}: {counts}>"

    def table(self, name: str) -> pa.Table:
        """One of the tables "frames", "objects", "relations", "expressions", in canonical order."""
        return read_table(self.root / f"{name}.parquet", name)

    @cached_property
    def frames(self) -> pa.Table:
        return self.table("frames")

    @cached_property
    def objects(self) -> pa.Table:
        return self.table("objects")

    @cached_property
    def relations(self) -> pa.Table:
        return self.table("relations")

    @cached_property
    def expressions(self) -> pa.Table:
        return self.table("expressions")

    @property
    def relation_names(self) -> tuple[str, ...]:
        """The relations that were labelled, in the order of PAIRWISE."""
        return tuple(self.manifest.config["relations"])


def open_labels(path: str | Path) -> Labels:
    """Open a labels folder that `label` or `merge` finished.

    Raises
    ------
    InputError
        No labels there, unmerged ones, or ones of another schema.
    """
    root = Path(path).expanduser()
    file = root / MANIFEST_FILE
    if not file.is_file():
        unmerged = (root / "parts").is_dir()
        raise InputError(
            "these labels are not merged yet" if unmerged else "no labels here",
            expected=f"a folder with {MANIFEST_FILE}",
            cause=f"run: spatialviz merge {root}" if unmerged else "did `spatialviz label` finish?",
            path=root,
        )
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        version = str(content.get("schema_version", ""))
        if version.split(".")[0] != SCHEMA_VERSION.split(".")[0]:
            raise InputError("labels of another schema", got=version, expected=SCHEMA_VERSION, path=file)
        manifest = Manifest.model_validate(content)
    except (ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise InputError("the manifest is damaged", got=reason, path=file) from error
    unknown = [r for r in manifest.config.get("relations", ()) if r not in PAIRWISE]
    if unknown:
        raise InputError(
            "these labels hold a relation that is not declared here", got=repr(unknown[0]),
            expected=", ".join(PAIRWISE), cause="made with a relation of somebody's own?", path=file,
        )  # fmt: skip
    missing = [name for name in TABLES if not (root / f"{name}.parquet").is_file()]
    if missing:
        raise InputError(f"the table {missing[0]} is missing", path=root / f"{missing[0]}.parquet")
    return Labels(root, manifest)


PROVENANCE_FILE = "provenance.parquet"
MARKS_FILE = "marks.json"
STATUSES_FILE = "statuses.json"
"""What reviewers said of frames, objects, relations and expressions, and notes: kind, frame, key, field, value."""


@dataclass(frozen=True)
class Corrections:
    """Values that people set: the linter does not hold them against the rules that made the other ones.

    Attributes
    ----------
    relations : frozenset of (str, int, int, str)
        Frame, a, b, relation: set by a person, or ruled out by what a person set.
    expressions : frozenset of (str, str)
        Frame and id of those whose text or answers a person set.
    """

    relations: frozenset[tuple[str, int, int, str]] = frozenset()
    expressions: frozenset[tuple[str, str]] = frozenset()


def read_corrections(root: Path) -> Corrections:
    """The corrections of a labels folder; none where it has no provenance.

    Raises
    ------
    InputError
        The file is damaged.
    """
    path = root / PROVENANCE_FILE
    if not path.exists():
        return Corrections()
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        rows = pq.read_table(path, columns=["table", "frame", "key", "column", "origin", "was"]).to_pylist()
        relations, expressions = set(), set()
        for row in rows:
            # A relation that was ruled out follows from no geometry, and neither does its pair's.
            if row["table"] == "relations" and row["origin"] in ("human", "recomputed"):
                a, b = (int(n) for n in row["key"].split(","))
                if row["origin"] == "human" or row["was"] == "1":
                    relations.add((row["frame"], a, b, row["column"]))
            elif row["table"] == "expressions" and row["origin"] == "human":
                expressions.add((row["frame"], row["key"]))
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("the provenance of the labels is damaged", got=str(error).split("\n")[0], path=path) from error
    return Corrections(frozenset(relations), frozenset(expressions))
