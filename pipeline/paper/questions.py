"""What a vision-language model is asked: for the box of a sentence, and whether the relations of a pair hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipeline.evaluation.model_answers import BoxScale, parse_box, parse_yes_no, yes_probability
from pipeline.geometry.frame import Frame
from pipeline.labels.exports.vqa_questions import BRIEF, ask_grounding, ask_relation, can_be_asked
from pipeline.language.naming import normal_form
from pipeline.language.noun_phrase import noun_phrase, readable
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.paper.view import View, marked, view_of
from pipeline.system.chat import Answer, ChatClient, Picture, Question
from pipeline.system.errors import InputError, require

_Key = tuple[tuple[int, int] | None, str, str, str]

UNKNOWN = 0.5
_TOP_LOGPROBS = 5
"""As many as all servers grant; vLLM's default limit is 20, others have 5."""


class Named(Protocol):
    """A thing of a frame: an `Annotation`, a `SceneObject`."""

    @property
    def label(self) -> str: ...

    @property
    def bbox(self) -> np.ndarray: ...


@dataclass(frozen=True)
class AskingConfig:
    """How a model is asked.

    Attributes
    ----------
    wording : int
        Which of the house's sentences asks; 0 is the plainest, LLaVA's.
    square, max_side
        See `view.view_of`.
    max_tokens : int
    workers : int
    keep_going : bool
        Go on without an answer where one question fails for itself.
    """

    wording: int = 0
    square: bool = True
    max_side: int | None = None
    max_tokens: int = 32
    workers: int = 4
    keep_going: bool = False


@dataclass(frozen=True)
class RelationConfig(AskingConfig):
    """How relations are asked for; the wording is that of `labels.wording.question_text`, where nothing is marked.

    Attributes
    ----------
    mark : bool
        Draw the pair's boxes, numbered 1 and 2, and name the numbers in the question ("Is the mug (box 1) ..."), as
        in Set-of-Mark prompting (Yang et al. 2023). Without it, as in LLaVA, things are told apart by their names only.
    logprobs : bool
        Ask for log-probabilities, and where the server gives them take P(yes) / (P(yes) + P(no)).
    """

    mark: bool = False
    logprobs: bool = False

    def __post_init__(self) -> None:
        require(0 <= self.wording < 2**64, "the wording of questions", got=self.wording, expected="0 .. 2**64 - 1")


@dataclass(frozen=True)
class PairScores:
    """What the model says of N ordered pairs and R relations.

    Attributes
    ----------
    relations : tuple of str
    probabilities : (N, R) float64
        P("a RELATION b"): 1 for yes, 0 for no, 0.5 where the answer is not known; or by log-probabilities.
    known : (N, R) bool
        False where the 0.5 is no answer.
    by_logprobs : (N, R) bool
        Where the probability comes from log-probabilities.
    ambiguous : (N,) bool
        Pairs that the question does not pin down: a name that another thing of the frame has too, and no marks.
    texts : tuple of tuple of str
        The answers, N by R.
    reasons : dict of str to int
        Why answers are not known, and how often.
    """

    relations: tuple[str, ...]
    probabilities: np.ndarray
    known: np.ndarray
    by_logprobs: np.ndarray
    ambiguous: np.ndarray
    texts: tuple[tuple[str, ...], ...]
    reasons: dict[str, int]


