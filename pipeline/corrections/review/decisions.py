"""Questions of a review: what the label of an item claims, and what *right*, *wrong* and *unsure* make of it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Literal

from pipeline.corrections.journal.edits import Edits, judge_relation, set_relation, settle
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import relation_ref
from pipeline.corrections.review.items import ItemKey, State, judgements_of
from pipeline.corrections.review.worklist import say_of_item, status_ref
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import F, T, U, letter
from pipeline.system.errors import needed
from pipeline.system.frozen import dataclass

Answer = Literal["right", "wrong", "unsure"]
UNNAMED = "unnamed"
"""Class of an outlined object without a name."""
SAYS = {T: "true", U: "undecided", F: "false"}
OF_LETTER = {letter(state): state for state in SAYS}
_STATUS: dict[Answer, State] = {"right": "accepted", "wrong": "rejected", "unsure": "unsure"}
_WORDS = {"accepted": "correct", "corrected": "correct, as corrected", "rejected": "wrong", "unsure": "unsure"}
_OTHERS = "ask another"


@dataclass(frozen=True)
class GivenAnswer:
    """Word of one person on an item."""

    author: str
    verdict: str  # T, U or F of a relation, else a status
    time: datetime

    @property
    def text(self) -> str:
        """Verdict in words."""
        return SAYS[OF_LETTER[self.verdict]] if self.verdict in OF_LETTER else _WORDS[self.verdict]


@dataclass(frozen=True)
class ReviewChoice:
    """Consequence of an answer."""

    does: str  # in few words
    state: int | None = None  # T, U or F that a relation gets
    whose: tuple[GivenAnswer, ...] = ()  # words of people that it follows


@dataclass(frozen=True)
class ReviewQuestion:
    """Claim of an item, and its three answers."""

    item: ItemKey
    claim: str
    ask: str
    choices: dict[Answer, ReviewChoice]
    words: tuple[GivenAnswer, ...] = ()  # of people who differ


def words_of(frame: EffectiveFrame, events: Sequence[Event], item: ItemKey) -> tuple[GivenAnswer, ...]:
    """Words of people who differ on an item, oldest first; none where nobody does. `events` are all of the frame."""
    ignored = {u.event.ulid for u in frame.unapplied if u.kind != "agreed"}
    found = judgements_of(events, automatic=lambda k: frame.auto.pairs.state(k.a, k.b, k.what), ignored=ignored)
    if not found.differ(item.plain):
        return ()
    time = {e.id: e.time for e in events}
    said = sorted(found.words.get(item.plain, {}).values(), key=lambda w: w.at)
    return tuple(GivenAnswer(w.author, w.verdict, time[w.at]) for w in said if w.status not in ("unreviewed", "unsure"))


def question_of(
    frame: EffectiveFrame, item: ItemKey, missing: str = "object", words: tuple[GivenAnswer, ...] = ()
) -> ReviewQuestion | None:
    """Ask about an item; None for an object that is gone. `missing` is the class of one that may be missing."""
    if item.kind == "relation":
        return _of_relation(frame, item, words)
    keep, drop = (
        tuple(w for w in words if (w.verdict == "rejected") == out and w.verdict != "unsure") for out in (False, True)
    )
    choices: dict[Answer, ReviewChoice] = {
        "right": ReviewChoice(_told(keep) or "keep it", whose=keep),
        "wrong": ReviewChoice(_told(drop) or "leave it out", whose=drop),
        "unsure": ReviewChoice(_OTHERS),
    }
    if item.kind == "expression":
        text = (frame.expression(item.what) or {}).get("text", "")
        return ReviewQuestion(item, f"“{text}”", "Is this true of what is marked?", choices, words)
    if item.a < 0:
        choices["right"], choices["wrong"] = ReviewChoice("none is missing"), ReviewChoice("one is missing")
        return ReviewQuestion(item, f"No {missing} is labelled here", "Is there none?", choices, words)
    row = frame.object(item.a)
    if row is None:
        return None
    if row["label"] == UNNAMED:
        return ReviewQuestion(item, "What is this?", "Name it: Shift+O, or the digit of its class.", choices, words)
    claim = f"{row['label']} {item.a}"
    return ReviewQuestion(item, claim, "Are its name, its pixels and its box correct?", choices, words)


def _of_relation(frame: EffectiveFrame, item: ItemKey, words: tuple[GivenAnswer, ...]) -> ReviewQuestion:
    assert item.b is not None
    now = frame.pairs.state(item.a, item.b, item.what)
    one, other = (f"{(frame.object(n) or {}).get('label', 'object')} {n}" for n in (item.a, item.b))
    says = PHRASE[item.what]
    claim = f"{one} is {says} {other}" if now == T else f"{one} is not {says} {other}"
    first, second = (F, T) if now == F else (T, F)
    if words:
        # What contradicts the label; "undecided" has an answer of its own.
        others = sorted({OF_LETTER[w.verdict] for w in words} - {first}, key=lambda state: state == U)
        second = others[0] if others else second
    states: dict[Answer, int] = {"right": first, "wrong": second, "unsure": U}
    choices: dict[Answer, ReviewChoice] = {
        answer: _state_choice(now, state, tuple(w for w in words if OF_LETTER[w.verdict] == state))
        for answer, state in states.items()
    }
    labelled = "Not labelled yet." if now is None else f"Labelled {SAYS[now]}."
    return ReviewQuestion(item, claim if now in (T, F) else f"Is {one} {says} {other}?", labelled, choices, words)


def _state_choice(now: int | None, state: int, whose: tuple[GivenAnswer, ...]) -> ReviewChoice:
    does = f"stays {SAYS[state]}" if now == state else SAYS[state] if state == U else f"make it {SAYS[state]}"
    return ReviewChoice(_told(whose) or does, state, whose)


def _told(words: Sequence[GivenAnswer]) -> str:
    """Who says so, and what: "ann: true"."""
    return f"{', '.join(w.author for w in words)}: {words[-1].text}" if words else ""


def edits_of_answer(frame: EffectiveFrame, question: ReviewQuestion, answer: Answer, author: str) -> Edits:
    """Edits of an answer under a person's name; where people differ, it settles the item for all of them."""
    item, choice = question.item, question.choices[answer]
    if item.kind != "relation":
        if question.words and answer != "unsure":
            return settle(frame, status_ref(item), _STATUS[answer])
        return say_of_item(frame, item, _STATUS[answer], author)
    assert item.b is not None
    assert choice.state is not None
    if choice.state == frame.pairs.state(item.a, item.b, item.what) and not question.words:
        return say_of_item(frame, item, "accepted", author)
    return state_edits(frame, item, choice.state, author, bool(question.words))


def state_edits(frame: EffectiveFrame, item: ItemKey, state: int, author: str, differ: bool = False) -> Edits:
    """Edits of a relation's state; `differ` settles it for all.

    A label already right is accepted, under this person's name. Another person's decision stays, too: this person's
    opinion is noted, and reviewers are told of a disagreement.
    """
    a, b, relation = item.a, needed(item.b, "no relation"), item.what
    is_so = frame.pairs.state(a, b, relation) == state
    if differ:
        return settle(frame, status_ref(item), "accepted" if is_so else "corrected", state=state)
    origin = frame.origin(relation_ref(frame.frame, a, b, relation))
    if is_so or (origin.source == "human" and origin.author != author):
        return judge_relation(frame, a, b, relation, state, author)
    return set_relation(frame, a, b, relation, state)
