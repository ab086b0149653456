"""Commands about runs and failures, run whole: tables, and what-if."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_relation_report import networks

from pipeline.datasets.demo import demo_labels
from pipeline.diagnosis.whatif import Edits, edits_record
from pipeline.labels.reading import Labels, open_labels
from spatialviz.cli import main


def test_tables_and_plots_of_a_run_from_the_command_line(
    label_sets: dict[str, Labels], networks: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib", reason="the extra report is not installed")
    start = ["eval", "demo", "--labels", str(label_sets["demo"].root), "--workers", "1"]
    told = [*start, "--tables", "relations", "--relation-frames", "2", "--out", str(tmp_path / "run")]
    words = ["--vectors", str(networks["flat"].parent / "words.npz")]
    assert main([*told, *words, "--srm", "rule", "--relations-of", str(networks["worded"]), "--json"]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert set(found["tables"]) == {"srm", "srm_relations"}
    assert found["tables"]["srm"]["rule"]["pairs"] == found["pairs"] > 0
    (warned,) = [line for line in printed.err.splitlines() if "worded" in line]
    assert warned.startswith("spatialviz: ")
    names = {p.relative_to(tmp_path / "run").as_posix() for p in (tmp_path / "run").rglob("*") if p.is_file()}
    assert names == {
        "tables.md",
        "tables.tex",
        "tables/srm.csv",
        "tables/srm_relations.csv",
        "relation_records.parquet",
        "run.json",
        "plots/srm_relations.png",
    }
    again = ["tables", str(tmp_path / "run"), "--json"]
    assert main(again) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]["paper_relations_avd"]
    assert [row["source"] for row in rows.values()] == ["reported"] * 6 + ["measured"] * 3
    assert main([*again[:2], "--format", "markdown"]) == 0
    assert "| 3D-Geom+Lng (reported) |" in capsys.readouterr().out
    for wrong, message in (
        (["--tables", "grounding", "--relation-frames", "2"], "belongs to relations alone"),
        (["--tables", "relations", "--limit", "4"], "are about expressions"),
        (["--vlm-url", "http://localhost:1/v1"], "go together"),
    ):
        assert main([*start, "--out", str(tmp_path / "other"), *wrong]) == 2
        assert message in capsys.readouterr().err
    assert open_labels(label_sets["demo"].root).relation_names


def test_the_command_shows_before_and_after(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:

    edits = tmp_path / "edits.json"
    edits.write_text(json.dumps(edits_record(Edits().with_k(3).with_scorer("rule"))), encoding="utf-8")
    command = ["whatif", "demo", "3", "book left of basket", "--edits", str(edits)]
    assert main([*command, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["edits"]["k"] == 3
    assert record["after"]["p_relation"] in (0.05, 0.5, 0.95)
    assert main(command) == 0
    assert "before" in capsys.readouterr().out
    edits.write_text(json.dumps(edits_record(Edits().with_hidden("#999"))), encoding="utf-8")
    assert main(command) == 2
    assert "#999" in capsys.readouterr().err


ASK = ["ask", "demo", "0", "mug"]


@pytest.mark.parametrize("value", ["nan", "inf", "-1", "1e308", "a"])
@pytest.mark.parametrize("option", ["--k", "--depth-scale", "--up", "--min-score", "--show", "--seed"])
def test_a_number_that_is_none_is_told_in_a_line(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    given = ",".join([value] * 3) if option == "--up" else value
    verb = ["eval", "demo", "--labels", str(demo_labels())] if option in ("--show", "--seed") else ASK
    if (option, value) != ("--up", "-1"):
        assert main([*verb, f"{option}={given}"]) == 2
        said = capsys.readouterr().err
        assert said.startswith("spatialviz: error: ")
        assert said.count("\n") == 1
