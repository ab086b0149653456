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
Without the dataset's depth no gaps are asked, which a note says. Which questions are
asked, and how, depends on the rows and the seed alone. The words for objects and
relations are those of the expressions.

`provenance` of a record lists, of the objects, the pair and the expression that a
question is made from, every value that is not the labeller's: `table`, `key` and
the keys of `pipeline.labels.exports.base`. Whatever it does not list is "auto".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from operator import attrgetter
from typing import Any

import numpy as np

from pipeline.labels.exports.base import (
    ExportFormat,
    ExportFrame,
    Job,
    JsonList,
    Provenance,
    Written,
    image_name,
    iterate_frames,
)
from pipeline.labels.exports.vqa_geometry import (
    POINTS,
    Depths,
    Figures,
    Kind,
    VqaConfig,
    figures_of,
    gap_between,
)
from pipeline.labels.labelling import row_hash
from pipeline.labels.wording import can_be_worded, question_text
from pipeline.language.noun_phrase import alone, noun_phrase, readable
from pipeline.language.relation_names import RELATIONS
from pipeline.relations.relations import F, T
from pipeline.system.errors import InputError, Shown, require
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import text_file

IMAGE_TOKEN = "<image>"
CONVERSATIONS_FILE = "conversations.json"
SIZE_AXES = {"height": 1, "width": 0}
"""What sizes are asked for, and along which of (right, up, forward)."""


@dataclass(frozen=True)
class PlannedQuestion:
    """A question that may be asked, of objects by their index; its text is made when it is its turn."""

    key: int
    """Hash that orders the questions of a kind."""
    kind: Kind
    indices: tuple[int, ...]
    """relation: (target, reference). which: (answer, reference). grounding: (target, reference). distance: the two.
    size: the one."""
    about: str
    """The relation; or what is measured: "center", "gap", "height", "width"."""
    text: Callable[[], str]
    answer: str
    source: str | None = None
    """Of a grounding question the id of its expression."""
    rests_on: str | None = None
    """Of a distance or a size what its figure was measured on: see `vqa_geometry`."""


Unit = tuple[PlannedQuestion, ...]
"""Questions that are asked together or not at all."""
_by_key = attrgetter("key")


@dataclass(frozen=True)
class VqaFrame:
    """One frame, made ready for asking."""

    rows: ExportFrame
    config: VqaConfig
    number: np.ndarray
    """(N,) int: the objects' numbers."""
    clear: np.ndarray
    """(N,) bool: usable objects whose name means no other object of the frame."""
    figures: Sequence[Figures]

    def label(self, index: int) -> str:
        return self.rows.objects[index]["label"]

    def key(self, kind: str, *parts: object) -> int:
        return row_hash(self.config.seed, self.rows.frame["frame"], kind, *parts)

    def record(self, ask: PlannedQuestion) -> dict[str, Any]:
        """Question in words, as LLaVA's training data has it; InputError where a sentence cannot carry the names."""
        index = self.rows.index
        return {
            "id": f"{index:06d}-{ask.kind}-{ask.key:016x}",
            "image": image_name(index),
            "conversations": [
                {"from": "human", "value": f"{IMAGE_TOKEN}\n{ask.text()}"},
                {"from": "gpt", "value": ask.answer},
            ],
            "metadata": {
                "kind": ask.kind,
                "frame": self.rows.frame["frame"],
                "frame_index": index,
                "objects": [int(self.number[k]) for k in ask.indices],
                "about": ask.about,
                "source": ask.source,
                "rests_on": ask.rests_on,
            },
        }


