"""Effective labels: automatic labels with corrections, as the same four tables, with provenance.

What follows from corrected pixels and boxes is lifted and judged as the labeller does it.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
import xxhash

from pipeline.answering.objects import PreparedFrame, SceneObject, pixels_inside, prepare_frame
from pipeline.corrections.journal.effective_expressions import correct_expressions
from pipeline.corrections.journal.effective_frame import EffectiveFrame, Setting, Withdrawn, setting_of
from pipeline.corrections.journal.effective_objects import (
    DERIVED,
    OF_BOX,
    correct_objects,
    correct_pairs,
    relate_objects,
)
from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import KINDS, FieldRef, box_of, judged_item
from pipeline.corrections.journal.frame_rows import BOX_COLUMNS, FrameIndex, FrameRows, Pairs, Row
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.replay import (
    Origin,
    Unapplied,
    all_gone,
    by_ref,
    provenance_schema,
    replay,
    replayed_judgement,
)
from pipeline.datasets import Dataset
from pipeline.geometry.camera import UpSource
from pipeline.geometry.lifting import LiftedObject, lift
from pipeline.geometry.masks import decode_run_length, mask_box
from pipeline.labels.labelling import label_objects, unusable
from pipeline.labels.profiles import NONE, open_second_opinion
from pipeline.labels.reading import Labels, build_table
from pipeline.labels.schema import ADDED_COLUMNS, TABLES
from pipeline.language.class_sizes import is_thin
from pipeline.proposals.annotations import box_mask
from pipeline.relations.model import OnnxScorer
from pipeline.system.arrow import pa, pc
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

FRAMES_LOADED = 4
"""Frames that stay loaded: who corrects one goes on correcting it."""


class Relifter:
    """Lifting of objects of one dataset's frames.

    Corrections are judged in the level frame of the labels' up vectors.
    """

    def __init__(self, dataset: Dataset, setting: Setting, frames: pa.Table) -> None:
        self.dataset, self.setting = dataset, setting
        columns = (frames.column(name).to_pylist() for name in ("frame", "up", "up_source"))
        self.ups: dict[str, tuple[np.ndarray, UpSource]] = {
            name: (np.array(up), source or "assumed")
            for name, up, source in zip(*columns, strict=True)
            if any(up or ())
        }
        # The lifted objects of a frame go with it.
        self._loaded = lru_cache(maxsize=FRAMES_LOADED)(lambda frame: (self._load(frame), dict[Any, LiftedObject]()))

    def context(self, frame: str) -> PreparedFrame:
        """Frame of the dataset, ready to lift from; raises as `Dataset.load`."""
        return self._loaded(frame)[0]

    def _load(self, frame: str) -> PreparedFrame:
        loaded = self.dataset.load(frame)
        if frame in self.ups:
            loaded = replace(loaded, camera=loaded.camera.with_up(*self.ups[frame]))
        return prepare_frame(self.dataset, loaded, self.setting.config.lift)

    @cached_property
    def network(self) -> OnnxScorer | None:
        """Second opinion of the labels, opened when first asked."""
        name = self.setting.config.second_opinion
        return None if name == NONE else open_second_opinion(name)

    def lifted(self, frame: str, row: Row, box: Any) -> SceneObject:
        """Object from an effective row and a person's 3D box."""
        return self._object(self.context(frame), row, box, human_bbox=True)

    def __call__(
        self, auto: FrameRows, rows: Mapping[int, Row], boxes: Mapping[int, Any], human_bbox: Iterable[int]
    ) -> tuple[dict[int, Row], Pairs]:
        """Lift and judge the objects of a frame anew.

        `rows` are all standing objects, `boxes` the 3D boxes (JSON values) that people set, `human_bbox` the objects
        whose 2D box is not to follow from their mask.
        """
        context = self.context(auto.frame)
        numbers, kept = sorted(rows), set(human_bbox)
        objects = [self._object(context, rows[n], boxes.get(n), n in kept) for n in numbers]
        labels = label_objects(
            context,
            objects,
            self.setting.config,
            frame_index=auto.index,
            scene=auto.row["scene"],
            exact=self.setting.exact,
            network=self.network,
            numbers=numbers,
            expressions=False,
        )
        columns = labels.objects
        found = {n: {name: values[k] for name, values in columns.items()} for k, n in enumerate(numbers)}
        return found, Pairs.of_table(numbers, build_table("relations", labels.relations))

    def _object(self, context: PreparedFrame, row: Row, box: Any, human_bbox: bool) -> SceneObject:
        """Object from a mask, else the pixels in the 3D box, else the 2D box."""
        frame, source = context.frame, row["mask_source"]
        bbox = np.array(row["bbox"], np.float32)
        if row["mask"] is not None and source != "box":
            mask = decode_run_length((frame.height, frame.width), row["mask"], f"object {row['object']}")
        else:
            mask = box_mask(bbox, frame.height, frame.width)
            if source == "box3d" and box is not None:
                within = pixels_inside(box_of(box), mask, frame)
                mask, source = (within, "box3d") if within.any() else (mask, "box")
        lifted = self._lift(context, mask, source, is_thin(row["label"]))
        if box is not None:
            lifted = lifted.moved_to(box_of(box), context.viewer)
        if source == "human" and not human_bbox and mask.any():
            bbox = np.array(mask_box(mask), np.float32)
        return SceneObject(row["object"], row["label"], row["score"], bbox, mask, lifted)

    def _lift(self, context: PreparedFrame, mask: np.ndarray, source: Any, thin: bool) -> LiftedObject:
        known = self._loaded(context.frame.id)[1]
        key = xxhash.xxh3_128_hexdigest(np.ascontiguousarray(mask).data), str(source), thin
        if key not in known:
            (known[key],) = lift(
                context.frame.depth,
                context.frame.camera,
                [mask],
                context.viewer,
                config=context.config,
                mask_source=source,
                edges=context.edges,
                thin=[thin],
            )
        return known[key]


