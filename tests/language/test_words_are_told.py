"""No content word is dropped in silence: each is known, part of a name, mended and told, or listed as unused."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import frame_of, upright

from pipeline.answering import trace_record
from pipeline.answering.ask import ask
from pipeline.answering.detector_prompts import detections
from pipeline.geometry import Frame
from pipeline.language import Query, match, parse
from pipeline.language.attributes import SINGLE_WORDS
from pipeline.language.chain import OWN_WORDS
from pipeline.language.lexicon import CONTRACTIONS, SHORTHAND, VIEW_WORDS
from pipeline.language.naming import meanings
from pipeline.language.openers import FRAMING, leading
from pipeline.language.tokens import attribute_meant, is_known, spelling_corrected
from pipeline.proposals import AnnotationDetector, Proposals
from pipeline.system import InputError, UnknownClass

NAMES = ("mug", "laptop", "desk lamp", "dining table", "chair", "pillow")
TRUTH = AnnotationDetector(NAMES)
SCENE = frame_of([upright((x, 0.9, 2), (0.3, 0.4, 0.3)) for x in (-0.6, 0.0, 0.6)], ["mug", "laptop", "mug"])
FRAME_WORDS = frozenset(w for phrase in leading() for w in phrase.split()) | VIEW_WORDS | FRAMING
OPENERS = [
    "",
    "please find",
    "wheres",
    "how about",
    "could you pass me",
    "which one of",
    "is there",
    "what is",
    "i need",
    "might i trouble you for",
]
THINGS = ["mug", "laptop", "lamp", "coffee mug", "table", "cushion", "chair", "thing", "one", "chiar", "something"]
LOOKS = ["red", "pruple", "wodden", "small", "dark blue", "not red", "wooden", "striped", "bigger", "second", "top"]
RELATIONS = [
    "left of",
    "to the rigth of",
    "on",
    "next to",
    "that is behind",
    "closer to",
    "not on",
    "in front of",
    "farthest from",
    "between the mug and",
    "and near",
    "or under",
    "which stands by",
    "instead of",
    "with",
    "without",
    "from",
    "near from",
    "at right from",
    "without a",
    "except the",
    "on no",
]
TAILS = [
    "",
    "on the left",
    "second from the right",
    "please",
    "in red",
    "that is not green",
    "closest to me",
    "and small",
    "left",
    "in front corner",
    "not on the right",
]
STRANGE = st.from_regex(r"[bdfgkmnprstvz][aeiou][bdfgkmnprstvz]{2}[aeiou][bdfgkmnprstvz]{1,3}", fullmatch=True).filter(
    lambda w: not is_known(w) and attribute_meant(w) is None and spelling_corrected(w) == w and not meanings(w, NAMES)
)


def known_to_a_name(word: str, query: Query) -> bool:
    """Whether a word in lower case is one of the detector's names or of the table's, spelled right or by a letter."""
    return (
        is_known(word)
        or word in OWN_WORDS
        or any(m.how == "spelling" for m in meanings(word, NAMES)[:1])
        or bool(match(word, NAMES))
    )


def lost(query: Query) -> list[str]:
    """The words that nothing accounts for."""
    mended = {said.lower() for said, _ in query.mended}
    found = []
    for word in re.finditer(r"[a-z']+", query.text.lower()):
        roles = {s.role for s in query.spans if s.start <= word.start() and word.end() <= s.end}
        said = word[0].strip("'")
        usual = said in mended or said in CONTRACTIONS or said in SHORTHAND
        if roles & {"target", "reference"}:
            told = usual or known_to_a_name(said, query)
        elif roles:
            told = usual or "unused" in roles or is_known(said) or said in OWN_WORDS
        else:
            told = usual or said in OWN_WORDS or said in FRAME_WORDS or spelling_corrected(said) in OWN_WORDS
        found += [] if told else [said]
    return found


@st.composite
def sentences(draw: st.DrawFn) -> str:
    words = [draw(st.sampled_from(OPENERS))]
    for place in range(draw(st.integers(1, 3))):
        words += [draw(st.sampled_from(RELATIONS))] if place else []
        words += ["the", *draw(st.lists(st.sampled_from(LOOKS), max_size=2)), draw(st.sampled_from(THINGS))]
    words = [w for w in (*words, draw(st.sampled_from(TAILS))) if w]
    for strange in draw(st.lists(STRANGE, max_size=2)):
        words.insert(draw(st.integers(0, len(words))), strange)
    return " ".join(words)


@given(sentences())
@settings(max_examples=300, deadline=None)
def test_every_word_is_known_named_mended_or_told_to_be_unused(text: str) -> None:
    try:
        _, query = detections(SCENE, TRUTH, parse(text, class_names=NAMES))
    except InputError:
        return
    assert lost(query) == [], query.default.description
    assert all(s.note for s in query.unused)


@pytest.mark.parametrize(
    ("text", "left_out"),
    [
        ("the zorbly mug", ["zorbly"]),
        ("the zorbly coffee mug", ["zorbly"]),
        ("the mug near the zorbly laptop", ["zorbly"]),
        ("mug with a red lid", ["red", "lid"]),
        ("the mug on the floor that's closer to the laptop", ["floor"]),
        ("the garden table", ["garden"]),
        ("the mid-zorbly chair", ["mid", "zorbly"]),
        ("a pillow of zorbly", ["zorbly"]),
        ("the coffee mug", []),
        ("the pruple mug", []),
    ],
)
def test_what_a_detector_of_few_names_cannot_use_is_listed(text: str, left_out: list[str]) -> None:
    _, query = detections(SCENE, TRUTH, parse(text, class_names=NAMES))
    assert [text[s.start : s.end] for s in query.unused] == left_out


def test_an_unknown_thing_alone_is_refused() -> None:
    with pytest.raises(UnknownClass):
        detections(SCENE, TRUTH, parse("the zorbly", class_names=NAMES))


class Open:
    """A detector that is given phrases as they stand."""

    name, exact, vocabulary, segments = "open", False, None, False

    def detect(self, frame: Frame, labels: Sequence[str] | None = None) -> Proposals:
        return TRUTH.detect(frame, ["mug"])

    def fingerprint(self) -> str:
        return "open"


def test_phrases_that_go_out_as_they_stand_are_shown() -> None:
    _, query = detections(SCENE, Open(), parse("the zorbly pruple mug behind the mug with a lid"))
    assert query.asked == (("purple zorbly mug", "purple zorbly mug"),) or query.asked[0] == (
        "zorbly pruple mug",
        "zorbly pruple mug",
    )
    assert query.asked[1] == ("mug with a lid", "mug with a lid")
    record = trace_record(ask(SCENE, "a red mug left of the thing", TRUTH))
    assert record["expression"]["asked"] == [{"name": "red mug", "phrase": "mug"}, {"name": "thing", "phrase": None}]


def test_a_comparison_among_several_and_heights_of_what_is_seen_are_told() -> None:
    three = frame_of([upright((x, 0.9, 2), (0.3, 0.4, 0.3)) for x in (-0.6, 0.0, 0.6)], ["mug", "mug", "mug"])
    notes = trace_record(ask(three, "the farther mug", TRUTH))["notes"]
    assert len(notes) == 1
    assert "compares two, and 3 things are called 'mug'" in notes[0]
    assert "notes" not in trace_record(ask(SCENE, "the farther mug", TRUTH))
    assert "seen" in trace_record(ask(SCENE, "the tallest mug", TRUTH))["notes"][0]
    four = frame_of(
        [upright((x, 0.9, 2), (0.3, 0.4, 0.3)) for x in (-0.6, 0.0, 0.6, 1.2)], ["mug", "mug", "mug", "laptop"]
    )
    record = trace_record(ask(four, "the mug that is closer to the laptop", TRUTH))
    assert "'closer to' compares two" in record["notes"][0]
    assert record["answer"]["target"]["id"] == 2


def test_words_for_looks_are_known_as_they_are() -> None:
    assert all(attribute_meant(word) is None for word in SINGLE_WORDS)
