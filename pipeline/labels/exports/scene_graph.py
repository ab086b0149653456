"""Scene graphs: objects as nodes, relations that hold as directed edges; JSON and GraphML, a file of each a frame.

`graphs/000000.json` and `graphs/000000.graphml` are of the frame that `index.jsonl` names. Everything is in the
viewer's frame of reference: axes right, up and forward, origin at the camera, metres; `T_world_viewer` leads from there
to the world where the frame has a pose. An edge says "source RELATION target", with its margin in metres. States that
are too close to call (U) are listed apart in JSON; what does not hold is left out.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from pipeline.geometry.camera import to_world
from pipeline.geometry.viewer import IMAGE_UP, ViewerAxes, viewer_axes
from pipeline.labels.exports.base import ExportFormat, ExportFrame, Job, Written, iterate_frames, json_line
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import T, U
from pipeline.system.whole_files import text_file, write_json

NAMESPACE = "http://graphml.graphdrawing.org/xmlns"
NODE_KEYS = {"label": "string", "object": "int", "instance": "int", "x": "double", "y": "double", "z": "double"}
EDGE_KEYS = {"relation": "string", "margin": "double"}


def write_scene_graphs(job: Job) -> Written:
    """Write the graphs of every usable frame, and the list of frames."""
    (job.folder / "graphs").mkdir()
    counts = Counter(frames=0, nodes=0, edges=0)
    with text_file(job.folder / "index.jsonl") as index:
        for rows in iterate_frames(job.labels, job.tell):
            frame = rows.frame
            if not frame["ok"]:
                continue
            index.write(json_line({"index": rows.index, "frame": frame["frame"], "scene": frame["scene"]}) + "\n")
            graph = scene_graph(rows)
            write_json(job.folder / "graphs" / f"{rows.index:06d}.json", graph)
            _write_graphml(job.folder / "graphs" / f"{rows.index:06d}.graphml", graph)
            counts.update(frames=1, nodes=len(graph["nodes"]), edges=len(graph["edges"]))
            job.copy_picture(rows)
    notes = ("masks, points and expressions have no place in this format",)
    return Written(("index.jsonl", "graphs/", *(("images/",) if job.images is not None else ())), counts, notes)


def scene_graph(rows: ExportFrame) -> dict[str, Any]:
    """Graph of a usable frame, JSON-able.

    Returns
    -------
    dict
        frame, scene, frame_of_reference, nodes ({object, label, instance, score, center, size, axes}; the last three
        null without a 3D box), edges ({source, target, relation, margin}), undecided ({source, target, relation}).
    """
    frame = rows.frame
    viewer = viewer_axes(IMAGE_UP if frame["up"] is None else np.asarray(frame["up"]))
    nodes = [_node(row, viewer) for row in rows.objects]
    edges: list[dict[str, Any]] = []
    undecided: list[dict[str, Any]] = []
    for row in rows.relations.to_pylist():
        for relation in PAIRWISE:
            named = {"source": row["a"], "target": row["b"], "relation": relation}
            if row[relation] == T:
                edges.append(named | {"margin": _rounded(row[f"{relation}_margin"])})
            elif row[relation] == U:
                undecided.append(named)
    reference = {
        "name": "viewer",
        "axes": ["right", "up", "forward"],
        "origin": "the camera",
        "unit": "metre",
        "up_source": frame["up_source"],
        "T_world_viewer": _pose(frame["T_world_camera"], viewer),
    }
    return {
        "frame": frame["frame"],
        "scene": frame["scene"],
        "frame_of_reference": reference,
        "nodes": nodes,
        "edges": edges,
        "undecided": undecided,
    }


def _node(row: dict[str, Any], viewer: ViewerAxes) -> dict[str, Any]:
    known = all(row[name] is not None for name in ("center", "R", "size"))
    center = viewer.matrix @ np.asarray(row["center"]) if known else None
    axes = viewer.matrix @ np.asarray(row["R"]).reshape(3, 3) if known else None
    return {
        "object": row["object"],
        "label": row["label"],
        "instance": row["instance"],
        "score": row["score"],
        "center": None if center is None else center.round(4).tolist(),
        "size": [_rounded(x) for x in row["size"]] if known else None,
        "axes": None if axes is None else axes.T.round(6).tolist(),
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def _pose(pose: list[float] | None, viewer: ViewerAxes) -> list[list[float]] | None:
    """Affine matrix (4, 4) from the viewer's axes, which are left-handed, to the world; None without a pose."""
    if pose is None:
        return None
    T_world_camera, out = np.asarray(pose, np.float64).reshape(4, 4), np.eye(4)
    out[:3, :3] = T_world_camera[:3, :3] @ viewer.matrix.T
    out[:3, 3] = to_world(np.zeros(3), T_world_camera)
    return out.round(6).tolist()


def _write_graphml(path: Path, graph: dict[str, Any]) -> None:
    """Write a graph as GraphML (http://graphml.graphdrawing.org/specification.html)."""
    root = ET.Element("graphml", xmlns=NAMESPACE)
    for what, keys in (("node", NODE_KEYS), ("edge", EDGE_KEYS)):
        for name, kind in keys.items():
            ET.SubElement(root, "key", {"id": name, "for": what, "attr.name": name, "attr.type": kind})
    out = ET.SubElement(root, "graph", id=_plain(graph["frame"]), edgedefault="directed")
    for node in graph["nodes"]:
        place = dict(zip("xyz", node["center"] or (), strict=False))
        _data(ET.SubElement(out, "node", id=f"n{node['object']}"), {**node, **place}, NODE_KEYS)
    for edge in graph["edges"]:
        ends = {end: f"n{edge[end]}" for end in ("source", "target")}
        _data(ET.SubElement(out, "edge", ends), edge, EDGE_KEYS)
    ET.indent(root, " ")
    path.write_bytes(ET.tostring(root, "utf-8", xml_declaration=True) + b"\n")


def _data(element: ET.Element, values: dict[str, Any], keys: dict[str, str]) -> None:
    for name in keys:
        if values.get(name) is not None:
            ET.SubElement(element, "data", key=name).text = _plain(str(values[name]))


def _plain(text: str) -> str:
    """Text without the characters that XML has no place for."""
    return "".join(
        c if c in "\t\n\r" or (c >= " " and c not in "￾￿" and not "\ud800" <= c <= "\udfff") else "�" for c in text
    )


FORMAT = ExportFormat(
    write_scene_graphs, description="scene graphs, JSON and GraphML, a file of each a frame", lossless=False
)
