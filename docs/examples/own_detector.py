"""A detector of your own: any object with these four names. Here it finds things by their colour.

As an object it is given to `sp.open`. For `--detector by-color` on the command line, in runs and in labelling, name the
function `make` in your package's pyproject.toml:

    [project.entry-points."spatialviz.detectors"]
    by-color = "own_detector:make"
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

import spatialviz as sp

COLORS = ("red thing", "green thing", "blue thing")
STRONG, LEAST_PIXELS = 40, 100


class ByColor:
    """All that is of one colour is one thing."""

    name = "by-color"
    vocabulary: tuple[str, ...] | None = COLORS
    exact = False  # Its scores are opinions, not the truth.

    def fingerprint(self) -> str:
        return f"by-color:{STRONG}:{LEAST_PIXELS}"

    def detect(self, frame: sp.Frame, labels: Sequence[str] | None) -> sp.Proposals:
        names, boxes, index, masks = tuple(COLORS if labels is None else labels), [], [], []
        for n, name in enumerate(names):
            channel = COLORS.index(name)
            others = np.delete(frame.rgb.astype(int), channel, axis=2).max(axis=2)
            mask = (frame.rgb[..., channel] - others > STRONG) & (frame.depth > 0)
            if mask.sum() < LEAST_PIXELS:
                continue
            rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            boxes.append((columns[0], rows[0], columns[-1] + 1, rows[-1] + 1))
            index.append(n)
            masks.append(mask)
        return sp.Proposals(
            boxes=np.array(boxes, np.float32).reshape(-1, 4),
            scores=np.full(len(index), 0.9, np.float32),
            label_index=np.array(index, np.int64),
            labels=names,
            masks=np.array(masks, bool).reshape(-1, frame.height, frame.width),
            ids=np.array([COLORS.index(names[n]) for n in index], np.int64),  # The same thing has one id in every run.
        )


def make(request: Any) -> sp.Detector:
    """What the entry point names; `request` holds model, class_names, synonyms, min_score, config."""
    return ByColor()


if __name__ == "__main__":
    print(sp.ask("demo", 7, "blue thing left of the red thing", detector=ByColor()))
