"""3D scene of a client: the frame's cloud, boxes by role, pair lines; draws without computing.

Everything stands in the viewer's level frame with x right, y forward, z up and the camera at the origin, so that the
floor is level at any camera pitch.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence, Set
from typing import Any

import numpy as np
import viser
import viser.transforms as vtf

from pipeline.diagnosis.whatif.answer_view import ExtraBox
from pipeline.diagnosis.whatif.state import CameraView
from pipeline.geometry.boxes import CUBE, CUBE_FACES, Box3D, boxes_on_ray, edge_lines, half_dashed
from pipeline.geometry.camera import Camera
from pipeline.geometry.cloud import Cloud, nearest_distance, viewpoint
from pipeline.geometry.palette import FACE_OPACITY, LINE_WIDTH, RGB, Role, hex_color, palette
from pipeline.system.errors import needed
from pipeline.system.frozen import dataclass
from pipeline.system.recent import Recent
from spatialviz.app.scene_client import SceneClient, triple
from spatialviz.app.state import State

GHOST_GROWTH = 0.012
"""Enlargement of extra boxes, metres, so that no lines coincide with the answer's boxes."""


@dataclass(frozen=True)
class Tag:
    """Name tag at a node of the scene."""

    node: str
    text: str
    detail: str
    color: str  # "#rrggbb"
    strong: bool
    # Half sizes of the named thing around the node, metres, along the columns of a rotation; a point without an extent
    extent: tuple[float, float, float] = (0.0, 0.0, 0.0)
    R: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    mark: str = ""  # Glyph of a role, "T" or "R"
    right: bool = False  # A right answer
    dashed: bool = False  # Of a labelled box, which is dashed


MARKS: dict[str, str] = {"target": "T", "reference": "R"}
COLORS = palette(True)
"""Role colours in the scene, the same on any ground as in the picture: boxes stand over points, with a dark halo."""


