"""Readers of RGB-D datasets: one file a format, found by looking at the folder."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.datasets.base import (
        MOVES,
        Dataset,
        DatasetFormat,
        GivenExpression,
        InMemoryDataset,
        dataset_notes,
        given_expressions,
        has_moves,
        load_picture,
        moves,
        resolve_frame,
        scene_of,
        splits,
    )
    from pipeline.datasets.demo import DEMO_EXPRESSION, demo_labels, demo_path, demo_run
    from pipeline.datasets.depth.contract import known_contract, network_names
    from pipeline.datasets.doctor.examine import Examination, apply, examine, overlay
    from pipeline.datasets.frame_names import FrameNames
    from pipeline.datasets.frame_reports import FrameReport, SurveyCounts, survey
    from pipeline.datasets.images import read_color
    from pipeline.datasets.opening import open_dataset
    from pipeline.datasets.report_records import frame_record
    from pipeline.datasets.saved_case import MANIFEST
    from pipeline.datasets.scene_mesh import export_mesh, fuse_context
    from pipeline.datasets.semantic_abstraction_splits import SUBSETS, subsets_of
    from pipeline.datasets.settings import SOURCES, Settings, parse_level_at, read_settings, write_settings
    from pipeline.datasets.up import OFF_SCENE, resolved_camera, told_doubts, told_up, with_frame_up

__getattr__ = lazy_exports(__name__, __file__)
