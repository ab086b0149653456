"""spatialviz's headless core: RGB-D frames to grounded spatial relations.

    import pipeline

    opened = pipeline.open("demo")
    answer = opened.ask(0, "mug left of the laptop")
    answer.target.box, answer.reference, answer.holds, answer.verdict

The names of `__all__` are the public face and stay; everything else here is private: its modules move and its names
change without notice. `spatialviz` has the same face, and a screen. Data flows one way: frame -> proposals -> lifted ->
scored -> ranked. Importing this package imports nothing but the standard library: a name is loaded when it is used.
"""

import os

from pipeline.system.lazy_exports import lazy_exports
from pipeline.system.version import __version__ as __version__

# Nothing leaves this machine unasked: unless this is set before it loads, ONNX Runtime reports its use to its maker,
# with an id of the machine that it keeps on disk.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

TYPE_CHECKING = False
# Type checkers take it for that of `typing`, whose import would be most of what importing this package costs.
if TYPE_CHECKING:
    from pipeline.answering.tracing import trace
    from pipeline.datasets.base import Dataset, DatasetFormat
    from pipeline.diagnosis.answer import Answer
    from pipeline.diagnosis.opened import Opened, ask, open
    from pipeline.evaluation.adapters.published import PredictionFormat
    from pipeline.evaluation.importing import import_records
    from pipeline.evaluation.job import evaluate
    from pipeline.evaluation.run_folder import Run, open_run
    from pipeline.geometry.boxes import Box3D
    from pipeline.geometry.camera import Camera
    from pipeline.geometry.frame import Annotation, Frame
    from pipeline.labels.exports.base import ExportFormat, Written
    from pipeline.labels.job import label
    from pipeline.labels.reading import Labels, open_labels
    from pipeline.proposals.base import Detector, Proposals
    from pipeline.proposals.segmenter import Segmenter
    from pipeline.relations.scorer import RelationScorer, RelationScores
    from pipeline.system.errors import InputError

__all__ = [
    "Annotation",
    "Answer",
    "Box3D",
    "Camera",
    "Dataset",
    "DatasetFormat",
    "Detector",
    "ExportFormat",
    "Frame",
    "InputError",
    "Labels",
    "Opened",
    "PredictionFormat",
    "Proposals",
    "RelationScorer",
    "RelationScores",
    "Run",
    "Segmenter",
    "Written",
    "ask",
    "evaluate",
    "import_records",
    "label",
    "open",
    "open_labels",
    "open_run",
    "trace",
]

__getattr__ = lazy_exports(__name__, __file__)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
