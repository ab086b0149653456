"""Files from elsewhere that are damaged, foreign or made to harm: each is told in a line, and nothing is saved."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from journal_world import FRAME

from pipeline.corrections import ImportConfig, ImportReport, Journal, import_corrections, journal_of
from pipeline.corrections.journal.incoming import claims as claims_module
from pipeline.corrections.journal.incoming.coco_file import (
    is_rectangle,
    mask_of,
    polygon_mask,
    polygons_of,
    same_outline,
)
from pipeline.labels import Labels, export_labels
from pipeline.system import InputError

Take = Callable[..., ImportReport]


@pytest.fixture(scope="module")
def coco(demo_labels: Labels, tmp_path_factory: pytest.TempPathFactory) -> Callable[[], dict[str, Any]]:
    """A fresh copy of the first image's part of an export."""
    folder = tmp_path_factory.mktemp("coco")
    export_labels(demo_labels, "coco", folder / "out")
    whole = json.loads((folder / "out" / "instances.json").read_bytes())
    (image,) = [i for i in whole["images"] if i["frame"] == FRAME]
    annotations = [a for a in whole["annotations"] if a["image_id"] == image["id"]]
    text = json.dumps({**whole, "images": [image], "annotations": annotations})
    return lambda: json.loads(text)


@pytest.fixture(scope="module")
def lines(demo_labels: Labels, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], list[dict[str, Any]]]:
    """The first rows of a table's export."""
    folder = tmp_path_factory.mktemp("jsonl")
    export_labels(demo_labels, "jsonl", folder / "out")

    def found(name: str) -> list[dict[str, Any]]:
        with open(folder / "out" / f"{name}.jsonl", encoding="utf-8") as file:
            return [json.loads(line) for _, line in zip(range(4), file, strict=False)]

    return found


@pytest.fixture
def take(demo_labels: Labels, journal: Journal) -> Take:
    def found(path: Path, **config: Any) -> ImportReport:
        return import_corrections(demo_labels, journal, path, "eve", ImportConfig(**config))

    return found


def first(content: dict[str, Any], **changed: Any) -> None:
    content["annotations"][0].update(changed)


