"""Labels whose manifest or columns are damaged are told of in one line, wherever they are read."""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.datasets.demo import demo_run
from pipeline.labels import export_labels, open_labels
from pipeline.labels.schema import TABLES
from pipeline.system import InputError
from tests.slow_cases import mostly_slow

COLUMNS = [(table, name) for table, row in TABLES.items() for name in row.model_fields]


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    return Path(shutil.copytree(demo_run().parent / "labels", tmp_path / "labels"))


@pytest.mark.parametrize("value", [None, "left", {}, 7])
def test_a_manifest_without_relations(value: object, labels: Path) -> None:
    file = labels / "manifest.json"
    content = json.loads(file.read_text())
    del content["config"]["relations"]
    file.write_text(json.dumps(content if value is None else content | {"config": {"relations": value}}))
    with pytest.raises(InputError, match=r"config\.relations; got .*; expected a list"):
        open_labels(labels)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(COLUMNS), st.sampled_from([None, "x", [[1, 2]], -5.5, b"\xff"]))
@pytest.mark.parametrize("form", mostly_slow(["kitti", "vqa", "coco"]))
def test_an_export_of_damaged_columns(form: str, labels: Path, column: tuple[str, str], value: object) -> None:
    name, field = column
    file = labels / f"{name}.parquet"
    sound = file.read_bytes()
    table = pq.read_table(file)
    # Columns that came later may be missing as it is.
    damaged = table.drop_columns([field]) if field in table.column_names else table
    if value is not None:
        damaged = damaged.append_column(field, pa.array([value] * table.num_rows))
    pq.write_table(damaged, file)
    try:
        with suppress(InputError):
            export_labels(open_labels(labels), form, labels.parent / "out", overwrite=True)
    finally:
        file.write_bytes(sound)
