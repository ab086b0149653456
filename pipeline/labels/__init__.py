"""Auto-labels: from frames to checked expressions; their schema, their making, their checks and their exports."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.labels.by_hand import begun_labels, default_folder, grows, with_frames
    from pipeline.labels.cases import HIT, Case, FrameCases, Meant, read_cases, read_query
    from pipeline.labels.check import check_labels, finding_record
    from pipeline.labels.check.expressions import says_the
    from pipeline.labels.check.objects import projected
    from pipeline.labels.exports import export_labels
    from pipeline.labels.exports.base import ExportedFrom
    from pipeline.labels.exports.exporting import HubConfig
    from pipeline.labels.exports.vqa_geometry import VqaConfig
    from pipeline.labels.job import label, label_dataset, label_shard, open_labeller
    from pipeline.labels.labelling import label_objects
    from pipeline.labels.merge import merge_labels
    from pipeline.labels.plan import SENTENCE_KINDS, LabelConfig, SourceSpec, load_plan, make_plan, save_plan
    from pipeline.labels.profiles import GIVEN, NONE, PROFILES, canonical_hash, open_second_opinion, profile_of
    from pipeline.labels.provenance import Makers, Model, makers_of, mask_makers
    from pipeline.labels.reading import (
        MANIFEST_FILE,
        PROVENANCE_FILE,
        SENTENCES_FILE,
        Labels,
        build_table,
        labelled_dataset,
        labelled_up,
        open_labels,
        read_table,
        write_table,
    )
    from pipeline.labels.report import write_report
    from pipeline.labels.schema import SCHEMA_VERSION, TABLES, Manifest, labels_version
    from pipeline.labels.selection import SelectConfig
    from pipeline.labels.statistics import label_statistics
    from pipeline.labels.store import LabelStore
    from pipeline.labels.wording import expression_text

__getattr__ = lazy_exports(__name__, __file__)
