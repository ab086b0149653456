"""Search: the same rows as a plain filter, nothing that escapes from a value, and errors of one line."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_records import CLASSES, RELATIONS, random_records

from pipeline.diagnosis import ORACLES, VERDICTS
from pipeline.evaluation import complete, find_failures, find_rows, quote
from pipeline.evaluation.browsing import completions
from pipeline.evaluation.records import records_schema
from pipeline.evaluation.search import compile_search, read_terms
from pipeline.system import InputError

TABLES = [random_records(seed) for seed in range(4)]
COMPARE: dict[str, Any] = {
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "=": np.equal,
    "!=": np.not_equal,
}


def find(records: pa.Table, query: str) -> pa.Table:
    return records.take(find_rows(records, query))


def missing(value: Any) -> bool:
    return value is None or bool(np.isnan(value))


@st.composite
def terms(draw: st.DrawFn) -> tuple[str, Any]:
    """A term as it is written, and as a function of a row."""
    kind = draw(st.sampled_from(["verdict", "class", "exact", "margin", "lucky", "repair", "word", "frame", "gap"]))
    negated = draw(st.booleans())
    if kind == "verdict":
        chosen = draw(st.lists(st.sampled_from(VERDICTS), min_size=1, max_size=3))
        text, holds = "verdict:" + ",".join(chosen).lower(), lambda row: row["verdict"] in chosen
    elif kind == "class":
        name = draw(st.sampled_from(CLASSES))
        escaped = name.replace('"', '\\"')
        text, holds = f'class:"{escaped}"', lambda row: row["target"].lower() == name.lower()
    elif kind == "exact":
        name = draw(st.sampled_from(CLASSES))
        text, holds = f"class={quote(name)}", lambda row: row["target"] == name
    elif kind == "margin":
        operator = draw(st.sampled_from(sorted(COMPARE)))
        bound = draw(st.sampled_from([0.1, 0.2, 1.0, -0.5]))
        text = f"margin {operator} {bound}"
        # Different is what is not equal, and a gap is not equal to anything.
        holds = lambda row: (  # noqa: E731
            operator == "!=" if missing(row["margin"]) else bool(COMPARE[operator](row["margin"], np.float32(bound)))
        )
    elif kind == "lucky":
        text, holds = "lucky", lambda row: row["lucky"]
    elif kind == "repair":
        chosen = draw(st.lists(st.sampled_from(ORACLES), min_size=1, max_size=2))
        text, holds = "repair:" + ",".join(chosen), lambda row: bool(set(chosen) & set(row["repair"] or []))
    elif kind == "word":
        word = draw(st.sampled_from(["chair", "50%", "t_o", "trash", "CAN?"]))
        text, holds = word, lambda row: word.lower() in row["text"].lower()
    elif kind == "frame":
        text, holds = "frame:000002/*", lambda row: row["frame"].startswith("000002/")
    else:
        text, holds = "detail:none", lambda row: row["detail"] is None
    return ("-" + text, lambda row: not holds(row)) if negated else (text, holds)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, len(TABLES) - 1), st.lists(terms(), max_size=4))
def test_a_search_finds_what_a_plain_filter_finds(number: int, asked: list[tuple[str, Any]]) -> None:
    rows = TABLES[number].to_pylist()
    expected = [k for k, row in enumerate(rows) if all(holds(row) for _, holds in asked)]
    assert find_rows(TABLES[number], " ".join(text for text, _ in asked)).tolist() == expected


@settings(max_examples=30, deadline=None)
@given(st.text(max_size=30))
def test_a_quoted_value_means_itself_whatever_it_holds(name: str) -> None:
    (term,) = read_terms(f"class={quote(name)}")
    assert term.values[0].text == name
    others = ["other"] * (TABLES[0].num_rows - 1)
    table = TABLES[0].set_column(TABLES[0].column_names.index("target"), "target", pa.array([name, *others]))
    expected = list(range(table.num_rows)) if name == "other" else [0]
    assert find_rows(table, f"class={quote(name)}").tolist() == expected


@settings(max_examples=30, deadline=None)
@given(st.text(alphabet="abverdict:<>=!-,\"\\'; *%_()0.1\n", max_size=25))
def test_anything_that_is_typed_is_found_or_refused_in_one_line(text: str) -> None:
    refused = None
    try:
        assert len(find_rows(TABLES[1], text)) <= TABLES[1].num_rows
    except InputError as error:
        refused = str(error)
    assert refused is None or "\n" not in refused


@pytest.mark.parametrize(
    "attack",
    [
        'class:"\' OR 1=1 --"',
        'class:"x\'); DROP TABLE run; --"',
        "\"'; COPY run TO 'stolen.csv'; --\"",
        "class='||(SELECT_1)||'",
        "frame:*'_OR_'1'='1",
    ],
)
def test_sql_in_a_value_stays_a_value(attack: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    search = compile_search(attack, records_schema())
    assert "'" not in search.where.replace("ESCAPE '\\'", "")
    assert len(search.parameters) == 1
    assert find(TABLES[0], attack).num_rows == 0
    assert not list(tmp_path.iterdir())
    # A column cannot be smuggled in either.
    with pytest.raises(InputError, match="unknown field"):
        find(TABLES[0], 'sort:"margin; DROP TABLE run"')


def test_order_puts_gaps_last_and_keeps_ties_in_place() -> None:
    for down in (False, True):
        rows = find(TABLES[2], f"sort:{'-' if down else ''}margin").to_pylist()
        values = [r["margin"] for r in rows if not missing(r["margin"])]
        assert values == sorted(values, reverse=down)
        assert all(missing(r["margin"]) for r in rows[len(values) :])
        assert len(values) < len(rows) == TABLES[2].num_rows
        assert all(a["id"] < b["id"] for a, b in pairwise(rows) if a["margin"] == b["margin"])


def test_failures_leave_out_what_is_right_unless_it_is_asked_for() -> None:
    table = random_records(3, rows=180)
    wrong = sum(not right for right in table.column("set_correct").to_pylist())
    assert find_failures(table).num_rows == find(table, "-right").num_rows == wrong < table.num_rows
    assert not any(find_failures(table, "class:chair").column("set_correct").to_pylist())
    assert set(find_failures(table, "lucky").column("verdict").to_pylist()) == {"CORRECT"}
    opm = set(find_failures(table, "verdict:OPM").column("verdict").to_pylist())
    assert opm == {"OPM-TARGET", "OPM-REF", "OPM-CONF"}
    exactly = find(table, "repair=SRM,LIFT").column("repair").to_pylist()
    assert exactly == [r for r in table.column("repair").to_pylist() if r == ["LIFT", "SRM"]]
    assert find(table, 'relation:"LEFT OF"').num_rows == table.column("relation").to_pylist().count(RELATIONS[0])


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("verdct:SRM", "expected verdict"),
        ("verdict:SMR", "expected 'SRM'"),
        ("class<3", "no order"),
        ("margin:wide", "is a number"),
        ("lucky:maybe", "yes or no"),
        ('"open', "not closed"),
        ("class:", "missing"),
        ("repair:OPM", "one of RECALL"),
        ("sort:nothing_like_it", "unknown field"),
        ("margin<nan", "is a number"),
        ('class:"a"b', "a space is missing"),
    ],
)
def test_what_cannot_be_searched_is_said(query: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        find(TABLES[0], query)


def test_a_run_without_verdicts_says_so_and_is_searched_for_the_rest() -> None:
    old = TABLES[0].drop_columns(["verdict", "detail", "lucky", "right_with", "margin", "object_size"])
    for query in ("verdict:SRM", "margin<1", "lucky:yes", "size>1"):
        with pytest.raises(InputError, match="made by an older release"):
            find(old, query)
    with pytest.raises(InputError, match="no verdicts"):
        find_failures(old)
    assert find(old, "relation:left").num_rows > 0


def test_completions_are_searches_that_find_something() -> None:
    fields = completions(TABLES[0])
    by_name = {f.name: f for f in fields}
    assert "class:" in complete("verdict:SRM -lucky cl", fields)
    assert complete("-verdict:SRM,LA", fields) == ["-verdict:SRM,LABEL"]
    assert "sort:-margin" in complete("sort:-mar", fields)
    spaced = next(v for v in by_name["class"].values if " " in v)
    assert complete(f"verdict:SRM class:{spaced[:-2]}", fields) == [f"class:{spaced}"]
    assert complete(f"class:{spaced} cl", fields) == ["class:"]
    assert sum(find(TABLES[0], f"class={v}").num_rows for v in by_name["class"].values) == TABLES[0].num_rows
    for value in by_name["verdict"].values:
        assert find(TABLES[0], f"verdict:{value}").num_rows > 0
