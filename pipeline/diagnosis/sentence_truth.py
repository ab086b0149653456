"""Truth of free sentences: the objects meant, and the attributes of labelled objects.

Nobody labels attributes. What is known of them comes from one of two sources:

- The sentence comes with its right answers (`eval --sentences`). A right answer has every attribute that is said of it:
  .99. Another thing of the class, of which all the rest that the sentence says surely holds, and which yet is no right
  answer, has not: .01. Of all other things nobody knows, and what the pipeline gave stays: so the relation's truth is
  never smuggled in by way of the attributes. (A reference has its attributes where it is the only one of its class that
  a right answer stands in the relation to.)
- The sentence was typed about a frame with labels or annotations. Then the attributes are judged by the pixels and the
  box of the labelled things themselves, among those of their class: above .5 they count as had, from .3 as in doubt.
  The right answers are those of which the whole tree is true when it is solved among the labelled things, with the
  labelled relations. What wrong masks and boxes do to attributes is found so; that the model of colours is wrong about
  true pixels is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.batch import FrameAnswers
from pipeline.answering.evidence import ATTRIBUTE_HOLDS, HOLDS
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.ranking import Candidates
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.oracles import ALL_ORACLES, STATE_PROBABILITY
from pipeline.diagnosis.substitution import SubstitutedTree
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT, Case, FrameCases, Meant
from pipeline.language.naming import match, spelt
from pipeline.language.tree import Node
from pipeline.relations.relations import U

POSSIBLE = 0.2
"""From this belief on a thing may be what a sentence means: one doubt leaves a half, two leave a quarter."""
_BY_GEOMETRY = {"between", "closest", "farthest"}
_EVERY_ORACLE = (1 << len(ALL_ORACLES)) - 1
_TRUE, _FALSE = STATE_PROBABILITY[1], STATE_PROBABILITY[-1]


def sentence_case(
    truth: FrameCases, trace: Trace, pipeline: Pipeline, context: PreparedFrame, right: np.ndarray | None = None
) -> Case | str:
    """Case of a sentence with its truth, or the reason for none.

    Parameters
    ----------
    trace : Trace
        Its answer.
    context : PreparedFrame
        Of the trace's frame.
    right : (K,) int64, optional
        Indices of the labelled objects that are right answers; by default worked out from the labels.
    """
    root, top = trace.root, trace.root.pairwise
    nodes = [node for node in root.walk() if not node.viewer]
    if top is not None and len(top.nodes) > 1:
        return "the truth of “between” is not worked out"
    reference = "" if top is None or not top.nodes else top.nodes[0].label
    absent = [name for name in trace.missing if name not in (root.label, reference)]
    if absent:
        return f"no {absent[0]} was found, and without it nothing is ranked"
    names = tuple(dict.fromkeys([*truth.labels, *pipeline.dataset.class_names]))
    classes = {n.label: _of_class(n, truth, names, pipeline) for n in nodes}
    if right is not None:
        classes[root.label] = classes[root.label] | np.isin(np.arange(len(truth.labels)), right)
    nothing = np.zeros(0, np.int64)
    case = Case(
        "typed",
        trace.query.text,
        root.label,
        "" if top is None else top.relation,
        reference,
        0,
        0,
        nothing,
        nothing,
        False,
        float("nan"),
        Meant(root, classes, {}),
    )
    unknown = sorted(case.relations - truth.states.keys() - _BY_GEOMETRY)
    if unknown:
        return f"the truth of {unknown[0]!r} is not known"
    world = _LabelledWorld(truth, trace, pipeline, context, case)
    if right is None:
        attributes = _seen(world, nodes)
        if isinstance(attributes, str):
            return attributes
        belief = world.belief(Meant(root, classes, attributes))
        strict, acceptable = np.flatnonzero(belief > HOLDS), np.flatnonzero(belief >= POSSIBLE)
    else:
        attributes, strict, acceptable = _inferred(world, nodes, right), right, right
    case = replace(
        case,
        strict=strict,
        acceptable=acceptable,
        ambiguous=len(acceptable) > 1,
        meant=Meant(root, classes, attributes),
    )
    pairs = np.stack([strict, strict], axis=1) if top is None else np.argwhere(truth.acceptable_pairs(case))
    pairs = pairs[np.isin(pairs[:, 0], strict)]
    if not len(pairs):
        return "in this frame the expression is true of nothing beyond doubt"
    a, b = (int(k) for k in pairs[closest_pair(pairs, trace, truth)])
    return replace(case, target_object=a, reference_object=b)


def _of_class(node: Node, truth: FrameCases, names: tuple[str, ...], pipeline: Pipeline) -> np.ndarray:
    """(N,) bool: labelled objects meant by the name of a noun phrase."""
    name = spelt(node.name, names, pipeline.synonyms)
    meant = truth.labels if node.anything else match(name, names, pipeline.synonyms)
    return np.array([label in meant for label in truth.labels], np.bool_)


class _LabelledWorld:
    """Labelled objects alone, as the candidates of a sentence."""

    def __init__(self, truth: FrameCases, trace: Trace, pipeline: Pipeline, context: PreparedFrame, case: Case) -> None:
        answers = FrameAnswers.of_trace(pipeline, context, trace)
        answers.candidates = {name: Candidates(np.zeros(0, np.int64), np.zeros(0)) for name, _ in truth.roles(case)}
        self.truth, self.case, self._evidence = truth, case, FrameEvidence(truth, answers, cases=(case,))

    def _spread(self, tree: SubstitutedTree, name: str, values: np.ndarray, fill: float) -> np.ndarray:
        found = np.full(len(self.truth.labels), fill)
        found[tree.roles[name].object] = values
        return found

    def belief(self, meant: Meant) -> np.ndarray:
        """(N,) float64: truth of the sentence for each object; 0 for other classes."""
        tree = SubstitutedTree(self._evidence, meant)
        return self._spread(tree, meant.root.label, tree.solved(_EVERY_ORACLE).root.belief, 0.0)

    def looks(self, node: Node) -> dict[str, np.ndarray | None]:
        """(N,) float64 by attribute, from true pixels and boxes; None where not judged."""
        assert self.case.meant is not None
        tree = SubstitutedTree(self._evidence, self.case.meant)
        told = {str(a): tree.attribute(node.label, a) for a in node.attributes}
        return {text: None if p is None else self._spread(tree, node.label, p, np.nan) for text, p in told.items()}


def _seen(world: _LabelledWorld, nodes: list[Node]) -> dict[tuple[str, str], np.ndarray] | str:
    """Attributes of labelled objects by pixels and boxes, or the reason for none."""
    found = {}
    for node in nodes:
        for text, p in world.looks(node).items():
            if p is None:
                return f"nothing says which {node.name} is {text}"
            sure, possible = p > HOLDS, p >= ATTRIBUTE_HOLDS
            state = np.select([sure, possible], [_TRUE, STATE_PROBABILITY[0]], _FALSE)
            found[node.label, text] = np.where(np.isnan(p), np.nan, state)
    return found


def _inferred(world: _LabelledWorld, nodes: list[Node], right: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
    """Attributes inferred from the right answers; NaN where unknown."""
    truth, case = world.truth, world.case
    assert case.meant is not None
    root, classes = case.meant.root, case.meant.classes
    count = len(truth.labels)
    found = {(n.label, str(a)): np.full(count, np.nan) for n in nodes for a in n.attributes}
    top = root.pairwise
    if top is not None and top.relation in truth.states:
        states = truth.states[top.relation]
        ends = ((states.T if top.inverse else states) >= U)[right] & classes[top.nodes[0].label]
        only = np.unique(ends[ends.sum(axis=1) == 1].nonzero()[1])
        for attribute in top.nodes[0].attributes:
            found[top.nodes[0].label, str(attribute)][only] = _TRUE
    if root.attributes:
        wrong = np.zeros(count, np.bool_)
        if not case.meant.chooses:
            # Of a choice, or of what a thing is not, nobody knows whether it or the attribute leaves the thing out.
            wrong = world.belief(replace(case.meant, root=replace(root, attributes=()))) > HOLDS
        for attribute in root.attributes:
            told = found[root.label, str(attribute)]
            told[wrong] = _FALSE
            told[right] = _TRUE
    return found


def closest_pair(pairs: np.ndarray, trace: Trace, truth: FrameCases) -> int:
    """Index of the answered pair: by overlap with the target, of equal ones with the reference."""
    if trace.ranking is None or not trace.ranking.pairs:
        return 0
    best = trace.ranking.pairs[0]
    indices = (best.target, best.target if best.reference is None else best.reference)
    overlap = iou_2d(np.array([trace.objects[k].bbox for k in indices], np.float64), truth.boxes)
    overlap[overlap < HIT] = 0
    return int(np.lexsort((-overlap[1, pairs[:, 1]], -overlap[0, pairs[:, 0]]))[0])
