"""OPM: object proposals by class name, from the dataset's truth, a recording, or a network."""

from pipeline.proposals.annotations import AnnotationDetector
from pipeline.proposals.base import Detector, Proposals
from pipeline.proposals.cache import CachedDetector
from pipeline.proposals.registry import DETECTORS, make_detector
from pipeline.proposals.selection import top_k

__all__ = ["DETECTORS", "AnnotationDetector", "CachedDetector", "Detector", "Proposals", "make_detector", "top_k"]
