"""Labels of a dataset that says its relations itself: they are what it says, and no geometry is asked."""

from __future__ import annotations

from pathlib import Path

import pytest
from needs import needs
from semantic_abstraction_writer import write_view

from pipeline.datasets import given_expressions, open_dataset
from pipeline.labels import LabelConfig, SourceSpec, check_labels, label_dataset, open_labels
from pipeline.system import InputError

pytestmark = needs("h5py", "embreex")

VIEW = "FloorPlan1_0"
CONFIG = LabelConfig(vocabulary="semantic-abstraction", profile="given", style="semantic-abstraction")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One view; two of its things are said to be behind and left of others, whatever geometry says."""
    folder = tmp_path_factory.mktemp("given")
    write_view(folder / f"{VIEW}.hdf5", points=2_000)
    things = open_dataset(folder).load(VIEW).annotations
    names = [a.label for a in things]
    first, second, third = [a for a in things if names.count(a.label) == 1 and a.mask is not None][:3]
    said = [(first.label, first.index, "behind", second.label), (third.label, third.index, "left", first.label)]
    write_view(folder / f"{VIEW}.hdf5", points=2_000, descriptions=said)
    return folder


def test_states_are_those_that_the_dataset_says(root: Path, tmp_path: Path) -> None:
    label_dataset(SourceSpec(str(root)), tmp_path / "labels", CONFIG)
    labels = open_labels(tmp_path / "labels")
    said = {
        (e.target_indices[0], e.reference_indices[0], e.relation)
        for e in given_expressions(open_dataset(root), labels.frames.column("frame")[0].as_py())
        if len(e.target_indices) == len(e.reference_indices) == 1
    }
    held = {
        (row["a"], row["b"], relation)
        for row in labels.relations.to_pylist()
        for relation in labels.relation_names
        if row[relation] == 1
    }
    assert said
    assert held == said
    assert not [f for f in check_labels(labels) if f.severity == "error"]


def test_a_split_that_there_is_not_is_told(root: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such split"):
        label_dataset(SourceSpec(str(root)), tmp_path / "labels", CONFIG, frames_of=("vool/none",))
    assert not (tmp_path / "labels").exists()