def frame_questions(
    rows: ExportFrame, relations: Sequence[str], config: VqaConfig, figures: Sequence[Figures]
) -> list[dict[str, Any]]:
    """Records of the chosen questions of a frame: kinds take turns up to `per_frame`.

    A relation that holds is asked together with one of the same name that does
    not, so that there are as many yes as no, of every relation. `figures` are the
    objects', see `vqa_geometry.figures_of`.
    """
    if not rows.frame["ok"] or not rows.objects:
        return []
    named_alone = alone([row["label"] for row in rows.objects])
    clear = named_alone & [row["usable"] and can_be_asked(row["label"]) for row in rows.objects]
    scene = VqaFrame(rows, config, np.array([row["object"] for row in rows.objects], np.int64), clear, figures)
    units: dict[str, Callable[[], Iterable[Unit]]] = {
        "relation": lambda: relation_units(scene, relations),
        "which": lambda: zip(which_asks(scene, relations)),
        "grounding": lambda: zip(grounding_asks(scene)),
        "distance": lambda: zip(distance_asks(scene)),
        "size": lambda: zip(size_asks(scene)),
    }
    waiting = [iter(units[kind]()) for kind in config.kinds]
    found: list[dict[str, Any]] = []
    while waiting and len(found) < config.per_frame:
        for kind in list(waiting):
            asked = _next_asked(scene, kind)
            if asked is None or len(found) + len(asked) > config.per_frame:
                waiting.remove(kind)
            else:
                found += asked
    return found


def _next_asked(scene: VqaFrame, units: Iterator[Unit]) -> list[dict[str, Any]] | None:
    for unit in units:
        try:
            return [scene.record(ask) for ask in unit]
        except InputError:
            # A name that a sentence cannot carry beside the other one.
            continue
    return None


