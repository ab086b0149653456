"""spatialviz's headless core: RGB-D frames to grounded spatial relations.

    import pipeline

    opened = pipeline.open("demo")
    answer = opened.ask(0, "mug left of the laptop")
    answer.target.box, answer.reference, answer.holds, answer.verdict

The names of `__all__` are the public face and stay; everything else here is private: its modules move and its names
change without notice. `spatialviz` has the same face, and a screen. Data flows one way: frame -> proposals -> lifted ->
scored -> ranked. Importing this package imports nothing but the standard library: a name is loaded when it is used.
"""

from pipeline.system.version import __version__ as __version__

TYPE_CHECKING = False
# Type checkers take it for that of `typing`, whose import would be most of what importing this package costs.
if TYPE_CHECKING:
    from pipeline.answering.tracing import trace
    from pipeline.datasets.base import Dataset, DatasetFormat
    from pipeline.diagnosis.answer import Answer
    from pipeline.diagnosis.opened import Opened, ask, open
    from pipeline.evaluation.adapters.base import PredictionFormat
    from pipeline.evaluation.from_records import import_records
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

_ROOMS = {
    "answering.tracing": "trace",
    "datasets.base": "Dataset DatasetFormat",
    "diagnosis.answer": "Answer",
    "diagnosis.opened": "Opened ask open",
    "evaluation.adapters.base": "PredictionFormat",
    "evaluation.from_records": "import_records",
    "evaluation.job": "evaluate",
    "evaluation.run_folder": "Run open_run",
    "geometry.boxes": "Box3D",
    "geometry.camera": "Camera",
    "geometry.frame": "Annotation Frame",
    "labels.exports.base": "ExportFormat Written",
    "labels.job": "label",
    "labels.reading": "Labels open_labels",
    "proposals.base": "Detector Proposals",
    "proposals.segmenter": "Segmenter",
    "relations.scorer": "RelationScorer RelationScores",
    "system.errors": "InputError",
}
"""Where the names of the face are defined; the imports above say the same to type checkers."""
_MODULE_OF = {name: module for module, names in _ROOMS.items() for name in names.split()}


if not TYPE_CHECKING:  # A type checker would take any name for one of this module's.

    def __getattr__(name: str) -> object:
        from importlib import import_module

        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
