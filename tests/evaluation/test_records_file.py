"""Records on their file: searches, facets, slices and rows are those of the same records in memory."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from evaluation.run_records import random_records

from pipeline.datasets.demo import demo_run
from pipeline.evaluation import find_failures, find_rows, slices
from pipeline.evaluation.browsing import RunRows, completions, facets_of
from pipeline.evaluation.comparing import compare
from pipeline.evaluation.job import in_groups
from pipeline.evaluation.records import read_records
from pipeline.evaluation.records_file import RecordsFile, open_records
from pipeline.evaluation.slices import DIMENSIONS, figure_rows, slice_by
from pipeline.metrics.intervals import BootstrapConfig
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import InputError

TABLE = random_records(3, 90)
QUICK = BootstrapConfig(resamples=20)
NAMES = ("verdict", "relation", "class", "lucky", "margin", "repair", "text", "frame", "p_relation", "detail")


def written(folder: Path, records: pa.Table, rows_a_group: int = 7) -> RecordsFile:
    pq.write_table(records, folder / "records.parquet", row_group_size=rows_a_group)
    found = open_records(folder)
    assert isinstance(found, RecordsFile)
    return found


def rows_of(records: pa.Table) -> list[str]:
    """Rows as texts, in which NaN is NaN."""
    return [repr(row) for row in records.to_pylist()]


def searches(records: pa.Table, seed: int) -> list[str]:
    """Searches made of values that occur, one or two terms each, with orders."""
    rng, found = np.random.default_rng(seed), ["", "-right", "lucky sort:-margin", '"the" -lucky', "margin:none"]
    fields = {f.name: f for f in completions(records)}
    for _ in range(40):
        terms = []
        for name in rng.choice(NAMES, 2, replace=False):
            field = fields[str(name)]
            if field.kind == "number":
                terms.append(f"{name}{rng.choice(['<', '>=', '!='])}{rng.normal():.2f}")
            elif field.values:
                terms.append(f"{rng.choice(['', '-'])}{name}:{rng.choice(field.values)}")
        order = rng.choice(["", "sort:margin", "sort:-p_relation,text"])
        found.append(" ".join([*terms, str(order)]).strip())
    return found


@pytest.mark.parametrize("name", ["run", "a [b] *?"])
def test_a_search_on_the_file_finds_what_one_in_memory_finds(tmp_path: Path, name: str) -> None:
    folder = tmp_path / name
    folder.mkdir()
    shutil.copy(demo_run() / "records.parquet", folder / "records.parquet")
    records, file = read_records(folder), open_records(folder)
    assert isinstance(file, RecordsFile)
    for query in searches(records, 0):
        assert find_rows(file, query).tolist() == find_rows(records, query).tolist(), query
    assert rows_of(find_failures(file)) == rows_of(find_failures(records))
    assert facets_of(file, "class:chair -lucky") == facets_of(records, "class:chair -lucky")
    for dimension in DIMENSIONS:
        assert slice_by({"x": file}, dimension, QUICK) == slice_by({"x": records}, dimension, QUICK)
    assert completions(file) == completions(records)


def test_rows_are_taken_in_any_order_and_twice(tmp_path: Path) -> None:
    file = written(tmp_path, TABLE)
    rows = np.array([40, 3, 3, 89, 0])
    assert rows_of(file.take(rows)) == rows_of(TABLE.take(pa.array(rows)))
    assert file.take(np.zeros(0, np.int64)).equals(TABLE.slice(0, 0))
    assert rows_of(figure_rows(file, rows)) == rows_of(figure_rows(TABLE, rows))


def test_marks_and_added_columns_are_found_beside_those_of_the_file(tmp_path: Path) -> None:
    lists = [RunRows(records, tmp_path) for records in (written(tmp_path, TABLE), TABLE)]
    lists[0].mark([3, 1, 41], "done")
    for rows in lists:
        rows.mark([5], "odd")
        rows.add_column("third", [k % 3 for k in range(90)])
    own, other = lists
    for query in ("marks:done third:0", "-marks:none sort:-third", "marks:odd", "third:2 verdict:none"):
        in_memory = own.records.select(own.records.column_names)
        assert own.find(query).tolist() == find_rows(in_memory, query).tolist()
    assert own.find("marks:done").tolist() == [1, 3, 41]
    assert own.find("third:2").tolist() == other.find("third:2").tolist() == list(range(2, 90, 3))
    assert [row["marks"] for row in own.read(np.array([5, 0, 3]))] == [["odd"], [], ["done"]]
    frame, expression = own.keys(np.array([7]))[0]
    assert own.number(frame, expression) == other.number(frame, expression) == 7


@pytest.mark.parametrize("most_cells", [10, 10**6])
def test_slices_hold_where_few_scenes_and_frames_meet(
    tmp_path: Path, most_cells: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slices, "MOST_CELLS", most_cells)
    rooms = pa.array([f"room {k % 17}" for k in range(90)])
    frames = pa.array([f"{k % 17}/{k % 34}" for k in range(90)])
    records = TABLE.set_column(TABLE.schema.get_field_index("scene"), "scene", rooms)
    records = records.set_column(TABLE.schema.get_field_index("frame"), "frame", frames)
    found = slice_by({"x": written(tmp_path, records)}, "frame", QUICK, most=5)
    assert sum(s.n for s in found.slices) == 90
    for part in found.slices[:5]:
        (alone,) = slice_by({"x": records.take(find_rows(records, str(part.query)))}, "frame", QUICK).slices
        assert (part.n, part.correct.value) == (alone.n, alone.correct.value)
        assert +Counter(part.counts) == +Counter(alone.counts)
    everyone = slice_by({"x": records}, "frame", QUICK)
    assert found.slices[-1].name == "29 others"
    assert found.slices[-1].n == sum(s.n for s in everyone.slices) - sum(s.n for s in found.slices[:5])


def test_texts_are_read_as_dictionaries_with_the_same_values(tmp_path: Path) -> None:
    file = written(tmp_path, TABLE)
    assert rows_of(file.select(file.column_names, coded=True)) == rows_of(TABLE)
    for rows in ([40, 3, 3, 89, 0], list(range(80, 20, -1)), []):
        assert rows_of(file.take(np.array(rows, np.int64), coded=True)) == rows_of(TABLE.take(pa.array(rows, "int64")))


def test_two_runs_on_their_files_are_compared_as_in_memory(tmp_path: Path) -> None:
    other = TABLE.take(pa.array([*range(70, 10, -1), 80, 80]))
    wrong = pa.array([k % 3 == 0 for k in range(other.num_rows)])
    other = other.set_column(other.schema.get_field_index("set_correct"), "set_correct", wrong)
    folders = tmp_path / "one", tmp_path / "other"
    for folder in folders:
        folder.mkdir()
    files = written(folders[0], TABLE), written(folders[1], other)
    in_memory = compare(TABLE, other)
    assert compare(*files) == in_memory == compare(TABLE, files[1])
    assert (in_memory.shared, in_memory.only_before, in_memory.only_after) == (62, 28, 0)
    assert in_memory.fixed
    lists = [RunRows(one, tmp_path, second) for one, second in (files, (TABLE, other))]
    for query in ("change:fixed", "second_verdict:none", "-change:same sort:-second_margin", "change:none"):
        found = lists[0].find(query)
        assert found.tolist() == lists[1].find(query).tolist(), query
        assert repr(lists[0].read(found)) == repr(lists[1].read(found))
        assert lists[0].facets(query) == lists[1].facets(query)
    assert lists[0].find("change:fixed").size


def test_of_a_few_rows_only_their_groups_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, read = written(tmp_path, TABLE, rows_a_group=10), list[int]()
    whole = pq.ParquetFile.read_row_group
    monkeypatch.setattr(
        pq.ParquetFile,
        "read_row_group",
        lambda self, group, **more: read.append(self.metadata.row_group(group).num_rows) or whole(self, group, **more),
    )
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_, **__: pytest.fail("the whole file was read"))
    assert len(find_rows(file, "-right sort:margin")) > 0
    assert read == []
    file.take(np.array([12, 13, 55, 19]))
    assert read == [10, 10]


def test_a_run_that_was_written_anew_is_not_mixed_with_the_old_one(tmp_path: Path) -> None:
    file = written(tmp_path, TABLE)
    written(tmp_path, TABLE.slice(0, 50))
    with pytest.raises(InputError, match="written anew"):
        file.take(np.array([1]))


def test_columns_of_another_type_are_read_as_they_were_meant(tmp_path: Path) -> None:
    at = TABLE.schema.get_field_index("margin")
    wide = TABLE.set_column(at, "margin", TABLE.column("margin").cast("float64"))
    pq.write_table(wide, tmp_path / "records.parquet")
    assert isinstance(open_records(tmp_path), pa.Table)


@pytest.mark.parametrize("rows", [1, 25, 1000])
def test_groups_hold_the_same_rows_in_their_order(rows: int) -> None:
    parts = [TABLE.slice(k, 9) for k in range(0, 90, 9)]
    groups = list(in_groups(parts, rows))
    assert rows_of(pa.concat_tables(groups)) == rows_of(TABLE)
    assert all(group.num_rows >= rows for group in groups[:-1])
    assert list(in_groups([], rows)) == []