def score_pairs(
    client: ChatClient,
    frame: Frame,
    objects: Sequence[Named],
    pairs: np.ndarray | Sequence[tuple[int, int]],
    relations: Sequence[str],
    *,
    config: RelationConfig | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> PairScores:
    """Ask of each pair whether each relation holds.

    Parameters
    ----------
    objects : sequence
        Things with a label and a bbox, such as the frame's annotations.
    pairs : (N, 2) int
        Indices of a and b in `objects`.
    relations : sequence of str
        Out of `relations.PAIRWISE`.
    progress : callable
        Called with the number of questions answered so far, and of all.

    Raises
    ------
    InputError
        For arguments out of range.
    ServerError
        The server gives no answer.
    """
    config = config or RelationConfig()
    indices = _checked(pairs, len(objects), relations)
    asked = _questions(objects, indices, relations, config)
    # Things of one name ask the same without marks, and are asked about once.
    order = {key: n for n, key in enumerate(dict.fromkeys(k for k, text in asked if text is not None))}
    prompts = {key: text for key, text in asked if text is not None}
    answers = client.ask_many(
        _with_pictures(frame, objects, [(key[0], prompts[key]) for key in order], config),
        workers=config.workers,
        progress=lambda done: progress(done, len(order)),
        keep_going=config.keep_going,
    )
    shape = (len(indices), len(relations))
    probabilities, known = np.full(shape, UNKNOWN), np.zeros(shape, np.bool_)
    by_logprobs, reasons, texts = np.zeros(shape, np.bool_), Counter[str](), [[""] * shape[1] for _ in range(shape[0])]
    for cell, (key, text) in enumerate(asked):
        i, j = divmod(cell, shape[1])
        if text is None:
            reasons["a name that cannot stand in a question"] += 1
            continue
        answer = answers[order[key]]
        texts[i][j] = answer.text
        value, exact, reason = _judged(answer)
        if reason is not None:
            reasons[reason] += 1
        else:
            probabilities[i, j], known[i, j], by_logprobs[i, j] = value, True, exact
    return PairScores(
        tuple(relations),
        probabilities,
        known,
        by_logprobs,
        _shared_names(objects)[indices].reshape(-1, 2).any(axis=1) & np.full(len(indices), not config.mark),
        tuple(map(tuple, texts)),
        dict(reasons),
    )


def marked_question(relation: str, a: str, b: str) -> str:
    """The question about the things in the boxes 1 and 2 of a marked picture."""
    first, second = (noun_phrase(readable(name)) for name in (a, b))
    verb = first.verb.capitalize()
    return f"{verb} {first.definite()} (box 1) {PHRASE[relation]} {second.definite()} (box 2)?\n{BRIEF}"


def _questions(
    objects: Sequence[Named], indices: np.ndarray, relations: Sequence[str], config: RelationConfig
) -> list[tuple[_Key, str | None]]:
    """For every cell what makes its question the same as another's, and its words; None where a name cannot be said."""
    found: list[tuple[_Key, str | None]] = []
    for a, b in indices.tolist():
        names = objects[a].label, objects[b].label
        for relation in relations:
            text = None
            if all(map(can_be_asked, names)):
                try:
                    text = (
                        marked_question(relation, *names)
                        if config.mark
                        else ask_relation(relation, *names, config.wording)
                    )
                except InputError:
                    text = None
            found.append((((a, b) if config.mark else None, relation, *names), text))
    return found


def _with_pictures(
    frame: Frame, objects: Sequence[Named], asked: Sequence[tuple[tuple[int, int] | None, str]], config: RelationConfig
) -> Iterator[Question]:
    """The questions with their pictures, one pair's at a time: those of a whole frame would fill the memory."""
    drawn: tuple[int, int] | None = None
    picture: Picture | None = None
    for pair, prompt in asked:
        if picture is None or pair != drawn:
            rgb = frame.rgb if pair is None else marked(frame.rgb, [objects[i].bbox for i in pair])
            picture, drawn = view_of(rgb, square=config.square, max_side=config.max_side).picture, pair
        yield Question(prompt, picture, config.max_tokens, _TOP_LOGPROBS if config.logprobs else 0)


def _judged(answer: Answer) -> tuple[float, bool, str | None]:
    """Probability, whether by log-probabilities, and why there is none."""
    if answer.failure is not None:
        return UNKNOWN, False, "the server failed"
    verdict = parse_yes_no(answer.text)
    if verdict.value is None:
        cut = answer.finish == "length"
        return UNKNOWN, False, f"{verdict.reason}, cut off by max_tokens" if cut else verdict.reason
    exact = yes_probability(answer.logprobs)
    return (float(verdict.value), False, None) if exact is None else (exact, True, None)


def _shared_names(objects: Sequence[Named]) -> np.ndarray:
    """(M,) bool: things whose name another has too."""
    forms = [normal_form(thing.label) for thing in objects]
    counts = Counter(forms)
    return np.array([counts[form] > 1 for form in forms], np.bool_)


def _checked(pairs: np.ndarray | Sequence[tuple[int, int]], count: int, relations: Sequence[str]) -> np.ndarray:
    indices = np.asarray(pairs)
    if not indices.size:
        indices = np.zeros((0, 2), np.int64)
    require(
        indices.ndim == 2 and indices.shape[1] == 2 and np.issubdtype(indices.dtype, np.integer),
        "pairs must be int (N, 2)",
        got=f"{indices.dtype} {indices.shape}",
    )
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        raise InputError("a pair names an object that is not there", got=f"{indices.min()} to {indices.max()}",
                         expected=f"0 to {count - 1}")  # fmt: skip
    for relation in relations:
        require(
            relation in PAIRWISE, "no such relation of two things", got=repr(relation), expected=" | ".join(PAIRWISE)
        )
    return indices


@dataclass(frozen=True)
class GroundingConfig(AskingConfig):
    """How boxes are asked for.

    Attributes
    ----------
    box_scale : float, "pixels" or "auto"
        See `answers.parse_box`; pixels are those of the picture as it is sent. Models that count in thousandths
        (Qwen3-VL, InternVL) need 1000.
    """

    max_tokens: int = 64
    box_scale: BoxScale = "auto"


@dataclass(frozen=True)
class Grounding:
    """Where the model says that an expression's target is.

    Attributes
    ----------
    box : (4,) float32 or None
        x0, y0, x1, y1, pixels of the frame.
    raw : str
        The answer.
    reason : str or None
        Why there is no box.
    notes : tuple of str
        What had to be mended or assumed to read it.
    """

    box: np.ndarray | None
    raw: str
    reason: str | None = None
    notes: tuple[str, ...] = ()


def ground_many(
    client: ChatClient,
    frame: Frame,
    texts: Sequence[str],
    *,
    config: GroundingConfig | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Grounding]:
    """Ask for the boxes of expressions about one frame; in their order.

    Parameters
    ----------
    texts : sequence of str
        Such as "the mug left of the laptop".

    Raises
    ------
    InputError
        For an expression that cannot be asked.
    ServerError
        The server gives no answer.
    """
    config = config or GroundingConfig()
    # An unusable scale is told before the server is asked.
    parse_box("", (1, 1), config.box_scale)
    require(all(text.strip() for text in texts), "an expression is empty")
    view = view_of(frame.rgb, square=config.square, max_side=config.max_side)
    questions = [Question(ask_grounding(text, config.wording), view.picture, config.max_tokens) for text in texts]
    answers = client.ask_many(
        questions,
        workers=config.workers,
        progress=lambda done: progress(done, len(questions)),
        keep_going=config.keep_going,
    )
    return [_grounding(answer, view, config.box_scale) for answer in answers]


def _grounding(answer: Answer, view: View, scale: BoxScale) -> Grounding:
    if answer.failure is not None:
        return Grounding(None, "", answer.failure)
    found = parse_box(answer.text, view.size, scale)
    if found.box is None:
        cut = ", cut off by max_tokens" if answer.finish == "length" else ""
        return Grounding(None, answer.text, f"{found.reason}{cut}", found.notes)
    box = view.to_frame(found.box)
    if box is None:
        return Grounding(None, answer.text, "a box outside the frame, in the padding", found.notes)
    return Grounding(box, answer.text, None, found.notes)
