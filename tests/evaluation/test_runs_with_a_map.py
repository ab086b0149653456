"""Runs with an object map: what a frame does not show is NOT-SEEN in records, manifest and the answer asked again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.answering import StageClock
from pipeline.datasets import demo_run
from pipeline.evaluation import open_run
from pipeline.evaluation.row_stories import row_head
from pipeline.evaluation.run_folder import Run, spec_record
from pipeline.evaluation.systems import EvalSpec, OwnPipeline
from pipeline.geometry.camera import to_world
from pipeline.labels import read_cases
from pipeline.scenes.map_files import map_path, read_map, save_map
from pipeline.scenes.object_map import map_scene
from pipeline.scenes.views import posed_frames

HERE, THERE = "000001/000000", "000001/000002"


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(demo_run())


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from pipeline.answering import open_pipeline

    folder, demo = tmp_path_factory.mktemp("maps"), open_pipeline("demo")
    save_map(map_scene(demo, "000001", posed_frames(demo.dataset, HERE)), folder)
    return folder


def rows(run: Run, maps: Path, spec: EvalSpec) -> list[dict[str, Any]]:
    """Records of a frame by the labels of another one, as if they were of the whole scene."""
    index = run.source.dataset.frame_ids.index(THERE)
    (truth,) = read_cases(run.labels, index, index + 1)
    poses = read_map(map_path(maps, "000001")).poses
    to_here = np.linalg.inv(poses[HERE]) @ poses[THERE]
    truth = replace(truth, frame=HERE, rgb_hash=None)
    truth.geometry["center"] = to_world(truth.geometry["center"], to_here)
    return OwnPipeline().open(spec, run.source, run.labels, StageClock())(truth, None)


def test_records_tell_what_the_frame_does_not_show(run: Run, maps: Path) -> None:
    before, after = (rows(run, maps, replace(run.spec, map=folder)) for folder in (None, str(maps)))
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert {new["verdict"] for _, new in changed} == {"NOT-SEEN"}
    assert {old["verdict"] for old, _ in changed} <= {"OPM-TARGET", "OPM-REF"}
    made = read_map(map_path(maps, "000001"))
    for _, new in changed:
        own = [o for o in made.objects if o.label == new["missed_name"]]
        assert any(o.presence[HERE].upper() == new["detail"] for o in own), new
        assert row_head(new) == ("wrong", f"{new['missed_name'].capitalize()} not in view")
    # What the frame shows and the detector did not find is still its fault.
    kept = {new["verdict"] for new in after}
    assert kept & {"OPM-TARGET", "OPM-REF"}


def test_a_run_remembers_its_map(run: Run, maps: Path, tmp_path: Path) -> None:
    assert "map" not in spec_record(run.spec, run.folder)
    assert run.maps is None
    record = spec_record(replace(run.spec, map=str(maps)), tmp_path)
    assert (tmp_path / record["map"]).resolve() == maps.resolve()
