"""Answering: from an expression and a frame to ranked pairs."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.answering.answer_words import (
        NO_SUCH_PAIR,
        best_pair,
        holds,
        probability,
        why_no_answer,
        words_of_answer,
    )
    from pipeline.answering.ask import AskConfig, Trace
    from pipeline.answering.batch import FrameAnswers, StageClock
    from pipeline.answering.coordinate_conventions import box_2d, check_places
    from pipeline.answering.detector_runs import annotated_names, calibrate_scores, record_detections
    from pipeline.answering.fitted_models import FittedRanking, Scale
    from pipeline.answering.frame_store import BackgroundPictures, FrameStore, LoadedFrame, UpHint
    from pipeline.answering.imported import ImportedPipeline
    from pipeline.answering.json_records import relation_records, trace_record
    from pipeline.answering.model_catalogue import describe_file
    from pipeline.answering.objects import (
        PreparedFrame,
        SceneObject,
        all_objects,
        appearance_of,
        pixels_inside,
        prepare_frame,
        same_object,
    )
    from pipeline.answering.pair_rules import RunRules
    from pipeline.answering.pair_table import (
        HOLDS,
        MIN_RELATION,
        MIN_SCORE,
        Link,
        PairTable,
        RankConfig,
        ScoredPair,
        side,
    )
    from pipeline.answering.pipeline import (
        FrameRelations,
        Pipeline,
        contexts,
        frame_range,
        open_pipeline,
        open_sources,
        relate_frames,
    )
    from pipeline.answering.predictions import (
        Header,
        PredictedAnswer,
        PredictedBox,
        Prediction,
        Predictions,
        Proposal,
        read_predictions,
        write_predictions,
    )
    from pipeline.answering.ranking import Candidates, alone, rank
    from pipeline.answering.tracing import trace

__getattr__ = lazy_exports(__name__, __file__)
