"""What is reviewed, item by item: its key, and where it stands by what people did.

What a person did to an item is a word on it. Correcting a value says
"corrected", or "accepted" where it is what the labeller had said; leaving out
an object or expression, or marking the latter as wrong, says "rejected"; a
status says itself; a judgement (`pipeline.corrections.journal.replay`) says it for one
person. Of each person the newest word counts, and what was taken back was never
said.

Over all, the newest word counts as well, unless people say different things:
then the item is "unsure", and so open, until `edits.settle` says the last word.
Who is unsure contradicts nobody. A word after the settlement that says
something else opens the item again.

How far two reviewers agree is told by Cohen's kappa (Educational and Psychological Measurement 20, 1960).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import field
from itertools import combinations
from typing import Any, Literal, NamedTuple, get_args

from pipeline.corrections.journal.events import Event, grouped
from pipeline.corrections.journal.field_refs import FieldRef, judged_item, same_value
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.replay import by_ref, standing_at
from pipeline.metrics.intervals import Agreement, cohen_kappa
from pipeline.relations.relations import letter
from pipeline.system.frozen import dataclass

Kind = Literal["relation", "object", "expression"]
State = Literal["unreviewed", "accepted", "corrected", "rejected", "unsure"]
KINDS: tuple[Kind, ...] = get_args(Kind)
STATES: tuple[State, ...] = get_args(State)
DISAGREED = 1 - 1e-6
"""The weight of an item on which reviewers say different things: above all that machines find."""
SETTLED: tuple[State, ...] = ("accepted", "corrected", "rejected")
"""Nothing is left to do; an item that a reviewer is unsure of may be asked of another."""
NOBODY = -1
"""In place of an object's number where there is none."""


class ItemKey(NamedTuple):
    """What names a label in every version of a dataset's labels."""

    frame: str
    """The frame's id."""
    kind: str
    """ "relation", "object" or "expression"."""
    a: int
    """Number of the object; of a pair, of the one that is said to be somewhere. NOBODY of an expression, and where an
    object may be missing."""
    b: int | None
    """The other object of a pair."""
    what: str
    """The relation, or the expression's id; empty for objects. Where one may be missing (in queues and journals of
    earlier versions), its place x0,y0,x1,y1 in pixels."""

    @property
    def plain(self) -> ItemKey:
        """Key without the objects of an expression: the id names it, and a journal knows no more."""
        return self._replace(a=NOBODY, b=None) if self.kind == "expression" else self


_RANK = {"unreviewed": 0, "unsure": 1, "accepted": 2, "corrected": 3, "rejected": 4}
"""Of what one action says of an item, by several fields, the strongest counts."""
Labelled = Callable[[ItemKey], "int | None"]
"""The state (T, U, F) that automatic labels give a relation; None where it is not known."""


@dataclass(frozen=True)
class Judgement:
    """What one person says of an item."""

    author: str
    status: State
    """ "accepted", "corrected", "rejected" or "unsure"; "unreviewed" where an earlier word was withdrawn."""
    verdict: str
    """What is compared between people. Of relations T, U or F: who accepts a T says T. Of others the status; who
    accepts what another has corrected says "corrected", as that one did."""
    at: int
    """`id` of the event that made it so: later words have greater ones."""


