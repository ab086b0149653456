"""Tables whose text is no UTF-8, as a flipped byte leaves it: one line says so, before a row is made."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.datasets import demo_labels
from pipeline.datasets.demo import demo_run
from pipeline.evaluation.records import read_records
from pipeline.labels import open_labels
from pipeline.labels.frame_stream import table_batches
from pipeline.system import InputError


def spoil(path: Path, column: str) -> None:
    """Put a byte that begins nothing into the first text of a column."""
    table = pq.read_table(path)
    texts = table.column(column).combine_chunks().cast(pa.binary()).to_pylist()
    texts[0] = b"caf\xe9 " + texts[0]
    sizes = [0]
    for text in texts:
        sizes.append(sizes[-1] + len(text))
    buffers = [None, pa.py_buffer(pa.array(sizes, pa.int32()).buffers()[1]), pa.py_buffer(b"".join(texts))]
    spoiled = pa.Array.from_buffers(pa.string(), len(texts), buffers)
    pq.write_table(table.set_column(table.column_names.index(column), table.schema.field(column), spoiled), path)


def test_labels_and_runs_with_text_that_is_none_are_refused_in_a_line(tmp_path: Path) -> None:
    shutil.copytree(demo_labels(), tmp_path / "labels")
    spoil(tmp_path / "labels" / "expressions.parquet", "text")
    labels = open_labels(tmp_path / "labels")
    with pytest.raises(InputError, match=r"not a readable Parquet file.*UTF8"):
        _ = labels.expressions
    with pytest.raises(InputError, match=r"not a readable Parquet file.*UTF8"):
        list(table_batches(labels, "expressions"))
    shutil.copytree(demo_run(), tmp_path / "run")
    spoil(tmp_path / "run" / "records.parquet", "text")
    with pytest.raises(InputError, match=r"cannot be read.*UTF8"):
        read_records(tmp_path / "run")
