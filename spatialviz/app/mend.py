"""Smallest change that would make an answer right: tried on it by a press, and counted over the run."""

from __future__ import annotations

from pipeline.diagnosis.story_words import Change, Story
from pipeline.evaluation.mend_counts import MendCount
from spatialviz.app.markup import Child, Element, h, slider
from spatialviz.app.state import State


def mend_html(state: State, told: Story) -> Element | None:
    """What would mend the answer without edits, as a button and a slider; after a press the counts over the run."""
    told = told if state.edited is None else state.edited.story
    if not told.mend:
        return None
    if told.tone != "wrong":
        return h.p(told.mend, cls="sub")
    tried = state.tried is not None and state.edits == state.tried
    button: Child = None
    if told.change is not None:
        label, hint = ("Take it back", "as it was") if tried else ("Try it", "answer again with this change")
        do = f"ask:{told.change.name}" if told.change.field == "question" else "try-mend"
        button = h.button(label, cls="try" if tried else "go", do=do, title=hint, id="try-mend")
    return h.div(
        h.div(h.h3("What would mend it"), h.p(told.mend)),
        button,
        _slider(told.change, state) if told.change is not None and state.tried is not None else None,
        _over_run(state),
        cls="fix",
    )


def _slider(change: Change, state: State) -> Element | None:
    """Slider of the number that changes."""
    after = change.after if state.tried_value is None else state.tried_value
    if change.after is None or after is None:
        return None
    low = "" if change.before is None else f"{change.before:.2f} → "
    step = "0.001" if change.after < 0.05 else "0.01"
    return h.label(
        h.span(f"{low}{after:.2f}"),
        slider(after, step=step, live="mend-live", change="mend-value", aria_label="The number that changes"),
        cls="slide whole",
        id="slide-mend",
    )


def _over_run(state: State) -> Element | None:
    """Counts of a setting of this kind over the run."""
    found = state.mended
    if found is None:
        return None
    said = found.said if isinstance(found, MendCount) else f"{found}: counting …"
    return h.p(h.b("Over the run "), said, cls="sub whole", role="status", id="over-run")
