"""Writers and servers that are killed: all that was acknowledged is there, and no action in part or twice."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from benchmarks.journal_kills import GROUP, judge, survive
from postgres_cluster import missing, started_cluster
from slow_cases import mostly_slow

from pipeline.corrections import JOURNAL_FILE, Edit, Saved, object_ref, open_journal

needs_killing = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is of POSIX")


@pytest.fixture(scope="module")
def _postgres() -> None:
    reason = missing()
    if reason is not None:
        if os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1":
            pytest.fail(reason)
        pytest.skip(reason)


@needs_killing
@pytest.mark.parametrize("rounds", mostly_slow([1, 3]))
def test_writers_killed_on_sqlite(tmp_path: Path, rounds: int) -> None:
    found = survive(str(tmp_path / JOURNAL_FILE), tmp_path, rounds=rounds)
    assert found.holds, found
    assert found.kills == 4 * rounds
    assert found.acknowledged >= 4 * rounds
    assert found.refused == 0


@pytest.mark.slow
@needs_killing
@pytest.mark.usefixtures("_postgres")
def test_writers_killed_and_the_server_too(tmp_path: Path) -> None:
    with started_cluster() as cluster:

        def cut_off() -> None:
            cluster.crash()
            cluster.start()

        found = survive(cluster.url, tmp_path, rounds=1, disturb=cut_off)
        assert found.holds, found
        assert found.refused > 0, "the writers saw the server go"
        with open_journal(cluster.url) as journal:
            assert isinstance(journal.append([Edit(object_ref("f", 1, "label"), None, "mug")], "ann"), Saved)


def test_broken_promises_are_seen(tmp_path: Path) -> None:
    with open_journal(tmp_path / JOURNAL_FILE) as journal:
        groups = []
        for number in range(3):
            cells = [object_ref("f", k, "label") for k in range(GROUP)]
            done = journal.append([Edit(c, None, f"0 {number}", number) for c in cells], "writer 0")
            assert isinstance(done, Saved)
            groups.append(done.group)
        events = journal.events()
    told = [[{"group": group} for group in groups]]
    assert judge(events, told).holds
    assert judge(events[:-GROUP], told).lost == 1
    assert judge(events[:-1], told).torn == 1
    assert judge((*events, events[0]), told).doubled == 1
    assert judge(events, [told[0][:1]]).unasked == 1
    assert judge(events, [told[0][:2]]).holds, "one may have been on its way"