COCO: list[tuple[str, Callable[[dict[str, Any]], Any], str]] = [
    ("unknown picture", lambda c: c["images"][0].update(frame="x/1"), "no such frame"),
    ("unknown file name", lambda c: c["images"][0].update(frame=None, file_name="IMG_7.jpg"), "no file name of an exp"),
    ("unknown number", lambda c: c["images"][0].update(frame=None, file_name="999999.jpg"), "no file name of an exp"),
    ("another size", lambda c: c["images"][0].update(width=1280), "another size"),
    ("an id that is a list", lambda c: c["images"][0].update(id=[1]), "whole number of its own"),
    ("a picture twice", lambda c: c["images"].append({**c["images"][0], "id": 77}), "second image of frame"),
    ("a picture that is none", lambda c: c["images"].append("x"), "not an object of JSON"),
    ("NaN box", lambda c: first(c, bbox=[1, 2, 1e400, 3]), "bbox is x, y, width, height"),
    ("negative box", lambda c: first(c, bbox=[10, 10, -5, 3]), "bbox is x, y, width, height"),
    ("box of text", lambda c: first(c, bbox=["1", "2", "3", "4"]), "bbox is x, y, width, height"),
    ("box of three", lambda c: first(c, bbox=[1, 2, 3]), "bbox is x, y, width, height"),
    ("box elsewhere", lambda c: first(c, bbox=[5000, 5000, 10, 10]), "outside the picture"),
    ("second id", lambda c: c["annotations"].append(dict(c["annotations"][0])), "whole number of its own"),
    ("second object", lambda c: c["annotations"].append({**c["annotations"][0], "id": 9999}), "second annotation of"),
    ("no such object", lambda c: first(c, object=4321), "had no object 4321"),
    ("object of text", lambda c: first(c, object="mug"), "object must be a number"),
    ("object true", lambda c: first(c, object=True), "object must be a number"),
    ("no such category", lambda c: first(c, category_id=4321), "no such category"),
    ("category of a list", lambda c: first(c, category_id=[1]), "no such category"),
    ("category without a name", lambda c: c["categories"].append({"id": 555}), "a category has a name"),
    ("category twice", lambda c: c["categories"].append(dict(c["categories"][0])), "whole number of its own"),
    ("empty class name", lambda c: [k.update(name=" ") for k in c["categories"]], "text that is not empty"),
    ("NUL in a class name", lambda c: [k.update(name="a\x00b") for k in c["categories"]], "cannot be kept"),
    ("image that is not listed", lambda c: first(c, image_id=4321), "which the file does not list"),
    ("annotation that is none", lambda c: c["annotations"].append(7), "not an object of JSON"),
    ("polygon of two corners", lambda c: first(c, segmentation=[[1, 2, 3, 4]]), "three corners or more"),
    ("polygon of text", lambda c: first(c, segmentation=[["a"] * 6]), "three corners or more"),
    ("polygon without end", lambda c: first(c, segmentation=[[1e400, 2, 3, 4, 5, 6]]), "three corners or more"),
    ("polygon outside", lambda c: first(c, segmentation=[[-9, -9, -8, -9, -8, -8]]), "the mask is empty"),
    ("endless polygon", lambda c: first(c, segmentation=[[0, 0, 639, 479] * 5_000]), "too long"),
    ("codes of another size", lambda c: first(c, segmentation={"size": [2, 2], "counts": [4]}), "another size"),
    ("codes that do not fill", lambda c: first(c, segmentation={"size": [480, 640], "counts": [4]}), "the mask"),
    ("huge codes", lambda c: first(c, segmentation={"size": [480, 640], "counts": [10**30]}), "the mask"),
    ("codes of text", lambda c: first(c, segmentation={"size": [480, 640], "counts": ["x"]}), "run-length code"),
    ("codes of nonsense", lambda c: first(c, segmentation={"size": [480, 640], "counts": "äöü"}), "the mask"),
    ("segmentation of text", lambda c: first(c, segmentation="circle"), "list of polygons"),
    ("no such status", lambda c: first(c, status="great"), "no such status"),
    ("box3d of text", lambda c: first(c, box3d="big"), "must have center, R and size"),
    (
        "box3d of NaN",
        lambda c: first(c, box3d={"center": [1e400] * 3, "size": [1] * 3, "R": []}),
        "must have center, R and size",
    ),
    ("box3d no rotation", lambda c: first(c, box3d={"center": [1] * 3, "size": [1] * 3, "R": [1] * 9}), "box"),
    ("box3d of two", lambda c: first(c, box3d={"center": [1] * 2, "size": [1] * 3, "R": [1] * 9}), "box"),
    (
        "new without a place",
        lambda c: c["annotations"].append({"id": 9999, "image_id": c["images"][0]["id"], "category_id": 1}),
        "bbox is x, y, width, height",
    ),
]


@pytest.mark.parametrize(("change", "said"), [c[1:] for c in COCO], ids=[c[0] for c in COCO])
def test_coco_that_is_not_in_order(
    coco: Callable[[], dict[str, Any]], journal: Journal, take: Take, tmp_path: Path, change: Any, said: str
) -> None:
    content = coco()
    # A sound correction in the same file must not be saved either.
    content["annotations"][-1]["status"] = "accepted"
    change(content)
    path = tmp_path / "instances.json"
    path.write_text(json.dumps(content).replace("Infinity", "1e400"), encoding="utf-8")
    report = take(path)
    assert report.saved is None
    assert any(said in line for line in report.problems), report.problems
    assert all(line.startswith("instances.json ") and "\n" not in line for line in report.problems)
    assert journal.events() == ()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "7",
        '"x"',
        "{}",
        '{"images": 3}',
        '{"images": [], "annotations": []}',
        "[" * 100_000,
        '{"images": [], "annotations": [], "categories": {}}',
        '{"annotations": [NaN]}',
        "\ufeff{}",
    ],
)
def test_json_that_is_no_coco(take: Take, tmp_path: Path, text: str) -> None:
    path = tmp_path / "instances.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"instances\.json|is said|lacks the list"):
        take(path, base="now")


