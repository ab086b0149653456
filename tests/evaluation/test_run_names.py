"""Two runs are told apart by what differs in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.datasets import demo_run
from pipeline.evaluation import Run, open_run
from pipeline.evaluation.run_names import told_apart


def run_with(**settings: Any) -> Run:
    run = open_run(demo_run())
    config = run.manifest["config"]
    options = {**config["options"], **settings.pop("options", {})}
    rank = {**config["rank"], **settings.pop("rank", {})}
    top = {key: settings.pop(key) for key in ("detector", "scorer", "name") if key in settings}
    found = {**run.manifest, **top, "config": {**config, **settings, "options": options, "rank": rank}}
    return replace(run, manifest=found, name=top.get("name", run.name))


@pytest.mark.parametrize(
    ("other", "names"),
    [
        ({"k": 2}, ("K 5", "K 2")),
        ({"options": {"min_score": "0.3"}}, ("minimum score 0.015", "minimum score 0.3")),
        ({"options": {"min_score": "None"}}, ("minimum score 0.015", "minimum score none")),
        ({"k": 2, "rank": {"relation_weight": 2.5}}, ("K 5 · γ 1", "K 2 · γ 2.5")),
        ({"detector": "gdino", "k": 2, "rank": {"beta": 0}}, ("simulated · K 5", "gdino · K 2")),
        ({"options": {"model": "other/place/better.toml"}}, ("simulated.toml", "better.toml")),
        ({"name": "after the fix"}, ("simulated detector", "after the fix")),
        ({}, ("first run", "second run")),
    ],
)
def test_runs_are_told_apart_by_their_settings(other: dict[str, Any], names: tuple[str, str]) -> None:
    assert told_apart(open_run(demo_run()), run_with(**other)) == names


def test_equal_runs_are_told_apart_by_their_folders() -> None:
    run = open_run(demo_run())
    assert told_apart(run, replace(run, folder=Path("later"))) == ("run", "later")
