"""A detector that gives masks, as a segmenter: its masks for the boxes of another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.proposals.assignment import Segments, segment_from
from pipeline.proposals.base import Detector


class DetectorSegmenter:
    """Runs a detector for everything it knows and gives each box the mask that fits it.

    Parameters
    ----------
    detector : Detector
        Any that gives masks; proposals of it that are only a box are not used.
    synonyms : Synonyms, optional
    """

    def __init__(self, detector: Detector, synonyms: Synonyms | None = None) -> None:
        self.detector = detector
        self.synonyms = synonyms

    @property
    def name(self) -> str:
        return self.detector.name

    def fingerprint(self) -> str:
        return f"masks:{self.detector.fingerprint()}"

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """(N, H, W) bool masks by greatest overlap of the boxes (at least one half), names first; and which were found.

        Raises
        ------
        InputError
            What the detector raises.
        """
        found = self.detector.detect(frame, None)
        masks = found.masks
        if masks is None:
            found, masks = found.take(np.zeros(0, np.int64)), np.zeros((0, frame.height, frame.width), np.bool_)
        elif found.has_mask is not None:
            found, masks = found.take(found.has_mask), masks[found.has_mask]
        names = tuple(found.label(i) for i in range(len(found)))
        segments = Segments(found.boxes, names, lambda i: masks[i])
        return segment_from(segments, boxes, labels, (frame.height, frame.width), self.synonyms)
