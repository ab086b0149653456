"""Semantic Abstraction: its splits and subsets, and pickles that are none."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from semantic_abstraction_checks import VIEW, changed, refused, view  # noqa: F401
from semantic_abstraction_subsets import novel_class, novel_room, novel_visual, novel_vocabulary
from semantic_abstraction_writer import ViewTruth, write_view
from slow_cases import mostly_slow

from pipeline.datasets import SUBSETS, GivenExpression, open_dataset, splits, subsets_of
from pipeline.datasets.semantic_abstraction import SemanticAbstractionDataset
from pipeline.datasets.semantic_abstraction_splits import (
    NOVEL_CLASSES,
    RANDOMIZED,
    RENAMED,
    SYNONYMS,
    read_split,
    with_synonyms,
)
from pipeline.system import InputError


def opened(root: Path) -> SemanticAbstractionDataset:
    dataset = open_dataset(root)
    assert isinstance(dataset, SemanticAbstractionDataset)
    return dataset


# Splits

TEST_VIEW = "00009|FloorPlan30_physics"
TABLE = {
    "train": [f"{VIEW}.hdf5"],
    "unseen_instances": [f"{TEST_VIEW}.hdf5", "../outside.hdf5", "/etc/outside.hdf5", "not here.hdf5"],
    "unseen_instances_dr": [f"{TEST_VIEW}.hdf5"],
    "unseen_instances_synonyms": [f"{TEST_VIEW}.hdf5"],
}


@pytest.fixture(params=["json", "pkl", "pkl2"])
def divided(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    write_view(tmp_path / f"{VIEW}.hdf5")
    described = [("laptop", 5, "on", "desk"), ("mug", 6, "on", "desk"), ("book", 7, "behind", "lamp")]
    write_view(tmp_path / f"{TEST_VIEW}.hdf5", descriptions=described, randomized=True)
    (tmp_path.parent / "outside.hdf5").write_bytes(b"outside")
    if request.param == "json":
        (tmp_path / "vool_split.json").write_text(json.dumps(TABLE))
    else:
        table = TABLE if request.param == "pkl" else {name: set(files) for name, files in TABLE.items()}
        (tmp_path / "vool_split.pkl").write_bytes(pickle.dumps(table, protocol=4 if request.param == "pkl" else 2))
    return tmp_path


def test_splits_name_frames_that_are_here(divided: Path) -> None:
    assert splits(open_dataset(divided)) == {
        "vool/train": (VIEW,),
        "vool/unseen_instances": (TEST_VIEW,),
        "vool/unseen_instances_dr": (TEST_VIEW + RANDOMIZED,),
        "vool/unseen_instances_synonyms": (TEST_VIEW + RENAMED,),
    }


@pytest.mark.slow
def test_the_four_subsets(divided: Path) -> None:
    dataset = opened(divided)

    def texts(found: Any) -> list[tuple[str, str]]:
        return [(item.frame_id, item.expression.text) for item in found]

    plain = ["laptop on a desk", "book behind a lamp"]
    assert texts(novel_room(dataset)) == [(TEST_VIEW, text) for text in plain]
    assert texts(novel_visual(dataset)) == [(TEST_VIEW + RANDOMIZED, text) for text in plain]
    assert texts(novel_vocabulary(dataset)) == [(TEST_VIEW + RENAMED, "computer on a desk")]
    assert texts(novel_class(dataset)) == [
        (TEST_VIEW, "mug on a desk"),
        (TEST_VIEW + RANDOMIZED, "mug on a desk"),
        (TEST_VIEW + RENAMED, "mug on a desk"),
    ]
    assert [item.split for item in novel_class(dataset)] == list(TABLE)[1:]
    assert list(novel_room(dataset, "ssc")) == []
    everything = [*novel_room(dataset), *novel_visual(dataset), *novel_vocabulary(dataset), *novel_class(dataset)]
    for name, chosen in zip(SUBSETS, (novel_visual, novel_vocabulary, novel_class), strict=True):
        by_id = {
            (x.frame_id, x.expression.text)
            for x in everything
            if name in subsets_of(x.frame_id, x.expression.target, x.expression.reference)
        }
        assert by_id == set(texts(chosen(dataset)))
    assert dataset.load(next(novel_visual(dataset)).frame_id).annotations


def test_a_view_with_other_names_is_the_same_view(tmp_path: Path) -> None:
    write_view(tmp_path / f"{TEST_VIEW}.hdf5")
    dataset = opened(tmp_path)
    plain, renamed = (dataset.load(TEST_VIEW + end) for end in ("", RENAMED))
    assert np.array_equal(plain.rgb, renamed.rgb)
    assert np.array_equal(plain.depth, renamed.depth)
    names = [(a.label, b.label) for a, b in zip(plain.annotations, renamed.annotations, strict=True)]
    assert [SYNONYMS.get(own, own) for own, _ in names] == [other for _, other in names]
    assert any(own != other for own, other in names)
    assert dataset.scene_of(TEST_VIEW + RENAMED) == "FloorPlan30"
    assert dataset.scene_of("view_of_a_room") is None


def test_synonyms_and_novel_classes_are_the_published_ones() -> None:
    assert len(SYNONYMS) == 17
    assert len(NOVEL_CLASSES) == 6
    expression = GivenExpression("sofa in front of a laptop", "sofa", "front", "laptop", (1,), (2, 3))
    changed = with_synonyms(expression)
    assert changed == GivenExpression("couch in front of a computer", "couch", "front", "computer", (1,), (2, 3))
    unknown = GivenExpression("mug on a desk", "mug", "on", "desk")
    assert with_synonyms(unknown) == unknown


class Malicious:
    """A pickle of it makes a file when it is loaded the usual way."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


