"""A scene's objects from a viewpoint: those that the viewpoint does not show, too.

The viewpoint is that of a frame, or imagined: somebody who stands at one object and faces another. Relations are the
viewer's, as everywhere; what is not visible from there has its points from the other frames of the scene.
"""

from __future__ import annotations

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
from pipeline.scenes.object_map import ObjectMap, Presence, WorldObject, presences
from pipeline.scenes.views import PosedView
from pipeline.scenes.voxels import VOXEL_M, centers_of
from pipeline.scenes.world_boxes import seen_by
from pipeline.system.errors import InputError, require

EYE_HEIGHT_M = 1.5
"""Of somebody who stands at an object, above the lowest place of the scene."""
IMAGINED = Camera(intrinsics(400.0, 400.0, 320.0, 240.0), 640, 480)
"""Camera of an imagined viewpoint: 77 degrees wide."""
LEAST_DEPTH_M = 0.05
FLOOR_PERCENTILE = 1.0
"""Of the heights of a scene's places: single stray ones lie below the floor."""
LEAST_APART_M = 0.2
"""Objects nearer to each other give no direction to face."""


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

    def __init__(self, frame: Frame, made: ObjectMap, pose: np.ndarray, config: LiftConfig | None = None) -> None:
        points = {o.id: to_world(made.voxels.of(o.id), np.linalg.inv(pose)).astype(np.float32) for o in made.objects}
        bboxes = {number: _bbox(own, frame.camera) for number, own in points.items()}
        found = tuple(Annotation(o.id, o.label, bboxes[o.id]) for o in made.objects)
        super().__init__(replace(frame, annotations=found), config)
        self.made, self.pose, self.points = made, pose, points
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
    return WorldFrame(prepared.frame, made, made.poses[frame_id], pipeline.config.lift)


def imagined(pipeline: Pipeline, made: ObjectMap, at: str, facing: str) -> WorldFrame:
    """Scene for somebody who stands at one object and faces another, each named by its class.

    InputError for a name that the scene has no object of, or more than one, and for objects above each other.
    """
    one, other = named_object(made, at), named_object(made, facing)
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
    require(len(places), "the map has no places")
    eye = np.asarray(one.center, float)
    eye += (float(np.percentile(places @ up, FLOOR_PERCENTILE)) + EYE_HEIGHT_M - eye @ up) * up
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(-up, ahead), -up, ahead], axis=1)
    pose[:3, 3] = eye
    depth = _splatted(places, pose)
    camera = replace(IMAGINED, T_world_camera=pose, up=pose[:3, :3].T @ up, up_source="given")
    shade = (40 + 160 / np.maximum(depth, 1.0) * (depth > 0)).astype(np.uint8)
    frame = Frame(f"at {one.label} facing {other.label}", np.repeat(shade[..., None], 3, axis=2), depth, camera)
    return WorldFrame(frame, made, pose, pipeline.config.lift)


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
    """The one object of a scene with a class name; InputError for none or several."""
    labels = tuple(dict.fromkeys(o.label for o in made.objects))
    meant = match(name, labels)
    found = [o for o in made.objects if o.label in meant]
    require(found, "the scene has no such object", got=name, expected=", ".join(labels))
    require(len(found) == 1, f"the scene has {len(found)} objects called {name}", got=name, expected="one")
    return found[0]


def ask_world(pipeline: Pipeline, world: WorldFrame, text: str) -> Trace:
    """Answer an expression by all objects of a scene; errors as of `ask`."""
    detector = AnnotationDetector(tuple(dict.fromkeys(o.label for o in world.made.objects)), pipeline.synonyms)
    return replace(pipeline, detector=detector, predictions=None, line=None).ask(world, text)


def presence_from(world: WorldFrame, number: int) -> Presence:
    """Presence of an object in the viewpoint's picture, by depth alone where the frame is not of the map."""
    found = next(o for o in world.made.objects if o.id == number)
    if world.frame.id in found.presence:
        return found.presence[world.frame.id]
    ((presence, _),) = presences(PosedView.of(world.frame, world.pose), [world.made.voxels.of(number)])
    # Nobody has looked for objects in an imagined picture.
    return "seen" if presence == "missed" else presence


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
    depth[~np.isfinite(depth)] = 0
    return depth
