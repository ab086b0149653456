"""Links and view strings that people kept open the same place, and commands read folders of earlier versions."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import pytest
from command_line import spatialviz

from pipeline.diagnosis.whatif.state import decode
from spatialviz.app.state import CameraMode, ColorMode, Place, SceneFlags, State
from spatialviz.app.view_strings import CAMERA, FOV, POINTS, with_settings

FIXTURE = Path(__file__).parents[2] / "tests" / "fixtures" / "2026-11-26"
VIEWS: dict[str, Any] = json.loads((FIXTURE / "views.json").read_text(encoding="utf-8"))
EXPECTED: dict[str, Any] = json.loads((FIXTURE / "expected.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", VIEWS["addresses"])
def test_a_link_opens_what_it_did(name: str) -> None:
    kept = VIEWS["addresses"][name]
    place = json.loads(json.dumps(asdict(Place.read(kept["query"], ["recording"]))))
    assert {field: place[field] for field in kept["place"]} == kept["place"]


@pytest.mark.parametrize("name", VIEWS["strings"])
def test_a_view_string_sets_what_it_did(name: str) -> None:
    view = decode(VIEWS["strings"][name]["string"])
    state = with_settings(State(view.dataset, view.frame), view)
    assert state.colors == view.colors
    assert view.colors in get_args(ColorMode)
    # The place by the pair is where a view begins, and no string asks for it.
    assert state.camera == view.toggles[CAMERA]
    assert view.toggles[CAMERA] in get_args(CameraMode)
    assert state.point_size == view.toggles.get(POINTS, 1)
    # What a string of an earlier version does not know stands as it does on a new page.
    assert asdict(state.flags) == asdict(SceneFlags()) | {
        name: on for name, on in view.toggles.items() if name not in (CAMERA, FOV, POINTS)
    }


def test_commands_read_old_folders(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(FIXTURE, tmp_path / "old"))
    labels, run = folder / "labels", folder / "run"
    checked = spatialviz(0, "journal", labels, "--check", "--json").record
    assert (checked["sound"], checked["events"]) == (True, EXPECTED["journal"]["events"])
    assert len(spatialviz(0, "journal", labels, "--json").records) == EXPECTED["journal"]["events"]
    shown = spatialviz(0, "show", labels, "000001/000000", "--dataset", folder / "recording", "--json").records
    names = {str(o["object"]): o["label"] for o in shown}
    assert names.items() >= EXPECTED["effective"]["names"]["000001/000000"].items()
    for name in ("run", "imported"):
        assert EXPECTED[name]["verdicts"] == {
            row["verdict"]: row["n"]
            for row in spatialviz(
                0, "query", folder / name, "select verdict, count(*) as n from records group by verdict", "--json"
            ).records
        }
    found = spatialviz(0, "failures", run, "verdict:LIFT", "--json").records
    assert found
    replayed = spatialviz(0, "replay", folder / "case", folder / "case_imported", "--json").records
    assert replayed
