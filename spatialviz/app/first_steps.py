"""First steps of a newcomer: hints on the demo, and on a folder of one's own what each view needs."""

from __future__ import annotations

import shlex
from functools import lru_cache
from pathlib import Path

from pipeline.datasets.demo import demo_path
from spatialviz.app.context import Context
from spatialviz.app.evaluate_html import no_run_html
from spatialviz.app.markup import Element, h, panel

NEEDS = {
    "Explain": "needs a detector that finds what you ask for:",
    "Label": "needs nothing more: outline things and name them.",
}


@lru_cache(maxsize=16)
def is_demo(root: Path) -> bool:
    """True for the folder of the built-in demo."""
    return root.resolve() == demo_path().resolve()


def needs_html(ctx: Context, name: str) -> Element | None:
    """What each view of a dataset needs, with commands; None where a run, labels or annotations judge answers."""
    dataset, shared = ctx.source.dataset, ctx.shared
    if name in shared.runs or name in shared.labels or dataset.class_names:
        return None
    command = f"spatialviz view {shlex.quote(str(dataset.root))} --detector yolo-seg --model FILE.onnx"
    place = shared.journals.get(name)
    labels = None if place is None or not place.labels.root.exists() else place.labels.root
    explain = None if ctx.can_ask else (h.p(h.b("Explain "), NEEDS["Explain"]), h.pre(command, cls="file", tabindex=0))
    label = h.p(h.b("Label "), NEEDS["Label"]) if place is not None else None
    return panel(
        h.details(
            h.summary("No labels and no run are open: answers are not judged"),
            explain,
            label,
            h.p(h.b("Evaluate")),
            no_run_html(dataset.root, False, labels),
        ),
        cls="needs",
    )