ROWS: list[tuple[str, str, dict[str, Any], str]] = [
    ("frame", "objects", {"frame": "x/1"}, "no such frame"),
    ("frame of a list", "objects", {"frame": []}, "no such frame"),
    ("another frame's index", "objects", {"frame_index": 7}, "frame_index is of another frame"),
    ("no such object", "objects", {"object": 4321}, "had no object 4321"),
    ("object of text", "objects", {"object": "1"}, "object must be the number"),
    ("object true", "objects", {"object": True}, "object must be the number"),
    ("label of a number", "objects", {"label": 3}, "label: a class name"),
    ("long label", "objects", {"label": "x" * 300}, "too long"),
    ("half a surrogate", "objects", {"label": "\ud800"}, "cannot be kept"),
    ("mask of nonsense", "objects", {"mask": "zzz"}, "mask: not COCO"),
    ("mask of another size", "objects", {"mask": "04"}, "mask"),
    ("box of null", "objects", {"bbox": None}, "bbox: a 2D box"),
    ("box of NaN", "objects", {"bbox": [float("nan")] * 4}, "NaN is no number"),
    ("half a 3D box", "objects", {"center": None}, "some of them are null"),
    ("3D box of text", "objects", {"center": "mid"}, "box"),
    ("state", "relations", {"left": 2}, "no such state"),
    ("state true", "relations", {"left": True}, "no such state"),
    ("state of text", "relations", {"left": "T"}, "no such state"),
    ("state 1.5", "relations", {"left": 1.5}, "no such state"),
    ("pair of itself", "relations", {"b": 0, "a": 0, "left": 1}, "no relation"),
    ("no such pair", "relations", {"a": 4321, "left": 1}, "no object 4321"),
    ("statuses", "relations", {"statuses": {"left": "accepted"}}, "statuses is a list"),
    ("statuses of another", "relations", {"statuses": [{"relation": "x", "status": None}]}, "statuses is a list"),
    ("no such expression", "expressions", {"id": "zz"}, "no such expression"),
    ("text", "expressions", {"text": ""}, "text: a text"),
    ("targets", "expressions", {"targets": "all"}, "targets: must be a list"),
    ("a target that is not there", "expressions", {"targets": [4321]}, "no object 4321"),
    ("no answer", "expressions", {"targets": [], "acceptable": []}, "needs an answer"),
    ("ambiguous", "expressions", {"ambiguous": "yes"}, "true or false"),
    ("mark", "expressions", {"mark": "BAD"}, "no such mark"),
    ("status", "frames", {"status": "fine"}, "no such status"),
    ("note", "frames", {"note": 7}, "note: a text"),
]


@pytest.mark.parametrize(("table", "change", "said"), [c[1:] for c in ROWS], ids=[c[0] for c in ROWS])
def test_jsonl_that_is_not_in_order(
    lines: Callable[[str], list[dict[str, Any]]],
    journal: Journal,
    take: Take,
    tmp_path: Path,
    table: str,
    change: dict[str, Any],
    said: str,
) -> None:
    rows = lines(table)
    rows[1] |= change
    path = tmp_path / f"{table}.jsonl"
    path.write_text("".join(json.dumps(r) + "\n" for r in rows), encoding="utf-8")
    report = take(path)
    assert report.saved is None
    assert len(report.problems) == 1, report.problems
    assert report.problems[0].startswith(f"{table}.jsonl line 2: ")
    assert said in report.problems[0]
    assert journal.events() == ()


def test_rows_that_are_none_and_rows_that_come_twice(
    lines: Callable[[str], list[dict[str, Any]]], take: Take, tmp_path: Path
) -> None:
    row = json.dumps(lines("objects")[0])
    path = tmp_path / "objects.jsonl"
    path.write_text(f"{row}\n{{\n[1]\n\n{row}\n{'[' * 100_000}\n", encoding="utf-8")
    report = take(path)
    assert [line.split(":")[0] for line in report.problems] == [f"objects.jsonl line {n}" for n in (2, 3, 5, 6)]


