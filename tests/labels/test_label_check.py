"""The linter of labels: nothing on clean labels, and of every single damage exactly the finding it calls for."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from damaged_labels import Tables, copied, damage, write_labels
from hypothesis import given, settings
from hypothesis import strategies as st
from label_damages import DAMAGES, Damage, item, pair, put
from label_damages_pairs import PAIR_DAMAGES
from slow_cases import mostly_slow

from pipeline.labels import (
    TABLES,
    LabelConfig,
    LabelStore,
    SourceSpec,
    check_labels,
    finding_record,
    frame_stream,
    label_shard,
    make_plan,
    merge_labels,
    open_labeller,
    open_labels,
    save_plan,
)
from pipeline.labels.check import RULES, Finding
from pipeline.system import InputError

CONFIGS = {
    "avd": LabelConfig(),
    "semantic-abstraction": LabelConfig(vocabulary="semantic-abstraction"),
    "all": LabelConfig(vocabulary="all"),
    "published": LabelConfig(vocabulary="semantic-abstraction", profile="semantic-abstraction-published"),
    "published-directions": LabelConfig(vocabulary="avd", profile="semantic-abstraction-published"),
}
ALL_DAMAGES = [*DAMAGES, *PAIR_DAMAGES]
FIRST = {rule: change for rule, _, change in reversed(ALL_DAMAGES)}
"""Of each rule the first damage that it finds."""


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folders = {}
    for name in ("all", "published"):
        folders[name] = tmp_path_factory.mktemp("labels") / name
        write_labels(folders[name], replace(CONFIGS[name], style="plain"))
    return folders


@pytest.fixture(scope="module")
def baseline(clean: dict[str, Path]) -> list[Finding]:
    return check(clean["all"])


def check(root: Path, **options: Any) -> list[Finding]:
    return list(check_labels(open_labels(root), **options))


def errors(findings: list[Finding]) -> list[Finding]:
    return [f for f in findings if f.severity == "error"]


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_slow(CONFIGS, fast=(2,)))
def test_clean_labels_of_rooms_have_no_error(name: str, tmp_path: Path) -> None:
    spec, config = SourceSpec("demo"), CONFIGS[name]
    plan, store = make_plan(spec, config, limit=5), LabelStore(tmp_path)
    store.prepare()
    save_plan(plan, store)
    labeller = open_labeller(spec, config)
    for shard in plan.shards:
        label_shard(shard, labeller, store)
    merge_labels(tmp_path)
    findings = check(tmp_path)
    assert errors(findings) == []
    warnings = {f.rule for f in findings}
    # The last two are of objects too small to clean: pixels of what is behind make their boxes metres long.
    expected = {"object/border", "object/few-points", "expression/everything"}
    expected |= {"object/implausible-size", "object/box-mask"}
    assert warnings <= expected


@pytest.mark.parametrize("name", ["all", "published"])
def test_clean_labels_of_exact_scenes_have_no_error(name: str, clean: dict[str, Path]) -> None:
    findings = check(clean[name])
    assert errors(findings) == []
    assert {f.rule for f in findings} <= {"object/border", "expression/everything"}


@pytest.mark.parametrize(
    ("rule", "severity", "change"),
    mostly_slow(ALL_DAMAGES, fast=[k for k, (rule, _, c) in enumerate(ALL_DAMAGES) if c is FIRST[rule]], several=True),
    ids=[c.__name__ for _, _, c in ALL_DAMAGES],
)
def test_a_damage_is_found_where_it_is(
    rule: str, severity: str, change: Damage, clean: dict[str, Path], baseline: list[Finding], tmp_path: Path
) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    expected = damage(root, change)
    before = {(f.frame, f.objects) for f in baseline if f.rule == rule}
    found = {(f.frame, f.objects, f.severity) for f in check(root, rules=[rule])}
    new = {(frame, objects, s) for frame, objects, s in found if (frame, objects) not in before}
    assert new == {(frame, objects, severity) for frame, objects in expected}


@pytest.mark.parametrize("rule", mostly_slow(FIRST, fast=(0, 20)))
def test_a_rule_alone_finds_what_all_rules_find(rule: str, clean: dict[str, Path], tmp_path: Path) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    damage(root, FIRST[rule])
    findings = check(root)
    assert {finding_record(f)["rule"] for f in findings} >= {rule}
    assert [f for f in findings if f.rule == rule] == check(root, rules=[rule])
    if rule == "profile/changed":
        assert not [f for f in findings if f.rule == "relation/geometry"]


def test_every_rule_has_a_damage() -> None:
    assert {rule for rule, _, _ in ALL_DAMAGES} | {"file/unreadable", "object/other-masks"} == set(RULES)


def test_the_published_profile_is_compared_with_its_own_geometry(clean: dict[str, Path], tmp_path: Path) -> None:
    def change(t: Tables) -> None:
        put(pair(t, "room/0", 3, 4), left=-1)
        put(pair(t, "room/1", 0, 1), right=1)

    root = copied(clean["published"], tmp_path / "labels")
    damage(root, change)
    found = {(f.rule, f.frame, f.objects) for f in errors(check(root, rules=["relation"]))}
    assert found == {
        ("relation/geometry", "room/0", (3, 4)),
        ("relation/geometry", "room/1", (0, 1)),
        ("relation/antisymmetry", "room/1", (0, 1)),
    }


def test_mutual_on_that_the_extents_allow_is_a_warning(clean: dict[str, Path], tmp_path: Path) -> None:
    """Two slabs of one height that overlap a little less than half: each lies within 5 cm of on the other."""

    def change(t: Tables) -> None:
        for number, left in ((0, 0.0), (1, 0.2)):
            put(item(t, "room/1", number), lo=[left, -1.0, 2.0], hi=[left + 0.3, -0.98, 2.3])
        put(pair(t, "room/1", 0, 1), on=1)
        put(pair(t, "room/1", 1, 0), on=1)

    root = copied(clean["all"], tmp_path / "labels")
    damage(root, change)
    (found,) = check(root, rules=["relation/antisymmetry"])
    assert (found.severity, found.frame, found.objects) == ("warning", "room/1", (0, 1))


def test_findings_are_json(clean: dict[str, Path], tmp_path: Path) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    for _, _, change in ALL_DAMAGES[::7]:
        damage(root, change)
    findings = check(root)
    assert len({f.rule for f in findings}) > 8
    for finding in findings:
        record = json.loads(json.dumps(finding_record(finding), allow_nan=False))
        assert record["rule"] == finding.rule
        assert RULES[finding.rule] == "error" or finding.severity == "warning"


def test_an_unknown_rule_is_one_clear_error(clean: dict[str, Path]) -> None:
    with pytest.raises(InputError, match="no such rule"):
        check_labels(open_labels(clean["all"]), rules=["relation/inverted"])


def test_a_garbled_file_is_a_finding(clean: dict[str, Path], tmp_path: Path) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    (root / "objects.parquet").write_bytes(b"PAR1 and then nothing")
    findings = check(root)
    assert [(f.rule, f.figures["table"]) for f in findings if f.rule.startswith("file/")] == [
        ("file/unreadable", "objects")
    ]
    # What rests on the objects would be one error a row.
    assert {f.frame for f in findings} == {None}


def test_a_table_in_place_of_another_is_a_finding(clean: dict[str, Path], tmp_path: Path) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    (root / "relations.parquet").write_bytes((root / "objects.parquet").read_bytes())
    assert ("file/unreadable", "relations") in {(f.rule, f.figures.get("table")) for f in errors(check(root))}


def rewritten(root: Path, table: str, change: Callable[[pa.Table], pa.Table]) -> None:
    path = root / f"{table}.parquet"
    old = pq.read_table(path)
    pq.write_table(change(old).replace_schema_metadata(old.schema.metadata), path)


def test_a_missing_column_is_a_finding(clean: dict[str, Path], tmp_path: Path) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    rewritten(root, "expressions", lambda t: t.drop_columns(["margin"]))
    rewritten(root, "frames", lambda t: t.append_column("weather", pa.array(["fair"] * len(t))))
    (found,) = errors(check(root))
    assert (found.rule, found.figures["table"]) == ("file/unreadable", "expressions")
    assert "lacks the column 'margin'" in found.message


def test_frames_out_of_order_are_a_finding_and_the_rest_is_checked(clean: dict[str, Path], tmp_path: Path) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    rewritten(root, "relations", lambda t: t.sort_by([("frame_index", "descending")]))
    damage(root, lambda t: put(item(t, "room/1", 2), mask_pixels=17))
    (whole, found) = errors(check(root))
    assert (whole.rule, whole.figures["table"]) == ("file/unreadable", "relations")
    assert "not in the order" in whole.message
    assert (found.rule, found.frame, found.objects) == ("object/mask", "room/1", (2,))


def test_another_width_is_read(clean: dict[str, Path], tmp_path: Path) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    schema = pq.read_schema(root / "relations.parquet")

    def widened(table: pa.Table) -> pa.Table:
        kinds = {pa.int8(): pa.float64(), pa.float32(): pa.float64(), pa.string(): pa.large_string()}
        return table.cast(pa.schema([(f.name, kinds.get(f.type, f.type)) for f in schema]))

    rewritten(root, "relations", widened)
    findings = check(root)
    assert errors(findings) == []
    (found,) = (f for f in findings if f.frame is None)
    assert (found.rule, found.message) == ("file/changed", "relations.parquet was written anew with the same rows")


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10**6))
def test_wild_edits_never_crash(clean: dict[str, Path], tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """Cells of any table set to null, to numbers and texts that make no sense, rows dropped and shuffled."""
    rng = random.Random(seed)
    root = copied(clean["all"], tmp_path_factory.mktemp("wild") / "labels")

    def change(t: Tables) -> None:
        for name in TABLES:
            rows = t[name]
            for row in rng.sample(rows, min(3, len(rows))):
                column = rng.choice(list(row))
                old = row[column]
                wild: list[Any] = [None, type(old)(-100) if isinstance(old, int | float) else old]
                if isinstance(old, list) and old:
                    wild += [[], old[:1], [*old, old[0]]]
                    wild += [[float("nan")] * len(old), [0.0] * len(old)] if isinstance(old[0], float) else []
                if isinstance(old, str):
                    wild += ["", "\u0436\u0437", old[::-1]]
                row[column] = rng.choice(wild)
            if rng.random() < 0.4:
                rows.pop(rng.randrange(len(rows)))
            if rng.random() < 0.3:
                rng.shuffle(rows)

    damage(root, change)
    for finding in check(root):
        json.dumps(finding_record(finding), allow_nan=False)


@pytest.mark.slow
def test_batches_change_nothing(clean: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = copied(clean["all"], tmp_path / "labels")
    for _, _, change in ALL_DAMAGES[22:60:5]:
        damage(root, change)
    whole = check(root)
    for rows in (1, 3, 16):
        monkeypatch.setattr(frame_stream, "BATCH", rows)
        assert check(root) == whole
