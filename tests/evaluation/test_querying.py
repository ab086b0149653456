"""What is asked in SQL keeps to its memory and time, whatever it asks, and leaves nothing behind."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.datasets.demo import demo_run
from pipeline.evaluation import open_database
from pipeline.system import LIMITS_VARIABLE, InputError
from pipeline.system.sql import QueryDatabase
from tests.slow_cases import mostly_slow

HUNGRY = (
    "SELECT list(x) FROM range(900000000) t(x)",
    "SELECT repeat('x', 3000000000)",
    "SELECT len(generate_series(1, 900000000))",
    "SELECT string_agg(x::VARCHAR, ',') FROM range(2000000000) t(x)",
    "SELECT lpad('x', 2000000000, 'y')",
    "SELECT repeat('x', 20000000) FROM range(100)",
)
ENDLESS = (
    "SELECT count(*) FROM range(10000000) a, range(10000000) b WHERE a.range * b.range % 7 = 1",
    "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r",
    "SELECT count(*) FROM range(3000000000) t(x) WHERE regexp_matches(x::VARCHAR, '(9|8|98)*7$')",
)


@pytest.fixture
def database(monkeypatch: pytest.MonkeyPatch) -> Iterator[QueryDatabase]:
    monkeypatch.setenv(LIMITS_VARIABLE, "query=100M,query_seconds=4")
    with open_database(demo_run()) as opened:
        yield opened


def most_held(database: QueryDatabase) -> float:
    """The most memory that the process of a database ever held, in bytes."""
    assert database._process is not None
    lines = Path(f"/proc/{database._process.pid}/status").read_text().splitlines()
    return next(float(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


@pytest.mark.parametrize("sql", mostly_slow(HUNGRY, (0, 1)))
def test_a_hungry_query_ends_in_one_line(sql: str, database: QueryDatabase) -> None:
    with pytest.raises(InputError, match=r"(too much memory|takes too long|too large).*expected"):
        list(database.select(sql).rows)
    if database._process is not None:
        assert most_held(database) < 500e6
    assert list(database.select("SELECT 1").rows) == [(1,)], "the next query is answered"


@pytest.mark.parametrize("sql", mostly_slow(ENDLESS))
def test_an_endless_query_is_killed(sql: str, database: QueryDatabase) -> None:
    begun = time.monotonic()
    with pytest.raises(InputError, match=r"takes too long; got more than 1 s; expected a narrower one$"):
        list(database.select(sql, seconds=1).rows)
    assert time.monotonic() - begun < 3
    assert list(database.select("SELECT count(*) FROM records").rows) == [(1800,)]


def test_rows_come_in_order_and_of_the_last_query_alone(database: QueryDatabase) -> None:
    found = database.select("SELECT x, ? FROM range(2500) t(x) ORDER BY x", ["a"])
    assert found.columns[0] == "x"
    assert list(found.rows) == [(k, "a") for k in range(2500)]
    early = database.select("SELECT x FROM range(2500) t(x)").rows
    next(early)
    assert list(database.select("SELECT 7").rows) == [(7,)]
    with pytest.raises(InputError, match="another query was asked"):
        list(early)


def test_no_process_and_no_folder_stays(database: QueryDatabase) -> None:
    list(database.select("SELECT 1").rows)
    process = database._process
    assert process is not None
    assert database.spill.is_dir()
    database.close()
    assert process.poll() is not None
