"""Parquet tables with picture columns, as of the Hugging Face libraries `datasets` and `lerobot`: a row per frame.

https://huggingface.co/docs/datasets/image_dataset, https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.base import DatasetFormat
from pipeline.datasets.cameras import Stated, flat_numbers, or_note, stated_in
from pipeline.datasets.files import Part, read_json, readable
from pipeline.datasets.pairing import role_of
from pipeline.datasets.recording import Listed, Recording
from pipeline.datasets.settings import Settings
from pipeline.system.errors import as_input_error, needed, require
from pipeline.system.safe_files import open_parquet

SUFFIX = ".parquet"
ROWS_KEPT = 8
"""So many decoded rows stay in memory."""
LEROBOT = "meta/info.json"
LEROBOT_UNITS = {"m": 1.0, "mm": 1000.0}
NAME_COLUMNS = ("id", "frame_id", "image_id", "frame", "name")


def cell(table: Path, row: int, column: str) -> Part:
    """Picture in a cell of a table: encoded bytes, bare or in a struct, or nested lists of numbers."""
    return Part(table, f"/{column}[{row}]", partial(_read_cell, table, row, column))


def _read_cell(table: Path, row: int, column: str) -> bytes | np.ndarray:
    value = _row(table, row)[column]
    value = value.get("bytes") if isinstance(value, Mapping) else value
    with as_input_error("a cell without a picture", ValueError, TypeError, path=f"{table}/{column}[{row}]"):
        return value if isinstance(value, bytes) else np.array(needed(value, "an empty cell"), np.float32)


def _file(table: Path) -> Any:
    return _opened(table, table.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _opened(table: Path, written: int) -> Any:
    with as_input_error("a table that cannot be read", Exception, got=str, path=table):
        return open_parquet(table, memory_map=True)


def _row(table: Path, row: int) -> dict[str, Any]:
    return _decoded_row(table, table.stat().st_mtime_ns, row)


@lru_cache(maxsize=ROWS_KEPT)
def _decoded_row(table: Path, written: int, row: int) -> dict[str, Any]:
    """Row of a table, keeping only the batch around the row."""
    file, first = _file(table), 0
    with as_input_error("a row that cannot be read", Exception, got=str, path=table):
        for group in range(file.num_row_groups):
            count = file.metadata.row_group(group).num_rows
            if row < first + count:
                for batch in file.iter_batches(1, row_groups=[group]):
                    if first == row:
                        return batch.to_pylist()[0]
                    first += 1
            first += count
    raise IndexError(row)


class ParquetDataset(Recording):
    """Rows of one table or of all tables in a folder; columns are told by the words of their names.

    A colour and a depth column are needed; numbers in other columns (`fx`, `intrinsics`, `depth_scale`, ...) are the
    row's camera. The id is that of a column `id` or `frame_id`, else the row's number.
    """

    format = "parquet"

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        tables = tables_in(root)
        columns = _file(tables[0]).schema_arrow
        features = lerobot_features(root)
        self._columns = _picture_columns(columns, features)
        missing = [what for role, what in (("color", "colour"), ("depth", "depth")) if self._columns[role] is None]
        require(
            not missing,
            f"a table without a {' and a '.join(missing)} column",
            got=", ".join(columns.names),
            path=tables[0],
        )
        self._numbers = [n for n in columns.names if n not in self._columns.values()]
        self._rows: dict[str, tuple[Path, int]] = {}
        for table in tables:
            for row, name in enumerate(_ids(table, columns.names)):
                # Of several tables the name goes first, with its chunk if it is in one.
                above = "" if table.parent in (root, root / "data") else f"{table.parent.name}/"
                self._rows[name if len(tables) == 1 else f"{above}{table.stem}/{name}"] = table, row
        self.frame_ids = tuple(self._rows)
        require(self.frame_ids, "a table without a row", path=root)
        unit = str(_info(features, str(self._columns["depth"])).get("depth_unit"))
        self._units = LEROBOT_UNITS.get(unit)
        arrays = _is_array(columns.field(str(self._columns["depth"])))
        seen = f"{len(self._rows)} rows with {self._columns['color']} and {self._columns['depth']}"
        self._ask_for(seen, self._stated(next(iter(self._rows.values()))), arrays)

    def _listed(self, frame_id: str, notes: list[str]) -> Listed:
        table, row = self._found(self._rows, frame_id)
        color, depth = (cell(table, row, str(name)) for name in self._columns.values())
        stated = self._stated((table, row))
        return Listed(color, depth, stated)

    def _stated(self, at: tuple[Path, int]) -> Stated:
        row = _row(*at)
        stated = stated_in(dict(flat_numbers({name: row[name] for name in self._numbers})), at[0])
        return replace(stated, units_per_metre=stated.units_per_metre or self._units)


def lerobot_features(root: Path) -> dict[str, Any]:
    """Features of a LeRobot dataset by name, from `meta/info.json`; empty otherwise."""
    if root.is_file() or not (root / LEROBOT).is_file():
        return {}
    features = (or_note([], "", read_json, root / LEROBOT) or {}).get("features")
    return {str(k): v for k, v in features.items() if isinstance(v, dict)} if isinstance(features, dict) else {}


def _info(features: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    info = features.get(name, {}).get("info")
    return info if isinstance(info, dict) else {}


def is_lerobot_depth(features: Mapping[str, Any], name: str) -> bool:
    """Test whether a feature holds depth, by mark or name."""
    info = _info(features, name)
    return bool(info.get("is_depth_map") or info.get("video.is_depth_map")) or role_of(name)[0] == "depth"


def _picture_columns(columns: Any, features: Mapping[str, Any]) -> dict[str, str | None]:
    """The columns of colour and depth: of several the first depth, and the colour of the same camera."""
    # Pictures are encoded bytes, bare or in a struct, or nested lists of numbers.
    coded = ("struct<bytes: ", "binary", "large_binary")
    names = [field.name for field in columns if str(field.type).startswith(coded) or _is_array(field)]
    depth = next((name for name in names if is_lerobot_depth(features, name)), None)
    colors = [name for name in names if role_of(name)[0] == "color" and name != depth]
    same = [name for name in colors if depth is not None and role_of(name)[1] == role_of(depth)[1]]
    return {"color": next(iter((*same, *colors)), None), "depth": depth}


def _is_array(column: Any) -> bool:
    return str(column.type).count("list<") > 1


def _ids(table: Path, columns: list[str]) -> list[str]:
    """The ids of a table's rows, each once."""
    column = next((name for name in NAME_COLUMNS if name in columns), None)
    if column is not None:
        names = [str(v) for v in _file(table).read([column]).column(0).to_pylist()]
        if len(set(names)) == len(names):
            return names
    return [str(row) for row in range(_file(table).metadata.num_rows)]


def tables_in(root: Path) -> list[Path]:
    """Tables of a folder, of `data/`, or of LeRobot's `data/chunk-NNN/`; or the single table."""
    if root.suffix.lower() == SUFFIX:
        return [root]
    folder = root / "data" if (root / "data").is_dir() and not any(_named(root)) else root
    chunks = [folder / name for name in readable(folder)[0] if name.startswith("chunk-")]
    return [part / name for part in (folder, *chunks) for name in _named(part)]


def _named(folder: Path) -> list[str]:
    return [name for name in readable(folder)[1] if name.lower().endswith(SUFFIX)]


def _recognises(root: Path) -> bool:
    tables = tables_in(root)
    if not tables:
        return False
    try:
        columns = _picture_columns(_file(tables[0]).schema_arrow, lerobot_features(root))
    except ValueError:
        # What is wrong with the file is told when it is opened by name.
        return root.is_file()
    return None not in columns.values() or root.is_file()


FORMAT = DatasetFormat(
    "parquet", "parquet: tables with picture columns of colour and depth", _recognises, ParquetDataset
)
