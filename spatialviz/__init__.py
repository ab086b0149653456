"""See why an RGB-D spatial-reasoning pipeline answered what it answered.

    import spatialviz as sp

    p = sp.open("demo")
    a = p.ask(0, "mug left of the laptop")
    a.target.box, a.reference, a.holds, a.verdict
    a.show()

The names of `__all__` are the public face and stay: those of `pipeline`, the headless core, and `show`. Everything else
here, the command line's modules and the page's, is private. Importing this package loads neither; in IPython it tells
the shell how an answer and a run look.
"""

import sys

import pipeline
from pipeline import __version__

TYPE_CHECKING = False
# See `pipeline`.
if TYPE_CHECKING:
    from typing import Any

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
        label,
        open_labels,
        open_run,
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
    "label",
    "open",
    "open_labels",
    "open_run",
    "show",
]


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


def _in_notebook() -> None:
    """Say how an answer and a run look, where this is imported in IPython; the report is loaded when one is shown."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None:
        return

    def html(shown: "Any") -> str:
        from spatialviz.report.notebook import notebook_html

        return notebook_html(shown)

    formatter = shell.display_formatter.formatters["text/html"]
    formatter.for_type_by_name("pipeline.diagnosis.answer", "Answer", html)
    formatter.for_type_by_name("pipeline.evaluation.run_folder", "Run", html)


_in_notebook()
