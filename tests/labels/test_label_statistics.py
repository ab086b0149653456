"""Statistics of labels: each number again in plain Python; a report that is whole, escaped, and replaces its own."""

from __future__ import annotations

import json
import math
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from slow_cases import mostly_slow

from pipeline.datasets import FrameReport, SurveyCounts
from pipeline.labels import (
    SCHEMA_VERSION,
    TABLES,
    Labels,
    build_table,
    label_statistics,
    open_labels,
    read_table,
    statistics,
    write_report,
    write_table,
)
from pipeline.labels.reading import arrow_schema
from pipeline.labels.statistics import DISTANCE_BINS, quantiles
from pipeline.language import PAIRWISE, RELATIONS
from pipeline.system import InputError

HOSTILE = (
    "<script>alert(1)</script>", '"><img src=x>', "$\\frac{a$", "[red]mug[/]", "kaffe\n\tkopp",
    "\N{CJK UNIFIED IDEOGRAPH-676F}", "x" * 300, " ",
)  # fmt: skip
RELATED = ("left", "right", "above", "in", "near")


def make_labels(
    root: Path,
    *,
    frames: int = 7,
    classes: tuple[str, ...] = ("mug", "book", "lamp"),
    relations: tuple[str, ...] = RELATED,
    most: int = 6,
    expressions: bool = True,
    seed: int = 0,
) -> Labels:
    """Labels of any content, with every kind of null and oddity the schema allows."""
    rng = np.random.default_rng(seed)
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}
    for f in range(frames):
        ok, key = f % 5 != 3, {"frame": f"s{f // 2}/{f}", "frame_index": f}
        n = int(rng.integers(0, most + 1)) if ok else 0
        rows["frames"].append(
            {**key, "scene": f"s{f // 2}", "ok": ok, "problem": None if ok else "broken", "width": 4, "height": 3,
             "up_source": rng.choice(["declared", "assumed"]) if ok and f % 4 else None, "objects": n, "notes": []}
        )  # fmt: skip
        labels = rng.choice(np.array(classes, object), n)
        for k in range(n):
            known, usable = bool(rng.random() < 0.8), bool(rng.random() < 0.7)
            lo = rng.uniform(-3, 3, 3)
            size = rng.uniform(0.01, 2, 3).tolist() if known else None
            rows["objects"].append(
                {**key, "object": k, "label": labels[k], "score": 1.0, "bbox": [0.0, 0, 1, 1], "mask_source": "dataset",
                 "mask_pixels": 9, "points": 9, "kept": 1.0, "depth_missing": 0.0, "fallback": False,
                 "touches_border": bool(rng.random() < 0.3), "distance": float(rng.uniform(0, 7)) if known else None,
                 "size": size, "yaw_confidence": 0.0, "estimator": "gravity", "lo": lo.tolist() if known else None,
                 "hi": (lo + 0.2).tolist() if known else None, "occluded": float(rng.choice([0, 0.05, 0.1, 0.6])),
                 "usable": usable, "reason": None if usable else str(rng.choice(["background", "few points"]))}
            )  # fmt: skip
        for a in range(n):
            for b in range(n):
                if a == b:
                    continue
                row = {**key, "a": a, "b": b, "distance": None, "doubted": 0}
                for name in relations:
                    state = int(rng.choice([-1, -1, -1, 0, 1]))
                    row[name] = state
                    row[f"{name}_margin"] = state * float(rng.gamma(1, 0.3))
                    if state == 1 and expressions:
                        accepted = sorted({a, *rng.choice(n, int(rng.integers(1, n + 1))).tolist()})
                        text = f"{labels[a]} {name} {labels[b]}" + str(rng.choice(["", "!"]))
                        rows["expressions"].append(
                            {**key, "id": f"{len(rows['expressions']):016x}", "text": text, "target": labels[a],
                             "relation": name, "reference": labels[b], "target_object": a, "reference_object": b,
                             "targets": [a], "acceptable": accepted, "ambiguous": len(accepted) > 1, "margin": 0.1,
                             "judged_in": "viewer", "up_source": "declared", "profile": "viewer-cone-v1"}
                        )  # fmt: skip
                rows["relations"].append(row)
    root.mkdir(parents=True)
    for name, table in rows.items():
        columns = {c: [row.get(c) for row in table] for c in arrow_schema(name).names} if table else {}
        write_table(build_table(name, columns), root / f"{name}.parquet")
    (root / "manifest.json").write_text(json.dumps(manifest(rows, relations, classes[0])), encoding="utf-8")
    return open_labels(root)


