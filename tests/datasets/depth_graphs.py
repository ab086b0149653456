"""Tiny ONNX graphs with the tensors of public depth networks, which read the depth off the picture's red channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from PIL import Image

from pipeline.datasets import known_contract
from pipeline.datasets.depth.contract import DepthContract

HEIGHT, WIDTH = 48, 64
FOCAL = 80.0
"""Of the camera that took the pictures, pixels."""
NEAREST_M, SPAN_M = 1.0, 1.5
"""The depth of red 0, and what red 255 adds."""
SCALE, SHIFT = 2.5, 0.3
"""Metres of MoGe's unit, and what its z lacks, in that unit."""


def plane(height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """(H, W) float32 metres of a slanted plane, as far as 8 bits hold it."""
    return NEAREST_M + SPAN_M * _red(height, width).astype(np.float32) / 255


def _red(height: int, width: int) -> np.ndarray:
    v, u = np.mgrid[0:height, 0:width]
    # 1 / z is linear in the picture: a plane.
    inverse = 1 / 1.2 - 0.25 * u / width - 0.15 * v / height
    return np.round(np.clip((1 / inverse - NEAREST_M) / SPAN_M, 0, 1) * 255).astype(np.uint8)


def write_picture(
    path: Path,
    *,
    height: int = HEIGHT,
    width: int = WIDTH,
    mm: int | None = None,
    turned: int = 1,
) -> None:
    """A picture of the plane; its EXIF states the focal length `mm`, as of 35 mm film, and that it is `turned`."""
    rgb = np.full((height, width, 3), 90, np.uint8)
    rgb[..., 0] = _red(height, width)
    exif = Image.Exif()
    if turned != 1:
        exif[0x0112] = turned
    if mm is not None:
        exif[0x8769] = {0xA405: mm}
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(rgb).save(path, exif=exif)


class _Graph:
    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def constant(self, value: Any) -> str:
        name = f"c{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def __call__(self, kind: str, *inputs: str, out: str | None = None, **how: Any) -> str:
        out = out or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [out], **how))
        return out

    def metres(self, contract: DepthContract, picture: str) -> str:
        """(1, H, W): the depth that the red channel says, out of the normalised input."""
        given = contract.input
        red = self("Gather", picture, self.constant(np.int64(0)), axis=1)
        level = self(
            "Add", self("Mul", red, self.constant(np.float32(given.std[0]))), self.constant(np.float32(given.mean[0]))
        )
        per_level = np.float32(SPAN_M / 255 / given.scale)
        return self("Add", self("Mul", level, self.constant(per_level)), self.constant(np.float32(NEAREST_M)))


def write_network(
    path: Path,
    name: str,
    *,
    factor: float = 1.0,
    focal: float = FOCAL,
    nan: bool = False,
    size: tuple[int, int] | None = None,
) -> Path:
    """A file with the tensors of a known network.

    Parameters
    ----------
    factor : float
        What its depth is of the metres.
    focal : float
        Its own focal length: of MoGe's camera, pixels of the picture; of Depth Pro's, pixels of its input.
    size : (int, int), optional
        Height and width of the input, where they are fixed.
    """
    contract, graph = known_contract(name), _Graph()
    sides = contract.input.size or size or ("height", "width")
    inputs = [helper.make_tensor_value_info(str(contract.input.name), TensorProto.FLOAT, [1, 3, *sides])]
    metres = graph.metres(contract, str(contract.input.name))
    metres = graph("Mul", metres, graph.constant(np.float32(np.nan if nan else factor)))
    outputs: dict[str, list[Any]] = {}
    if name == "moge-2":
        inputs.append(helper.make_tensor_value_info("num_tokens", TensorProto.INT64, []))
        v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
        rays = ((u - (WIDTH - 1) / 2) / focal, (v - (HEIGHT - 1) / 2) / focal)
        axis = graph.constant(np.array([3], np.int64))
        unit = graph("Div", metres, graph.constant(np.float32(SCALE)))
        flat = [graph("Mul", unit, graph.constant(r[None].astype(np.float32))) for r in rays]
        flat.append(graph("Sub", unit, graph.constant(np.float32(SHIFT))))
        graph("Concat", *(graph("Unsqueeze", part, axis) for part in flat), out="points", axis=3)
        mask = np.ones((1, HEIGHT, WIDTH), np.float32)
        mask[:, :4] = 0.1
        graph("Identity", graph.constant(mask), out="mask")
        graph("Identity", graph.constant(np.array([SCALE], np.float32)), out="scale")
        outputs = {"points": [1, HEIGHT, WIDTH, 3], "mask": [1, HEIGHT, WIDTH], "scale": [1]}
    else:
        depth = str(contract.output.depth)
        if name == "depth-anything-3-metric":
            graph("Unsqueeze", metres, graph.constant(np.array([1], np.int64)), out=depth)
            assert size is not None
            sky = np.zeros((1, 1, *size), np.float32)
            sky[:, :, : size[0] // 8] = 0.9
            graph("Identity", graph.constant(sky), out="sky")
            outputs = {depth: [1, 1, *sides], "sky": [1, 1, *sides]}
        else:
            graph("Identity", metres, out=depth)
            outputs = {depth: [1, *sides]}
        if contract.output.focal is not None:
            graph("Identity", graph.constant(np.array([focal], np.float32)), out=contract.output.focal)
            outputs[contract.output.focal] = [1]
        for more in contract.recognised_by:
            if more not in outputs:
                graph("Identity", graph.constant(np.zeros(1, np.float32)), out=more)
                outputs[more] = [1]
    declared = [helper.make_tensor_value_info(n, TensorProto.FLOAT, shape) for n, shape in outputs.items()]
    made = helper.make_graph(graph.nodes, name, inputs, declared, graph.weights)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path
