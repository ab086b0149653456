"""One RGB-D frame, validated when it is built, and what is annotated in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera
from pipeline.system.errors import InputError

NEAREST_MEDIAN_M = 0.1
FARTHEST_MEDIAN_M = 20.0
"""Bounds for the median depth of an indoor frame. Outside them the depth unit
is wrong: metres read as millimetres fall a thousand times below."""


@dataclass(frozen=True)
class Annotation:
    """One annotated object of a frame.

    Attributes
    ----------
    index : int
        Its place in the dataset's own list for this frame.
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
        How hard the dataset says the object is to find: 1 is easy.
    """

    index: int
    label: str
    bbox: np.ndarray
    mask: np.ndarray | None = None
    box: Box3D | None = None
    visible: float | None = None
    instance: int | None = None
    difficulty: int | None = None

    def __post_init__(self) -> None:
        bbox = np.asarray(self.bbox, dtype=np.float32)
        if bbox.shape != (4,) or not np.isfinite(bbox).all():
            raise InputError(f"annotation {self.index}: a box must be four finite numbers", got=self.bbox)
        object.__setattr__(self, "bbox", bbox)
        if self.mask is not None and (self.mask.dtype != np.bool_ or self.mask.ndim != 2):
            raise InputError(
                f"annotation {self.index}: a mask must be bool (H, W)",
                got=f"{self.mask.dtype} {self.mask.shape}",
            )


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
        What was found odd in this frame and could be left out.
    """

    id: str
    rgb: np.ndarray
    depth: np.ndarray
    camera: Camera
    annotations: tuple[Annotation, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        rgb, depth, camera = self.rgb, self.depth, self.camera
        if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
            raise InputError(
                f"frame {self.id}: colour must be uint8 (H, W, 3)", got=f"{rgb.dtype} {rgb.shape}"
            )
        if depth.dtype != np.float32 or depth.shape != rgb.shape[:2]:
            raise InputError(
                f"frame {self.id}: depth must be float32 metres of shape {rgb.shape[:2]}",
                got=f"{depth.dtype} {depth.shape}",
                cause="is this the raw depth and not the one registered to the colour image?",
            )
        if (camera.height, camera.width) != depth.shape:
            raise InputError(
                f"frame {self.id}: the camera is for another image size",
                got=f"{camera.width}x{camera.height}",
                expected=f"{depth.shape[1]}x{depth.shape[0]}",
            )
        lowest, highest = float(depth.min()), float(depth.max())
        if not (np.isfinite(lowest) and np.isfinite(highest)) or lowest < 0:
            raise InputError(
                f"frame {self.id}: depth must be finite and at least 0",
                got=f"{lowest:g} to {highest:g}",
                cause="pixels without depth are 0",
            )
        if highest == 0:
            raise InputError(f"frame {self.id}: no usable depth", got="only zeros")
        valid = depth[depth > 0]
        # A strided median is exact enough for a factor of a thousand.
        median = float(np.median(valid[:: max(1, valid.size // 20_000)]))
        if not NEAREST_MEDIAN_M <= median <= FARTHEST_MEDIAN_M:
            raise InputError(
                f"frame {self.id}: depth of the wrong unit",
                got=f"a median depth of {median:.3g} m",
                expected=f"{NEAREST_MEDIAN_M:g} to {FARTHEST_MEDIAN_M:g} m",
                cause="is the depth scale the number of depth units in one metre, "
                "1000 for millimetres and 1 for metres?",
            )
        for annotation in self.annotations:
            if annotation.mask is not None and annotation.mask.shape != depth.shape:
                raise InputError(
                    f"frame {self.id}: the mask of annotation {annotation.index} has another size",
                    got=annotation.mask.shape,
                    expected=depth.shape,
                )

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
