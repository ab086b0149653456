"""Labelling one frame: its objects, every relation between them, and the expressions that are true of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import xxhash

from pipeline.answering.objects import PreparedFrame, SceneObject, appearance_of
from pipeline.datasets import GivenExpression
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.cleaning import OUTSIDE, PixelEvidence
from pipeline.geometry.fitting import pca_boxes
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.masks import encode_crops
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.plan import LabelConfig
from pipeline.labels.profiles import GIVEN, JudgedPairs, as_given, doubted
from pipeline.labels.wording import can_be_worded
from pipeline.language.noun_phrase import same_names
from pipeline.language.relation_names import DIRECTIONAL, PAIRWISE
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import T, U
from pipeline.system.arrow import Repeated, pa
from pipeline.system.frozen import dataclass

if TYPE_CHECKING:
    from pipeline.labels.reading import Columns


@dataclass(frozen=True)
class FrameLabels:
    """The rows of one frame, as columns of the tables of a shard, and what was judged."""

    frames: Columns
    objects: Columns
    relations: Columns
    candidates: Columns
    judged: JudgedPairs | None = None
    sentences: Columns = field(default_factory=dict)

    def tables(self) -> dict[str, Columns]:
        from pipeline.labels.reading import PART_TABLES, SENTENCES

        return {name: getattr(self, name) for name in (*PART_TABLES, SENTENCES)}


def broken_frame(frame_id: str, frame_index: int, scene: str, problem: str) -> FrameLabels:
    """Rows of a frame that cannot be loaded, with the reason."""
    row = {"frame": frame_id, "frame_index": frame_index, "scene": scene, "ok": False, "problem": problem}
    return FrameLabels(_rows([{**row, "width": 0, "height": 0, "objects": 0, "notes": []}]), {}, {}, {})


def label_objects(
    context: PreparedFrame,
    objects: Sequence[SceneObject],
    config: LabelConfig,
    *,
    frame_index: int,
    scene: str,
    exact: bool,
    network: OnnxScorer | None = None,
    numbers: Sequence[int] | None = None,
    given: Sequence[GivenExpression] = (),
    expressions: bool = True,
    instances: Mapping[int, int] | None = None,
) -> FrameLabels:
    """Rows of a frame with lifted objects.

    `objects`: in any order; those of one detector. `frame_index`: the frame's index in the dataset. `exact`: the
    objects are the dataset's own: their numbers are its annotations'. `numbers`: the objects' numbers, where they have
    some already. `given`: what the dataset itself says of its annotations: the relations under the profile `given`.
    `expressions`: False for objects and relations alone. `instances`: by number the objects' ids in their scene; by
    default what the dataset says.
    """
    frame = context.frame
    if numbers is None:
        numbers = [o.id if exact else k for k, o in enumerate(objects)]
    known = {a.index: a for a in frame.annotations} if exact else {}
    boxed = [k for k, o in enumerate(objects) if len(o.lifted.points)]
    pca = dict(zip(boxed, pca_boxes([objects[k].lifted.points for k in boxed]), strict=True))
    masks = encode_crops((frame.height, frame.width), [o.held.crop for o in objects])
    rows = [
        {
            **_object_row(o, number, known.get(number), frame, frame_index, context.viewer, config),
            **_pca_columns(pca.get(k)),
            "mask": mask,
        }
        for k, (o, number, mask) in enumerate(zip(objects, numbers, masks, strict=True))
    ]
    if instances is not None:
        rows = [row | {"instance": instances.get(number)} for row, number in zip(rows, numbers, strict=True)]
    related = [k for k, o in enumerate(objects) if not config.is_background(o.label)]
    judged = judge_list(context, [objects[k] for k in related], config, network)
    ids = [numbers[k] for k in related]
    if config.profile == GIVEN:
        judged = as_given(judged, ids, given)
    up_source = str(context.viewer.up_source)
    return FrameLabels(
        _frame_rows(frame, frame_index, scene, len(objects), context.viewer.up_doubt),
        _rows(rows),
        _relation_columns(frame.id, frame_index, ids, judged, config),
        {}
        if not expressions
        else candidate_expressions(
            frame.id,
            frame_index,
            ids,
            [objects[k].label for k in related],
            np.array([rows[k]["usable"] for k in related], np.bool_),
            judged,
            config,
            up_source,
        ),
        judged,
    )


def judge_list(
    context: PreparedFrame, objects: Sequence[SceneObject], config: LabelConfig, network: OnnxScorer | None = None
) -> JudgedPairs:
    """Judge every ordered pair of objects: by the rules, undecided by doubtful geometry or a network."""
    lifted = [o.lifted for o in objects]
    judged = judge_objects(lifted, context.viewer, config)
    judged = with_undecided(judged, np.array([item.quality.fallback for item in lifted], np.bool_))
    return (
        judged
        if network is None
        else doubted(judged, network, lifted, context.viewer, appearance_of(objects, context.frame))
    )


def with_undecided(judged: JudgedPairs, unsure: np.ndarray) -> JudgedPairs:
    """Judgements with U for every pair with an unreliable object.

    `unsure` (N,) bool: objects too small to be cleaned: pixels of what is behind them may be in their extents.
    """
    if not unsure.any():
        return judged
    pairs = (unsure[:, None] | unsure[None, :]) & ~np.eye(len(unsure), dtype=np.bool_)
    changed = pairs[..., None] & (judged.states != U)
    bits = (changed << np.arange(changed.shape[2], dtype=np.int32)).sum(axis=2, dtype=np.int32)
    states, margins = np.where(changed, U, judged.states).astype(np.int8), np.where(changed, 0.0, judged.margins)
    return JudgedPairs(states, margins, judged.distance, bits)


def judge_objects(lifted: Sequence[LiftedObject], viewer: ViewerAxes, config: LabelConfig) -> JudgedPairs:
    """Every ordered pair of the objects under the profile's rules."""
    lo, hi = (np.array([getattr(item, end) for item in lifted], np.float64).reshape(-1, 3) for end in ("lo", "hi"))
    centres = (lo + hi) / 2
    for k, item in enumerate(lifted):
        if len(item.points):
            centres[k] = centroid(item, viewer)
    clouds = None
    if not set(config.relations) <= set(DIRECTIONAL):
        matrix = viewer.matrix.T.astype(np.float32)
        clouds = [item.points @ matrix for item in lifted]
    return config.rules.judge(lo, hi, centres, clouds, config.relations)