def test_files_that_cannot_be_read(
    lines: Callable[[str], list[dict[str, Any]]], take: Take, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    binary = tmp_path / "objects.jsonl"
    binary.write_bytes(b"\xff\xfe\x00")
    for path in (binary, tmp_path / "nothing.jsonl", tmp_path, tmp_path / "x.txt"):
        with pytest.raises(InputError):
            take(path)
    binary.write_text(json.dumps(lines("objects")[0]) + "\n", encoding="utf-8")
    monkeypatch.setattr(claims_module, "BLOCK", 64)
    with pytest.raises(InputError, match="too long"):
        take(binary)
    large = tmp_path / "instances.json"
    large.write_text('{"annotations": []}', encoding="utf-8")
    monkeypatch.setenv("SPATIALVIZ_LIMITS", "text=3")
    with pytest.raises(InputError, match="too large"):
        take(large)


def test_a_file_of_something_else_is_not_read_to_its_end(
    take: Take, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(claims_module, "MOST_PROBLEMS", 5)
    path = tmp_path / "objects.jsonl"
    path.write_text('{"frame": "x"}\n' * 50, encoding="utf-8")
    report = take(path, base="now")
    assert len(report.problems) == 5


def test_files_of_other_labels_and_other_journals(
    lines: Callable[[str], list[dict[str, Any]]], take: Take, tmp_path: Path
) -> None:
    (row, *_), path = lines("objects"), tmp_path / "objects.jsonl"
    version = row["base"].split(".")[0]
    for base, said in (
        (f"{'0' * 16}.0.0", "other automatic labels"),
        (f"{version}.01ARZ3NDEKTSV4RRFFQ69G5FAV.0", "another journal"),
        ("yesterday", "not the state"),
        (7, "not the state"),
    ):
        path.write_text(json.dumps({**row, "base": base}), encoding="utf-8")
        with pytest.raises(InputError, match=said):
            take(path)
    with pytest.raises(InputError, match="not said what"):
        take(path, base=str(tmp_path))


def test_corrected_labels_take_no_corrections(demo_labels: Labels, journal: Journal, tmp_path: Path) -> None:
    from pipeline.corrections import materialise
    from pipeline.labels import open_labels

    materialise(demo_labels, journal, tmp_path / "labels")
    with pytest.raises(InputError, match="corrected already"):
        import_corrections(open_labels(tmp_path / "labels"), journal, tmp_path / "x.jsonl", "eve")


def test_what_the_journal_cannot_save_is_told(
    lines: Callable[[str], list[dict[str, Any]]], demo_labels: Labels, tmp_path: Path
) -> None:
    row = {**lines("objects")[0], "label": "jug"}
    (tmp_path / "objects.jsonl").write_text(json.dumps(row), encoding="utf-8")
    with journal_of(demo_labels, tmp_path / "j.sqlite") as journal, pytest.raises(InputError, match="an author"):
        import_corrections(demo_labels, journal, tmp_path / "objects.jsonl", "  ")


SIZE = (24, 32)
corner = st.tuples(st.floats(-8, 40), st.floats(-8, 32))


@given(st.lists(corner, min_size=3, max_size=8))
def test_polygons_are_filled_within_their_corners(corners: list[tuple[float, float]]) -> None:
    mask = polygon_mask([np.array(corners)], SIZE)
    assert mask.shape == SIZE
    v, u = np.nonzero(mask)
    if len(u):
        xs, ys = np.array(corners).T
        assert u.min() >= np.floor(xs.min()) - 1
        assert u.max() <= np.ceil(xs.max())
        assert v.min() >= np.floor(ys.min()) - 1
        assert v.max() <= np.ceil(ys.max())


@given(st.integers(0, 20), st.integers(0, 12), st.integers(4, 12), st.integers(4, 12), st.integers(0, 4))
def test_an_outline_is_the_same_to_within_its_tolerance(x: int, y: int, w: int, h: int, shift: int) -> None:
    one = np.zeros((40, 60), np.bool_)
    one[y : y + h, x : x + w] = True
    other = np.roll(one, shift, axis=1)
    assert same_outline(one, other, 1.5) == (shift <= 1)
    assert same_outline(one, one, 0)
    hole = one.copy()
    hole[y + 1 : y + h - 1, x + 1 : x + w - 1] = False
    assert same_outline(hole, one, 0)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=4),
        lambda inner: (
            st.lists(inner, max_size=7) | st.dictionaries(st.sampled_from(["size", "counts", "x"]), inner, max_size=3)
        ),
        max_leaves=12,
    )
)
def test_any_segmentation_gives_a_mask_or_one_clear_error(value: Any) -> None:
    with contextlib.suppress(InputError):
        found = mask_of(value, SIZE)
        assert found is None or (found.shape == SIZE and found.dtype == np.bool_)
        is_rectangle(value)
        if isinstance(value, list):
            polygons_of(value)


def test_rectangles() -> None:
    assert is_rectangle([[1, 2, 5, 2, 5, 9, 1, 9]])
    assert is_rectangle([[1, 2, 5, 2, 5, 9, 1, 9, 1, 2]])
    assert not is_rectangle([[1, 2, 5, 2, 5, 9, 1, 8]])
    assert not is_rectangle([[1, 2, 5, 2, 5, 9]])
    assert not is_rectangle([[1, 2, 5, 2, 5, 9, 1, 9]] * 2)
