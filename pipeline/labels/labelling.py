"""Labelling one frame: its objects, every relation between them, and the expressions that are true of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import xxhash

from pipeline.answering.objects import PreparedFrame, SceneObject, appearance_of
from pipeline.datasets import GivenExpression
from pipeline.geometry.fitting import pca_box
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.lifting import LiftedObject, Pixel, PixelEvidence
from pipeline.geometry.masks import encode_run_length
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.plan import LabelConfig
from pipeline.labels.profiles import GIVEN, JudgedPairs, as_given, doubted
from pipeline.labels.wording import can_be_worded
from pipeline.language.noun_phrase import same_names
from pipeline.language.relation_names import DIRECTIONAL, PAIRWISE
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import T, U

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
) -> FrameLabels:
    """Rows of a frame with lifted objects.

    `objects`: in any order; those of one detector. `frame_index`: the frame's index in the dataset. `exact`: the
    objects are the dataset's own: their numbers are its annotations'. `numbers`: the objects' numbers, where they have
    some already. `given`: what the dataset itself says of its annotations: the relations under the profile `given`.
    `expressions`: False for objects and relations alone.
    """
    frame = context.frame
    if numbers is None:
        numbers = [o.id if exact else k for k, o in enumerate(objects)]
    known = {a.index: a for a in frame.annotations} if exact else {}
    rows = [
        _object_row(o, number, known.get(number), frame, frame_index, context.viewer, config)
        for o, number in zip(objects, numbers, strict=True)
    ]
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
    return viewer.matrix @ lifted.points.mean(axis=0, dtype=np.float64)


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
    pca = pca_box(lifted.points)[0] if len(lifted.points) else None
    reason = unusable(config, entry.label, quality.mask_pixels, quality.points, quality.fallback)
    return {
        "frame": frame.id,
        "frame_index": frame_index,
        "object": number,
        "label": entry.label,
        "score": entry.score,
        "instance": getattr(annotation, "instance", None),
        "bbox": [float(x) for x in entry.bbox],
        "mask": encode_run_length(entry.mask),
        "mask_source": quality.mask_source,
        "mask_pixels": quality.mask_pixels,
        "points": quality.points,
        "kept": quality.kept,
        "depth_missing": quality.depth_missing,
        "touches_border": quality.touches_border,
        "fallback": quality.fallback,
        "distance": None if np.isnan(quality.distance) else quality.distance,
        "center": None if box is None else box.center.tolist(),
        "R": None if box is None else box.R.ravel().tolist(),
        "size": None if box is None else box.size.tolist(),
        "yaw_confidence": float(np.clip(lifted.yaw_confidence, 0, 1)),
        "estimator": config.lift.box,
        "open_sides": None if lifted.open_sides is None else list(lifted.open_sides),
        "pca_center": None if pca is None else pca.center.tolist(),
        "pca_R": None if pca is None else pca.R.ravel().tolist(),
        "pca_size": None if pca is None else pca.size.tolist(),
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
    distance = judged.distance[a, b].astype(np.float32)
    columns: Columns = {
        "frame": [frame] * len(a),
        "frame_index": np.full(len(a), frame_index, np.int32),
        "a": number[a],
        "b": number[b],
        "distance": [None if np.isnan(d) else d for d in distance.tolist()],
        "doubted": np.zeros(len(a), np.int32) if judged.doubted is None else judged.doubted[a, b],
    }
    for relation in config.relations:
        k = PAIRWISE.index(relation)
        columns[relation] = judged.states[a, b, k]
        columns[f"{relation}_margin"] = judged.margins[a, b, k].astype(np.float32)
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
    inside = (evidence.codes != Pixel.OUTSIDE).view(np.uint8)
    mask = cv2.copyMakeBorder(inside, top, bottom, left, right, cv2.BORDER_CONSTANT, value=0)
    z = depth[evidence.y0 - top : evidence.y0 + h + bottom, evidence.x0 - left : evidence.x0 + w + right]
    kernel = np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)
    ring = (cv2.dilate(mask, kernel) > 0) & (mask == 0) & (z > 0)
    own = np.where(mask > 0, z, 0).astype(np.float32)
    nearest = cv2.dilate(own, kernel)
    ring &= nearest > 0
    total = int(ring.sum())
    return float((z[ring] < nearest[ring] - NEARER_M).sum() / total) if total else 0.0


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
    kinds = same.astype(np.int32)
    kind, rivals = same.argmax(axis=1), same.sum(axis=1)
    asked = usable & np.array([can_be_worded(label) for label in labels], np.bool_)
    number = np.asarray(ids)
    found: dict[str, list[Any]] = {name: [] for name in _OWN_COLUMNS}
    for relation in config.relations:
        k = PAIRWISE.index(relation)
        state = np.where(np.eye(len(ids), dtype=np.bool_), -1, judged.states[..., k])
        # satisfied[a, b]: object a has the relation to some object of b's class.
        sure = (state == T).astype(np.int32) @ kinds > 0
        likely = (state >= U).astype(np.int32) @ kinds > 0
        targets, references = np.nonzero((state == T) & asked[:, None] & asked[None, :])
        answers: dict[tuple[int, int], tuple[list[int], list[int]]] = {}
        for a, b in zip(targets.tolist(), references.tolist(), strict=True):
            question = int(kind[a]), int(kind[b])
            if question not in answers:
                answers[question] = number[same[a] & sure[:, b]].tolist(), number[same[a] & likely[:, b]].tolist()
            strict, acceptable = answers[question]
            found["id"].append(f"{row_hash(config.seed, frame, ids[a], relation, ids[b]):016x}")
            found["target"].append(labels[a])
            found["reference"].append(labels[b])
            found["targets"].append(strict)
            found["acceptable"].append(acceptable)
            found["ambiguous"].append(len(acceptable) > 1)
            found["same_class"].append(int(rivals[a]))
        found["relation"] += [relation] * len(targets)
        found["target_object"] += number[targets].tolist()
        found["reference_object"] += number[references].tolist()
        found["margin"] += judged.margins[targets, references, k].tolist()
    n = len(found["id"])
    if not n:
        return {}
    shared = {
        "frame": frame,
        "frame_index": frame_index,
        "judged_in": "viewer",
        "up_source": up_source,
        "profile": config.profile,
    }
    return {**{name: [value] * n for name, value in shared.items()}, **found}


_OWN_COLUMNS = (
    "id",
    "target",
    "relation",
    "reference",
    "target_object",
    "reference_object",
    "targets",
    "acceptable",
    "ambiguous",
    "margin",
    "same_class",
)