class SceneView:
    """Draws into a client's scene."""

    def __init__(
        self,
        client: SceneClient,
        on_ray: Callable[[tuple[int, int] | None, list[int]], None],
    ) -> None:
        self.viewpoint = Viewpoint(client)
        self._client = client
        self._boxed: dict[int, Box3D] = {}
        self._boxes_of: tuple[object, object] = (), ()
        self._turned = Recent[tuple[int, int], tuple[Box3D, np.ndarray, Box3D]](1000)
        self.cloud: Cloud | None = None
        self.to_show = np.eye(3)

        def clicked(event: Any) -> None:
            ray = np.array(event.ray_origin), np.array(event.ray_direction)
            on_ray(None if self.cloud is None else self.cloud.pixel_on_ray(*ray), boxes_on_ray(self._boxed, *ray))

        client.on_click(clicked)

    def draw(self, state: State) -> list[Tag]:
        """Draw boxes and pair lines, and return the name tags."""
        colors, flags, lines = COLORS, state.flags, self._client.lines
        objects = state.shown.objects
        if self._boxes_of[0] is not objects or self._boxes_of[1] is not self.to_show:
            self._boxes_of = objects, self.to_show
            self._boxed = {i: self.shown_box(o.lifted.box) for i, o in enumerate(objects) if o.lifted.box is not None}
        role_of: dict[int, Role] = {i: state.roles.get(i, "other") for i in self._boxed}
        wanted = [i for i in self._boxed if state.boxes_shown or role_of[i] != "other"]

        def edges_of(chosen: Sequence[int]) -> np.ndarray:
            sides = [objects[i].lifted.open_sides for i in chosen]
            return edge_lines([self._boxed[i] for i in chosen], open_sides=sides)

        with self._client.atomic():
            for role in ("other", "reference", "target", "truth"):
                members = [i for i in wanted if role_of[i] == role]
                name = "asked" if role == "truth" else role
                lines(f"/boxes/{name}", edges_of(members), colors[role], LINE_WIDTH[role])
            chosen = [i for i in (state.selected,) if i in self._boxed and i not in state.roles]
            lines("/boxes/selected", edges_of(chosen), (255, 255, 255), LINE_WIDTH["target"])
            self._draw_whole(state, colors)
            annotated = () if state.loaded is None or not flags.truth else state.loaded.context.frame.annotations
            truth = [self.shown_box(a.box) for a in annotated if a.box is not None]
            lines("/boxes/truth", edge_lines(truth, dashes=True), colors["truth"], LINE_WIDTH["other"])
            self._draw_faces(wanted, role_of, colors)
            self._draw_pairs(state.pair_lines if flags.pairs else (), colors)
            ghosts = state.ghosts if flags.ghosts else ()
            tags = self._draw_axes(state) + self._draw_ghosts(ghosts, state, colors)
            return tags + self._draw_tags(state, role_of, colors, {ghost.of for ghost in ghosts})

    def _draw_whole(self, state: State, colors: Mapping[Role, RGB]) -> None:
        """Whole box of the selected object, in dashes where it is not sure."""
        i, edges = state.selected, np.zeros((0, 2, 3))
        whole = None if i is None or i not in self._boxed else state.shown.objects[i].estimated
        if whole is not None:
            edges = half_dashed(self.shown_box(whole.box), whole.unsure)
        color = (255, 255, 255) if i is None or i not in state.roles else colors[state.roles[i]]
        self._client.lines("/boxes/whole", edges, color, LINE_WIDTH["other"])

    def _draw_ghosts(self, ghosts: Sequence[ExtraBox], state: State, colors: Mapping[Role, RGB]) -> list[Tag]:
        """Extra boxes beside the answer's, slightly larger and in dashes; one of the same thing has the same name."""
        tags = []
        for role in ("truth", "edited", "other"):
            members = [self.shown_box(ghost.box) for ghost in ghosts if ghost.role == role]
            lines = edge_lines(members, GHOST_GROWTH, dashes=True)
            self._client.lines(f"/boxes/ghosts-{role}", lines, colors[role], LINE_WIDTH["truth"])
        for ghost in ghosts:
            box, color = self.shown_box(ghost.box), hex_color(colors[ghost.role])
            anchor = self._client.anchor(f"/tags/ghost-{ghost.key}", box.center)
            mark = MARKS[ghost.key.rpartition("-")[2]]
            text, detail = (ghost.text, "") if ghost.of is None else (_name(state, ghost.of), "as labelled")
            tags.append(Tag(anchor, text, detail, color, True, **_shape(box), mark=mark, dashed=True))
        return tags

    def shown_box(self, box: Box3D) -> Box3D:
        """Box of the camera frame, in the shown frame."""
        key = id(box), id(self.to_show)
        return self._turned.get(key, lambda: (box, self.to_show, box.turned(self.to_show)))[2]

    def camera_box(self, box: Box3D) -> Box3D:
        """Shown box, in the camera frame."""
        return box.turned(self.to_show.T)

    def _draw_faces(self, shown: Sequence[int], role_of: Mapping[int, Role], colors: Mapping[Role, RGB]) -> None:
        self._client.outdated("/boxes/faces", len(shown))
        if not shown:
            return
        boxes = [self._boxed[i] for i in shown]
        self._client.put(
            "batched_meshes_simple",
            "/boxes/faces",
            vertices=CUBE,
            faces=CUBE_FACES,
            batched_wxyzs=vtf.SO3.from_matrix(np.stack([b.R for b in boxes])).wxyz.astype(np.float32),
            batched_positions=np.stack([b.center for b in boxes]).astype(np.float32),
            batched_scales=np.stack([np.maximum(b.size, 0.005) for b in boxes]).astype(np.float32),
            batched_colors=np.array([colors[role_of[i]] for i in shown], np.uint8),
            batched_opacities=np.array([FACE_OPACITY[role_of[i]] for i in shown], np.float32),
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_pairs(self, pairs: Sequence[tuple[int, int]], colors: Mapping[Role, RGB]) -> None:
        """Lines between the boxes of pairs, the chosen pair first."""
        known = [pair for pair in pairs if self._boxed.keys() >= set(pair)]
        ends = [[self._boxed[a].center, self._boxed[b].center] for a, b in known]
        segments = np.array(ends, np.float32).reshape(-1, 2, 3)
        tint = np.array([[colors["target"], colors["reference"]]], np.uint8).repeat(len(segments), axis=0)
        first = 1 if known[:1] == list(pairs[:1]) else 0
        self._client.lines("/pairs/chosen", segments[:first], tint[:first], 5.0)
        self._client.lines("/pairs/others", segments[first:], (tint[first:] * 0.6).astype(np.uint8), 1.6)

    def _draw_axes(self, state: State) -> list[Tag]:
        """Axes of the relation's frame: the viewer's right, forward and up at the reference."""
        pairs = state.pair_lines if state.flags.axes or state.flags.region else ()
        reference = self._boxed.get(pairs[0][1]) if pairs else None
        tags: list[Tag] = []
        if reference is None:
            self._client.clear("/axes/")
            return tags
        length = float(np.clip(np.linalg.norm(reference.size), 0.25, 0.8))
        for name, direction in zip(("right", "forward", "up"), np.eye(3), strict=True):
            tip = reference.center + direction * length
            self._client.put(
                "arrows",
                f"/axes/{name}",
                points=np.array([[reference.center, tip]], np.float32),
                colors=np.array(plain_color(state.dark), np.uint8),
                shaft_radius=0.006,
                head_radius=0.016,
                head_length=0.05,
            )
            tags.append(Tag(self._client.anchor(f"/axes/tip-{name}", tip), name, "", "#5b6472", False))
        return tags

    def _draw_tags(
        self, state: State, role_of: Mapping[int, Role], colors: Mapping[Role, RGB], twice: Set[int | None]
    ) -> list[Tag]:
        """Name tags of boxes; those of `twice` have a labelled box as well."""
        tags = []
        for i, box in self._boxed.items():
            role = role_of[i]
            strong = role != "other" or i == state.selected
            if strong or state.flags.labels:
                # The target's tag moves from object to object: a moved node is cheaper than a new node.
                place = "target" if role == "target" else i
                anchor, color = self._client.anchor(f"/tags/{place}", box.center), hex_color(colors[role])
                mark, right = MARKS.get(role, ""), role in state.right_roles
                detail = "as found" if i in twice else ""
                tags.append(Tag(anchor, _name(state, i), detail, color, strong, **_shape(box), mark=mark, right=right))
        # The answer's tags come last, on top of others.
        return sorted(tags, key=lambda t: t.strong)


def _name(state: State, place: int) -> str:
    return state.shown.names[place].replace("·", " ")


def plain_color(dark: bool) -> RGB:
    """Colour of lines without a role: nearly white on dark, nearly black on light."""
    return (245, 247, 250) if dark else (24, 26, 30)


def _shape(box: Box3D) -> dict[str, Any]:
    """Extent and rotation of a box's tag."""
    return {"extent": triple(np.round(box.size / 2, 4)), "R": tuple(np.round(box.R, 4).ravel().tolist())}


SAMPLE, FLIGHT = 20_000, 12
"""Points sampled of a cloud for placing the view; steps of a smooth camera move."""


class Viewpoint:
    """Moves a client's camera in the level frame of the shown cloud."""

    def __init__(self, client: SceneClient) -> None:
        self._client = client
        self._points: np.ndarray | None = None
        self._to_show = np.eye(3)
        self._camera: Camera | None = None
        self._placed: tuple[str, float, np.ndarray] | None = None
        self._reached = False
        self.untouched = True
        """True until a person turns the view."""
        self._about: np.ndarray | None = None
        self._covered = (0.0, 0.0)

        @client.camera.on_update
        async def _(camera: viser.CameraHandle) -> None:
            if self._placed is None or self._points is None:
                return
            kind, aspect, eye = self._placed
            there = np.linalg.norm(np.array(camera.position) - eye) < 0.02
            if self._reached and not there:
                self._placed, self.untouched = None, False
                return
            # Until the new pose arrives, the browser reports an older pose.
            self._reached = self._reached or bool(there)
            if abs(self._aspect - aspect) > 0.02:
                self.place(kind)

    def set_frame(self, points: np.ndarray, R_show_camera: np.ndarray, camera: Camera) -> None:
        """Take over another cloud ((N, 3), shown frame, metres) and its camera."""
        self._points, self._to_show, self._camera = points[:: len(points) // SAMPLE + 1], R_show_camera, camera

    def look_about(self, corners: np.ndarray | None) -> bool:
        """Set the subject of "pair" ((N, 3), shown frame, metres); True if changed."""
        before, self._about = self._about, corners
        return before is not corners if before is None or corners is None else not np.array_equal(before, corners)

    def cover(self, width: float, height: float) -> None:
        """Keep a pair from under what covers these shares of the view, from its upper right corner."""
        if (width, height) != self._covered:
            self._covered = width, height
            if self._placed is not None and self._placed[0] == "pair":
                self.place("pair")

    def place(self, kind: str, steps: int = 1) -> None:
        """Move the camera to "pair", "sensor", "orbit" or "top", at once, or smoothly in steps."""
        # Repeated on a change of the page's shape until a person turns the view.
        points, lens = needed(self._points, "no cloud is shown"), needed(self._camera, "no cloud is shown")
        eye, look, fov = viewpoint(kind, points, self._to_show, lens, self._aspect, self._about, self._covered)
        # The sensor's own up in the sensor's view, as in the picture; the world's elsewhere.
        up = self._to_show @ np.array([0.0, -1.0, 0.0]) if kind == "sensor" else np.array([0.0, 0.0, 1.0])
        camera, self._placed = self._client.camera, None
        p0, l0, f0 = np.array(camera.position), np.array(camera.look_at), float(camera.fov)
        for k in range(1, steps + 1):
            t = k / steps
            t = t * t * (3 - 2 * t)
            position, look_at = p0 * (1 - t) + eye * t, l0 * (1 - t) + look * t
            self._turn(up_direction=triple(up), position=position, look_at=look_at, fov=f0 * (1 - t) + fov * t)
            if k < steps:
                self._client.flush()
                time.sleep(1 / 40)
        self._placed, self._reached, self.untouched = (kind, self._aspect, eye), False, True

    def _turn(self, **pose: Any) -> None:
        with self._client.atomic():
            for name, value in pose.items():
                setattr(self._client.camera, name, value)

    @property
    def _aspect(self) -> float:
        return float(np.clip(self._client.camera.aspect or 1.3, 0.4, 3.0))

    def turned_to(self) -> tuple[CameraView, float] | None:
        """Camera view as turned by a person, in the frame's camera frame, with field of view; None if not turned."""
        if self.untouched or self._points is None:
            return None
        camera = self._client.camera
        vectors = (camera.position, camera.look_at, camera.up_direction)
        return CameraView(*(triple((self._to_show.T @ np.array(v)).round(4)) for v in vectors)), float(camera.fov)

    def turn_to(self, view: CameraView, fov: float | None) -> None:
        """Restore a camera view."""
        eye, look, up = (self._to_show @ np.array(v) for v in (view.position, view.look_at, view.up))
        if np.linalg.norm(look - eye) < 1e-4 or np.linalg.norm(np.cross(look - eye, up)) < 1e-6:
            return  # Degenerate view.
        self._placed, self.untouched = None, False
        width = {"fov": fov} if fov is not None and 0.05 < fov < 3.0 else {}
        self._turn(up_direction=up, position=eye, look_at=look, **width)

    def focus(self, box: Box3D) -> None:
        """Look at an object from the camera's place, nearer."""
        center = self._to_show @ box.center
        # The next frame is shown whole again.
        self._placed, self.untouched = None, True
        away = np.array(self._client.camera.position) - center
        least = nearest_distance(box.corners, needed(self._camera, "no cloud is shown"))
        away *= max(float(np.linalg.norm(box.size)) * 1.9, least) / max(float(np.linalg.norm(away)), 1e-6)
        self._turn(position=center + away, look_at=center)
