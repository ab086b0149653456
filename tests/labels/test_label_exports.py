"""Exports of labels: what is read back is what was written, and nothing is left half done."""

from __future__ import annotations

import contextlib
import io
import json
import math
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from export_readers import SURVIVING, import_labels, read_rows
from hypothesis import given
from hypothesis import strategies as st
from label_sets import K, frame_row, object_row, pair_row, write_labels
from slow_cases import mostly_slow

from pipeline.datasets import demo_path, open_dataset
from pipeline.geometry import Box3D, Camera, project
from pipeline.labels import TABLES, HubConfig, Labels, VqaConfig, build_table, export_labels, frame_stream, write_table
from pipeline.labels.exports import FORMATS, ExportFormat, exporting
from pipeline.labels.exports.base import json_lines
from pipeline.labels.reading import content_hash
from pipeline.labels.schema import SCHEMA_FOLDER, json_schemas, schema_text
from pipeline.system import InputError, plugins

LOSSLESS = [name for name, found in FORMATS.items() if found.lossless]


@pytest.mark.parametrize("kind", ["demo", "hostile", "empty"])
@pytest.mark.parametrize("format", LOSSLESS)
def test_what_is_read_back_is_what_was_exported(
    label_sets: dict[str, Labels], format: str, kind: str, tmp_path: Path
) -> None:
    labels = label_sets[kind]
    report = export_labels(labels, format, tmp_path / "out")
    assert all((tmp_path / "out" / name).exists() for name in report.files)
    tables = import_labels(tmp_path / "out", format)
    assert list(tables) == list(TABLES)
    for name, table in tables.items():
        assert table.schema.equals(getattr(labels, name).schema)
        assert table.to_pylist() == getattr(labels, name).to_pylist()
        assert content_hash(table, name) == labels.manifest.tables[name].content_hash


