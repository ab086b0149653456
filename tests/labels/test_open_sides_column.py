"""The column `open_sides` of labels: of upright boxes, null of others and of labels that were made before it came."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from label_sets import label_demo, validate_rows

from pipeline.geometry.boxes import SIDES
from pipeline.geometry.cleaning import LiftConfig
from pipeline.labels import LabelConfig, Labels, SourceSpec, export_labels, label_dataset, open_labels
from pipeline.labels.reading import content_hash

OLD = Path(__file__).parents[1] / "fixtures" / "2026-11-26" / "labels"


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Labels:
    return label_demo(tmp_path_factory.mktemp("upright") / "labels", 1)


def test_upright_boxes_say_their_open_sides(labels: Labels) -> None:
    validate_rows(labels.objects, "objects")
    rows = labels.objects.to_pylist()
    assert all((row["open_sides"] is None) == (row["center"] is None) for row in rows)
    sides = [row["open_sides"] for row in rows if row["center"] is not None]
    assert all(side == [s for s in SIDES if s in side] for side in sides)
    assert {s for side in sides for s in side} >= {"far", "bottom"}
    assert [] in sides


def test_boxes_of_other_fits_have_none(tmp_path: Path) -> None:
    label_dataset(SourceSpec("demo"), tmp_path / "labels", LabelConfig(lift=LiftConfig(box="gravity")), limit=1)
    objects = open_labels(tmp_path / "labels").objects
    assert objects.column("open_sides").null_count == objects.num_rows
    assert set(objects.column("estimator").to_pylist()) == {"gravity"}


def test_labels_of_before_read_as_null_with_their_hash() -> None:
    old = open_labels(OLD)
    objects = old.objects
    assert old.manifest.schema_version == "1.2.0"
    assert objects.column("open_sides").null_count == objects.num_rows > 0
    assert set(objects.column("estimator").to_pylist()) == {"gravity"}
    assert content_hash(objects, "objects") == old.manifest.tables["objects"].content_hash


def test_exports_carry_the_sides(labels: Labels, tmp_path: Path) -> None:
    export_labels(labels, "coco", tmp_path / "coco")
    annotations = json.loads((tmp_path / "coco" / "instances.json").read_bytes())["annotations"]
    assert [a["quality"]["open_sides"] for a in annotations] == labels.objects.column("open_sides").to_pylist()
