"""Questions to a scene, and labels that know its objects, from the command line."""

from __future__ import annotations

import json
from pathlib import Path

from command_line import spatialviz

FRAME = "000001/000000"


def test_a_scene_is_asked_from_its_map_and_from_where_nobody_stood(tmp_path: Path) -> None:
    maps = tmp_path / "maps"
    spatialviz(0, "map", "demo", FRAME, "--out", maps)
    asked = ("ask", "demo", FRAME, "pillow on the armchair")
    assert spatialviz(1, *asked).out
    told = spatialviz(0, *asked, "--world", "--map", maps).out
    assert "not visible from here: outside the picture; seen in 000001/000002" in told
    record = spatialviz(0, *asked, "--world", "--map", maps, "--json").record
    assert record["world"]["objects"]["target"]["presence"] == "out"
    turned = ("--standing-at", "bookshelf", "--facing", "armchair")
    record = spatialviz(0, *asked, "--world", "--map", maps, *turned, "--json").record
    assert record["world"]["viewpoint"] == "at bookshelf facing armchair"
    spoken = "from the bookshelf, facing the armchair: pillow on the armchair"
    same = spatialviz(0, "ask", "demo", FRAME, spoken, "--world", "--map", maps, "--json").record
    assert same["world"] == record["world"]
    assert "with a map of the scene: `ask --world`" in spatialviz(2, "ask", "demo", FRAME, spoken).err
    for wrong, words in (
        (("--facing", "armchair"), "--standing-at X --facing Y"),
        (("--map", tmp_path), "no map of the scene"),
    ):
        assert words in spatialviz(2, *asked, "--world", *wrong).err
    assert "one frame" in spatialviz(2, "ask", "demo", "all", "pillow on the armchair", "--world").err


def test_labels_know_the_objects_of_a_map(tmp_path: Path) -> None:
    maps, labels = tmp_path / "maps", tmp_path / "labels"
    for frame in (FRAME, "000002/000000"):
        spatialviz(0, "map", "demo", frame, "--out", maps)
    spatialviz(0, "label", "demo", "--out", labels, "--map", maps, "--limit", 6)
    spatialviz(0, "export", labels, "--format", "jsonl", "--out", tmp_path / "out")
    found = (tmp_path / "out" / "objects.jsonl").read_text()
    assert '"instance": 0' in found
    assert '"instance": null' not in found
    spatialviz(0, "export", labels, "--format", "scene-graph", "--out", tmp_path / "graphs")
    assert (tmp_path / "graphs" / "graphs" / "000000.graphml").is_file()


def test_what_a_frame_does_not_show_is_not_the_detectors_fault(tmp_path: Path) -> None:
    maps, labels = tmp_path / "maps", tmp_path / "labels"
    spatialviz(0, "map", "demo", FRAME, "--out", maps)
    asked = ("ask", "demo", FRAME, "pillow on the armchair")
    told = spatialviz(1, *asked, "--map", maps).out
    assert "verdict NOT-SEEN OUT" in told
    assert "No pillow is in this picture; 000001/000002 shows one." in told
    verdict = spatialviz(1, *asked, "--map", maps, "--json").record["verdict"]
    assert (verdict["verdict"], verdict["unseen"]["frames"]) == ("NOT-SEEN", ["000001/000002"])
    assert "no object map" in spatialviz(2, *asked, "--map", tmp_path).err
    # Labels of what a frame shows have the same verdicts with a map and without.
    spatialviz(0, "label", "demo", "--out", labels, "--limit", 3)
    detector = ("--detector", "simulated", "--tables", "grounding", "--limit", 40, "--no-plots")
    verdicts = []
    for name, more in (("without", ()), ("with", ("--map", maps))):
        run = tmp_path / name
        spatialviz(0, "eval", "demo", "--labels", labels, "--out", run, *detector, *more)
        verdicts.append(spatialviz(0, "query", run, "SELECT id, verdict FROM records ORDER BY id", "--json").out)
        assert ("map" in json.loads((run / "run.json").read_text())["spec"]) == bool(more)
    assert verdicts[0] == verdicts[1]
    assert (
        "no object map"
        in spatialviz(2, "eval", "demo", "--labels", labels, "--out", tmp_path / "none", "--map", tmp_path).err
    )


def test_masks_are_compared_where_it_is_asked_for(tmp_path: Path) -> None:
    maps, labels = tmp_path / "maps", tmp_path / "labels"
    spatialviz(0, "map", "demo", FRAME, "--out", maps)
    spatialviz(0, "label", "demo", "--out", labels, "--map", maps, "--limit", 3)
    rule = "object/other-masks"
    assert rule not in spatialviz(0, "check", labels).out
    (found,) = [f for f in spatialviz(0, "check", labels, "--masks", "--json").records if f.get("rule") == rule]
    assert found["frame"].startswith("000001/")
    assert found["figures"]["other"] in spatialviz(0, "check", labels, "--rules", rule).out
    queue = ("review", labels, "--no-networks", "--kind", "object", "--find", rule)
    assert rule in spatialviz(0, *queue, "--masks").out
    spatialviz(1, *queue)
    spatialviz(0, "label", "demo", "--out", tmp_path / "plain", "--limit", 3)
    for command in (("check",), ("review", "--no-networks")):
        assert "label --map MAP" in spatialviz(2, *command, tmp_path / "plain", "--masks").err
