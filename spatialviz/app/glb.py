"""A coloured mesh for the browser that shows its colours as they are, whatever the light."""

from __future__ import annotations

from typing import Any

import numpy as np


def unlit_glb(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray, opacity: float = 1.0) -> bytes:
    """A binary glTF with one unlit material (KHR_materials_unlit).

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) int
    colors : (V, 3) uint8
        sRGB; glTF wants them linear.
    opacity : float
        0..1, of all of it.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb

    linear = np.round(255 * (colors / 255.0) ** 2.2).astype(np.uint8)
    solid = trimesh.Trimesh(vertices, faces, vertex_colors=linear, process=False)
    return bytes(export_glb(trimesh.Scene(solid), tree_postprocessor=lambda tree: _unlit(tree, opacity)))


def _unlit(tree: dict[str, Any], opacity: float) -> None:
    tree["materials"] = [
        {
            "pbrMetallicRoughness": {
                "metallicFactor": 0.0,
                "roughnessFactor": 1.0,
                "baseColorFactor": [1.0, 1.0, 1.0, opacity],
            },
            "alphaMode": "OPAQUE" if opacity >= 1 else "BLEND",
            "extensions": {"KHR_materials_unlit": {}},
            "doubleSided": True,
        }
    ]
    tree["extensionsUsed"] = sorted({*tree.get("extensionsUsed", []), "KHR_materials_unlit"})
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
