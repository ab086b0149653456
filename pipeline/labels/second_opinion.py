"""A second opinion on the rules: where a relation network does not agree, the label becomes doubtful.

The rules see the extents that one view shows; the network has learned from
exact geometry what objects are like behind that, and that one the image border
cuts goes on. It never decides a label: it can only turn T or F into U.
On rooms of another maker (tests/box_worlds.py) sign flips against exact geometry
fall from 1.6 to 0.3 (cameras held high) or from 8.9 to 0.3 (held low) in a
thousand, for two per cent more doubtful cells; on the crowded rooms of
tests/benchmarks/mesh_worlds.py from 9 to 15 to between 2 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.profiles import Judged
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.features import Appearance
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import InputError

NONE, TRAINED = "none", "trained"

LEAST_OF_T, MOST_OF_F = 0.9, 0.1
"""The network agrees with T from this probability on, and with F up to that one. Chosen on rooms of solids
(`synthetic.solids`), where its probabilities are calibrated: 1.4 in 1,000 decided cells are then flipped (by 0.8 and
0.2 it would be 1.9, with one cell in a hundred more decided)."""


def open_second_opinion(name: str) -> OnnxScorer | None:
    """The network of that name: "trained" (the shipped one), the path of an ONNX file, or "none".

    Raises
    ------
    InputError
        There is no such network, or it is a softmax network.
    """
    from pipeline.relations import make_scorer

    if name == NONE:
        return None
    scorer = make_scorer(name)
    if not isinstance(scorer, OnnxScorer):
        raise InputError("a second opinion is a network", got=repr(name), expected="trained, none, or an ONNX file")
    if scorer.contract.output != "sigmoid":
        # Its probabilities say which relation fits best, not whether one holds.
        raise InputError("a second opinion judges each relation alone", got="a softmax network", path=name)
    return scorer


def fingerprint(name: str) -> str:
    """What the opinion depends on: the hash of the network's file.

    Raises
    ------
    InputError
        There is no such file.
    """
    from pipeline.relations import shipped_network
    from pipeline.system.onnx_session import file_hash

    if name == NONE:
        return NONE
    path = shipped_network() if name == TRAINED else Path(name)
    if not path.is_file():
        raise InputError("a second opinion is a network", got=repr(name), expected="trained, none, or an ONNX file")
    return file_hash(path)


def doubted(
    judged: Judged,
    network: OnnxScorer,
    objects: Sequence[LiftedObject],
    viewer: ViewerAxes,
    appearance: Appearance | None = None,
) -> Judged:
    """The judgements with U where the network finds T not likely enough, or F too likely.

    The network answers inverse questions alike, and so inverse labels stay inverse.
    """
    states, margins = judged.states.copy(), judged.margins.copy()
    found = network.of_pairs(objects, viewer, appearance)
    bits = np.zeros(states.shape[:2], np.int32) if judged.doubted is None else judged.doubted.copy()
    for k, relation in enumerate(network.contract.vocabulary):
        column = PAIRWISE.index(relation)
        state, p = states[..., column], found[..., k]
        opposed = ((state == T) & (p < LEAST_OF_T)) | ((state == F) & (p > MOST_OF_F))
        opposed &= ~np.eye(len(state), dtype=np.bool_)
        state[opposed] = U
        margins[..., column][opposed] = 0.0
        bits |= opposed.astype(np.int32) << column
    return Judged(states, margins, judged.distance, bits)
