"""Labels folders with errors that are known."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from pipeline.labels import Labels, open_labels, write_table


def copied(labels: Labels, folder: Path) -> Path:
    """The folder's tables and manifest, elsewhere."""
    folder.mkdir(parents=True)
    for path in labels.root.iterdir():
        if path.is_file():
            shutil.copy(path, folder / path.name)
    return folder


def with_relations(labels: Labels, folder: Path, columns: Mapping[str, np.ndarray]) -> Labels:
    """The labels with other states of some relations, row by row."""
    copied(labels, folder)
    table = labels.relations
    for name, values in columns.items():
        at = table.schema.get_field_index(name)
        table = table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type))
    write_table(table, folder / "relations.parquet")
    return open_labels(folder)


def flipped(labels: Labels, folder: Path, share: float, seed: int) -> Labels:
    """The labels with this share of their directional cells that are T or F turned into the opposite."""
    rng = np.random.default_rng(seed)
    columns = {}
    for name in ("left", "right", "above", "below", "front", "behind"):
        states = labels.relations.column(name).to_numpy()
        columns[name] = np.where(rng.random(len(states)) < share, -states, states).astype(np.int8)
    return with_relations(labels, folder, columns)
