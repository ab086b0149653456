"""The selected object's whole box is shown beside the seen one, with what it is, and dashes where it is not sure."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest

from pipeline.answering.ask import AskConfig
from pipeline.answering.frame_store import FrameStore
from pipeline.answering.pipeline import open_pipeline
from pipeline.datasets.demo import DEMO_EXPRESSION
from pipeline.diagnosis.whatif.answer_view import shown_objects
from pipeline.geometry import LiftConfig
from pipeline.geometry.cleaning import BoxExtent
from spatialviz.app.scene import SceneView
from spatialviz.app.stage_objects import object_html
from spatialviz.app.state import State

PLANT = 1


def opened(boxes: BoxExtent) -> State:
    source = open_pipeline("demo", config=AskConfig(lift=LiftConfig(boxes=boxes)))
    loaded = FrameStore({"demo": source}).load("demo", source.dataset.frame_ids[0])
    trace = source.ask(loaded.context, DEMO_EXPRESSION)
    state = State("demo", loaded.context.frame.id, loaded=loaded, text=DEMO_EXPRESSION, trace=trace, selected=PLANT)
    return replace(state, found=shown_objects(loaded, trace, trace.exact))


@pytest.mark.parametrize("boxes", ["seen", "completed"])
def test_a_whole_box_is_drawn_and_told_where_it_is_wanted(boxes: BoxExtent) -> None:
    state, client = opened(boxes), MagicMock()
    SceneView(client, lambda *_: None).draw(state)
    sent = {call.args[0]: call.args[1] for call in client.lines.call_args_list}
    lines, told = sent["/boxes/whole"], str(object_html(state))
    assert (len(lines) > 12) == (boxes == "completed"), "with dashes"
    assert ("by the network, ±" in told) == (boxes == "completed")
    if boxes == "completed":
        whole = state.shown.objects[PLANT].estimated
        assert whole is not None
        assert whole.unsure
        assert np.ptp(lines.reshape(-1, 3), axis=0).max() >= whole.box.size.max() - 1e-3
