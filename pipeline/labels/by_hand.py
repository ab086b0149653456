"""Labels that a person begins: a folder of labels without frames, into which each frame comes when it is labelled."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from pipeline.answering.objects import prepare_frame
from pipeline.datasets import Dataset
from pipeline.datasets.base import scene_of
from pipeline.geometry.cleaning import LiftConfig
from pipeline.labels.labelling import label_objects
from pipeline.labels.merge import environment, move_all, write_labels, write_merged
from pipeline.labels.plan import LabelConfig, files_hash
from pipeline.labels.profiles import fingerprint
from pipeline.labels.reading import MANIFEST_FILE, Labels, build_table, open_labels
from pipeline.labels.schema import SCHEMA_VERSION, TABLES, Manifest
from pipeline.labels.selection import SelectConfig
from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.remote import is_elsewhere, local_path, url_of
from pipeline.system.version import __version__
from pipeline.system.whole_files import alone, temporary_folder

BY_HAND = "by-hand"
"""In place of the detector: nothing was found by a machine."""


@dataclass(frozen=True)
class NewLabels(Labels):
    """Labels that are not on the disk yet, as a whole or with these frames: `with_frames` writes them."""

    rows: pa.Table | None = None
    """All of their table `frames`."""

    def table(self, name: str) -> pa.Table:
        """Table by name; all but the frames are empty."""
        return self.rows if name == "frames" and self.rows is not None else build_table(name, {})


def grows(labels: Labels) -> bool:
    """Tell labels begun by hand, open to more frames."""
    return str(labels.manifest.models.get("detector", "")).startswith(f"{BY_HAND}:")


def default_folder(dataset: Dataset, otherwise: Path) -> Path:
    """Default folder of new labels: beside the recording's folder, or in `otherwise`."""
    root = dataset.root.resolve()
    name = f"{root.name}-labels"
    return root.with_name(name) if os.access(root.parent, os.W_OK) else otherwise / name


def begun_labels(
    dataset: Dataset, folder: str | Path, options: dict[str, Any] | None = None, config: LabelConfig | None = None
) -> Labels:
    """Open labels, or begin without frames in a missing or empty folder; nothing is written yet.

    `options`: what was declared of the camera: arguments of `open_dataset`. `config`: of new labels. Default: all
    relations.

    Raises InputError: the folder holds something else.
    """
    require(not is_elsewhere(folder), "labels are begun by hand in a folder of this machine", path=str(folder))
    folder = local_path(folder).absolute()
    if (folder / MANIFEST_FILE).exists():
        return open_labels(folder)
    require(
        not folder.exists() or (folder.is_dir() and not any(folder.iterdir())),
        "the folder holds something else than labels",
        cause="use another folder",
        path=folder,
    )
    config = config or LabelConfig(vocabulary="all")
    given = {k: str(v) for k, v in (options or {}).items() if v is not None}
    manifest = Manifest(
        schema_version=SCHEMA_VERSION,
        tool="spatialviz",
        version=__version__,
        config={**config.record(), "relations": list(config.relations)},
        config_hash=config.hash,
        profile={"name": config.profile, "parameters": config.rules.parameters},
        profile_hash=config.rules.hash,
        selection=asdict(SelectConfig()),
        dataset={
            "path": str(dataset.root.absolute()),
            "options": given,
            "format": dataset.format,
            # Of all files, once labels are written: a recording may have 300,000.
            "input_hash": "",
        },
        models={"detector": f"{BY_HAND}: 1", "second_opinion": fingerprint(config.second_opinion)},
        seed=config.seed,
        counts=_counts(build_table("frames", {}), {}),
        warnings=[],
        tables={},
        environment=environment(),
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )
    return NewLabels(folder, manifest)


def seen_with(labels: Labels, dataset: Dataset, name: str) -> Labels:
    """Labels with a further frame, to look at; nothing is written."""
    require(grows(labels), "only labels that were begun by hand take in frames", path=labels.root)
    require(name in dataset.frame_ids, "the dataset has no such frame", got=name, path=dataset.root)
    rows = {
        table.column("frame")[k].as_py(): table.slice(k, 1)
        for table in (labels.frames, _on_disk(labels).frames)
        for k in range(table.num_rows)
    }
    rows.setdefault(name, _frame_row(dataset, name, labels))
    return NewLabels(labels.root, labels.manifest, pa.concat_tables(rows.values()).sort_by("frame_index"))


def with_frames(labels: Labels, dataset: Dataset, names: Iterable[str] = ()) -> Labels:
    """Add frames of the dataset, without objects, and write the labels.

    Frames that are there, by whomever, stay as they are; several processes may add some at the same time.

    Raises InputError: the labels do not grow, the dataset has no such frame or cannot load it, or the folder cannot be
    written.
    """
    require(grows(labels), "only labels that were begun by hand take in frames", path=labels.root)
    require(url_of(labels.root) is None, "labels at a URL take in no frames", path=url_of(labels.root))
    ids = dataset.frame_ids
    absent = next((n for n in names if n not in ids), None)
    require(absent is None, "the dataset has no such frame", got=absent, path=dataset.root)
    known = _on_disk(labels)
    rows = [_frame_row(dataset, name, labels) for name in names if name not in _names(known)]
    with (
        as_input_error("the labels cannot be written", OSError, got=lambda e: e.strerror, path=labels.root),
        alone(labels.root),
    ):
        known = _on_disk(labels)
        there = _names(known)
        new = [row for row in rows if row.column("frame")[0].as_py() not in there]
        if new or isinstance(known, NewLabels):
            _write(known, pa.concat_tables([known.frames, *new]).sort_by("frame_index"))
    return open_labels(labels.root)


def _on_disk(labels: Labels) -> Labels:
    return (
        open_labels(labels.root) if (labels.root / MANIFEST_FILE).exists() else NewLabels(labels.root, labels.manifest)
    )


def _names(labels: Labels) -> set[str]:
    return set(labels.frames.column("frame").to_pylist())


def _frame_row(dataset: Dataset, name: str, labels: Labels) -> pa.Table:
    kept = labels.manifest.config
    config = LabelConfig(vocabulary=kept["vocabulary"], lift=LiftConfig(**kept["lift"]))
    context = prepare_frame(dataset, dataset.load(name), config.lift)
    index, scene = dataset.frame_ids.index(name), scene_of(dataset, name)
    rows = label_objects(context, (), config, frame_index=index, scene=scene, exact=False)
    return build_table("frames", rows.frames)


def _counts(frames: pa.Table, rows: dict[str, int]) -> dict[str, int]:
    return {
        "frames": frames.num_rows,
        "frames_usable": frames.num_rows,
        "frames_up_assumed": frames.column("up_source").to_pylist().count("assumed"),
        "objects": 0,
        "pairs": 0,
        "candidates": 0,
        "expressions": 0,
        **rows,
    }


def _write(labels: Labels, frames: pa.Table) -> None:
    with temporary_folder(labels.root / "tables") as staging:
        tables = {name: frames if name == "frames" else labels.table(name) for name in TABLES}
        files = {name: write_merged(staging, name, iter([table])) for name, table in tables.items()}
        rows = {("pairs" if name == "relations" else name): f.rows for name, f in files.items()}
        dataset = labels.manifest.dataset
        dataset = {**dataset, "input_hash": dataset["input_hash"] or files_hash(Path(dataset["path"]))}
        told = {"tables": files, "counts": _counts(frames, rows), "dataset": dataset}
        manifest = labels.manifest.model_copy(update=told)
        write_labels(staging, manifest)
        move_all(staging, labels.root)
