"""Labels that are begun by hand: nothing is written before a frame comes in, and each frame comes in once."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from pipeline.corrections import JournalLocation, LabelEditor, Saved, materialise
from pipeline.corrections.journal import edits
from pipeline.datasets import Dataset, demo_path, open_dataset
from pipeline.labels import Labels, begun_labels, default_folder, grows, labelled_dataset, open_labels, with_frames
from pipeline.labels.check.linter import check_labels
from pipeline.system import InputError


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return open_dataset(demo_path())


def test_nothing_is_written_until_a_frame_comes_in(dataset: Dataset, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    labels = begun_labels(dataset, folder)
    assert grows(labels)
    assert labels.frames.num_rows == 0
    assert not folder.exists()
    second, first = dataset.frame_ids[3], dataset.frame_ids[0]
    labels = with_frames(with_frames(labels, dataset, [second]), dataset, [first, second])
    assert open_labels(folder).frames.column("frame").to_pylist() == [first, second]
    assert labels.manifest.counts["frames"] == 2
    assert labelled_dataset(labels.manifest).frame_ids == dataset.frame_ids
    assert not [f for f in check_labels(labels) if f.severity == "error"]
    assert begun_labels(dataset, folder).frames.num_rows == 2


def test_other_labels_do_not_grow_and_other_folders_are_left_alone(
    dataset: Dataset, demo_labels: Labels, tmp_path: Path
) -> None:
    assert not grows(demo_labels)
    with pytest.raises(InputError, match="begun by hand"):
        with_frames(demo_labels, dataset, [])
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="something else"):
        begun_labels(dataset, tmp_path)
    with pytest.raises(InputError, match="no such frame"):
        with_frames(begun_labels(dataset, tmp_path / "new"), dataset, ["nowhere"])
    assert not (tmp_path / "new").exists()


def test_several_add_frames_at_the_same_time(dataset: Dataset, tmp_path: Path) -> None:
    labels, names = begun_labels(dataset, tmp_path / "all"), dataset.frame_ids[:4]
    threads = [threading.Thread(target=with_frames, args=(labels, dataset, [n])) for n in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert open_labels(labels.root).frames.column("frame").to_pylist() == list(names)


def test_an_outlined_thing_is_saved_and_every_command_reads_it(dataset: Dataset, tmp_path: Path) -> None:
    labels = begun_labels(dataset, tmp_path / "mine")
    location = JournalLocation(labels)
    ann, name = LabelEditor(labels, location, "ann", dataset), dataset.frame_ids[0]
    assert name in ann
    assert "nowhere" not in ann
    ann.take_in(name)
    assert not labels.root.exists()
    frame = ann.frame(name)
    annotated = [a for a in dataset.load(name).annotations if a.mask is not None and np.count_nonzero(a.mask) > 2000]
    for annotation in annotated[:2]:
        frame = ann.frame(name)
        assert isinstance(ann.save(edits.add_object(frame, annotation.label, mask=annotation.mask)), Saved)
    frame = ann.frame(name)
    one, other = frame.objects
    assert frame.pairs.state(one, other, "left") is not None
    assert all(row["center"] is not None for row in frame.objects.values())
    # Another one of the same journal, who has not seen the frame come in.
    bob = LabelEditor(labels, location, "bob", dataset)
    assert bob.corrected(dataset.frame_ids[1]) is None
    seen = bob.corrected(name)
    assert seen is not None
    assert set(seen.objects) == {one, other}
    materialise(open_labels(labels.root), location.to_write(), tmp_path / "effective", dataset=dataset)
    written = open_labels(tmp_path / "effective")
    assert written.objects.num_rows == 2
    assert not [f for f in check_labels(written) if f.severity == "error"]
    location.close()


def test_the_default_folder_stands_beside_the_recording(dataset: Dataset, tmp_path: Path) -> None:
    found = default_folder(dataset, tmp_path)
    assert found.name == f"{dataset.root.name}-labels"
    assert found.parent in (dataset.root.resolve().parent, tmp_path)