def _pairs(scene: VqaFrame, relation: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of a frame: indices of a and b among the objects, and a relation's state and margin; (P,) each."""
    table = scene.rows.relations
    order = np.argsort(scene.number)
    a, b = (order[np.searchsorted(scene.number, table.column(n).to_numpy(), sorter=order)] for n in ("a", "b"))
    # Null, as where a profile does not judge, is as little known as U.
    state, margin = (
        np.nan_to_num(table.column(n).to_numpy().astype(np.float64)) for n in (relation, f"{relation}_margin")
    )
    return a, b, state.astype(np.int64), margin


def relation_units(scene: VqaFrame, relations: Sequence[str]) -> Iterator[Unit]:
    """Pairs of a yes and a no of the same relation, the relations in turn."""
    lists: list[list[Unit]] = []
    for relation in relations:
        a, b, state, margin = _pairs(scene, relation)
        clear = scene.clear[a] & scene.clear[b] & (np.abs(margin) >= scene.config.min_margin)
        ranked = []
        for wanted in (T, F):
            asked = clear & (state == wanted)
            keyed = sorted(
                (scene.key("relation", relation, scene.number[i], scene.number[j]), i, j)
                for i, j in zip(a[asked].tolist(), b[asked].tolist(), strict=True)
            )
            ranked.append(
                [
                    PlannedQuestion(
                        key,
                        "relation",
                        (i, j),
                        relation,
                        partial(ask_relation, relation, scene.label(i), scene.label(j), key),
                        "Yes" if wanted == T else "No",
                    )
                    for key, i, j in keyed
                ]
            )
        lists.append(list(zip(*ranked, strict=False)))
    for turn in range(max(map(len, lists), default=0)):
        yield from sorted((units[turn] for units in lists if turn < len(units)), key=lambda unit: unit[0].key)


def which_asks(scene: VqaFrame, relations: Sequence[str]) -> list[PlannedQuestion]:
    """Questions for the only object surely in a relation to a reference."""
    found = []
    n = len(scene.number)
    for relation in relations:
        a, b, state, margin = _pairs(scene, relation)
        judged, holds, not_so = (np.bincount(b[rows], minlength=n) for rows in (np.s_[:], state == T, state == F))
        unique = (holds == 1) & (not_so == judged - 1) & scene.clear
        sure = (state == T) & (margin >= scene.config.min_margin) & unique[b]
        for i, j in zip(a[sure].tolist(), b[sure].tolist(), strict=True):
            if scene.rows.objects[i]["usable"] and can_be_asked(scene.label(i)):
                key = scene.key("which", relation, scene.number[i], scene.number[j])
                text = partial(ask_which, relation, scene.label(j), key)
                found.append(PlannedQuestion(key, "which", (i, j), relation, text, readable(scene.label(i))))
    return sorted(found, key=_by_key)


def grounding_asks(scene: VqaFrame) -> list[PlannedQuestion]:
    """Questions for the box of an expression's only object."""
    frame = scene.rows.frame
    index_of = {int(number): k for k, number in enumerate(scene.number)}
    found = []
    for row in scene.rows.expressions:
        if row["ambiguous"] or row["acceptable"] != [row["target_object"]]:
            continue
        pair = index_of[row["target_object"]], index_of[row["reference_object"]]
        x0, y0, x1, y1 = scene.rows.objects[pair[0]]["bbox"]
        if x1 > x0 and y1 > y0:
            key = scene.key("grounding", row["id"])
            box = box_text((x0, y0, x1, y1), frame["width"], frame["height"], scene.config.box_decimals)
            text = partial(ask_grounding, row["text"], key)
            found.append(PlannedQuestion(key, "grounding", pair, row["relation"], text, box, row["id"]))
    return sorted(found, key=_by_key)


def distance_asks(scene: VqaFrame) -> Iterator[PlannedQuestion]:
    """Questions for the distance of two objects, by centres or by the gap between."""
    found: list[tuple[int, str, int, int]] = []
    for pair in combinations(np.flatnonzero(scene.clear).tolist(), 2):
        for measure in ("center", "gap"):
            key = scene.key("distance", measure, *scene.number[list(pair)])
            # Who is named first is left to the hash, not to the order of the list.
            found.append((key, measure, *(pair if key & 1 else pair[::-1])))
    for key, measure, a, b in sorted(found):
        # Measured in the order of asking: few of all pairs are asked for.
        value, rests_on = distance(measure, scene.figures[a], scene.figures[b])
        if value is not None and value >= scene.config.min_distance:
            text = partial(ask_distance, measure, scene.label(a), scene.label(b), key >> 1)
            yield PlannedQuestion(key, "distance", (a, b), measure, text, f"{value:.2f} m", rests_on=rests_on)


def distance(measure: str, a: Figures, b: Figures) -> tuple[float | None, str | None]:
    """Metres between two objects, by centres or at the nearest points, with the source of the figure."""
    if measure == "gap":
        return gap_between(a, b), POINTS
    value = float(np.linalg.norm(a.center - b.center))
    return (None if np.isnan(value) else value), " and ".join(sorted({str(a.rests_on), str(b.rests_on)}))


def size_asks(scene: VqaFrame) -> list[PlannedQuestion]:
    """Questions for the height and width of an object, along the viewer's up and right."""
    found = []
    for a in np.flatnonzero(scene.clear).tolist():
        figures = scene.figures[a]
        for measure, axis in SIZE_AXES.items():
            if not np.isnan(figures.extents[axis]):
                key = scene.key("size", measure, scene.number[a])
                text, value = partial(ask_size, measure, scene.label(a), key), f"{figures.extents[axis]:.2f} m"
                found.append(PlannedQuestion(key, "size", (a,), measure, text, value, rests_on=figures.rests_on))
    return sorted(found, key=_by_key)


BRIEF = "Answer the question using a single word or phrase."
"""LLaVA's own words for a short answer."""
WHICH = (
    "Which object is {phrase} {the}?",
    "What is {phrase} {the}?",
    "Name the object {phrase} {the}.",
    "In this image, which object is {phrase} {the}?",
)
WHICH_PHRASE = {name: r.which or r.phrase for name, r in RELATIONS.items()}
"""`What is left of the lamp?` would ask for its remains."""
GROUNDING = (
    "Please provide the bounding box coordinate of the region this sentence describes: {text}",
    "Give the normalised bounding box of what this describes: {text}",
    "Locate the following as [x0, y0, x1, y1], each from 0 to 1: {text}",
)
DISTANCE = {
    "center": (
        "How far is it from the centre of {a} to the centre of {b}, in metres?",
        "What is the distance between the centres of {a} and {b}, in metres?",
    ),
    "gap": (
        "How wide is the gap between {a} and {b}, in metres?",
        "How far apart are {a} and {b} at their nearest sides, in metres?",
    ),
}
SIZE = {
    "height": ("How tall {verb} {a}, in metres?", "What is the height of {a}, in metres?"),
    "width": (
        "How wide {verb} {a} from side to side as seen from the camera, in metres?",
        "As seen from the camera, what is the width of {a}, in metres?",
    ),
}
_TOKEN = re.compile(r"<[^<>\s]+>")
"""What a tokenizer may take for one of its own marks: `<image>`, `</s>`, `<|im_end|>`."""


def can_be_asked(name: str) -> bool:
    """Tell class names fit for a question."""
    return can_be_worded(name) and bool(readable(name)) and not _TOKEN.search(name)


def _the(name: str) -> str:
    return noun_phrase(readable(name)).definite()


def _sentence(templates: Sequence[str], key: int, end: str = "", **words: str) -> str:
    text = templates[key % len(templates)].format(**words) + end
    require(not _TOKEN.search(text), "a sentence that a tokenizer would misread", got=Shown(text, 80))
    return text


def ask_relation(relation: str, target: str, reference: str, key: int) -> str:
    return _sentence(("{text}",), 0, f"\n{BRIEF}", text=question_text(relation, target, reference, key))


def ask_which(relation: str, reference: str, key: int) -> str:
    return _sentence(WHICH, key, f"\n{BRIEF}", phrase=WHICH_PHRASE[relation], the=_the(reference))


def ask_grounding(text: str, key: int) -> str:
    return _sentence(GROUNDING, key, text=text)


def ask_distance(measure: str, a: str, b: str, key: int) -> str:
    return _sentence(DISTANCE[measure], key, f"\n{BRIEF}", a=_the(a), b=_the(b))


def ask_size(measure: str, name: str, key: int) -> str:
    return _sentence(SIZE[measure], key, f"\n{BRIEF}", a=_the(name), verb=noun_phrase(readable(name)).verb)


def box_text(bbox: Sequence[float], width: int, height: int, decimals: int) -> str:
    """[x0, y0, x1, y1] as shares of the picture's width and height."""
    shares = [min(max(x / of, 0.0), 1.0) for x, of in zip(bbox, (width, height, width, height), strict=True)]
    return "[" + ", ".join(f"{x:.{decimals}f}" for x in shares) + "]"


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
                made = {"base": job.provenance.base, "made_by": job.provenance.made_by}
                records.add({**question, **made, "provenance": _provenance(job, question["metadata"])})
                counts[question["metadata"]["kind"]] += 1
            if asked:
                job.copy_picture(rows)
        records.close()
        file.write("\n")
    counts["questions"] = records.length
    files = (CONVERSATIONS_FILE, *(("images/",) if job.images is not None else ()))
    note = f"{depths.missing} frames without depth, where gaps are not asked: {depths.problem}"
    return Written(files, counts, (note,) if depths.missing else ())


def boxed_by_people(provenance: Provenance, rows: ExportFrame) -> frozenset[int]:
    """Numbers of a frame's objects with a 3D box set by a person."""
    return frozenset(
        row["object"]
        for row in rows.objects
        for entry in provenance.of("objects", rows.frame["frame"], str(row["object"]))
        if entry["column"] == "size" and entry["source"] == "human"
    )


def _provenance(job: Job, question: Mapping[str, Any]) -> list[dict[str, object]]:
    objects = question["objects"]
    rows = [("objects", str(n)) for n in objects]
    if len(objects) == 2 and question["kind"] in ("relation", "which", "grounding"):
        rows.append(("relations", f"{objects[0]},{objects[1]}"))
    if question["source"] is not None:
        rows.append(("expressions", question["source"]))
    found = ((table, key, job.provenance.of(table, question["frame"], key)) for table, key in rows)
    return [{"table": table, "key": key, **entry} for table, key, entries in found for entry in entries]


FORMAT = ExportFormat(
    write_vqa,
    description="questions and answers as LLaVA conversations, for fine-tuning",
    lossless=False,
    options=VqaConfig,
)
