"""One RGB-D frame, validated when it is built, and what is annotated in it."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera, project
from pipeline.geometry.fitting import median
from pipeline.geometry.masks import LazyMask, PictureMask
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.frozen import dataclass

NEAREST_MEDIAN_M = 0.1
FARTHEST_MEDIAN_M = 20.0
"""Bounds for the median depth of an indoor frame. Outside them the depth unit
is wrong: metres read as millimetres fall a thousand times below."""


@dataclass(frozen=True)
class Annotation:
    """An annotated object of a frame.

    Attributes
    ----------
    index : int
        Place in the dataset's own list for this frame.
    label : str
        Class name as the dataset gives it.
    bbox : (4,) float32
        x0, y0, x1, y1 in pixels; x1 and y1 are exclusive edges.
    mask : (H, W) bool or None
        Visible pixels.
    box : Box3D or None
        The exact 3D box in the camera frame, where the dataset knows it.
    visible : float or None
        Share of the object that is not occluded, 0..1.
    instance : int or None
        The dataset's number of this very object, the same in all frames that show it.
    difficulty : int or None
        Difficulty of finding the object, by the dataset: 1 is easy.
    fixed : bool
        The 3D box stands as it is: none is fitted to the points.

    >>> from pipeline import Annotation
    >>> Annotation(0, "mug", [210, 140, 260, 200])
    <Annotation 0 'mug' at 210 140 260 200>
    """

    index: int
    label: str
    bbox: np.ndarray
    mask: np.ndarray | None = None
    box: Box3D | None = None
    visible: float | None = None
    instance: int | None = None
    difficulty: int | None = None
    fixed: bool = False

    def __post_init__(self) -> None:
        bbox = np.asarray(self.bbox, dtype=np.float32)
        require(
            bbox.shape == (4,) and np.isfinite(bbox).all(),
            f"annotation {self.index}: a box must be four finite numbers",
            got=self.bbox,
        )
        object.__setattr__(self, "bbox", bbox)
        if self.mask is not None and (self.mask.dtype != np.bool_ or self.mask.ndim != 2):
            raise InputError(
                f"annotation {self.index}: a mask must be bool (H, W)",
                got=f"{self.mask.dtype} {self.mask.shape}",
            )

    def __repr__(self) -> str:
        parts = [f"{name}" for name in ("mask", "box") if getattr(self, name) is not None]
        return f"<Annotation {self.index} {self.label!r} at {_pixels(self.bbox)}{''.join(f', {p}' for p in parts)}>"

    @property
    def held(self) -> PictureMask | None:
        """The mask, as it is held by its crop."""
        own = LazyMask.of(self)
        return own if own is not None or self.mask is None else PictureMask.of(self.mask)

    @property
    def mask_size(self) -> tuple[int, ...] | None:
        """Height and width of the mask, which need not be painted for it."""
        own = LazyMask.of(self)
        return own.size if own is not None else None if self.mask is None else self.mask.shape

    @classmethod
    def of_mask(cls, index: int, label: str, mask: PictureMask, **more: Any) -> Annotation:
        """Build an annotation of a mask, and of its box; `more`: further fields."""
        return LazyMask.held_by(cls(index, label, np.array(mask.crop.box), **more), mask)


Annotation.mask = LazyMask()  # pyright: ignore[reportAttributeAccessIssue]


@dataclass(frozen=True)
class Frame:
    """A registered colour and depth image, its camera and its annotations.

    Attributes
    ----------
    id : str
        The dataset's own name of the frame.
    rgb : (H, W, 3) uint8
    depth : (H, W) float32
        Metres along the camera's z axis; 0 where nothing was measured.
    camera : Camera
    annotations : tuple of Annotation
    notes : tuple of str
        Oddities of this frame that could be left out.
    depth_source : str
        Network that estimated the depth, and the source of its metres, in words; empty where a sensor measured it.

    >>> import numpy as np
    >>> from pipeline import Frame
    >>> from pipeline.geometry import intrinsics
    >>> rgb, depth = np.zeros((480, 640, 3), np.uint8), np.full((480, 640), 1.5)
    >>> Frame.of_arrays(rgb, depth, intrinsics(570, 570, 320, 240))
    <Frame 'frame': 640x480, 0 annotations>
    """

    id: str
    rgb: np.ndarray
    depth: np.ndarray
    camera: Camera
    annotations: tuple[Annotation, ...] = ()
    notes: tuple[str, ...] = field(default=())
    depth_source: str = ""

    def __post_init__(self) -> None:
        rgb, depth, camera = self.rgb, self.depth, self.camera
        require(
            rgb.dtype == np.uint8 and rgb.ndim == 3 and rgb.shape[2] == 3,
            f"frame {self.id}: colour must be uint8 (H, W, 3)",
            got=f"{rgb.dtype} {rgb.shape}",
            cause=_color_advice(rgb),
        )
        require(
            depth.dtype == np.float32 and depth.shape == rgb.shape[:2],
            f"frame {self.id}: depth must be float32 metres of shape {rgb.shape[:2]}",
            got=f"{depth.dtype} {depth.shape}",
            cause="is this the raw depth and not the one registered to the picture?",
        )
        self._check_camera(camera)
        lowest, highest = float(depth.min()), float(depth.max())
        require(
            (np.isfinite(lowest) and np.isfinite(highest)) and lowest >= 0,
            f"frame {self.id}: depth must be finite and at least 0",
            got=f"{lowest:g} to {highest:g}",
            cause="pixels without depth are 0",
        )
        require(highest != 0, f"frame {self.id}: no usable depth", got="only zeros")
        valid = depth[depth > 0]
        # A strided median is exact enough for a factor of a thousand.
        middle = float(median(valid[:: max(1, valid.size // 20_000)]))
        require(
            NEAREST_MEDIAN_M <= middle <= FARTHEST_MEDIAN_M,
            f"frame {self.id}: depth of the wrong unit",
            got=f"a median depth of {middle:.3g} m",
            expected=f"{NEAREST_MEDIAN_M:g} to {FARTHEST_MEDIAN_M:g} m",
            cause="is it in millimetres? the depth scale is the depth units in one metre, 1000 for millimetres",
        )
        for annotation in self.annotations:
            size = annotation.mask_size
            if size is not None and size != depth.shape:
                raise InputError(
                    f"frame {self.id}: the mask of annotation {annotation.index} has another size",
                    got=size,
                    expected=depth.shape,
                )

    def _check_camera(self, camera: Camera) -> None:
        require(
            (camera.height, camera.width) == self.depth.shape,
            f"frame {self.id}: the camera is for another image size",
            got=f"{camera.width}x{camera.height}",
            expected=f"{self.depth.shape[1]}x{self.depth.shape[0]}",
        )

    def by_camera(self, camera: Camera, notes: tuple[str, ...] | None = None) -> Frame:
        """Frame of the same pixels, which are not checked again, by another camera, and with other notes."""
        self._check_camera(camera)
        found = copy(self)
        # As `replace` does; what is cached of the pixels holds.
        found.__dict__.update(camera=camera, notes=self.notes if notes is None else notes)
        return found

    @classmethod
    def of_arrays(
        cls,
        rgb: np.ndarray,
        depth: np.ndarray,
        K: np.ndarray,
        *,
        masks: Sequence[np.ndarray] | np.ndarray | None = None,
        names: Sequence[str] | None = None,
        boxes: Sequence[Box3D | None] | None = None,
        up: Sequence[float] | np.ndarray | None = None,
        T_world_camera: np.ndarray | None = None,
        id: str = "frame",
    ) -> Frame:
        """Build a frame from arrays, with the objects in view.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
        depth : (H, W) float
            Metres along the camera's z axis; 0 or NaN where nothing was measured.
        K : (3, 3) float
            Intrinsics, pixels.
        masks : (N, H, W) bool, optional
            The pixels of each object; integers 0 and 1 will do.
        names : N str, optional
            Name of each object; by default "object 1", "object 2", ...
        boxes : N Box3D or None, optional
            3D boxes, camera frame, metres: these stand, and none is fitted. They may come without masks.
        up : (3,) float, optional
            Against gravity, camera frame.
        T_world_camera : (4, 4) float, optional
            Pose.

        Raises
        ------
        InputError
            Arrays of other shapes, types or units; an empty mask, or a box that is not in view; another number of names
            or boxes than of masks.
        """
        rgb, depth = _array(rgb, "rgb", id), _array(depth, "depth", id)
        require(
            depth.dtype.kind == "f",
            f"frame {id}: depth must be float metres",
            got=f"{depth.dtype} {depth.shape}",
            cause="is it in millimetres? depth / 1000.0",
        )
        # NaN and infinity are how others write that nothing was measured.
        depth = np.where(np.isfinite(depth), depth, 0).astype(np.float32)
        known = None if up is None else np.asarray(up, np.float64)
        # Colour of another shape is refused by the frame.
        height, width = (*rgb.shape, 0, 0)[:2]
        camera = Camera(K, width, height, T_world_camera, known, None if up is None else "given")
        whole = cls(id, rgb, depth, camera)
        return replace(whole, annotations=_annotations(whole, masks, names, boxes))

    def __repr__(self) -> str:
        return f"<Frame {self.id!r}: {self.width}x{self.height}, {len(self.annotations)} annotations>"

    @property
    def height(self) -> int:
        return int(self.depth.shape[0])

    @property
    def width(self) -> int:
        return int(self.depth.shape[1])

    @cached_property
    def content_hash(self) -> str:
        """Hash of the pixels, for caches: equal pictures have equal hashes."""
        import xxhash

        digest = xxhash.xxh3_128()
        digest.update(str(self.rgb.shape).encode())
        digest.update(np.ascontiguousarray(self.rgb).data)
        return digest.hexdigest()


def _pixels(bbox: np.ndarray) -> str:
    return " ".join(f"{x:.0f}" for x in bbox)


def _array(values: object, what: str, frame: str) -> np.ndarray:
    with as_input_error(f"frame {frame}: {what} is no array", ValueError, TypeError, got=str):
        return np.asarray(values)


def _color_advice(rgb: np.ndarray) -> str | None:
    """Likely way from a picture of another type or order of axes to (H, W, 3) uint8."""
    if rgb.dtype.kind == "f":
        return "is it 0 to 1? (255 * rgb).astype(np.uint8)"
    turned = rgb.ndim == 3 and rgb.shape[0] == 3 and rgb.shape[2] != 3
    return "are channels first? rgb.transpose(1, 2, 0)" if turned else None


def _annotations(
    frame: Frame,
    masks: Sequence[np.ndarray] | np.ndarray | None,
    names: Sequence[str] | None,
    boxes: Sequence[Box3D | None] | None,
) -> tuple[Annotation, ...]:
    """Annotations from arrays, each with a mask, a 3D box or both; see `Frame.of_arrays`."""
    arrays = {"masks": masks, "names": names, "boxes": boxes}
    numbers = {what: len(values) for what, values in arrays.items() if values is not None}
    objects = numbers.get("masks") or numbers.get("boxes") or 0
    counts = ", ".join(f"{n} {what}" for what, n in numbers.items())
    require(
        not isinstance(names, str) and set(numbers.values()) <= {objects},
        f"frame {frame.id}: a name for each mask, and a box or None",
        got=repr(names) if isinstance(names, str) else counts,
    )
    found = []
    for index in range(objects):
        name = f"object {index + 1}" if names is None else str(names[index])
        mask = None if masks is None else _mask(masks[index], f"frame {frame.id}: the mask of {name!r}", frame)
        box = None if boxes is None else boxes[index]
        if mask is None and box is None:
            raise InputError(f"frame {frame.id}: {name!r} has neither a mask nor a box")
        bbox = np.zeros(4) if box is None else _seen(box, frame, f"frame {frame.id}: the 3D box of {name!r}")
        if mask is not None:
            rows, columns = (np.flatnonzero(np.any(mask, axis=axis)) for axis in (1, 0))
            bbox = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float32)
        found.append(Annotation(index, name, bbox, mask, box, fixed=box is not None))
    return tuple(found)


def _mask(mask: object, what: str, frame: Frame) -> np.ndarray:
    array = np.asarray(mask)
    require(
        array.dtype.kind in "bui" and array.shape == frame.depth.shape,
        f"{what} must be bool of shape {frame.depth.shape}",
        got=f"{array.dtype} {array.shape}",
        cause="are these probabilities or logits? mask > 0.5, mask > 0" if array.dtype.kind == "f" else None,
    )
    require(array.any(), f"{what} is empty")
    return array.astype(np.bool_)


def _seen(box: Box3D, frame: Frame, what: str) -> np.ndarray:
    """Rectangle of a 3D box in the picture, (4,) float32; InputError outside the view."""
    front = box.corners[box.corners[:, 2] > 0]
    seen = project(front, frame.camera) if len(front) else np.zeros((1, 2))
    low, high = (np.clip(end, 0, [frame.width, frame.height]) for end in (seen.min(axis=0), seen.max(axis=0)))
    require(
        (high > low).all() and box.center[2] < 2 * frame.depth.max(),
        f"{what} is not in view",
        got=f"center {box.center.round(3).tolist()}",
        expected="camera frame, x right, y down, z forward, metres",
        cause="is it in millimetres, in the world frame, or with y up?",
    )
    return np.concatenate([low, high]).astype(np.float32)
