"""A scene's objects from a viewpoint: those that the viewpoint does not show, too.

The viewpoint is that of a frame, or imagined: somebody who stands at one object and faces another. Relations are the
viewer's, as everywhere; what is not visible from there has its points from the other frames of the scene.
"""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.pipeline import Pipeline
from pipeline.geometry.camera import Camera, intrinsics, project, to_world
from pipeline.geometry.cleaning import LiftConfig
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.lifting import LiftedObject, Quality, extents
from pipeline.language.naming import match
from pipeline.language.views import spoken_viewpoint
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Detector, Proposals
from pipeline.scenes.object_map import LEAST_SURFACE, ObjectMap, Presence, WorldObject, presences
from pipeline.scenes.views import PosedView
from pipeline.scenes.voxels import VOXEL_M, centers_of
from pipeline.scenes.world_boxes import seen_by
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

EYE_HEIGHT_M = 1.5
"""Of somebody who stands at an object, above the lowest place of the scene."""
IMAGINED = Camera(intrinsics(400.0, 400.0, 320.0, 240.0), 640, 480)
"""Camera of an imagined viewpoint: 77 degrees wide."""
LEAST_DEPTH_M = 0.05
FLOOR_PERCENTILE = 1.0
"""Of the heights of a scene's places: single stray ones lie below the floor."""
VOXELS_BESIDE = 3
"""What lies so near to the object that somebody stands at hides nothing either: its rim is nobody's."""
STEEPEST = np.deg2rad(75)
"""Nobody looks farther up or down."""
LEAST_APART_M = 0.2
"""Objects nearer to each other give no direction to face."""


@dataclass(frozen=True)
class MapDetector(AnnotationDetector):
    """Detector of a map's objects: each by the name that the frames give it, for certain."""

    name = "object map"
    where = "the scene"

    def fingerprint(self) -> str:
        return self.name