_NAMED = ("table", "frame", "key", "column")
_KEYS = {"objects": ("object",), "relations": ("a", "b"), "expressions": ("id",)}
DECIDED = ("accepted", "corrected")
"""Statuses that say of a label that it is right as it is; a judgement that would correct it leaves it as it was."""
FRAMES_KEPT = 8
"""Effective frames that a corrector keeps: the one that is looked at, and those next in a queue."""
GEOMETRY = ("bbox", "mask", "center")
"""Columns of which a correction makes another object of what the dataset annotates."""


class Corrector:
    """Labels opened once, and their effective frames, kept by the ULIDs of their events; shared by threads.

    Without `dataset`, what follows from new pixels and boxes is marked stale.
    """

    def __init__(self, labels: Labels, dataset: Dataset | None = None) -> None:
        self.labels, self.dataset = labels, dataset
        self.setting: Setting = setting_of(labels)
        self.index = FrameIndex({name: getattr(labels, name) for name in TABLES})
        self.relifter = None if dataset is None else Relifter(dataset, self.setting, labels.frames)
        self._kept: OrderedDict[tuple[str, tuple[str, ...]], EffectiveFrame] = OrderedDict()
        self._lock = threading.RLock()

    def frame(self, frame: str, journal: Journal | Sequence[Event]) -> EffectiveFrame:
        """Apply the events of a frame; InputError for no such frame, or an unreadable picture."""
        require(frame in self.index.of_frame, "the labels have no such frame", got=repr(frame), path=self.labels.root)
        events = journal.events(frame=frame) if isinstance(journal, Journal) else tuple(journal)
        key = frame, tuple([e.ulid for e in events])
        with self._lock:
            if key not in self._kept:
                known = next((found for (name, _), found in reversed(self._kept.items()) if name == frame), None)
                auto = self.index.rows(frame) if known is None else known.auto
                self._kept[key] = effective_frame(auto, events, self.setting, self.relifter, known)
                while len(self._kept) > FRAMES_KEPT:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(key)
            return self._kept[key]