@pytest.mark.parametrize("format", mostly_slow(FORMATS, fast=(0,)))
def test_small_batches_write_the_same_files(
    demo_labels: Labels, format: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_labels(demo_labels, format, tmp_path / "whole")
    monkeypatch.setattr(frame_stream, "BATCH", 97)
    seen: list[tuple[int, int]] = []
    export_labels(demo_labels, format, tmp_path / "pieces", progress=lambda done, of: seen.append((done, of)))
    assert format == "parquet" or seen[-1] == (6, 6)
    for path in (tmp_path / "whole").rglob("*"):
        if path.is_file() and path.suffix != ".parquet":
            other = tmp_path / "pieces" / path.relative_to(tmp_path / "whole")
            assert other.read_bytes() == path.read_bytes(), path


@pytest.mark.parametrize("format", mostly_slow(FORMATS, fast=(1,)))
def test_an_export_that_is_stopped_leaves_nothing(
    label_sets: dict[str, Labels], demo_labels: Labels, format: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(job: object) -> None:
        FORMATS_BEFORE[format].write(job)  # type: ignore[arg-type]
        raise KeyboardInterrupt

    FORMATS_BEFORE = dict(FORMATS)
    earlier = export_labels(label_sets["hostile"], format, tmp_path / "kept").files
    before = {p: p.read_bytes() for p in (tmp_path / "kept").rglob("*") if p.is_file()}
    monkeypatch.setitem(exporting.FORMATS, format, replace(FORMATS[format], write=stopped))
    for target in ("new", "kept"):
        with pytest.raises(KeyboardInterrupt):
            export_labels(demo_labels, format, tmp_path / target, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]
    assert earlier
    assert {p: p.read_bytes() for p in (tmp_path / "kept").rglob("*") if p.is_file()} == before


def test_only_an_earlier_export_is_replaced(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    labels, out = label_sets["hostile"], tmp_path / "out"
    out.mkdir()
    export_labels(labels, "coco", out)
    with pytest.raises(InputError, match="expected another folder"):
        export_labels(labels, "jsonl", out)
    export_labels(labels, "jsonl", out, overwrite=True)
    assert (out / "frames.jsonl").exists()
    assert not (out / "instances.json").exists()
    foreign = tmp_path / "photos"
    foreign.mkdir()
    (foreign / "cat.jpg").write_bytes(b"x")
    (tmp_path / "file").write_text("x")
    for target, reason in ((foreign, "nothing that may be replaced"), (tmp_path / "file", "is a folder")):
        with pytest.raises(InputError, match=reason):
            export_labels(labels, "jsonl", target, overwrite=True)
    for target in (labels.root, labels.root.parent):
        with pytest.raises(InputError, match="cannot replace the labels"):
            export_labels(labels, "jsonl", target, overwrite=True)
    assert (foreign / "cat.jpg").exists()


def test_bad_input_is_told_in_one_line(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    labels = label_sets["hostile"]
    with pytest.raises(InputError, match="no such export format"):
        export_labels(labels, "yolo", tmp_path / "x")
    with pytest.raises(InputError, match="has no options"):
        export_labels(labels, "coco", tmp_path / "x", options=VqaConfig())
    with pytest.raises(InputError, match="expected VqaConfig"):
        export_labels(labels, "vqa", tmp_path / "x", options=HubConfig())
    with pytest.raises(InputError, match="holds no labels"):
        import_labels(tmp_path, "vqa")
    with pytest.raises(InputError, match="there is no such export"):
        import_labels(tmp_path / "nowhere", "coco")
    export_labels(labels, "jsonl", tmp_path / "out")
    with pytest.raises(InputError, match="in another format"):
        import_labels(tmp_path / "out", "coco")


@pytest.mark.parametrize(
    ("format", "file", "old", "new", "message"),
    [
        ("jsonl", "objects.jsonl", b'"score": 0.699', b'"score": 0.599', "changed after"),
        ("jsonl", "objects.jsonl", b'"score": 0.699', b'"score": "x', "not rows of objects"),
        ("jsonl", "objects.jsonl", b'"label": ', b'"colour": ', "not rows of objects"),
        ("coco", "instances.json", b'"annotations"', b'"annots"', "not a COCO export"),
        ("coco", "refs.json", b"]", b"", "not a readable JSON file"),
        ("coco", "relations.json", b'"left": [1', b'"left": [-1', "changed after"),
        ("parquet", "data/relations/train-00000-of-00001.parquet", b"PAR1", b"RAP1", "not a readable Parquet"),
    ],
)
def test_a_damaged_export_is_refused(
    label_sets: dict[str, Labels], format: str, file: str, old: bytes, new: bytes, message: str, tmp_path: Path
) -> None:
    export_labels(label_sets["hostile"], format, tmp_path / "out")
    path = tmp_path / "out" / file
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(InputError, match=message):
        import_labels(tmp_path / "out", format)
    path.unlink()
    with pytest.raises(InputError, match="missing"):
        import_labels(tmp_path / "out", format)


@given(
    st.lists(st.none() | st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=1),
    st.text(st.characters(exclude_categories=("Cs",))),
)
def test_a_number_and_a_text_survive_json_lines(numbers: list[float | None], text: str) -> None:
    rows = len(numbers)
    columns = {"frame": [text] * rows, "frame_index": [0] * rows, "a": range(rows), "b": [0] * rows}
    table = build_table("relations", {**columns, "distance": numbers, "doubted": [0] * rows, "left": [1] * rows})
    lines = list(json_lines(table))
    assert [len(line.splitlines()) for line in lines] == [1] * rows
    assert [json.loads(line) for line in lines] == table.to_pylist()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "relations.jsonl"
        path.write_text("".join(lines), encoding="utf-8")
        assert content_hash(read_rows(path, "relations"), "relations") == content_hash(table, "relations")


@pytest.mark.parametrize("format", ["jsonl", "coco"])
@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_number_that_json_cannot_carry_is_refused(tmp_path: Path, format: str, number: float) -> None:
    frame = frame_row(0, "f")
    objects = [object_row(frame, n, "mug", None) for n in (0, 1)]
    pairs = [pair_row(frame, 0, 1, {"left": 1})]
    labels = write_labels(tmp_path / "labels", {"frames": [frame], "objects": objects, "relations": pairs})
    columns = {name: [value] for name, value in {**pairs[0], "distance": number}.items()}
    write_table(build_table("relations", columns), labels.root / "relations.parquet")
    with pytest.raises(InputError, match="JSON cannot carry"):
        export_labels(labels, format, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_every_line_of_jsonl_fits_its_schema(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    for kind, every in (("demo", 29), ("hostile", 1)):
        export_labels(label_sets[kind], "jsonl", tmp_path / kind)
        for name in TABLES:
            schema = json.loads((tmp_path / kind / "schemas" / f"{name}.json").read_text(encoding="utf-8"))
            validator = jsonschema.Draft202012Validator(schema)
            # splitlines also splits at U+2028 and the like: no line may hold one.
            lines = (tmp_path / kind / f"{name}.jsonl").read_text(encoding="utf-8").splitlines()
            assert len(lines) == label_sets[kind].table(name).num_rows
            for line in lines[::every]:
                validator.validate(json.loads(line))
            assert not validator.is_valid({**json.loads(lines[0]), "frame_index": -1})
        manifest = json.loads((tmp_path / kind / "manifest.json").read_text(encoding="utf-8"))
        jsonschema.validate(manifest, json_schemas()["manifest"])


def test_the_committed_json_schemas_are_those_of_the_models() -> None:
    again = "the models changed: raise SCHEMA_VERSION if need be, and run python -m pipeline.labels.schema"
    assert {p.stem for p in SCHEMA_FOLDER.glob("*.json")} == set(json_schemas()), again
    for name, schema in json_schemas().items():
        assert (SCHEMA_FOLDER / f"{name}.json").read_text(encoding="utf-8") == schema_text(schema), again


@pytest.mark.parametrize("kind", mostly_slow(["hostile", "demo"]))
def test_pycocotools_reads_the_coco_export(label_sets: dict[str, Labels], kind: str, tmp_path: Path) -> None:
    from pycocotools import mask as coco_mask
    from pycocotools.coco import COCO

    export_labels(label_sets[kind], "coco", tmp_path / "out")
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO(str(tmp_path / "out" / "instances.json"))
    frames = {row["frame_index"]: row for row in label_sets[kind].frames.to_pylist() if row["ok"]}
    assert set(coco.getImgIds()) == set(frames)
    anns = coco.loadAnns(coco.getAnnIds())
    rows = label_sets[kind].objects.to_pylist()
    assert len(anns) == len(rows)
    for ann, row in zip(anns, rows, strict=True):
        assert coco.cats[ann["category_id"]]["name"] == row["label"]
        assert ann["id"] > 0
        frame = frames[row["frame_index"]]
        mask = coco.annToMask(ann)
        assert mask.shape == (frame["height"], frame["width"])
        x, y, w, h = ann["bbox"]
        np.testing.assert_allclose([x, y, x + w, y + h], row["bbox"], atol=1e-9)
        if row["mask"] is not None:
            own = coco_mask.decode({"size": [frame["height"], frame["width"]], "counts": row["mask"].encode()})
            assert mask.sum() == row["mask_pixels"] == ann["area"]
            np.testing.assert_array_equal(mask, own)


def test_references_name_annotations(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    export_labels(label_sets["demo"], "coco", tmp_path / "out")
    anns = {a["id"]: a for a in json.loads((tmp_path / "out/instances.json").read_bytes())["annotations"]}
    refs = json.loads((tmp_path / "out/refs.json").read_bytes())
    assert len(refs) == label_sets["demo"].expressions.num_rows
    for ref, row in zip(refs, label_sets["demo"].expressions.to_pylist(), strict=True):
        acceptable = [anns[k] for k in ref["acceptable_ann_ids"]]
        assert [a["object"] for a in acceptable] == row["acceptable"]
        assert {a["image_id"] for a in acceptable} == {ref["image_id"]} == {row["frame_index"]}
        assert anns[ref["ann_id"]]["category_id"] == ref["category_id"]
        assert anns[ref["reference_ann_id"]]["object"] == row["reference_object"]
        assert ref["sentences"][0]["raw"] == row["text"]
        assert ref["sentences"][0]["tokens"]


@pytest.mark.parametrize("kind", ["demo", "hostile", "empty"])
def test_what_survives_in_kitti_comes_back(label_sets: dict[str, Labels], kind: str, tmp_path: Path) -> None:
    labels = label_sets[kind]
    report = export_labels(labels, "kitti", tmp_path / "out")
    tables = import_labels(tmp_path / "out", "kitti")
    assert {name: tuple(t.column_names) for name, t in tables.items()} == SURVIVING
    exact = {
        "frames": ("frame", "frame_index", "ok", "width", "height"),
        "objects": ("frame", "frame_index", "object", "label", "score", "bbox", "touches_border"),
    }
    for name, columns in exact.items():
        assert tables[name].select(list(columns)).to_pylist() == labels.table(name).select(list(columns)).to_pylist()
    for name, columns in (("frames", ("K", "up")), ("objects", ("center", "R", "size"))):
        for back, row in zip(tables[name].to_pylist(), labels.table(name).to_pylist(), strict=True):
            for column in columns:
                if row[column] is None or row.get("estimator") == "pca":
                    assert back[column] is None
                else:
                    np.testing.assert_allclose(back[column], row[column], rtol=1e-11, atol=5e-9)
    boxed = [row for row in labels.objects.to_pylist() if row["center"] is not None]
    assert report.rows["boxes"] == sum(row["estimator"] in ("upright", "gravity") for row in boxed)
    assert any("not upright" in note for note in report.notes) == (kind == "hostile")


def test_kitti_boxes_project_to_the_same_pixels(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    """By the devkit's own recipe, read from the text files: P2 times the corners of h, w, l, x, y, z, rotation_y."""
    export_labels(label_sets["demo"], "kitti", tmp_path / "out")
    frames = {row["frame_index"]: row for row in label_sets["demo"].frames.to_pylist()}
    worst = compared = tilted = 0
    for index, frame in frames.items():
        camera = Camera(np.array(frame["K"]).reshape(3, 3), frame["width"], frame["height"])
        text = (tmp_path / f"out/calib/{index:06d}.txt").read_text()
        calib = {line.split(":")[0]: np.array(line.split(":")[1].split(), float) for line in text.splitlines()}
        P2, R0 = calib["P2"].reshape(3, 4), calib["R0_rect"].reshape(3, 3)
        tilted += np.abs(R0 - np.eye(3)).max() > 0.05
        rows = [row for row in label_sets["demo"].objects.to_pylist() if row["frame_index"] == index]
        lines = (tmp_path / f"out/label_2/{index:06d}.txt").read_text().splitlines()
        for line, row in zip(lines, rows, strict=True):
            h, w, length, x, y, z, ry = map(float, line.split()[8:15])
            corners = np.array(
                [[sx * length / 2, sy, sz * w / 2] for sx in (-1, 1) for sy in (-h, 0) for sz in (-1, 1)]
            )
            turn = np.array([[np.cos(ry), 0, np.sin(ry)], [0, 1, 0], [-np.sin(ry), 0, np.cos(ry)]])
            level = corners @ turn.T + [x, y, z]
            box = Box3D(np.array(row["center"]), np.array(row["R"]).reshape(3, 3), np.array(row["size"]))
            if box.corners[:, 2].min() < 0.1:
                continue
            mapped = np.hstack([level, np.ones((8, 1))]) @ P2.T
            worst = max(worst, np.abs(mapped[:, :2] / mapped[:, 2:] - project(box.corners, camera)).max())
            # The full chain from a point of the camera frame gives its pixel as well.
            chain = box.corners @ R0.T @ P2[:, :3].T
            np.testing.assert_allclose(chain[:, :2] / chain[:, 2:], project(box.corners, camera), atol=1e-6)
            compared += 1
    assert compared > 300
    assert tilted > 6
    assert worst < 1e-3


def test_kitti_of_a_level_camera_is_plain_kitti(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    export_labels(label_sets["hostile"], "kitti", tmp_path / "out")
    text = (tmp_path / "out/calib/000003.txt").read_text()
    P2 = np.array(text.split("P2: ")[1].split("\n")[0].split(), float).reshape(3, 4)
    np.testing.assert_allclose(P2, np.hstack([np.array(K).reshape(3, 3), np.zeros((3, 1))]), atol=1e-12)
    mug, leaning, _ = ((line.split()) for line in (tmp_path / "out/label_2/000003.txt").read_text().splitlines())
    # A box 0.2 wide, 0.3 high, 0.4 deep around (0, 0, 2), turned by 0.3: its bottom is 0.15 below.
    np.testing.assert_allclose([float(x) for x in mug[8:15]], [0.3, 0.4, 0.2, 0, 0.15, 2, 0.3], atol=1e-9)
    assert float(mug[3]) == pytest.approx(0.3)
    assert (mug[1], leaning[1]) == ("0", "1")
    assert leaning[8:15] == ["-1", "-1", "-1", "-1000", "-1000", "-1000", "-10"]
    assert not (tmp_path / "out/label_2/000001.txt").exists()
    for path in (tmp_path / "out/label_2").iterdir():
        assert all(len(line.split()) == 16 for line in path.read_text(encoding="utf-8").splitlines())
        assert "DontCare " not in path.read_text(encoding="utf-8")


def test_pictures_come_along(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    dataset = open_dataset(demo_path())
    export_labels(label_sets["demo"], "coco", tmp_path / "coco", images="copy")
    image = json.loads((tmp_path / "coco/instances.json").read_bytes())["images"][7]
    rgb = dataset.load(image["frame"]).rgb
    bgr = cv2.imread(str(tmp_path / "coco" / image["file_name"]))
    assert bgr is not None
    written = bgr[..., ::-1]
    assert np.abs(written.astype(int) - rgb).mean() < 3
    with pytest.raises(InputError, match="no frame"):
        export_labels(label_sets["hostile"], "vqa", tmp_path / "vqa", images="copy", dataset=dataset)
    with pytest.raises(InputError, match="no such dataset"):
        export_labels(label_sets["hostile"], "jsonl", tmp_path / "jsonl", images="copy")
    assert [p.name for p in tmp_path.iterdir()] == ["coco"]


def test_the_hub_layout_is_cut_into_files(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    report = export_labels(label_sets["demo"], "parquet", tmp_path / "out", options=HubConfig(1000, 'CC BY: "4.0"'))
    files = sorted(p.name for p in (tmp_path / "out/data/relations").iterdir())
    assert files[0] == "train-00000-of-00010.parquet"
    assert len(files) == 10
    assert report.rows["relations"] == 9822
    tables = import_labels(tmp_path / "out", "parquet")
    assert (
        content_hash(tables["relations"], "relations") == label_sets["demo"].manifest.tables["relations"].content_hash
    )
    (tmp_path / "out/data/relations/train-00003-of-00010.parquet").unlink()
    with pytest.raises(InputError, match="missing"):
        import_labels(tmp_path / "out", "parquet")


def test_a_plugin_adds_a_format(label_sets: dict[str, Labels], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Point:
        def __init__(self, name: str, loaded: object) -> None:
            self.name = self.value = name
            self._loaded = loaded

        def load(self) -> object:
            if isinstance(self._loaded, Exception):
                raise self._loaded
            return self._loaded

    own = ExportFormat(FORMATS["jsonl"].write, None, "ours")
    points = [Point("ours", own), Point("broken", RuntimeError("no")), Point("odd", 3)]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points if group == "spatialviz.exports" else [])
    with pytest.warns(UserWarning, match="export plugin"):
        export_labels(label_sets["hostile"], "ours", tmp_path / "out")
    assert read_rows(tmp_path / "out" / "frames.jsonl", "frames").num_rows == 4