def centroid(lifted: LiftedObject, viewer: ViewerAxes) -> np.ndarray:
    """(3,) mean of an object's points along (right, up, forward), metres."""
    return viewer.matrix @ lifted.mean


def _frame_rows(frame: Frame, frame_index: int, scene: str, objects: int, doubt: str) -> Columns:
    camera = frame.camera
    pose = camera.T_world_camera
    row = {
        "frame": frame.id,
        "frame_index": frame_index,
        "scene": scene,
        "ok": True,
        "problem": None,
        "width": frame.width,
        "height": frame.height,
        "K": camera.K.ravel().tolist(),
        "T_world_camera": None if pose is None else pose.ravel().tolist(),
        "up": None if camera.up is None else camera.up.tolist(),
        "up_source": camera.up_source,
        "rgb_hash": frame.content_hash,
        "depth_hash": xxhash.xxh3_128_hexdigest(np.ascontiguousarray(frame.depth).data),
        "objects": objects,
        "notes": [*frame.notes, *([doubt] if doubt else [])],
    }
    return _rows([row])


def _object_row(
    entry: SceneObject,
    number: int,
    annotation: Annotation | None,
    frame: Frame,
    frame_index: int,
    viewer: ViewerAxes,
    config: LabelConfig,
) -> dict[str, Any]:
    lifted, quality = entry.lifted, entry.lifted.quality
    box, known = lifted.box, bool(np.isfinite(lifted.lo).all())
    exact = annotation.box if annotation is not None else None
    centre = centroid(lifted, viewer) if len(lifted.points) else None
    reason = unusable(config, entry.label, quality.mask_pixels, quality.points, quality.fallback)
    return {
        "frame": frame.id,
        "frame_index": frame_index,
        "object": number,
        "label": entry.label,
        "score": entry.score,
        "instance": getattr(annotation, "instance", None),
        "bbox": np.asarray(entry.bbox).tolist(),
        "mask_source": quality.mask_source,
        "mask_pixels": quality.mask_pixels,
        "points": quality.points,
        "kept": quality.kept,
        "depth_missing": quality.depth_missing,
        "touches_border": quality.touches_border,
        "fallback": quality.fallback,
        "distance": None if math.isnan(quality.distance) else quality.distance,
        "center": None if box is None else box.center.tolist(),
        "R": None if box is None else box.R.ravel().tolist(),
        "size": None if box is None else box.size.tolist(),
        "yaw_confidence": min(max(float(lifted.yaw_confidence), 0.0), 1.0),
        "estimator": config.lift.box,
        "open_sides": None if lifted.open_sides is None else list(lifted.open_sides),
        "lo": lifted.lo.tolist() if known else None,
        "hi": lifted.hi.tolist() if known else None,
        "centroid": None if centre is None else centre.tolist(),
        "exact_center": None if exact is None else exact.center.tolist(),
        "exact_R": None if exact is None else exact.R.ravel().tolist(),
        "exact_size": None if exact is None else exact.size.tolist(),
        "visible": None if annotation is None else annotation.visible,
        "occluded": 0.0 if lifted.evidence is None else occluded_share(lifted.evidence, frame.depth),
        "usable": reason is None,
        "reason": reason,
    }