class WorldFrame(PreparedFrame):
    """Frame of a viewpoint with all objects of a scene, by their ids; made by `from_frame` and `imagined`.

    >>> from pipeline.answering.pipeline import open_pipeline
    >>> from pipeline.scenes.object_map import map_scene
    >>> from pipeline.scenes.views import posed_frames
    >>> from pipeline.scenes.world_frame import ask_world, from_frame
    >>> demo = open_pipeline("demo")
    >>> made = map_scene(demo, "000001", posed_frames(demo.dataset, "000001/000000"))
    >>> trace = ask_world(demo, from_frame(demo, made, "000001/000000"), "mug left of the laptop")
    >>> trace.objects[trace.ranking.pairs[0].target].label
    'mug'
    """

    def __init__(
        self,
        frame: Frame,
        made: ObjectMap,
        pose: np.ndarray,
        config: LiftConfig | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        points = {o.id: to_world(made.voxels.of(o.id), np.linalg.inv(pose)).astype(np.float32) for o in made.objects}
        bboxes = {number: _bbox(own, frame.camera) for number, own in points.items()}
        found = tuple(Annotation(o.id, o.label, bboxes[o.id]) for o in made.objects)
        super().__init__(replace(frame, annotations=found), config)
        self.made, self.pose, self.points = made, pose, points
        self.notes = notes  # What is assumed of the viewpoint
        self.wholes = {number: seen_by(whole, pose, self.viewer) for number, whole in made.boxes.items()}

    def lift(self, proposals: Proposals, detector: Detector) -> tuple[SceneObject, ...]:
        """Take the objects' points from the scene."""
        nothing = np.zeros(self.frame.depth.shape, np.bool_)
        return tuple(
            SceneObject(
                int(n),
                proposals.label(i),
                float(proposals.scores[i]),
                proposals.boxes[i],
                nothing,
                self._of(int(n)),
                whole=self.wholes.get(int(n)),
            )
            for i, n in enumerate(proposals.ids)
        )

    def _of(self, number: int) -> LiftedObject:
        points, whole = self.points[number], self.wholes.get(number)
        box = None if whole is None else whole.box
        distance = float(np.median(points[:, 2])) if len(points) else float("nan")
        quality = Quality(0, len(points), 1.0, 0.0, False, distance, False, "annotation")
        return LiftedObject(points, box, 0.0, *extents(points, box, self.viewer), None, quality)


def from_frame(pipeline: Pipeline, made: ObjectMap, frame_id: str) -> WorldFrame:
    """Scene from a frame of it, in whose axes relations are judged; InputError for a frame that was not joined."""
    require(
        frame_id in made.poses,
        "the frame has no place in the map",
        got=frame_id,
        expected=", ".join(made.frame_ids),
        cause=made.left_out.get(frame_id),
    )
    prepared = pipeline.prepare(frame_id)
    reason = made.left_out.get(frame_id)
    doubt = f"frame {frame_id} was left out of the map: {reason}; directions and what is visible rest on that pose"
    return WorldFrame(
        prepared.frame, made, made.poses[frame_id], pipeline.config.lift, () if reason is None else (doubt,)
    )


def imagined(pipeline: Pipeline, made: ObjectMap, at: str, facing: str) -> WorldFrame:
    """Scene for somebody who stands in the middle of one object and looks at another, each named by its class or id.

    What one stands at hides nothing. InputError for a name that the scene has no object of, or more than one, for the
    same object twice, and for objects above each other.
    """
    one, other = named_object(made, at), named_object(made, facing)
    require(one.id != other.id, "nobody faces what they stand at", got=f"{at} and {facing}: {one.label} {one.id}")
    up = made.up
    require(np.isfinite(up).all(), "nothing of the scene has a box, which would tell where up is")
    ahead = np.subtract(other.center, one.center)
    ahead = ahead - (ahead @ up) * up
    length = float(np.linalg.norm(ahead))
    require(
        length >= LEAST_APART_M,
        f"who stands at the {one.label} does not face the {other.label}: it is above or below",
        got=f"{length:.2f} m apart",
        expected=f"at least {LEAST_APART_M:g} m",
    )
    ahead /= length
    places = centers_of(made.voxels.places[0])
    beside = (np.maximum(np.subtract(one.low, places), places - one.high) > VOXELS_BESIDE * VOXEL_M).any(axis=1)
    places = places[beside]
    require(len(places), "the map has no places")
    eye = np.asarray(one.center, float)
    eye += (float(np.percentile(places @ up, FLOOR_PERCENTILE)) + EYE_HEIGHT_M - eye @ up) * up
    steep = float(np.clip(np.arctan2((np.asarray(other.center) - eye) @ up, length), -STEEPEST, STEEPEST))
    right, ahead = np.cross(-up, ahead), np.cos(steep) * ahead + np.sin(steep) * up
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    pose[:3, 3] = eye
    depth = _splatted(places, pose)
    camera = replace(IMAGINED, T_world_camera=pose, up=pose[:3, :3].T @ up, up_source="given")
    shade = (40 + 160 / np.maximum(depth, 1.0) * (depth > 0)).astype(np.uint8)
    frame = Frame(f"at {one.label} facing {other.label}", np.repeat(shade[..., None], 3, axis=2), depth, camera)
    named = ((at, one), (facing, other))
    taken = tuple(f"'{name}' taken as {o.label} {o.id}" for name, o in named if o.label not in name.casefold())
    return WorldFrame(frame, made, pose, pipeline.config.lift, taken)


def asked_from(pipeline: Pipeline, made: ObjectMap, text: str) -> tuple[str, WorldFrame | None]:
    """Split an expression into what is asked and the viewpoint that it names, as of `imagined`; None for none.

    Who faces nothing in particular faces the reference, or without one the target. Without a target anything is asked
    for.

    >>> from pipeline.answering.pipeline import open_pipeline
    >>> from pipeline.scenes.object_map import map_scene
    >>> from pipeline.scenes.views import posed_frames
    >>> from pipeline.scenes.world_frame import asked_from
    >>> demo = open_pipeline("demo")
    >>> made = map_scene(demo, "000001", posed_frames(demo.dataset, "000001/000000"))
    >>> text, world = asked_from(demo, made, "from the bookshelf, facing the armchair: mug left of the laptop")
    >>> text, world.frame.id
    ('mug left of the laptop', 'at bookshelf facing armchair')
    """
    text, spoken = spoken_viewpoint(text)
    if spoken is None:
        return text, None
    if not _reads(pipeline, text) and _reads(pipeline, f"what is {text}"):
        # "…, left of the table": anything that is there.
        text = f"what is {text}"
    facing = spoken.facing or pipeline.read(text).labels[:2][-1]
    return text, imagined(pipeline, made, spoken.at, facing)


def _reads(pipeline: Pipeline, text: str) -> bool:
    try:
        pipeline.read(text)
    except InputError:
        return False
    return True


def named_object(made: ObjectMap, name: str) -> WorldObject:
    """Object of a scene by its class name, its id, or both ("sink 9"); InputError for none or several."""
    said = re.fullmatch(r"(?:(.*?)[ ·])?(\d+)", name.strip())
    if said is not None and (own := next((o for o in made.objects if o.id == int(said[2])), None)) is not None:
        require(said[1] in (None, own.label), f"object {own.id} of the scene is no {said[1]}", got=own.label)
        return own
    labels = tuple(dict.fromkeys(o.label for o in made.objects))
    meant = match(name, labels)
    found = [o for o in made.objects if o.label in meant]
    require(found, "the scene has no such object", got=name, expected=", ".join(labels))
    one_of = " | ".join(f"{o.label} {o.id}" for o in found)
    require(len(found) == 1, f"the scene has {len(found)} objects called {name}", got=name, expected=one_of)
    return found[0]


def ask_world(pipeline: Pipeline, world: WorldFrame, text: str) -> Trace:
    """Answer an expression by all objects of a scene; errors as of `ask`."""
    detector = MapDetector(tuple(dict.fromkeys(o.label for o in world.made.objects)), pipeline.synonyms)
    return replace(pipeline, detector=detector, predictions=None, line=None).ask(world, text)


def presence_from(world: WorldFrame, number: int) -> Presence:
    """Presence of an object in the viewpoint's picture, by depth alone where the frame is not of the map."""
    found = next(o for o in world.made.objects if o.id == number)
    if world.frame.id in found.presence:
        return found.presence[world.frame.id]
    places = world.made.voxels.of(number)
    ((presence, _),) = presences(PosedView.of(world.frame, world.pose), [places])
    if presence == "out" or world.frame.id in world.made.left_out:
        return "seen" if presence == "missed" else presence
    # An imagined picture is drawn of the places themselves: what hides an object is in front of its own front.
    own, depth = _splatted(places, world.pose), world.frame.depth
    front = (own > 0) & ((own <= depth + VOXELS_BESIDE * VOXEL_M) | (depth <= 0))
    return "seen" if np.count_nonzero(front) >= LEAST_SURFACE * max(1, np.count_nonzero(own)) else "hidden"


def _bbox(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Box in the picture of camera-frame points, (4,) float32, pixels; empty where none is in view."""
    pixel = project(points[points[:, 2] > LEAST_DEPTH_M], camera)
    low, high = (f(pixel, axis=0) if len(pixel) else np.zeros(2) for f in (np.min, np.max))
    size = np.array([camera.width, camera.height])
    low, high = np.clip(low, 0, size), np.clip(high + 1, 0, size)
    inside = bool((high > low).all()) and len(pixel) > 0
    return np.concatenate([low, high]).astype(np.float32) if inside else np.zeros(4, np.float32)


def _splatted(places: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Depth of the scene's places from a pose, (H, W) float32, metres: each as large as its voxel."""
    points = to_world(places, np.linalg.inv(pose))
    points = points[points[:, 2] > LEAST_DEPTH_M]
    u, v = np.rint(np.nan_to_num(project(points, IMAGINED), nan=-1.0)).astype(np.int64).T
    side = np.clip(np.ceil(1.5 * VOXEL_M * IMAGINED.fx / points[:, 2]), 1, 15).astype(np.int64)
    depth = np.full((IMAGINED.height, IMAGINED.width), np.inf, np.float32)
    for size in np.unique(side).tolist():
        own = np.full(depth.shape, np.inf, np.float32)
        of = (side == size) & (u >= 0) & (v >= 0) & (u < IMAGINED.width) & (v < IMAGINED.height)
        np.minimum.at(own, (v[of], u[of]), points[of, 2].astype(np.float32))
        depth = np.minimum(depth, cv2.erode(own, np.ones((size, size), np.uint8)))
    # Where nothing is seen, at the border too, which erosion fills with the largest number.
    depth[depth >= np.finfo(np.float32).max] = 0
    return depth