def manifest(rows: dict[str, list[Any]], relations: tuple[str, ...], name: str) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION, "tool": "spatialviz", "version": "0", "config": {"relations": relations},
        "config_hash": "0", "profile": {"name": "viewer-cone-v1"}, "profile_hash": "0", "selection": {},
        "dataset": {"path": f"/data/{name}", "format": "bop", "input_hash": "0"}, "models": {"detector": name},
        "seed": 0, "counts": {"candidates": 3 * len(rows["expressions"])}, "warnings": [],
        "tables": {n: {"file": "", "rows": len(t), "content_hash": "0", "sha256": "0"} for n, t in rows.items()},
        "environment": {}, "created": "",
    }  # fmt: skip


@pytest.fixture(scope="module", params=mostly_slow(range(3)))
def labels(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Labels:
    # A path that DuckDB would take for a pattern.
    return make_labels(tmp_path_factory.mktemp("it's [1]*") / "l?", frames=9, classes=HOSTILE, seed=request.param)


def rows_of(labels: Labels, name: str) -> list[dict[str, Any]]:
    return labels.table(name).to_pylist()


def rank(values: list[float], q: float) -> float:
    return sorted(values)[max(math.ceil(q * len(values) - 1e-9), 1) - 1]


def test_counts_and_classes_are_those_of_the_rows(labels: Labels) -> None:
    found = label_statistics(labels)
    frames, objects, expressions = (rows_of(labels, n) for n in ("frames", "objects", "expressions"))
    assert found["counts"] == {
        "frames": len(frames),
        "frames_usable": sum(r["ok"] for r in frames),
        "scenes": len({r["scene"] for r in frames}),
        "objects": len(objects),
        "objects_usable": sum(r["usable"] for r in objects),
        "unusable": dict(Counter(r["reason"] for r in objects if not r["usable"])),
        "pairs": len(rows_of(labels, "relations")),
        "expressions": len(expressions),
        "candidates": 3 * len(expressions),
    }
    assert found["up_source"] == dict(Counter(r["up_source"] or "unknown" for r in frames if r["ok"]))
    assert set(found["classes"]) == {r["label"] for r in objects}
    for name, entry in found["classes"].items():
        assert entry == {
            "objects": sum(r["label"] == name for r in objects),
            "usable": sum(r["label"] == name and r["usable"] for r in objects),
            "as_target": sum(r["target"] == name for r in expressions),
            "as_reference": sum(r["reference"] == name for r in expressions),
        }
    order = [(-entry["objects"], name.encode()) for name, entry in found["classes"].items()]
    assert order == sorted(order)
    json.dumps(found, allow_nan=False)


def test_relations_and_margins_are_those_of_the_rows(labels: Labels) -> None:
    found = label_statistics(labels)
    pairs, expressions = rows_of(labels, "relations"), rows_of(labels, "expressions")
    assert tuple(found["relations"]) == labels.relation_names
    for name, entry in found["relations"].items():
        states = Counter(r[name] for r in pairs)
        said = [r for r in expressions if r["relation"] == name]
        assert (entry["T"], entry["U"], entry["F"]) == (states[1], states[0], states[-1])
        assert entry["u_share"] == pytest.approx(states[0] / len(pairs), abs=1e-6)
        assert entry["T_per_pair"] == pytest.approx(states[1] / len(pairs), abs=1e-6)
        assert entry["expressions"] == len(said)
        assert entry["ambiguous"] == sum(r["ambiguous"] for r in said)
        for letter, state in (("T", 1), ("F", -1)):
            millimetres = [round(r[f"{name}_margin"] * 1000) for r in pairs if r[name] == state]
            margin = found["margins"][name][letter]
            assert margin["n"] == len(millimetres)
            for q in (5, 25, 50, 75, 95):
                # Halves of a millimetre may round either way.
                assert margin[f"p{q:02d}"] == pytest.approx(rank(millimetres, q / 100) / 1000, abs=0.001001)
    held = [sum(r[name] == 1 for name in labels.relation_names) for r in pairs]
    assert found["cells"]["positives_per_pair"] == pytest.approx(np.mean(held), abs=1e-6)
    assert found["cells"]["pairs_without_T"] == held.count(0)


@pytest.mark.slow
def test_distance_ambiguity_occlusion_and_text_are_those_of_the_rows(
    labels: Labels, monkeypatch: pytest.MonkeyPatch
) -> None:
    objects, pairs, expressions = (rows_of(labels, n) for n in ("objects", "relations", "expressions"))
    monkeypatch.setattr(statistics, "FRAMES_AT_ONCE", 2)
    found = label_statistics(labels)

    def bin_of(distance: float | None) -> str:
        return "unknown" if distance is None else DISTANCE_BINS[np.searchsorted([1, 2, 3, 5], distance, side="right")]

    at = {(r["frame"], r["object"]): bin_of(r["distance"]) for r in objects}
    for name, entry in found["distance"].items():
        cells = [r[n] for r in pairs if at[r["frame"], r["a"]] == name for n in labels.relation_names]
        assert entry["objects"] == sum(v == name for v in at.values())
        assert entry["cells"] == len(cells)
        assert entry["u_share"] == (pytest.approx(cells.count(0) / len(cells), abs=1e-6) if cells else None)
        assert entry["expressions"] == sum(at[r["frame"], r["target_object"]] == name for r in expressions)
    sizes = Counter(len(r["acceptable"]) for r in expressions)
    assert found["ambiguity"]["set_sizes"] == {str(k): v for k, v in sizes.items()}
    assert found["ambiguity"]["ambiguous"] == sum(r["ambiguous"] for r in expressions)
    occlusion = found["occlusion"]
    assert occlusion["mean"] == pytest.approx(np.mean([r["occluded"] for r in objects]), abs=2e-6)
    assert occlusion["occluded"] == sum(r["occluded"] > 0.09 for r in objects)
    cut = np.mean([r["touches_border"] for r in objects])
    assert occlusion["touching_border_share"] == pytest.approx(cut, abs=1e-6)
    questions: dict[Any, set[str]] = {}
    for r in expressions:
        questions.setdefault((r["target"], r["relation"], r["reference"]), set()).add(r["text"])
    assert found["text"]["sentences"] == len({r["text"] for r in expressions})
    assert found["text"]["questions"] == len(questions)
    assert found["text"]["sentences_per_question"] == pytest.approx(
        np.mean([len(t) for t in questions.values()]), abs=1e-6
    )


def test_quantiles_are_nearest_ranks() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 20, 99, 100):
        values, counts = np.unique(rng.integers(-9, 9, n), return_counts=True)
        flat = np.repeat(values, counts).tolist()
        for q in (0.0, 0.05, 0.1, 0.5, 0.95, 1.0):
            assert quantiles(values, counts, (q,)) == [rank(flat, q)]


