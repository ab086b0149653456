"""Opening merged labels, each table checked when it is read, and the dataset that they were made from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline.datasets import Dataset, open_dataset
from pipeline.datasets.demo import DEMO_NAME, demo_path
from pipeline.labels.schema import SCHEMA_VERSION, TABLES, Manifest
from pipeline.labels.tables import read_table
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import InputError, Shown, as_input_error, first_line, present, require

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
        require(
            version.split(".")[0] == SCHEMA_VERSION.split(".")[0],
            "labels of another schema",
            got=version,
            expected=SCHEMA_VERSION,
            path=file,
        )
        manifest = Manifest.model_validate(content)
    except (ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise InputError("the manifest is damaged", got=reason, path=file) from error
    for relation in manifest.config.get("relations", ()):
        require(
            relation in PAIRWISE, "these labels hold a relation that is not declared here", got=repr(relation),
            expected=", ".join(PAIRWISE), cause="made with a relation of somebody's own?", path=file,
        )  # fmt: skip
    for path in (root / f"{name}.parquet" for name in TABLES):
        require(path.is_file(), f"the table {path.stem} is missing", path=path)
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
    with as_input_error(
        "the provenance of the labels is damaged",
        pa.ArrowException,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        got=first_line,
        path=path,
    ):
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
    return Corrections(frozenset(relations), frozenset(expressions))


Intrinsics = tuple[float, float, float, float]


def labelled_dataset(
    manifest: Manifest,
    path: str | None = None,
    *,
    intrinsics: Intrinsics | None = None,
    depth_scale: float | None = None,
    up: str | None = None,
    level_at: str | None = None,
) -> Dataset:
    """Open it where it was when it was labelled, or where it is now; its camera is the one that was declared then.

    Parameters
    ----------
    manifest : Manifest
        Of the labels.
    path : str, optional
        Where it is now.
    intrinsics : tuple of float, optional
        fx, fy, cx, cy in pixels, instead of what was declared then.
    depth_scale : float, optional
        Depth units in one metre, instead of what was declared then.
    up, level_at : str, optional
        As for `open_dataset`, instead of what was declared then.

    Raises
    ------
    InputError
        The labels do not name it, or it cannot be opened.
    """
    record = manifest.dataset
    where = path or present(record.get("path") or None, "the labels do not say which dataset they are of")
    if where == DEMO_NAME and not Path(where).exists():
        where = demo_path()
    options = dict(record.get("options") or {})
    if intrinsics is None and options.get("intrinsics"):
        fx, fy, cx, cy = _numbers(options["intrinsics"], 4, "camera")
        intrinsics = fx, fy, cx, cy
    if depth_scale is None and options.get("depth_scale") is not None:
        (depth_scale,) = _numbers(options["depth_scale"], 1, "depth scale")
    known = labelled_up(manifest, {"up": up, "level_at": level_at})
    return open_dataset(where, intrinsics=intrinsics, depth_scale=depth_scale, **known)


def labelled_up(manifest: Manifest, options: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `open_dataset`, with the up vector of when the labels were made where none is given."""
    declared = manifest.dataset.get("options") or {}
    known = {n: str(declared[n]) for n in ("up", "level_at") if declared.get(n) is not None}
    return dict(options) if any(options.get(n) is not None for n in ("up", "level_at")) else {**options, **known}


def _numbers(value: Any, count: int, what: str) -> list[float]:
    """So many numbers, of a list or of its text."""
    with as_input_error(f"the labels name a {what} that is none", ValueError, got=Shown(value)):
        numbers = [float(n) for n in str(value).strip("()[] ").split(",")]
        if len(numbers) != count:
            raise ValueError(f"{len(numbers)} numbers")
    return numbers
