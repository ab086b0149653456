"""Debugger of RGB-D spatial-reasoning pipelines: see the reason of every answer.

    import spatialviz as sp

    p = sp.open("demo")
    a = p.ask(0, "mug left of the laptop")
    a.target.box, a.reference, a.holds, a.verdict
    a.show()

The names of `__all__` are the public face and stay: those of `pipeline`, the headless core, and `show`. Everything else
here, the command line's modules and the page's, is private. Importing this package loads neither; it says which
function makes the HTML by which answers, runs and failures show themselves in a notebook.
"""

import pipeline
from pipeline import __version__
from pipeline.system.in_notebook import InNotebook

TYPE_CHECKING = False
# See `pipeline`.
if TYPE_CHECKING:
    from pipeline import (
        Annotation,
        Answer,
        Box3D,
        Camera,
        Dataset,
        DatasetFormat,
        Detector,
        ExportFormat,
        Frame,
        InputError,
        Labels,
        Opened,
        PredictionFormat,
        Proposals,
        RelationScorer,
        RelationScores,
        Run,
        Segmenter,
        Written,
        evaluate,
        import_records,
        label,
        open_labels,
        open_run,
        trace,
    )
    from spatialviz.face import ask, open, show

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
    "__version__",
    "ask",
    "evaluate",
    "import_records",
    "label",
    "open",
    "open_labels",
    "open_run",
    "show",
    "trace",
]


InNotebook.html_by = "spatialviz.report.notebook:notebook_html"

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        if name in ("ask", "open", "show"):
            from spatialviz import face

            return getattr(face, name)
        return getattr(pipeline, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