@dataclass(frozen=True)
class Judgements:
    """All words that stand."""

    words: dict[ItemKey, dict[str, Judgement]] = field(default_factory=dict)
    """The newest of each author."""
    settled: dict[ItemKey, Judgement] = field(default_factory=dict)
    """What was settled where people differed."""

    @property
    def authors(self) -> tuple[str, ...]:
        """Authors of any judgement, sorted."""
        return tuple(sorted({author for of_item in self.words.values() for author in of_item}))

    def of(self, author: str) -> dict[ItemKey, Judgement]:
        """Judgements of one person."""
        return {key: words[author] for key, words in self.words.items() if author in words}

    def differ(self, key: ItemKey) -> bool:
        """Tell items with differing judgements and no settlement."""
        return len({w.verdict for w in self._open_words(key)}) > 1

    def state(self, key: ItemKey) -> State:
        """The state of an item over all people."""
        if self.differ(key):
            return "unsure"
        if key in self.settled:
            return self.settled[key].status
        words = [w for w in self.words.get(key, {}).values() if w.status != "unreviewed"]
        return max(words, key=lambda w: w.at).status if words else "unreviewed"

    def verdict(self, key: ItemKey) -> str | None:
        """Verdict of a settled item, as of `Judgement.verdict`; else None."""
        return None if self.state(key) not in SETTLED else max(self._open_words(key), key=lambda w: w.at).verdict

    def states(self, author: str | None = None) -> dict[ItemKey, State]:
        """State of every judged item, over all people or by a single person."""
        if author is not None:
            return {k: w.status for k, w in self.of(author).items() if w.status != "unreviewed"}
        found: dict[ItemKey, State] = {key: self.state(key) for key in {**self.words, **self.settled}}
        return {key: state for key, state in found.items() if state != "unreviewed"}

    def states_now(self, now: Callable[[ItemKey], int | None]) -> dict[ItemKey, State]:
        """State of each item over all; "unsure" of a relation whose label differs from its verdict.

        That is so where labels were made again, and where the only word on a label is that of a second opinion.

        `now`: T, U or F of a relation as the labels are now; None where they have none.
        """
        found = self.states()
        for key in found:
            state, verdict = now(key) if key.kind == "relation" else None, self.verdict(key)
            if state is not None and verdict in ("T", "U", "F") and verdict != letter(state):
                found[key] = "unsure"
        return found

    def _open_words(self, key: ItemKey) -> list[Judgement]:
        words = [w for w in self.words.get(key, {}).values() if w.status in SETTLED]
        last = self.settled.get(key)
        return words if last is None else [last, *(w for w in words if w.at > last.at)]


def judgements_of(
    journal: Journal | Iterable[Event],
    *,
    automatic: Labelled | None = None,
    ignored: Collection[str] = (),
) -> Judgements:
    """Everyone's words.

    `journal`: all events, in the order of their saving. `automatic`: what the labeller says of a relation, for those
    who accepted it by its status alone. Without it, their word is "accepted" where nobody ever changed the relation.
    `ignored`: ULIDs of events that say nothing of the labels as they are now (`EffectiveLabels.unapplied`).
    """
    refs = by_ref(journal.events() if isinstance(journal, Journal) else tuple(journal))
    standing = {ref: [x for x in standing_at(members) if x[0].ulid not in ignored] for ref, members in refs.items()}
    settling = {e.group for ref, found in standing.items() if ref.field == "settled" for e, _ in found}
    items = {ref: key for ref in refs if (key := item_of(ref)) is not None}
    of_entity = grouped((ref for ref in items if _is_value(ref)), items.__getitem__)
    groups: dict[tuple[ItemKey, str, str], Judgement] = {}
    settled: dict[ItemKey, Judgement] = {}
    for ref, key in items.items():
        for event, at in standing[ref]:
            word = _word(event, at, key, refs, of_entity.get(key, ()), automatic)
            if ref.field == "settled":
                if word.status != "unreviewed" and (key not in settled or at > settled[key].at):
                    settled[key] = word
            elif event.group not in settling:
                spoken = key, event.author, event.group
                if spoken not in groups or _RANK[word.status] >= _RANK[groups[spoken].status]:
                    groups[spoken] = word
    words: dict[ItemKey, dict[str, Judgement]] = {}
    for (key, author, _), word in groups.items():
        newest = words.setdefault(key, {}).setdefault(author, word)
        if word.at > newest.at:
            words[key][author] = word
    return Judgements(words, settled)


def item_of(ref: FieldRef) -> ItemKey | None:
    """Item of a cell; None of a frame's."""
    a, b, what = NOBODY, None, ref.key
    if ref.kind == "review":
        _, kind, a, b, what = judged_item(ref.key)
        return ItemKey(ref.frame, kind, a, b, what)
    if ref.kind == "relation":
        (a, b), what = ref.numbers, ref.field.removesuffix(".status")
    elif ref.kind == "object":
        a, what = ref.numbers[0], ""
    return None if ref.kind == "frame" else ItemKey(ref.frame, ref.kind, a, b, what)


def _is_value(ref: FieldRef) -> bool:
    return ref.kind != "review" and not ref.field.endswith("status") and ref.field != "mark"


