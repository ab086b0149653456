"""Where a reported answer is from, and how it is made again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.errors import InputError
from pipeline.evaluation.shared_makers import Share, shares_of_answer
from pipeline.failure_case.manifest import PROPOSALS
from pipeline.failure_case.opening import OpenedCase
from pipeline.jobs import Source
from pipeline.labels.reading import Labels
from pipeline.objects import FrameContext


@dataclass(frozen=True)
class Subject:
    """What the page says besides the answer.

    Attributes
    ----------
    dataset : str
        Its name.
    frame : str
    commands : tuple of str
        To see the same again.
    state : str or None
        The view as one string.
    facts : tuple of (str, str)
        More about where it is from.
    shares : tuple of Share
        What the answer has in common with what made the truth that its verdict is by.
    """

    dataset: str
    frame: str
    commands: tuple[str, ...]
    state: str | None = None
    facts: tuple[tuple[str, str], ...] = ()
    shares: tuple[Share, ...] = ()

    @staticmethod
    def of_case(opened: OpenedCase) -> Subject:
        """A kept case."""
        m = opened.manifest
        root = str(opened.root)
        facts = [("case", m.name), ("kept", f"{m.created} by {m.tool}")]
        facts += [(str(key), str(value)) for key, value in m.run.items()]
        facts += [("note", note) for note in opened.notes]
        dataset = m.dataset.get("name", "")
        recording = str(opened.root / PROPOSALS)
        commands = (
            shlex.join(["spatialviz", "replay", root]),
            shlex.join(["spatialviz", "view", root, "--detector", "recorded", "--model", recording]),
        )
        return Subject(
            dataset, m.frame.id, commands, view_state(dataset, m.frame.id, m.text, m.edits), tuple(facts),
        )  # fmt: skip

    @staticmethod
    def of_dataset(
        path: str, source: Source, context: FrameContext, text: str, options: Sequence[str] = (),
        labels: Labels | None = None,
    ) -> Subject:
        """An expression on a frame of a dataset, judged by labels or its annotations; `options` of the command line."""
        frame = context.frame.id
        name = source.dataset.root.resolve().name
        commands = (
            shlex.join(["spatialviz", "ask", path, frame, text, *options]),
            shlex.join(["spatialviz", "save-case", path, frame, text, "--out", "CASE", *options]),
        )
        shares = shares_of_answer(source, labels)
        return Subject(name, frame, commands, view_state(name, frame, text, None), shares=shares)


def view_state(dataset: str, frame: str, text: str, edits: Mapping[str, Any] | None) -> str | None:
    """The view as a string that `spatialviz view --state` takes; None where it cannot be written."""
    from importlib.util import find_spec

    if find_spec("pipeline.whatif") is None:
        return None
    from pipeline.whatif.edits import Edits
    from pipeline.whatif.edits_json import read_edits
    from pipeline.whatif.state import ViewState, encode

    try:
        return encode(ViewState(dataset, frame, text, edits=read_edits(dict(edits)) if edits else Edits()))
    except InputError:
        return None
