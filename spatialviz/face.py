"""Public face: opened pipelines and answers with a page, and the page on arrays."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.datasets.base import InMemoryDataset
from pipeline.diagnosis import opened as core
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.opened import Opened, Source
from pipeline.diagnosis.whatif.edits import Edits, read_edits
from pipeline.diagnosis.whatif.state import ViewState
from pipeline.evaluation.run_folder import Run
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    import viser


def open(dataset: Source, **options: Any) -> Opened:
    """Open a dataset as `pipeline.open`, with a page for the pipeline and the answers."""
    return replace(core.open(dataset, **options), viewer=show)


def ask(dataset: Opened | Source, frame: int | str | Frame, text: str, **options: Any) -> Answer:
    """Answer an expression as `pipeline.ask`, with a page for the answer."""
    opened = dataset if isinstance(dataset, Opened) else open(dataset, **options)
    return opened.ask(frame, text)


def show(
    what: Opened | Answer | Run | Source | np.ndarray,
    depth: np.ndarray | None = None,
    K: np.ndarray | None = None,
    *,
    masks: Sequence[np.ndarray] | np.ndarray | None = None,
    names: Sequence[str] | None = None,
    boxes: Sequence[Any] | None = None,
    relations: Mapping[str, Any] | None = None,
    up: Sequence[float] | np.ndarray | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    dark: bool | None = None,
    outer_address: Sequence[str] = (),
    open_browser: bool = True,
    block: bool | None = None,
) -> viser.ViserServer | None:
    """Open the page on arrays, an answer, an opened pipeline, a run, or anything that `open` takes.

    Parameters
    ----------
    what
        What is shown; of arrays the picture, (H, W, 3) uint8.
    depth : (H, W) float, optional
        Metres along the camera's z axis; 0 or NaN where nothing was measured.
    K : (3, 3) float, optional
        Intrinsics, pixels.
    masks, names, up
        What is in the picture, and where up is; see `Frame.of_arrays`.
    boxes, relations
        3D boxes and relation probabilities of one's own, which are shown and ranked as they are; see `open_arrays` of
        `pipeline.diagnosis.opened`.
    host, port, dark, outer_address, open_browser
        As the options of `spatialviz view`. A notebook behind JupyterHub, jupyter-server-proxy or Codespaces finds its
        outer address itself, and Jupyter shows the page below the cell.
    block : bool, optional
        Wait until the page is stopped by Ctrl-C. By default scripts wait, and interactive sessions go on.

    Returns
    -------
    ViserServer or None
        The running server, to be ended by its `stop()`; None after waiting.

    Raises
    ------
    InputError
        Arrays that make no frame, a dataset that cannot be opened, an address that cannot be used.

    Examples
    --------
    >>> server = show("demo", port=0, open_browser=False, block=False)  # doctest: +ELLIPSIS
    spatialviz: the built-in demo at http://127.0.0.1:... (stop() stops)
    >>> server.stop()  # doctest: +ELLIPSIS
    (viser) ...
    """
    arrays = {"masks": masks, "names": names, "boxes": boxes, "relations": relations, "up": up}
    arrays = {name: value for name, value in arrays.items() if value is not None}
    if depth is not None and K is not None:
        what = core.open_arrays(what, depth, K, **arrays)
    elif isinstance(what, np.ndarray):
        raise InputError("a picture alone is no frame", expected="show(rgb, depth, K)")
    elif arrays or depth is not None or K is not None:
        given = ", ".join(arrays) or "depth or K alone"
        raise InputError(f"{given}: no picture with depth and K", expected="show(rgb, depth, K, ...)")
    view: dict[str, Any] = {}
    if isinstance(what, Answer):
        what, view = _of_answer(what)
    if isinstance(what, Run):
        name = _name(what.source)
        sources, view = {name: what.source}, {"runs": {name: what}}
    else:
        opened = what if isinstance(what, Opened) else core.open(what)
        name = _name(opened.pipeline)
        sources = {name: opened.pipeline}
        view["labels"] = {} if opened.labels is None else {name: opened.labels}

    from spatialviz.app.access import Access
    from spatialviz.app.in_notebook import addresses_of_notebook, show_in_notebook
    from spatialviz.app.outer_address import outer_address as read
    from spatialviz.app.server import serve

    if block is None:
        block = not (hasattr(sys, "ps1") or sys.flags.interactive)
    found, framed = ((), False) if outer_address else addresses_of_notebook()
    access = Access.of(host, outer=[*map(read, outer_address), *found])
    here = open_browser and not found
    server = serve(sources, host=host, port=port, dark=dark, open_browser=here, block=block, access=access, **view)
    if server is not None and framed and open_browser:
        show_in_notebook(access.outer[0], access.unnamed)
    return server


def _name(pipeline: Pipeline) -> str:
    return pipeline.dataset.root.resolve().name


def _is_of(frame: Frame, opened: Opened) -> bool:
    """True for a frame of the dataset, unlike a frame at hand with the same id."""
    if frame.id not in opened.frames.ids:
        return False
    own = opened.frames[frame.id]
    return np.array_equal(own.rgb, frame.rgb) and np.array_equal(own.depth, frame.depth)


def _of_answer(answer: Answer) -> tuple[Opened, dict[str, Any]]:
    """Pipeline behind an answer, and the answer's view; InputError for an answer without a pipeline."""
    opened, frame = answer.origin, answer.needed_trace().frame
    if not isinstance(opened, Opened):
        raise InputError("this answer does not know what answered it", expected="one that `ask` of `open` gave")
    if not _is_of(frame, opened):
        opened = Opened(replace(opened.pipeline, dataset=InMemoryDataset([frame])))
    edits = Edits() if answer.edits is None else read_edits(dict(answer.edits))
    return opened, {"first_view": ViewState(_name(opened.pipeline), frame.id, answer.text, edits=edits)}
