"""OPM: object proposals by class name, from the dataset's truth, a recording, or a network."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.proposals.annotations import AnnotationDetector, box_mask
    from pipeline.proposals.base import Detector, Proposals, no_proposals, reads_annotations, suppress, top_k
    from pipeline.proposals.cache import CachedDetector, CachedSegmenter
    from pipeline.proposals.class_names import known_names, metadata_names, name_groups, same_name
    from pipeline.proposals.depth_segmenter import DepthSegmenter
    from pipeline.proposals.mismatch import recognise
    from pipeline.proposals.recorded import RecordedDetector
    from pipeline.proposals.registry import DETECTORS, SEGMENTERS, make_detector, make_segmenter
    from pipeline.proposals.score_calibration import (
        FittedFrame,
        ScoreCalibration,
        fit_scores,
        load_calibration,
        save_calibration,
        score_logit,
    )
    from pipeline.proposals.segmenter import Segmented, Segmenter
    from pipeline.proposals.simulated import SimulatedDetector, SimulationOptions

__getattr__ = lazy_exports(__name__, __file__)
