"""A dataset of your own: how a folder is recognised, and how a frame of it is read. Here one .npz file is a frame.

`sp.open(NpzDataset(FOLDER))` needs no more. For `spatialviz view FOLDER` and every other command, name it in your
package's pyproject.toml:

    [project.entry-points."spatialviz.datasets"]
    npz = "own_dataset:FORMAT"
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

import spatialviz as sp


class NpzDataset:
    """Files with rgb, depth (metres), K, masks and names."""

    format = "npz"

    def __init__(self, root: Path, settings: Any = None) -> None:
        self.root = root
        self.frame_ids = tuple(sorted(path.stem for path in root.glob("*.npz")))
        # Known without decoding a picture: only this small array of the file is read.
        self.class_names = tuple(sorted({str(name) for f in self.frame_ids for name in self._open(f)["names"]}))

    def _open(self, frame_id: str) -> Any:
        return np.load(self.root / f"{frame_id}.npz")

    def load(self, frame_id: str) -> sp.Frame:
        if frame_id not in self.frame_ids:
            raise sp.InputError(f"no frame {frame_id!r}", path=self.root)
        a = self._open(frame_id)
        names = [str(name) for name in a["names"]]
        return sp.Frame.of_arrays(a["rgb"], a["depth"], a["K"], masks=a["masks"], names=names, id=frame_id)


FORMAT = sp.DatasetFormat("npz", "npz: *.npz", lambda root: any(root.glob("*.npz")), NpzDataset)


def write_some(folder: Path) -> None:
    """Two frames of the demo as such files."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(sp.open("demo").frames[:2]):
        seen = [a for a in frame.annotations if a.mask is not None and a.mask.any()]
        masks, names = np.array([a.mask for a in seen]), [a.label for a in seen]
        rgb, depth, K = frame.rgb, frame.depth, frame.camera.K
        np.savez_compressed(folder / f"{number}.npz", rgb=rgb, depth=depth, K=K, masks=masks, names=names)


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "npz_frames")
    write_some(folder)
    p = sp.open(NpzDataset(folder))
    print(p, p.ask("0", "mug left of the laptop"), sep="\n")
