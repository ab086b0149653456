"""Depth estimated by a network, in metres, in place of or without measured depth; kept on disk."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xxhash

from pipeline.datasets.base import ChangedFrames, Dataset, dataset_notes, readable_frames
from pipeline.datasets.depth.contract import NamedContract, find_network
from pipeline.datasets.settings import INTRINSICS
from pipeline.geometry.camera import intrinsics
from pipeline.geometry.frame import Frame
from pipeline.geometry.picture_input import InputPlacement, checked_input, checked_outputs, place_picture
from pipeline.system.errors import InputError, in_file, require
from pipeline.system.onnx_session import model_hash, open_session, run_session
from pipeline.system.paths import cache_folder
from pipeline.system.whole_files import keep_whole

VERSION = "1"
"""Part of every fingerprint: a change of what is made of a network's output must change it."""
SAMPLES = 64
"""So many rows and columns of points tell the focal length and the shift."""


DepthEstimate = tuple[np.ndarray, np.ndarray | None]
"""Depth, (H, W) float32 metres along the camera's z axis, 0 where the network sees nothing; and the network's own
camera, (3, 3) float64 in pixels of the picture, where it was not given one and estimates one."""


class DepthModel:
    """A depth network described by a TOML file."""

    def __init__(self, network: NamedContract) -> None:
        self.name, self.path, self.contract = network.name, network.path, network.contract
        self._session = open_session(self.path)
        ranks = {i.name: len(i.shape) for i in self._session.get_inputs()}
        given = self.contract.input.constants
        self._constants = {n: np.full((1,) * ranks[n], value, np.float32) for n, value in given.items() if n in ranks}
        self._input, self._sides = checked_input(
            self._session, self.contract.input, tuple(self._constants), network.described
        )
        output, known = self.contract.output, {o.name for o in self._session.get_outputs()}
        scale = next((name for name in output.scale if name in known), next(iter(output.scale), None))
        roles = {"depth": output.depth, "points": output.points, "scale": scale, "focal": output.focal}
        roles |= {"mask": output.mask, "sky": output.sky}
        self._outputs = {role: name for role, name in roles.items() if name is not None}
        checked_outputs(self._session, tuple(self._outputs.values()), network.described)

    @cached_property
    def fingerprint(self) -> str:
        """Cache key of the estimates, besides picture and camera."""
        return f"{VERSION}:{model_hash(self.path)}:{self.contract.model_dump_json()}"

    def estimate(self, rgb: np.ndarray, K: np.ndarray | None) -> DepthEstimate:
        """The depth of a picture. `rgb` (H, W, 3) uint8; `K` (3, 3) float64 or None: Its camera, where it is known."""
        height, width = rgb.shape[:2]
        tensor, placement = place_picture(rgb, *self._size(height, width), self.contract.input)
        values = run_session(
            self._session, list(self._outputs.values()), {self._input: tensor, **self._constants}, self.path
        )
        found = dict(zip(self._outputs, values, strict=True))
        maps = {
            role: self._inside(found[role], placement, (height, width))
            for role in ("depth", "points", "mask", "sky")
            if role in found
        }
        shapes = {values.shape[:2] for values in maps.values()}
        require(len(shapes) == 1, "the network's maps differ in size", got=sorted(shapes), path=self.path)
        seen = np.ones(shapes.pop(), np.bool_)
        if "mask" in maps:
            seen &= maps["mask"] > 0.5
        if "sky" in maps:
            seen &= maps["sky"] < 0.5
        if "points" in maps:
            return self._of_points(maps["points"], seen, self._number(found["scale"]), (height, width), K)
        metres, own = maps["depth"], None
        canonical = self.contract.output.canonical_focal
        if canonical is not None:
            require(K is not None, f"the depth model {self.name} needs the focal length", path=self.path)
            assert K is not None
            metres = metres * (placement.scale_x * K[0, 0] + placement.scale_y * K[1, 1]) / (2 * canonical)
        elif "focal" in found:
            focal = self._number(found["focal"]) / placement.scale_x
            own = _centred(focal, height, width) if K is None else None
            metres = metres if K is None else metres * (K[0, 0] / focal)
        return _resized(metres, seen, height, width), own

    def _of_points(
        self, points: np.ndarray, seen: np.ndarray, scale: float, size: tuple[int, int], K: np.ndarray | None
    ) -> DepthEstimate:
        height, width = size
        rows, columns = points.shape[:2]
        seen = np.isfinite(points).all(axis=2) & seen
        y, x = np.mgrid[0:rows, 0:columns].astype(np.float64)
        # Pixels of the picture from its centre, where such networks take the principal point to be.
        away = np.stack([(x - (columns - 1) / 2) * width / columns, (y - (rows - 1) / 2) * height / rows], axis=2)
        some = np.ix_(*(np.unique(np.linspace(0, n - 1, SAMPLES).astype(int)) for n in (rows, columns)))
        known = None if K is None else float(K[0, 0] + K[1, 1]) / 2
        focal, shift = focal_and_shift(points[some][seen[some]], away[some][seen[some]], known)
        usable = np.isfinite(focal) and focal > 0
        require(usable, "the network's points are of no camera", got=f"focal length {focal:.3g}", path=self.path)
        depth = _resized((points[..., 2] + shift) * scale, seen, height, width)
        return depth, _centred(focal, height, width) if K is None else None

    def _size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width of the input for a picture."""
        given = self.contract.input
        scale = 1.0
        if given.shortest is not None:
            scale = given.shortest / min(height, width)
        if given.longest is not None:
            scale = min(scale, given.longest / max(height, width))
        step = given.multiple
        fixed_height, fixed_width = self._sides
        return (
            fixed_height or max(step, round(height * scale / step) * step),
            fixed_width or max(step, round(width * scale / step) * step),
        )

    def _inside(self, value: np.ndarray, placement: InputPlacement, size: tuple[int, int]) -> np.ndarray:
        """Crop of an output map, (H, W) or (H, W, 3), to the picture, in pixels of the map."""
        shape = value.shape[-3:] if value.shape[-1] == 3 and value.ndim > 3 else value.shape[-2:]
        require(
            len(shape) >= 2 and value.size == np.prod(shape),
            "the network's output is no map of the picture",
            got=list(value.shape),
            expected="[1, H, W], [1, 1, H, W] or [1, H, W, 3]",
            path=self.path,
        )
        found: np.ndarray = value.reshape(tuple(shape))
        rows, columns = found.shape[0], found.shape[1]
        down, across = rows / placement.height, columns / placement.width
        top, left = placement.top, placement.left
        bottom, right = top + size[0] * placement.scale_y, left + size[1] * placement.scale_x
        return found[round(top * down) : round(bottom * down), round(left * across) : round(right * across)]

    def _number(self, value: np.ndarray) -> float:
        number = float(value.ravel()[0]) if value.size == 1 else float("nan")
        require(
            np.isfinite(number) and number > 0,
            "the network's scale or focal length is none",
            got=f"{number:g}, shape {list(value.shape)}",
            path=self.path,
        )
        return number


def focal_and_shift(points: np.ndarray, away: np.ndarray, focal: float | None) -> tuple[float, float]:
    """Focal length and shift of z by least squares of focal * xy / (z + shift) - away, as in
    `moge/utils/geometry_numpy.py` of microsoft/MoGe (MIT).

    `points` (N, 3) float: Right up to the shift of z, and a scale; `away` (N, 2) float: Where they are seen, pixels
    from the principal point; `focal`: where it is known, pixels; only the shift is then found.
    """
    if len(points) < 3:
        return float("nan") if focal is None else focal, 0.0
    from scipy.optimize import least_squares

    xy, z = points[:, :2].astype(np.float64), points[:, 2].astype(np.float64)

    def best(shift: float) -> tuple[float, np.ndarray]:
        rays = xy / (z + shift)[:, None]
        own = float((rays * away).sum() / np.square(rays).sum()) if focal is None else focal
        return own, (own * rays - away).ravel()

    with np.errstate(all="ignore"):
        # In units of the picture's size the residuals are of order one, as in the original.
        reach = max(float(np.abs(away).max()), 1.0)
        shift = float(least_squares(lambda s: best(s[0])[1] / reach, 0.0, method="lm").x[0])
        return best(shift)[0], shift


def _centred(focal: float, height: int, width: int) -> np.ndarray:
    """(3, 3) intrinsics with the principal point in the middle of the picture."""
    return intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2)


def _resized(metres: np.ndarray, seen: np.ndarray, height: int, width: int) -> np.ndarray:
    """Resized depth (height, width) float32, linear between valid pixels; 0 where mostly invalid."""
    with np.errstate(invalid="ignore"):
        good = np.isfinite(metres) & (metres > 0) & seen
    weight = cv2.resize(good.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    filled = np.where(good, metres, 0).astype(np.float32)
    total = cv2.resize(filled, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.where(weight > 0.5, total / np.maximum(weight, 1e-6), 0).astype(np.float32)


@lru_cache(maxsize=2)
def _opened(given: str, path: Path, changed: int) -> DepthModel:
    return DepthModel(find_network(given))


def open_depth_model(given: str) -> DepthModel:
    """Open the network of `--depth-model`, once per file version."""
    network = find_network(given)
    require(network.path.is_file(), "there is no model file", path=network.path)
    return _opened(given, network.path.absolute(), network.path.stat().st_mtime_ns)


class EstimatedDepth(ChangedFrames):
    """A dataset with estimated depth, kept on disk by the picture, the network and the camera."""

    depth_units = None

    def __init__(self, inner: Dataset, model: DepthModel, browse: bool) -> None:
        super().__init__(inner)
        self.model, self.browse = model, browse
        measured = () if inner.format == "pictures" else ("depth is estimated: none that a sensor measured is used",)
        self.notes = (*dataset_notes(inner), *measured)
        if not browse and not model.contract.gives_focal:
            for frame in readable_frames(inner.load, inner.frame_ids[:1]):
                self._known(frame)

    def load_depth(self, frame_id: str) -> None:
        """Nothing: no depth that was measured is used; see `base.load_depth`."""

    def changed(self, frame: Frame) -> Frame:
        """Frame with estimated depth."""
        camera, K = frame.camera, self._known(frame)
        made_up = K is None and not self.model.contract.gives_focal
        depth, own = self._estimate(frame, camera.K if made_up else K)
        untold, notes = (INTRINSICS,) if made_up else (), frame.notes
        if made_up:
            notes = (*notes, f"nothing can be measured, sizes are made up: {INTRINSICS}")
        focal = "is made up" if made_up else "by the network" if K is None else "of the camera"
        name, file = self.model.name, self.model.path.name
        camera = replace(camera, K=camera.K if own is None else own, untold=untold)
        by_focal = self.model.contract.output.canonical_focal is not None
        metres = "metres by the focal length" if by_focal else "metres as it learnt them"
        source = f"estimated by {name} ({file}): {metres}, focal length {focal}"
        notes = (*notes, f"depth is {source}")
        with in_file(self.model.path):
            return replace(frame, depth=depth, camera=camera, depth_source=source, notes=notes)

    def _known(self, frame: Frame) -> np.ndarray | None:
        """Camera known without the network; InputError where unknown."""
        if INTRINSICS not in frame.camera.untold:
            return frame.camera.K
        if not self.browse and not self.model.contract.gives_focal:
            raise InputError(
                "the focal length is not known",
                expected=INTRINSICS,
                cause=f"{self.model.name} does not give one, and the picture states none in its EXIF",
                path=self.root,
            )
        return None

    def _estimate(self, frame: Frame, K: np.ndarray | None) -> DepthEstimate:
        """Depth estimate, from disk where cached."""
        parts = (frame.content_hash, self.model.fingerprint, "" if K is None else K.tobytes().hex())
        key = xxhash.xxh3_128_hexdigest("\x1f".join(parts).encode())
        path = cache_folder() / "depth" / key[:2] / f"{key}.npz"
        found = _load(path)
        if found is None or found[0].shape != frame.depth.shape:
            found = self.model.estimate(frame.rgb, K)
            keep_whole(path, partial(_store, found=found))
        return found


def _store(file: Any, found: DepthEstimate) -> None:
    depth, K = found
    np.savez_compressed(file, depth=depth, K=np.zeros(0) if K is None else K)


def _load(path: Path) -> DepthEstimate | None:
    try:
        with np.load(path, allow_pickle=False) as data:
            return data["depth"], data["K"] if data["K"].size else None
    except Exception:  # A file may be missing; damaged ones fail in zipfile, zlib, tokenize or NumPy, each in its way.
        return None
