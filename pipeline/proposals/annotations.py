"""The dataset's own masks and names as a detector: the truth, with score 1."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import MaskStack, PictureMask
from pipeline.language.naming import Synonyms, match
from pipeline.proposals.base import Proposals, no_proposals
from pipeline.proposals.class_names import meant_names
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class AnnotationDetector:
    """Detector of the frame's annotations.

    Attributes
    ----------
    class_names : tuple of str
        The dataset's class names: a name outside them is an error, one of them that is not in the frame is an
        honest "nothing".
    """

    class_names: tuple[str, ...] = ()
    synonyms: Synonyms | None = None

    name = "annotations"
    exact = True
    where = "the dataset"

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return self.class_names or None

    def fingerprint(self) -> str:
        return "annotations"

    def _meant(self, label: str, known: Sequence[str], here: Sequence[str]) -> tuple[str, ...]:
        """Classes of a name in the whole dataset, else in the frame, so that "box" means the same classes in every
        frame."""
        meant = meant_names(label, known, self.synonyms, self.where)
        return meant if any(n in here for n in meant) else match(label, here, self.synonyms)

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        here = tuple(dict.fromkeys(a.label for a in frame.annotations))
        wanted = list(here)
        if labels is not None:
            known = tuple(dict.fromkeys([*here, *self.class_names]))
            wanted = [n for label in labels for n in self._meant(label, known, here)]
        found = [a for a in frame.annotations if a.label in wanted]
        if not found:
            return no_proposals(frame.height, frame.width)
        names = tuple(dict.fromkeys(a.label for a in found))
        size = frame.height, frame.width
        masks = [a.held or PictureMask.of(box_mask(a.bbox, *size)) for a in found]
        return Proposals(
            np.stack([a.bbox for a in found]).astype(np.float32),
            np.ones(len(found), np.float32),
            np.array([names.index(a.label) for a in found], np.int64),
            names,
            MaskStack(size, masks),
            np.array([a.index for a in found], np.int64),
            np.array([a.held is not None for a in found]),
        )


def box_mask(bbox: np.ndarray, height: int, width: int) -> np.ndarray:
    """(H, W) bool: the pixels inside a 2D box (x0, y0, x1, y1).

    Examples
    --------
    >>> import numpy as np
    >>> from pipeline.proposals import box_mask
    >>> box_mask(np.array([1, 1, 3, 2]), height=4, width=4).astype(int)[1]
    array([0, 1, 1, 0])
    """
    mask = np.zeros((height, width), np.bool_)
    x0, y0, x1, y1 = np.clip(np.round(bbox), 0, [width, height, width, height]).astype(int)
    mask[y0:y1, x0:x1] = True
    return mask
