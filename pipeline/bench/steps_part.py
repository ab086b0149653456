"""Single steps of a person's work, in the core: a label set, a what-if step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from time import process_time

from pipeline.answering import open_pipeline
from pipeline.bench.clock import Figure, Setup, least, side_by_side, synced_row
from pipeline.bench.worlds import SCENE, crowded_frame
from pipeline.corrections import Edit, JournalLocation, LabelEditor, object_ref
from pipeline.diagnosis.whatif import Baseline, Edits, rerun
from pipeline.diagnosis.whatif.answer_view import answer_view
from pipeline.labels import SourceSpec, label_dataset, open_labels
from pipeline.system.whole_files import scratch_folder
from pipeline.system.worker_pool import one_thread

NAMES = ("mug", "book", "lamp")
ASKED = "mug left of the book"
FRAME, NUMBER = f"{SCENE}/000001", 3


def measure(setup: Setup) -> Iterator[Figure]:
    """Measure both in processor time."""
    with scratch_folder() as folder, one_thread():
        label_dataset(SourceSpec("demo"), folder / "labels", limit=3)
        labels, names = open_labels(folder / "labels"), count()
        place = JournalLocation(labels, folder / "journal.sqlite")
        editor = LabelEditor(labels, place, "bench", open_pipeline("demo").dataset)

        def set_label() -> None:
            frame, ref = editor.frame(FRAME), object_ref(FRAME, NUMBER, "label")
            edit = Edit(ref, frame.value(ref), NAMES[next(names) % len(NAMES)], frame.version(ref))
            editor.save([edit])
            editor.frame(FRAME)

        floor = synced_row(folder)
        found = side_by_side([set_label, lambda: next(floor)], setup.times(30, 6))
        place.close()
        yield "steps.label", found[0] * 1000, found[1] * 1000
        yield "steps.whatif", *whatif(setup, crowded_frame(folder / "sixty", 60, NAMES))


def whatif(setup: Setup, root: Path) -> tuple[float, float]:
    """Milliseconds of moving a box, answering again and comparing; and of the whole question."""
    pipeline = open_pipeline(str(root))
    context = pipeline.prepare(0)
    baseline = Baseline(pipeline, context, ASKED)
    key, box = baseline.outcome.keys[0], baseline.outcome.trace.objects[0].lifted.box
    assert box is not None
    seconds = []
    for k in range(1, setup.times(20, 5)):
        edits = Edits().with_box(key, replace(box, center=box.center + k / 100))
        start = process_time()
        answer_view(context, rerun(baseline, edits), edits)
        seconds.append(process_time() - start)
    anew = least(lambda: Baseline(pipeline, pipeline.prepare(0), ASKED), setup.times(3, 1))
    return min(seconds) * 1000, anew * 1000
