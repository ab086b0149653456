"""Scene graphs hold the relations that the labels hold, in the viewer's axes, alike in JSON and GraphML."""

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from pipeline.labels import SourceSpec, export_labels, label_dataset, open_labels
from pipeline.labels.exports.scene_graph import NAMESPACE
from pipeline.language.relation_names import PAIRWISE

FRAME = "000001/000000"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("graphs")
    label_dataset(SourceSpec("demo"), folder / "labels", limit=2)
    export_labels(open_labels(folder / "labels"), "scene-graph", folder / "out")
    return folder / "labels", folder / "out"


def graph(out: Path) -> dict:
    return json.loads((out / "graphs" / "000000.json").read_text())


def test_edges_are_the_relations_that_hold(exported: tuple[Path, Path]) -> None:
    labels, out = exported
    rows = [r for r in open_labels(labels).table("relations").to_pylist() if r["frame"] == FRAME]
    wanted = {state: {(r["a"], r["b"], n) for r in rows for n in PAIRWISE if r[n] == state} for state in (1, 0)}
    found = graph(out)
    assert {(e["source"], e["target"], e["relation"]) for e in found["edges"]} == wanted[1]
    assert {(e["source"], e["target"], e["relation"]) for e in found["undecided"]} == wanted[0]
    assert wanted[1]
    assert wanted[0]


def test_centers_lead_to_the_world(exported: tuple[Path, Path]) -> None:
    labels, out = exported
    opened, found = open_labels(labels), graph(out)
    frame = next(r for r in opened.frames.to_pylist() if r["frame"] == FRAME)
    rows = {r["object"]: r for r in opened.objects.to_pylist() if r["frame"] == FRAME}
    T_world_camera = np.array(frame["T_world_camera"]).reshape(4, 4)
    T_world_viewer = np.array(found["frame_of_reference"]["T_world_viewer"])
    for node in found["nodes"]:
        by_camera = T_world_camera @ [*rows[node["object"]]["center"], 1]
        np.testing.assert_allclose(T_world_viewer @ [*node["center"], 1], by_camera, atol=1e-3)


def test_graphml_says_the_same(exported: tuple[Path, Path]) -> None:
    _, out = exported
    found, names = graph(out), {"g": NAMESPACE}
    root = ET.parse(out / "graphs" / "000000.graphml").getroot()
    edges = root.findall("g:graph/g:edge", names)
    text = {(e.get("source"), e.get("target"), e.findtext("g:data[@key='relation']", None, names)) for e in edges}
    assert text == {(f"n{e['source']}", f"n{e['target']}", e["relation"]) for e in found["edges"]}
    labels = [n.findtext("g:data[@key='label']", None, names) for n in root.findall("g:graph/g:node", names)]
    assert labels == [n["label"] for n in found["nodes"]]