def _pca_columns(fit: tuple[Box3D, float] | None) -> dict[str, Any]:
    box = None if fit is None else fit[0]
    return {
        "pca_center": None if box is None else box.center.tolist(),
        "pca_R": None if box is None else box.R.ravel().tolist(),
        "pca_size": None if box is None else box.size.tolist(),
    }


def unusable(config: LabelConfig, label: str, mask_pixels: int, points: int, fallback: bool) -> str | None:
    """Reason against asking for an object, by row, or None."""
    if config.is_background(label):
        return "background"
    if mask_pixels < config.min_pixels:
        return f"fewer than {config.min_pixels} pixels"
    if points < config.min_points:
        return f"fewer than {config.min_points} points"
    # The raw mask was lifted then, with pixels of what is behind it.
    return "too small to clean" if fallback else None


def _relation_columns(
    frame: str, frame_index: int, ids: Sequence[int], judged: JudgedPairs, config: LabelConfig
) -> Columns:
    number = np.asarray(ids, np.int32)
    # Rows run by (a, b) as numbers, whatever the order of the objects.
    order = np.argsort(number, kind="stable")
    a, b = (order[k] for k in np.nonzero(~np.eye(len(ids), dtype=np.bool_)))
    pair = a * len(ids) + b
    distance = judged.distance.take(pair).astype(np.float32)
    columns: Columns = {
        "frame": Repeated([frame], np.zeros(len(a), np.int32)),
        "frame_index": np.full(len(a), frame_index, np.int32),
        "a": number[a],
        "b": number[b],
        "distance": distance,
        "doubted": np.zeros(len(a), np.int32) if judged.doubted is None else judged.doubted.take(pair),
    }
    for relation in config.relations:
        k = PAIRWISE.index(relation)
        columns[relation] = judged.states[..., k].take(pair)
        columns[f"{relation}_margin"] = judged.margins[..., k].take(pair).astype(np.float32)
    return columns


def _rows(rows: list[dict[str, Any]]) -> Columns:
    return {name: [row[name] for row in rows] for name in rows[0]} if rows else {}


NEARER_M = 0.05
REACH = 2
"""Pixels beyond the mask that are looked at: the first ones are often mixed."""


def occluded_share(evidence: PixelEvidence, depth: np.ndarray) -> float:
    """Share of the mask's border with something at least 5 cm nearer beside.

    `evidence`: the pixels of the mask. `depth` (H, W) float32: metres. Returns 0..1; 0 where no pixel beside the mask
    has depth.
    """
    height, width = depth.shape
    h, w = evidence.codes.shape
    top, left = min(REACH, evidence.y0), min(REACH, evidence.x0)
    bottom, right = min(REACH, height - evidence.y0 - h), min(REACH, width - evidence.x0 - w)
    inside = (evidence.codes != OUTSIDE).view(np.uint8)
    mask = cv2.copyMakeBorder(inside, top, bottom, left, right, cv2.BORDER_CONSTANT, value=0)
    z = depth[evidence.y0 - top : evidence.y0 + h + bottom, evidence.x0 - left : evidence.x0 + w + right]
    # The farthest depth of the mask in reach: 0 where there is none.
    farthest = cv2.dilate(mask * z, np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8))
    ring = (farthest > 0) & (z > 0) & (mask == 0)
    total = np.count_nonzero(ring)
    return np.count_nonzero(ring & (z < farthest - np.float32(NEARER_M))) / total if total else 0.0