def _word(
    event: Event,
    at: int,
    key: ItemKey,
    refs: Mapping[FieldRef, Sequence[Event]],
    of_entity: Sequence[FieldRef],
    automatic: Labelled | None,
) -> Judgement:
    ref, after = event.ref, event.after
    status, state = _status_of(event, refs[ref][0].before)
    if ref.kind == "review" and isinstance(after, dict):
        state = after["value"]
    elif key.kind == "relation" and status == "accepted" and not _is_value(ref):
        values = refs.get(FieldRef("relation", key.frame, f"{key.a},{key.b}", key.what), ())
        before = [e.after for e in values if e.id < event.id]
        # The relation's state when the event was saved.
        state = before[-1] if before else values[0].before if values else automatic and automatic(key)
    if key.kind == "relation" and state is not None and status != "unsure":
        verdict = letter(state)
    elif key.kind != "relation" and status == "accepted" and _changed_before(event, of_entity, refs):
        verdict = "corrected"
    else:
        verdict = status
    return Judgement(event.author, status, verdict, at)


def _status_of(event: Event, automatic: Any) -> tuple[State, int | None]:
    """The status of an event, and of a relation's value the value."""
    ref, after = event.ref, event.after
    if ref.kind == "review":
        return ("unreviewed" if after is None else after["status"]), None
    if not _is_value(ref):
        if after is None:
            return "unreviewed", None
        return ("rejected" if ref.field == "mark" else after), None
    changed = ref.field == "exists" or not same_value(after, automatic)
    return ("corrected" if changed else "accepted"), (after if ref.kind == "relation" else None)


def _changed_before(event: Event, of_entity: Sequence[FieldRef], refs: Mapping[FieldRef, Sequence[Event]]) -> bool:
    earlier = ((ref, [e for e in refs[ref] if e.id <= event.id]) for ref in of_entity)
    return any(e and (ref.field == "exists" or not same_value(e[-1].after, e[0].before)) for ref, e in earlier)


@dataclass(frozen=True, eq=False)
class PairAgreement:
    """How far two people agree."""

    first: str
    second: str
    all: Agreement
    """On all items that both have judged."""
    kinds: dict[str, Agreement]
    """On those of a kind, where there are any."""
    differ: tuple[tuple[ItemKey, str, str], ...]
    """tuple of (ItemKey, str, str): items that they judge differently, and what each says, by frame and key."""

    def record(self) -> dict[str, Any]:
        """The agreement as JSON."""
        return {
            "reviewers": [self.first, self.second],
            **self.all.record(),
            "kinds": {kind: found.record() for kind, found in self.kinds.items()},
            "differ": [
                {"frame": k.frame, "kind": k.kind, "a": k.a, "b": k.b, "what": k.what, "said": [one, other]}
                for k, one, other in self.differ
            ],
        }


def pair_agreements(judgements: Judgements, inverse: Callable[[str], str | None]) -> tuple[PairAgreement, ...]:
    """Agreement of each two people with judged items in common.

    Compared is each one's newest word (`Judgement.verdict`); who is unsure, or has withdrawn a word, has not judged.
    A settlement is nobody's own word, and does not bear on it. "a left of b" and "b right of a" are one item, so that
    what one key press says counts once.

    `inverse`: what "b ... a" is called where "a RELATION b" is said, as of `Setting.inverse`; None where nothing is.
    """
    verdict = {
        author: {k: w.verdict for k, w in _folded(judgements.of(author), inverse).items() if w.status in SETTLED}
        for author in judgements.authors
    }
    found = []
    for first, second in combinations(verdict, 2):
        both = sorted(verdict[first].keys() & verdict[second].keys(), key=str)
        if not both:
            continue
        pairs = [(k, verdict[first][k], verdict[second][k]) for k in both]
        kinds = {kind: [p for p in pairs if p[0].kind == kind] for kind in KINDS}
        found.append(
            PairAgreement(
                first,
                second,
                _of_pairs(pairs),
                {kind: _of_pairs(of_kind) for kind, of_kind in kinds.items() if of_kind},
                tuple(p for p in pairs if p[1] != p[2]),
            )
        )
    return tuple(found)


def _folded(words: Mapping[ItemKey, Judgement], inverse: Callable[[str], str | None]) -> dict[ItemKey, Judgement]:
    found: dict[ItemKey, Judgement] = {}
    for key, word in words.items():
        mirrored = inverse(key.what) if key.kind == "relation" else None
        if mirrored is not None and key.b is not None:
            key = min(key, key._replace(a=key.b, b=key.a, what=mirrored))
        if key not in found or word.at > found[key].at:
            found[key] = word
    return found


def _of_pairs(pairs: Sequence[tuple[ItemKey, str, str]]) -> Agreement:
    return cohen_kappa([p[1] for p in pairs], [p[2] for p in pairs])