@dataclass(frozen=True)
class EffectiveLabels(Labels):
    """Labels after all corrections; tables as of `pipeline.labels.reading.Labels`.

    `provenance` (`replay.provenance_schema`) lists values that are not the labeller's, `unapplied` events without
    effect, `marks` BAD_LABEL or BAD_BOX by (frame, expression), `last` the ULID of the newest event, `relifted` whether
    the dataset was at hand.
    """

    tables: dict[str, pa.Table]
    provenance: pa.Table
    unapplied: tuple[Unapplied, ...]
    withdrawn: tuple[Withdrawn, ...]
    marks: dict[tuple[str, str], str]
    events: int
    statuses: dict[FieldRef, Any]
    last: str | None
    relifted: bool

    def table(self, name: str) -> pa.Table:
        """Table by name, in canonical order."""
        return self.tables[name]

    @cached_property
    def counts(self) -> dict[str, int]:
        """Count objects with other pixels or boxes, values by origin, events without effect, withdrawn and marked
        expressions.
        """
        by_source = Counter(self.provenance.column("origin").to_pylist())
        named = zip(*(self.provenance.column(n).to_pylist() for n in _NAMED), strict=True)
        changed = {(frame, key) for table, frame, key, column in named if table == "objects" and column in GEOMETRY}
        return {
            "objects": len(changed),
            **{source: by_source.get(source, 0) for source in ("human", "recomputed", "stale")},
            "unapplied": len(self.unapplied),
            "withdrawn": len(self.withdrawn),
            "marks": len(self.marks),
        }

    @cached_property
    def decided(self) -> dict[str, tuple[int, int]]:
        """Count people's decisions (set, accepted, judged), and of how many: objects, relations, sentences."""
        by_table: dict[str, set[tuple[str, str, str]]] = {table: set() for table in _KEYS}
        entries = zip(*(self.provenance.column(n).to_pylist() for n in (*_NAMED, "origin")), strict=True)
        for table, frame, key, column, origin in entries:
            # What is said of a label is no value of it.
            if origin == "human" and table in by_table and column.rpartition(".")[2] not in ("status", "mark", "note"):
                by_table[table].add((frame, key, column if table == "relations" else ""))
        for ref, value in self.statuses.items():
            if ref.kind in ("object", "relation", "expression") and value in DECIDED:
                by_table[f"{ref.kind}s"].add((ref.frame, ref.key, ref.field.removesuffix("status").rstrip(".")))
            elif ref.kind == "review" and ref.field == "said" and value["status"] == "accepted":
                _, kind, a, b, what = judged_item(ref.key)
                key = what if kind == "expression" else f"{a}" if b is None else f"{a},{b}"
                by_table[f"{kind}s"].add((ref.frame, key, what if kind == "relation" else ""))
        counted = {}
        for table, found in by_table.items():
            columns = (self.tables[table].column(n).to_pylist() for n in ("frame", *_KEYS[table]))
            there = {(frame, ",".join(map(str, key))) for frame, *key in zip(*columns, strict=True)}
            refs = len(self.relation_names) if table == "relations" else 1
            counted[table] = (sum((frame, key) in there for frame, key, _ in found), len(there) * refs)
        return counted


def effective_tables(
    labels: Labels, journal: Journal | Iterable[Event], *, dataset: Dataset | None = None
) -> EffectiveLabels:
    """Apply a journal to labels; frames without events are taken over, rejected frames left out.

    Without `dataset`, what follows from new masks and boxes is marked stale. InputError where labels, journal or a
    frame cannot be read.
    """
    events = journal.events() if isinstance(journal, Journal) else tuple(journal)
    corrector = Corrector(labels, dataset)
    by_frame, index = grouped(events, lambda e: e.ref.frame), corrector.index
    known = sorted(by_frame.keys() & index.of_frame.keys(), key=index.of_frame.__getitem__)
    pieces: dict[str, list[pa.Table]] = {name: [] for name in TABLES}
    provenance: list[dict] = []
    unapplied: list[Unapplied] = []
    withdrawn: list[Withdrawn] = []
    marks: dict[tuple[str, str], str] = {}
    statuses: dict[FieldRef, Any] = {}
    for name in known:
        found = corrector.frame(name, by_frame[name])
        for table, changed in found.tables().items() if found.stands else ():
            pieces[table].append(changed.cast(index.tables[table].schema))
        provenance += found.provenance()
        unapplied += found.unapplied
        withdrawn += found.withdrawn
        statuses |= {ref: value for ref, value in found.statuses.items() if ref.field != "exists"}
        marks |= {(name, key): mark for key, mark in found.marks.items()}
    made_anew = [index.of_frame[name] for name in known]
    tables = {}
    for name, whole in index.tables.items():
        others = whole.filter(~pc.field("frame_index").isin(made_anew))
        # The sort is stable: within a frame the order is canonical already.
        tables[name] = pa.concat_tables([others, *pieces[name]]).sort_by("frame_index").combine_chunks()
    for name in by_frame.keys() - set(known):
        for members in by_ref(by_frame[name]).values():
            unapplied += all_gone(None, members, "the labels have no such frame any more").unapplied
    return EffectiveLabels(
        labels.root,
        labels.manifest,
        tables,
        pa.Table.from_pylist(provenance, provenance_schema()),
        tuple(sorted(unapplied, key=lambda u: u.event.id)),
        tuple(withdrawn),
        marks,
        len(events),
        statuses,
        events[-1].ulid if events else None,
        dataset is not None,
    )