def row_hash(seed: int, *parts: object) -> int:
    """64-bit hash of the seed and a row's content."""
    return xxhash.xxh3_64_intdigest("\x1f".join(str(p) for p in parts).encode(), seed=seed & (2**64 - 1))


def candidate_expressions(
    frame: str,
    frame_index: int,
    ids: Sequence[int],
    labels: Sequence[str],
    usable: np.ndarray,
    judged: JudgedPairs,
    config: LabelConfig,
    up_source: str,
) -> dict[str, Any]:
    """True expressions of all pairs of usable objects of a frame, not yet worded.

    `ids`, `labels`: numbers and class names of the objects that were judged. `usable` (N,) bool: objects that may be
    asked for; the others still count as acceptable answers.

    Returns columns of the table `candidates`, in canonical order, one row for each pair and relation that is T; empty
    where there is none.
    """
    if len(ids) < 2:
        return {}
    same = same_names(labels)
    kind = same.argmax(axis=1)
    asked = usable & np.array([can_be_worded(label) for label in labels], np.bool_)
    apart = ~np.eye(len(ids), dtype=np.bool_)
    relations = [PAIRWISE.index(relation) for relation in config.relations]
    states = np.moveaxis(judged.states[..., relations], -1, 0)
    relation, a, b = np.nonzero((states == T) & apart & asked[:, None] & asked)
    n = len(relation)
    if not n:
        return {}
    # Rows of one relation and two classes ask the same, and have the same answers.
    question = (relation * len(ids) + kind[a]) * len(ids) + kind[b]
    _, first, row = np.unique(question, return_index=True, return_inverse=True)
    _, column, of_name = np.unique(labels, return_index=True, return_inverse=True)
    alike = same[:, column].astype(np.float32)
    numbers, answers, several = np.asarray(ids, np.int32), {}, np.zeros(0, np.bool_)
    for name, holds in (("targets", states == T), ("acceptable", states >= U)):
        # satisfied[r, a, c]: object a has the relation to some object of the class c.
        satisfied = (holds & apart).astype(np.float32) @ alike > 0
        which = same[a[first]] & satisfied[relation[first], :, of_name[b[first]]]
        counts = which.sum(axis=1)
        ends = np.cumsum(counts, dtype=np.int32)
        lists = pa.ListArray.from_arrays(np.concatenate([np.zeros(1, np.int32), ends]), numbers[np.nonzero(which)[1]])
        answers[name], several = Repeated(lists, row), counts[row] > 1
    said, every = config.relations, np.zeros(n, np.int32)
    # The text of `row_hash`: once what many rows begin with.
    heads = [f"{frame}\x1f{i}\x1f{r}\x1f".encode() for r in said for i in ids]
    tails = [str(j).encode() for j in ids]
    keys = zip((relation * len(ids) + a).tolist(), b.tolist(), strict=True)
    seed, digest = config.seed & (2**64 - 1), xxhash.xxh3_64_digest
    digits = b"".join([digest(heads[begin] + tails[j], seed) for begin, j in keys]).hex().encode()
    ends = np.arange(0, 16 * n + 1, 16, dtype=np.int32)
    hashes = pa.StringArray.from_buffers(n, pa.py_buffer(ends), pa.py_buffer(digits))
    return {
        "id": Repeated(hashes, np.arange(n)),
        "frame": Repeated([frame], every),
        "frame_index": np.full(n, frame_index),
        "target": Repeated(labels, a),
        "relation": Repeated(said, relation),
        "reference": Repeated(labels, b),
        "target_object": numbers[a],
        "reference_object": numbers[b],
        **answers,
        "ambiguous": several,
        "margin": judged.margins[a, b, np.array(relations)[relation]],
        "same_class": same.sum(axis=1)[a],
        "judged_in": Repeated(["viewer"], every),
        "up_source": Repeated([up_source], every),
        "profile": Repeated([config.profile], every),
    }