FEW: list[dict[str, Any]] = [
    {"frames": 0}, {"most": 0}, {"most": 1}, {"expressions": False}, {"relations": ("near",)},
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("of", mostly_slow(FEW, fast=(1, 2, 3, 4)), ids=str)
def test_labels_without_rows_have_statistics_and_a_report(tmp_path: Path, of: dict[str, Any]) -> None:
    labels = make_labels(tmp_path / "labels", **of)
    found = label_statistics(labels)
    json.dumps(found, allow_nan=False)
    if not labels.expressions.num_rows:
        assert found["ambiguity"] == {"expressions": 0, "ambiguous": 0, "share": None, "set_sizes": {}}
        assert found["text"]["sentences_per_question"] is None
    if not labels.relations.num_rows:
        assert found["cells"]["u_share"] is None
        assert all(m == {"T": None, "F": None} for m in found["margins"].values())
    if of != {"frames": 0}:
        return
    assert found["counts"]["frames"] == 0
    assert len(write_report(labels, found, tmp_path / "report")) == 2


def test_numbers_that_are_none_do_not_stop_the_statistics(tmp_path: Path) -> None:
    """What the linter finds wrong must not keep it from being told."""
    import pyarrow as pa

    labels = make_labels(tmp_path / "labels", frames=3)
    path = labels.root / "objects.parquet"
    table = read_table(path, "objects")
    odd = {"distance": math.nan, "occluded": math.nan, "lo": [math.nan] * 3, "size": [math.inf] * 3}
    for name, value in odd.items():
        place = table.schema.get_field_index(name)
        field = table.schema.field(name)
        table = table.set_column(place, field, pa.array([value] * table.num_rows, field.type))
    write_table(table, path)
    found = label_statistics(labels)
    assert found["distance"]["unknown"]["objects"] == table.num_rows > 0


def test_damaged_tables_are_one_clear_error(tmp_path: Path) -> None:
    labels = make_labels(tmp_path / "labels", frames=12)
    path = labels.root / "relations.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    with pytest.raises(InputError, match="Parquet"):
        label_statistics(labels)
    # The footer is whole, the pages are not.
    path.write_bytes(whole[:4] + b"\xff" * (len(whole) // 2) + whole[4 + len(whole) // 2 :])
    with pytest.raises(InputError):
        label_statistics(labels)


class Page(HTMLParser):
    """What a browser would find: tags, and whether every tag is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_report_is_whole_and_escaped_and_replaces_only_a_report(tmp_path: Path) -> None:
    many = (*HOSTILE, *(f"class {k}" for k in range(40)))
    labels = make_labels(tmp_path / "labels", classes=many, frames=14, relations=PAIRWISE, seed=4)
    found = label_statistics(labels)
    out = tmp_path / "deep" / "report"
    files = write_report(labels, found, out)
    assert sorted(p.name for p in out.iterdir()) == ["index.html", "statistics.json"] == sorted(p.name for p in files)
    assert [p.name for p in out.parent.iterdir()] == ["report"]
    page = Page()
    page.feed(files[0].read_text(encoding="utf-8"))
    assert page.open == []
    assert page.tags["script"] == page.tags["img"] == 0
    assert page.tags["table"] == 4
    assert page.tags["tr"] > 4 + len(PAIRWISE) + 25
    assert json.loads((out / "statistics.json").read_text(encoding="utf-8")) == found
    before = [p.read_bytes() for p in files]
    assert [p.read_bytes() for p in write_report(labels, found, out)] == before


def test_a_report_leaves_other_pages_alone(tmp_path: Path) -> None:
    labels = make_labels(tmp_path / "labels", frames=1)
    found = label_statistics(labels)
    other = tmp_path / "site"
    other.mkdir()
    (other / "index.html").write_text("<h1>mine</h1>")
    (tmp_path / "file").write_text("mine")
    for out in (other, tmp_path / "file", labels.root):
        with pytest.raises(InputError):
            write_report(labels, found, out)
    assert (other / "index.html").read_text() == "<h1>mine</h1>"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "labels", "site"]


def counted(reports: list[FrameReport]) -> dict[str, Any]:
    counts = SurveyCounts()
    for report in reports:
        counts.add(report)
    return counts.record()


def test_every_relation_has_a_colour_of_its_own() -> None:
    assert len({RELATIONS[name].color for name in PAIRWISE}) == len(PAIRWISE)


def test_a_survey_is_summed_up() -> None:
    reports = [
        FrameReport(0, "a", True, None, 4, 3, 3, ("mug", "cup", "mug"), 0.5, 1.0, True, "declared", ("odd",)),
        FrameReport(1, "b", True, None, 4, 3, 0, (), 0.05, 1.0, False, None),
        FrameReport(2, "c", False, "frame c: no usable depth; got only zeros"),
        FrameReport(3, "d", False, "frame d: no usable depth; got only zeros"),
    ]
    found = counted(reports)
    assert found == {
        "frames": 4, "frames_usable": 2, "frames_broken": 2, "frames_decoded": 2, "notes": [],
        "problems": {"no usable depth": 2}, "remedies": {"no usable depth": "got only zeros"},
        "frames_with_little_depth": 1, "frames_without_pose": 1, "frames_without_objects": 1, "frames_with_notes": 1,
        "sizes": {"4x3": 2}, "up_source": {"declared": 1, "unknown": 1}, "depth_valid": 0.275,
        "objects": 3, "objects_per_frame": 1.5, "classes": {"mug": 2, "cup": 1},
    }  # fmt: skip
    counts = SurveyCounts()
    assert list(counts.watch(iter(reports))) == reports
    assert counts.record() == found
    assert counted([])["depth_valid"] is None