class Shell(Malicious):
    def __reduce__(self) -> Any:
        return os.system, (f"touch '{self.path}'",)


class Evaluated(Malicious):
    def __reduce__(self) -> Any:
        return eval, (f"open({str(self.path)!r}, 'w')",)


@pytest.mark.parametrize("kind", [Malicious, Shell, Evaluated])
@pytest.mark.parametrize("protocol", mostly_slow([4, 0, 2, 5]))
def test_a_pickle_with_code_is_refused_and_not_run(
    view: tuple[Path, ViewTruth], kind: type[Malicious], protocol: int
) -> None:
    root = view[0].parent
    mark = root / "was run"
    data = pickle.dumps({"train": [kind(mark)]}, protocol)
    pickle.loads(data)
    assert mark.exists(), "the pickle is harmless, and proves nothing"
    mark.unlink()
    (root / "vool_split.pkl").write_bytes(data)
    dataset = open_dataset(root)
    refused(lambda: splits(dataset), "the pickle holds something that is not read", "vool_split.pkl")
    assert not mark.exists()
    assert dataset.load(VIEW).annotations


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80\x04",
        b"garbage",
        pickle.dumps([1, 2]),
        pickle.dumps({"train": "abc"}),
        pickle.dumps({"train": [1]}),
        pickle.dumps({1: []}),
        pickle.dumps({"train": [f"{VIEW}.hdf5"]})[:-4],
        pickle.dumps({"train": np.array(["a.hdf5"])}),
        b"\x80\x04\x8c\x08builtins\x8c\x06getattr\x93.",
        b"\x82\x01.",
        b"P123\n.",
        b"\x80\x04]r\xff\xff\xff\x7f.",
    ],
)
def test_a_pickle_that_is_no_table_of_lists_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "ssc_split.pkl").write_bytes(data)
    refused(lambda: read_split(tmp_path / "ssc_split.pkl"), "ssc_split.pkl")


@settings(max_examples=30, deadline=None)
@given(st.binary(max_size=60))
def test_any_bytes_are_a_table_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any_split.pkl"
    path.write_bytes(data)
    with contextlib.suppress(InputError):
        assert isinstance(read_split(path), dict)
