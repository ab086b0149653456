"""OPM: object proposals by class name, from the dataset's truth, a recording, or a network."""

from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Detector, Proposals, top_k
from pipeline.proposals.cache import CachedDetector
from pipeline.proposals.registry import DETECTORS, SEGMENTERS, make_detector, make_segmenter
from pipeline.proposals.segmenter import Segmented, Segmenter

__all__ = [
    "DETECTORS",
    "SEGMENTERS",
    "AnnotationDetector",
    "CachedDetector",
    "Detector",
    "Proposals",
    "Segmented",
    "Segmenter",
    "make_detector",
    "make_segmenter",
    "top_k",
]
