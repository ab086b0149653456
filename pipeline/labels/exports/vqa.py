"""Questions and answers for fine-tuning a vision-language model, as LLaVA's conversations.

`conversations.json` is a list of {"id", "image", "conversations": [human, gpt],
"metadata"}, one record a line. Kinds of questions:

* relation: answered Yes or No, from states T and F that stand `min_margin` from
  every threshold, never from U; as many Yes as No of each relation.
* which: answered by a class name, where one object has the relation and every
  other judged object has it not.
* grounding: answered by [x0, y0, x1, y1] as shares of the whole picture's width
  and height, for expressions that only one object satisfies.
* distance: between the centres of two objects, or the gap between their nearest points.
* size: extent along the viewer's up ("height") and right ("width").

An object is named only where its name means no other object of the frame.
Distances and sizes are asked where a 3D box is given or the object is seen whole,
and `metadata.rests_on` says which: see `pipeline.labels.exports.vqa_geometry`.
Without the dataset's depth only given boxes are measured, which a note says. Which questions are
asked, and how, depends on the rows and the seed alone.

`provenance` of a record lists, of the objects, the pair and the expression that a
question is made from, every value that is not the labeller's: `table`, `key` and
the keys of `pipeline.labels.exports.provenance`. Whatever it does not list is "auto".
"""

from __future__ import annotations

from pipeline.labels.exports.base import ExportFormat, FrameRows, Job, Written, image_name, iterate_frames
from pipeline.labels.exports.provenance import JsonList, Provenance
from pipeline.labels.exports.vqa_geometry import Depths, figures_of
from pipeline.labels.exports.vqa_questions import frame_questions
from pipeline.labels.exports.vqa_records import CONVERSATIONS_FILE, Question, VqaConfig
from pipeline.system.whole_files import text_file

__all__ = ["FORMAT", "VqaConfig", "write_vqa"]


def write_vqa(job: Job) -> Written:
    """Write the conversations of all frames, as a stream."""
    counts = {"questions": 0, **dict.fromkeys(job.options.kinds, 0)}
    relations, depths = job.labels.relation_names, Depths(job.dataset)
    measured = bool({"distance", "size"} & set(job.options.kinds))
    with text_file(job.folder / CONVERSATIONS_FILE) as file:
        records = JsonList(file)
        for rows in iterate_frames(job.labels, job.tell):
            figures = figures_of(rows, job.options, depths, boxed_by_people(job.provenance, rows)) if measured else []
            asked = frame_questions(rows, relations, job.options, figures)
            for question in asked:
                known = {"base": job.provenance.base, "made_by": job.provenance.made_by}
                records.add({**question.record(), **known, "provenance": _provenance(job, question)})
                counts[question.kind] += 1
            if job.images is not None and asked:
                job.images.write(rows.frame, job.folder / image_name(rows.index))
        records.close()
        file.write("\n")
    counts["questions"] = records.length
    files = (CONVERSATIONS_FILE, *(("images/",) if job.images is not None else ()))
    note = (
        f"{depths.missing} frames without depth, where gaps are not asked, and sizes and distances of given 3D boxes "
        f"only: {depths.problem}"
    )
    return Written(files, counts, (note,) if depths.missing else ())


def boxed_by_people(provenance: Provenance, rows: FrameRows) -> frozenset[int]:
    """Numbers of the objects of a frame whose 3D box a person set."""
    return frozenset(
        row["object"]
        for row in rows.objects
        for entry in provenance.of("objects", rows.frame["frame"], str(row["object"]))
        if entry["column"] == "size" and entry["source"] == "human"
    )


def _provenance(job: Job, question: Question) -> list[dict[str, object]]:
    """Of the rows that a question and its answer were made from: their values that are not the labeller's."""
    known, frame = job.provenance, question.frame
    rows = [("objects", str(n)) for n in question.objects]
    if len(question.objects) == 2 and question.kind in ("relation", "which", "grounding"):
        rows.append(("relations", f"{question.objects[0]},{question.objects[1]}"))
    if question.source is not None:
        rows.append(("expressions", question.source))
    return [{"table": table, "key": key, **entry} for table, key in rows for entry in known.of(table, frame, key)]


FORMAT = ExportFormat(
    write_vqa, None, "questions and answers as LLaVA conversations, for fine-tuning", lossless=False, options=VqaConfig
)
