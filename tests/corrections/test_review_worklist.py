"""A stored queue and what is shown next from it."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.corrections import (
    STATES,
    ItemKey,
    Worklist,
    automatic_version,
    item_keys,
    read_queue,
    review_queue,
    worklist,
    write_queue,
)
from pipeline.corrections.review.items import KINDS, SETTLED
from pipeline.labels import Labels
from pipeline.system import InputError


def queue_of(count: int) -> pa.Table:
    kinds = ["relation", "object", "expression"]
    rows = [
        {
            "frame": f"f{k // 7}",
            "kind": kinds[k % 3],
            "a": k,
            "b": k + 1 if k % 3 == 0 else None,
            "relation": "left" if k % 3 == 0 else None,
            "expression": f"{k:x}" if k % 3 == 2 else None,
        }
        for k in range(count)
    ]
    names = {
        "frame": pa.string(),
        "kind": pa.string(),
        "a": pa.int32(),
        "b": pa.int32(),
        "relation": pa.string(),
        "expression": pa.string(),
    }
    return pa.Table.from_pylist(rows, pa.schema(list(names.items())))


@given(st.integers(0, 12), st.lists(st.tuples(st.integers(0, 11), st.sampled_from(STATES)), max_size=30))
def test_a_list_is_its_queue_with_its_states(count: int, steps: list[tuple[int, str]]) -> None:
    queue = queue_of(count)
    keys = item_keys(queue)
    found, states = worklist(queue), {}
    for place, state in steps:
        if place >= count:
            continue
        was = found.codes.copy()
        after = found.with_states({keys[place]: state})  # pyright: ignore[reportArgumentType]
        assert (found.codes == was).all()
        found = after
        states[keys[place]] = state
    again = worklist(queue, states)
    assert (again.codes == found.codes).all()
    of_states = [states.get(k, "unreviewed") for k in keys]
    assert found.counts == {
        "items": count,
        **{state: of_states.count(state) for state in STATES},
        "settled": sum(s in SETTLED for s in of_states),
    }
    for frame, (settled, open_) in found.frame_counts.items():
        of_frame = [states.get(k, "unreviewed") for k in keys if k.frame == frame]
        assert (settled, open_) == (sum(s in SETTLED for s in of_frame), sum(s not in SETTLED for s in of_frame))
    assert sum(map(sum, found.frame_counts.values())) == count
    left = [found.keys[k] for k in found.left()]
    unreviewed = [k for k in keys if states.get(k, "unreviewed") == "unreviewed"]
    assert left == [*unreviewed, *(k for k in keys if states.get(k) == "unsure")], "in order, the unsure ones last"
    assert found.next_item() == (left[0] if left else None)
    for kind in KINDS:
        of_kind = [k for k in left if k.kind == kind]
        assert found.next_item(kind=kind) == (of_kind[0] if of_kind else None)
        assert [found.keys[k] for k in found.left(kind)] == of_kind
    stored = queue.append_column("state", pa.array(of_states, pa.string()))
    assert (worklist(stored).codes == found.codes).all()
    assert [row["state"] for row in found.rows(range(count))] == of_states
    assert (worklist(queue).with_states(states).codes == found.codes).all()
    seen, at, now = [], None, found
    while (key := now.next_item(at)) is not None:
        seen.append(key)
        now, at = now.with_states({key: "accepted"}), key
    assert sorted(seen) == sorted(left), "each is shown once"
    assert seen[: len(unreviewed)] == unreviewed, "in the order of the queue, and those that somebody is unsure of last"


def test_what_comes_next_and_what_was_before() -> None:
    queue = queue_of(6)
    keys = item_keys(queue)
    found = worklist(queue, {keys[1]: "accepted", keys[2]: "unsure"})
    assert found.next_item() == keys[0]
    assert found.next_item(keys[0]) == keys[3]
    assert found.next_item(keys[5]) == keys[0], "from the top again"
    alone = found.with_states(dict.fromkeys(keys[3:], "accepted"))
    assert alone.next_item(keys[0]) == keys[0], "it is the only one that nobody has seen"
    alone = alone.with_states({keys[0]: "accepted"})
    assert alone.next_item(keys[0]) == keys[2], "what somebody is unsure of comes last"
    assert alone.with_states({keys[2]: "accepted"}).next_item() is None
    assert found.previous(keys[3]) == keys[2]
    assert found.previous(keys[0]) is None
    assert found.previous() == keys[5]
    assert found.previous(keys[5], "relation") == keys[3]
    elsewhere = ItemKey("f9", "object", 1, None, "")
    assert found.next_item(elsewhere) == keys[0]
    assert found.with_states({elsewhere: "accepted"}) is found
    spoken = keys[2]._replace(a=2, b=9)
    assert found.state(spoken) == "unsure", "an expression is named by its id"
    with pytest.raises(InputError, match="no such item"):
        found.state(elsewhere)
    with pytest.raises(InputError, match="no such state"):
        found.with_states({keys[0]: "done"})  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="twice"):
        worklist(pa.concat_tables([queue, queue]))
    assert isinstance(worklist(queue_of(0)), Worklist)
    assert worklist(queue_of(0)).next_item() is None


def test_what_has_gone_is_not_open_until_it_is_back() -> None:
    queue = queue_of(9)
    keys = item_keys(queue)
    found = worklist(queue, {keys[1]: "accepted", keys[2]: "unsure"})
    away = found.with_gone("f0", {keys[0], keys[1], keys[2], keys[4], keys[8]})
    assert away.next_item() == keys[3]
    assert away.with_states(dict.fromkeys([keys[3], *keys[5:]], "accepted")).next_item() is None
    assert away.previous(keys[3]) is None
    assert away.previous(keys[5]) == keys[3]
    assert away.gone.tolist() == [True, True, True, False, True, False, False, False, False], "of f0 alone"
    assert away.counts == {
        "items": 5,
        "unreviewed": 5,
        "accepted": 0,
        "corrected": 0,
        "rejected": 0,
        "unsure": 0,
        "settled": 0,
    }
    # What is said of it meanwhile is known when it is back.
    back = away.with_states({keys[4]: "rejected"}).with_gone("f0", ())
    assert back.counts == found.with_states({keys[4]: "rejected"}).counts
    assert back.with_states({keys[4]: "unreviewed"}).next_item(keys[3]) == keys[4]
    assert found.with_gone("f9", {keys[0]}) is found
    assert found.with_gone("f0", ()) is found


@pytest.fixture(scope="module")
def stored(label_sets: dict[str, Labels], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pa.Table]:
    path = tmp_path_factory.mktemp("queue") / "deep" / "queue.parquet"
    queue = review_queue(label_sets["demo"])
    write_queue(queue, path)
    return path, queue


def test_a_stored_queue_reads_back(stored: tuple[Path, pa.Table], label_sets: dict[str, Labels]) -> None:
    path, queue = stored
    version = automatic_version(label_sets["demo"].manifest)
    found = read_queue(path, version)
    assert found.equals(queue)
    assert read_queue(path).equals(queue)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    first = worklist(found).next_item()
    assert first is not None
    assert first == item_keys(queue)[0]
    assert worklist(found).row(first)["score"] == queue.column("score")[0].as_py()
    with pytest.raises(InputError, match="of other labels") as error:
        read_queue(path, automatic_version(label_sets["hostile"].manifest))
    assert "\n" not in str(error.value)
    write_queue(queue.slice(0, 0), path.with_name("none.parquet"))
    assert len(worklist(read_queue(path.with_name("none.parquet"), version))) == 0


def damaged(queue: pa.Table, how: str) -> pa.Table:
    at = queue.schema.get_field_index
    if how == "metadata":
        return queue.replace_schema_metadata({})
    if how == "column":
        return queue.drop_columns(["label"])
    if how == "kind":
        return queue.set_column(at("kind"), "kind", pa.array(["pair"] * queue.num_rows))
    if how == "type":
        return queue.set_column(at("a"), "a", queue.column("a").cast(pa.string()))
    if how == "null":
        return queue.set_column(at("frame"), "frame", pa.nulls(queue.num_rows, pa.string()))
    if how == "reasons":
        return queue.set_column(at("reasons"), "reasons", pa.array([1] * queue.num_rows))
    return pa.concat_tables([queue, queue])


@pytest.mark.parametrize("how", ["metadata", "column", "kind", "type", "null", "reasons", "twice"])
def test_a_queue_that_is_none_is_refused(stored: tuple[Path, pa.Table], how: str, tmp_path: Path) -> None:
    pq.write_table(damaged(stored[1], how), tmp_path / "q.parquet")
    with pytest.raises(InputError) as error:
        read_queue(tmp_path / "q.parquet")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"PAR1 no", None])
def test_a_file_that_is_none_is_refused(content: bytes | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "q.parquet").write_bytes(content)
    with pytest.raises(InputError, match="cannot be read"):
        read_queue(tmp_path / "q.parquet")


def test_a_queue_cannot_be_written_into_a_file(stored: tuple[Path, pa.Table]) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_queue(stored[1], stored[0] / "inside.parquet")