def effective_frame(
    auto: FrameRows,
    events: Sequence[Event],
    setting: Setting,
    relift: Relifter | None = None,
    known: EffectiveFrame | None = None,
) -> EffectiveFrame:
    """Apply the events of a frame, in the order of saving, to the automatic labels.

    `known` is any other state of the frame. Its objects are taken over where no event of an object came or went; where
    it is of the first of these events, what the others do not touch is taken over, too.
    Without `relift`, what follows from new pixels or boxes is stale. InputError where the frame cannot be loaded.
    """
    ulids = tuple([e.ulid for e in events])
    before = known if known is not None and ulids[: len(known.ulids)] == known.ulids else None
    came = events if before is None else events[len(before.ulids) :]
    said: dict[str, dict[FieldRef, list[Event]]] = {
        kind: {} if before is None else dict(before.said[kind]) for kind in KINDS
    }
    for event in came:
        of_kind = said[event.ref.kind]
        of_kind[event.ref] = [*of_kind.get(event.ref, ()), event]
    made_of = tuple([e.ulid for e in events if e.ref.kind == "object"])
    stage = known.stage if known is not None and known.made_of == made_of else None
    if stage is None:
        stage = EffectiveFrame.untouched(auto, setting)
        if known is not None:
            stage.shown = known.shown
        correct_objects(stage, said["object"])
        relifted = _lift(stage, relift)
        _rename(stage)
        relate_objects(stage, relifted)
    before = before if before is not None and before.stage is stage else None
    frame = (before or stage).successor()
    frame.stage, frame.made_of, frame.ulids, frame.said = stage, made_of, ulids, said
    causes = [e for e in events if e.ref.kind in ("object", "relation")]
    frame.cause = max(causes, key=attrgetter("id"), default=None)
    correct_pairs(frame, said["relation"], None if before is None else came)
    correct_expressions(frame, said["expression"], before, came)
    boxes = {n: row["bbox"] for n, row in auto.objects.items()}
    there = frame.objects.keys() | frame.left_out.keys()
    # A judgement is of labels, and never one itself: nothing follows from it.
    judged = said["review"]
    if before is not None and frame.outcomes.keys() == before.outcomes.keys():
        judged = {e.ref: judged[e.ref] for e in came if e.ref.kind == "review"}
    for ref, members in judged.items():
        after = frame.note(members, replayed_judgement(ref, members, boxes, there, frame.outcomes))
        frame.statuses.pop(ref, None)
        if after.value is not None:
            frame.statuses[ref] = after.value
    for ref, members in said["frame"].items():
        after = frame.note(members, replay(None, members))
        frame.statuses.pop(ref, None)
        frame.origins.pop(("frames", "", ref.field), None)
        if after.value is not None and after.event is not None:
            frame.statuses[ref] = after.value
            frame.put("frames", "", ref.field, Origin.of("human", after.event))
    frame.row = {**auto.row, "objects": len(frame.objects)}
    return frame


def _lift(frame: EffectiveFrame, relift: Relifter | None) -> Pairs | None:
    """Update, or mark stale, all consequences of pixels and boxes; return the relations judged anew."""
    auto, background = frame.auto, frame.setting.config.is_background
    newly_related = any(
        n in auto.objects and background(auto.objects[n]["label"]) and not background(frame.objects[n]["label"])
        for n in frame.renamed
        if n in frame.objects
    )
    if not frame.geometry and not newly_related:
        return None
    lifted: dict[int, Row] = {}
    relifted = None
    if relift is not None:
        lifted, relifted = relift(auto, frame.objects, frame.boxes, frame.human_bbox)
    pixels = {"mask", "mask_source", "bbox"}
    for number, event in frame.geometry.items():
        if number not in frame.objects:
            continue
        row, key, was = frame.objects[number], str(number), auto.objects.get(number, {})
        origin = Origin.of("stale" if relift is None else "recomputed", event)
        only_box = number in frame.boxes and frame.noted("objects", key, "mask") is None and number in auto.objects
        new = {**row, **{c: lifted[number][c] for c in (*DERIVED, *pixels)}} if lifted else row
        for column in (*(OF_BOX if only_box else DERIVED), *(pixels - {c for c in row if new[c] == row[c]})):
            noted = frame.noted("objects", key, column)
            by_hand = noted is not None and noted.source == "human" and (number in auto.objects or column == "label")
            # Labels of before have none of a column that came later, and no origin of it.
            unknown = column in ADDED_COLUMNS and new[column] is None and was.get(column) is None
            if not by_hand and not unknown and not (column in BOX_COLUMNS and number in frame.boxes):
                frame.put("objects", key, column, origin, was.get(column))
        if row["mask_source"] == "human" and number not in frame.human_bbox:
            frame.put("objects", key, "bbox", Origin.of("recomputed", event), was.get("bbox"))
        frame.objects[number] = new
    return relifted


def _rename(frame: EffectiveFrame) -> None:
    """Update `usable` of renamed objects: background is not asked for."""
    for number, event in frame.renamed.items():
        row = frame.objects.get(number)
        if row is None or row["reason"] == "not lifted yet":
            continue
        config = frame.setting.config
        reason = unusable(config, row["label"], row["mask_pixels"], row["points"], row["fallback"])
        if reason != row["reason"] and "background" in (reason, row["reason"]):
            for column, value in (("usable", reason is None), ("reason", reason)):
                frame.put("objects", str(number), column, Origin.of("recomputed", event), row[column])
                row[column] = value
