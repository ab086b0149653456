"""Expressions: every phrase, every reading, and an honest error for everything else."""

from __future__ import annotations

import ast
from itertools import pairwise
from pathlib import Path

import pytest
from expression_checks import expression_of, refused, triple
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from pipeline.language import MIRRORED, RELATIONS, Node, Query, grammar, lexicon, parse, sentence_kind, wording
from pipeline.language.lexicon import FAR, SAYS, SAYS_SWAPPED
from pipeline.language.openers import leading
from pipeline.system import InputError

NAMES = [
    "mug", "trash can", "front door", "remote control", "tv stand", "box of tissues on wheels", "pillow on bed",
    "left shoe", "right speaker", "in ear headphones", "under armour bag", "salt and pepper shaker", "built-in oven",
    "red_cup", "CD_player", "bat_(animal)", "plant in a pot", "hat with a wide brim", "close up lens", "M&M's",
    "by-pass valve", "mailbox_(at_home)", "iPod", "on top box", "nearest neighbour", "table holding lamps", "7up can",
]  # fmt: skip
SIMPLE = ["mug", "laptop", "cracker box", "table", "red cup", "sofa chair", "t-shirt", "master chef can", "box of tea"]
PLAIN_PHRASES = [(p, r) for r, phrases in SAYS.items() if r != "between" for p in phrases]
SWAPPED_PHRASES = [(p, r) for r, phrases in SAYS_SWAPPED.items() for p in phrases]


# ---- one relation ------------------------------------------------------------------------------------------------

SPECIFIED = {
    "left": ["to the left of", "on the left of", "to the left side of", "on the left side of", "left of"],
    "right": ["to the right of", "on the right of", "to the right side of", "on the right side of", "right of"],
    "above": ["above", "over", "higher than"],
    "below": ["below", "under", "underneath", "beneath"],
    "front": ["in front of", "in the front of", "ahead of"],
    "behind": ["behind", "in the back of", "at the back of", "on the back of"],
    "on": ["on", "on top of", "atop", "resting on", "lying on", "sitting on", "standing on", "supported by"],
    "in": ["in", "inside", "inside of", "within"],
    "near": ["next to", "beside", "by", "close to", "near"],
    "closest": ["closest to", "nearest to", "nearest"],
    "farthest": ["farthest from", "furthest from"],
}


@pytest.mark.parametrize(("relation", "phrase"), [(r, p) for r, phrases in SPECIFIED.items() for p in phrases])
def test_every_specified_phrase(relation: str, phrase: str) -> None:
    assert phrase in SAYS[relation]
    assert triple(f"mug {phrase} laptop") == ("mug", relation, "laptop")
    assert triple(f"Find the mug that is {phrase} the laptop.") == ("mug", relation, "laptop")


@pytest.mark.parametrize(("phrase", "relation"), SWAPPED_PHRASES)
def test_swapped_phrases_keep_the_head_as_target(phrase: str, relation: str) -> None:
    expression = expression_of(f"the table that is {phrase} a lamp")
    assert (expression.target, expression.relation, expression.reference) == ("table", relation, "lamp")
    assert expression.inverse


@given(
    st.sampled_from(NAMES),
    st.sampled_from(PLAIN_PHRASES),
    st.sampled_from(NAMES),
    st.sampled_from(
        ["{a} {p} {b}", "the {a} {p} the {b}", "is the {a} {p} a {b}?", "please find the {a} that is {p} {b}"]
    ),
)
@settings(max_examples=100)
def test_any_known_names_with_any_phrase(a: str, phrase: tuple[str, str], b: str, form: str) -> None:
    # `on top box` is a name too.
    assume(not (phrase[0].endswith("on top") and b.startswith("box")))
    query = parse(form.format(a=a, p=phrase[0], b=b), class_names=NAMES)
    expression = query.expression
    assert expression is not None
    assert (expression.target, expression.relation, expression.reference) == (a, phrase[1], b)
    assert len(query.readings) == 1
    assert not expression.inverse
    assert expression.second_reference is None


@given(
    st.sampled_from(SIMPLE),
    st.sampled_from(PLAIN_PHRASES),
    st.sampled_from(SIMPLE),
    st.sampled_from(["", "the ", "a ", "this ", "my "]),
    st.sampled_from([" ", "  ", "\t", "\n"]),
    st.sampled_from([str, str.upper, str.title]),
)
@settings(max_examples=75)
def test_case_articles_and_space_do_not_matter(a, phrase, b, article, gap, cased) -> None:  # type: ignore[no-untyped-def]
    text = cased(f"{article}{a} {phrase[0]} {article}{b}").replace(" ", gap)
    assert triple(f" {text} ") == (a, phrase[1], b)


@given(st.sampled_from(SIMPLE), st.sampled_from(PLAIN_PHRASES + SWAPPED_PHRASES), st.sampled_from(SIMPLE))
def test_spans_point_at_the_words(a: str, phrase: tuple[str, str], b: str) -> None:
    text = f"Where is the {a.upper()}, {phrase[0]} the {b}?"
    spans = parse(text).spans
    assert [(text[s.start : s.end], s.role, s.index) for s in spans] == [
        (a.upper(), "target", 0),
        (phrase[0], "relation", 0),
        (b, "reference", 1),
    ]


@pytest.mark.parametrize(
    "text",
    [
        "mug left of laptop", "The mug, left of the laptop.", "find me the mug which is located left of the laptop",
        "where is the mug that's to the left of the laptop?", "is the mug left of the laptop?",
        "show me the mug standing directly left of the laptop", "could you please pick up the mug left of the laptop",
        "From the camera, the mug left of the laptop", "from my view the mug left of the laptop",
        "as seen by the camera, the mug is left of the laptop", "mug left of laptop as seen from the camera",
        "from the camera's point of view, the mug left of the laptop", "in the image, the mug left of the laptop",
        "the mug left of the laptop, viewed from the viewer's perspective", "go to the mug on the left of the laptop",
        "click on the mug left-of the laptop", "is there a mug to the left side of the laptop", "mug left_of laptop",
        "which mug is on the left hand side of the laptop", "the mug left of the laptop in the scene please",
        '"mug" left of "laptop"', "“mug” left of the laptop",
    ],
)  # fmt: skip
def test_what_says_nothing_is_dropped(text: str) -> None:
    assert triple(text) == ("mug", "left", "laptop")
    assert len(parse(text).readings) == 1


def test_the_camera_may_be_a_reference() -> None:
    assert triple("the mug farthest from the camera") == ("mug", "farthest", "camera")
    assert triple("the mug by the camera") == ("mug", "near", "camera")


@pytest.mark.parametrize("phrase", SAYS["between"])
def test_between(phrase: str) -> None:
    expression = expression_of(f"the chair that is {phrase} the table and the sofa")
    assert (expression.target, expression.relation) == ("chair", "between")
    assert (expression.reference, expression.second_reference) == ("table", "sofa")
    assert str(expression) == "chair between table and sofa"
    names = ["salt and pepper shaker", "mug", "fork"]
    expression = expression_of("mug between the salt and pepper shaker and the fork", class_names=names)
    assert (expression.reference, expression.second_reference) == ("salt and pepper shaker", "fork")


@pytest.mark.parametrize("tail", ["on top", "on top of it", "on top of them", "on its top", "on it", "atop"])
def test_with_on_top_is_swapped(tail: str) -> None:
    for text in (f"the table with a lamp {tail}", f"find the table that has a lamp {tail}"):
        expression = expression_of(text)
        assert (expression.target, expression.relation, expression.reference) == ("table", "on", "lamp")
        assert expression.inverse
    query = parse(f"the table with a lamp {tail} left of the sofa")
    assert [r.description for r in query.readings] == ["(table supporting lamp) left of sofa"]


@pytest.mark.parametrize(
    ("text", "relation", "inverse"),
    [
        ("table with a box underneath", "above", False), ("table with a box under it", "above", False),
        ("table with a box in front of it", "behind", False), ("table with a box behind it", "front", False),
        ("table with a box to the left of it", "right", False), ("table with a box next to it", "near", False),
        ("bowl with an apple inside", "in", True), ("bowl with an apple in it", "in", True),
        ("desk with a shelf above", "below", False),
    ],
)  # fmt: skip
def test_with_tails(text: str, relation: str, inverse: bool) -> None:
    expression = expression_of(text)
    assert (expression.relation, expression.inverse) == (relation, inverse)
    assert expression.target == text.split()[0]


def test_with_and_no_tail_belongs_to_the_name() -> None:
    assert triple("the hat with a wide brim left of the mug") == ("hat with a wide brim", "left", "mug")
    assert triple("the mug on the table with the red legs") == ("mug", "on", "table with the red legs")


@pytest.mark.parametrize("phrase", FAR)
def test_far_from_is_not_taken_for_the_farthest(phrase: str) -> None:
    for text in (
        f"the mug {phrase} the laptop", f"find the mug that is {phrase} the laptop",
        f"mug left of the book {phrase} it", f"mug not {phrase} the laptop",
        f"the mug {phrase} the laptop and left of the book",
    ):  # fmt: skip
        message = refused(text)
        assert f"'{phrase}' is not a relation that is judged" in message
        assert "'farthest from' or 'near'" in message
    assert triple("the mug most distant from the laptop") == ("mug", "farthest", "laptop")
    assert triple("the mug farther away from the laptop") == ("mug", "farthest", "laptop")


@pytest.mark.parametrize("word", ["nearest", "closest", "farthest", "furthest"])
def test_superlatives_before_the_noun(word: str) -> None:
    relation = "closest" if word in SAYS["closest"] else "farthest"
    link = "to" if relation == "closest" else "from"
    assert triple(f"the {word} chair {link} the door") == ("chair", relation, "door")
    query = parse(f"the lamp on the {word} table {link} the door")
    assert [r.description for r in query.readings] == [f"lamp on (table {wording(relation)} door)"]
    choice = parse(f"the {word} chair").default.root.choices[0]
    assert (choice.order, choice.rank) == ("near" if relation == "closest" else "far", 1)


def test_inverses_are_an_involution() -> None:
    assert all(MIRRORED[MIRRORED[r]] == r for r in MIRRORED)
    assert {"left", "right", "above", "below", "front", "behind", "near"} <= set(MIRRORED)
    assert {"on", "in"}.isdisjoint(MIRRORED)
    assert set(SAYS) == set(RELATIONS)
    assert {wording(r) for r in RELATIONS} <= {p for phrases in SAYS.values() for p in phrases}


def test_a_phrase_says_one_thing() -> None:
    phrases = [p for table in (SAYS, SAYS_SWAPPED) for ps in table.values() for p in ps]
    assert len(set(phrases)) == len(phrases)
    assert all(p == " ".join(p.lower().split()) for p in phrases)


# ---- names -------------------------------------------------------------------------------------------------------


def test_names_with_relation_words_inside() -> None:
    names = ["pillow on bed", "pillow", "bed", "lamp", "monitor left", "keyboard"]
    assert triple("the pillow on bed left of the lamp", class_names=names) == ("pillow on bed", "left", "lamp")
    assert triple("the lamp near the Pillow On Bed", class_names=names) == ("lamp", "near", "pillow on bed")
    assert triple("pillow on bed", class_names=names) == ("pillow", "on", "bed")
    assert triple("pillow on bed on bed", class_names=names) == ("pillow on bed", "on", "bed")
    assert triple("monitor left of keyboard", class_names=names) == ("monitor", "left", "keyboard")
    assert len(parse("pillow on bed left of lamp").readings) == 2


def test_names_are_spelled_as_the_vocabulary_does() -> None:
    assert triple("the red cup by the cd player", class_names=["Red_Cup", "CD_player"]) == (
        "Red_Cup",
        "near",
        "CD_player",
    )
    assert triple("the Red Cup by the CD player") == ("red cup", "near", "cd player")


def test_synonyms_with_relation_words_hold_together() -> None:
    assert triple("the plant in a pot left of the lamp") == ("plant in a pot", "left", "lamp")
    assert triple("plant in a pot left of lamp", class_names=["potted plant"]) == ("plant in a pot", "left", "lamp")
    assert triple("plant in a pot left of lamp", class_names=["lamp", "pot"])[0] == "plant"
    assert triple("the plant in a pot") == ("plant", "in", "pot")


def test_compounds_and_quotes_are_names() -> None:
    assert triple("built-in oven under the cook-top") == ("built-in oven", "below", "cook-top")
    assert triple('"left of field" near "a mug"') == ("left of field", "near", "a mug")
    assert triple("the dog's bowl by the dog") == ("dog's bowl", "near", "dog")
    assert triple("tv stands behind the sofa") == ("tv stands", "behind", "sofa")


# ---- readings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("relations", "count"), [(1, 1), (2, 2), (3, 5), (4, 14)])
def test_readings_are_counted_by_catalan_numbers(relations: int, count: int) -> None:
    phrases = ["left of", "behind", "on", "near"][:relations]
    nouns = ["mug", "laptop", "table", "sofa", "lamp"]
    query = parse(nouns[0] + "".join(f" {p} the {n}" for p, n in zip(phrases, nouns[1:], strict=False)))
    assert len(query.readings) == count
    assert len({r.description for r in query.readings}) == count
    assert [r.is_default for r in query.readings] == [True] + [False] * (count - 1)
    for reading in query.readings:
        walked = list(reading.root.walk())
        assert sorted(n.mention for n in walked) == list(range(relations + 1))
        assert [nouns[n.mention] for n in walked] == [n.label for n in walked]
        # No crossing: depth first is the order of mention.
        assert [n.mention for n in walked] == sorted(n.mention for n in walked)
    node = query.default.root
    for noun in nouns[1 : relations + 1]:
        assert len(node.attachments) == 1
        (node,) = node.attachments[0].nodes
        assert node.label == noun
    assert query.labels == tuple(nouns[: relations + 1])


def test_too_many_relations() -> None:
    message = refused("mug" + " on table" * 17)
    assert "17" in message
    assert "16" in message
    # Of many only two readings are kept: each to the noun before it, and all to the target.
    many = parse("mug" + " on table" * 5)
    assert len(many.readings) == 2
    assert len(many.readings[1].root.attachments) == 5


def test_both_readings_of_two_relations() -> None:
    query = parse("mug left of the laptop on the table")
    assert [r.description for r in query.readings] == ["mug left of (laptop on table)", "(mug left of laptop) on table"]
    second = query.readings[1].root
    assert [(a.relation, a.nodes) for a in second.attachments] == [
        ("left", (Node("laptop", (), 1),)),
        ("on", (Node("table", (), 2),)),
    ]
    assert str(query.expression) == "mug left of laptop"


def test_and_joins_relations_of_one_noun() -> None:
    query = parse("the mug left of the laptop and behind the lamp")
    assert [r.description for r in query.readings] == ["(mug left of laptop) behind lamp"]
    query = parse("the mug on the table that is left of the sofa and is behind the lamp")
    assert [r.description for r in query.readings] == [
        "mug on ((table left of sofa) behind lamp)",
        "((mug on table) left of sofa) behind lamp",
    ]


def test_between_inside_a_nested_expression() -> None:
    query = parse("the mug on the chair between the table and the sofa behind the lamp")
    assert query.default.description == "mug on (chair between table and (sofa behind lamp))"
    assert query.labels == ("mug", "chair", "table", "sofa", "lamp")
    # The first reference of `between` is closed: five readings as for any chain of three.
    assert len(query.readings) == 5


def test_spans_of_a_nested_expression_do_not_overlap() -> None:
    text = "The table with a lamp on top, left of the nearest chair to the door"
    spans = parse(text).spans
    assert [(text[s.start : s.end], s.role, s.index) for s in spans] == [
        ("table", "target", 0), ("with", "relation", 0), ("lamp", "reference", 1), ("on top", "relation", 0),
        ("left of", "relation", 1), ("nearest", "relation", 2), ("chair", "reference", 2), ("to", "relation", 2),
        ("door", "reference", 3),
    ]  # fmt: skip
    assert all(a.end <= b.start for a, b in pairwise(spans))


def check(query: Query) -> None:
    assert query.readings
    assert query.expression is None or query.expression.relation in RELATIONS
    assert all(0 <= s.start < s.end <= len(query.text) for s in query.spans)
    assert all(a.end <= b.start for a, b in pairwise(query.spans))
    assert len({r.description for r in query.readings}) == len(query.readings) <= 14
    assert sum(r.is_default for r in query.readings) == 1
    named = {s.index for s in query.spans if s.role in ("target", "reference")}
    assert named <= {n.mention for n in query.default.root.walk()}
    for node in query.default.root.walk():
        assert node.label.strip()


def check_or_refuse(text: str, names: tuple[str, ...]) -> None:
    try:
        query = parse(text, class_names=names)
    except InputError:
        refused(text, class_names=names)
    else:
        check(query)


@given(st.text(max_size=310), st.sampled_from([(), tuple(NAMES)]))
@example("( on )", ())
@example('"" on ""', ())
@example('"on" on "on"', ())
@example("' on '", ())
def test_arbitrary_text_is_read_or_refused(text: str, names: tuple[str, ...]) -> None:
    check_or_refuse(text, names)


WORDS = sorted(
    {w for p, _ in PLAIN_PHRASES + SWAPPED_PHRASES for w in p.split()}
    | {w for p in leading() for w in p.split()}
    | lexicon.LINKING | lexicon.UNKNOWN_RELATIONS | lexicon.WITH | lexicon.PRONOUNS | lexicon.AND
    | {"mug", "the lamp", "table", '"', ",", "(", ")", "?", "-", "camera", "from the camera", "car's", "not", "between"}
)  # fmt: skip


@pytest.mark.parametrize("text", ["cup between me", "cup between me and the box", "& between us"])
def test_between_the_viewer_and_a_thing_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="the viewer is none"):
        parse(text)


@given(st.lists(st.sampled_from(WORDS), max_size=14), st.sampled_from([(), tuple(NAMES)]))
@settings(max_examples=125)
def test_any_order_of_the_grammars_own_words_is_read_or_refused(words: list[str], names: tuple[str, ...]) -> None:
    check_or_refuse(" ".join(words), names)


def test_the_parser_needs_no_heavy_library() -> None:
    heavy = {"torch", "spacy", "nltk", "scipy", "viser", "onnxruntime"}
    for name in ("expression", "grammar", "lexicon", "naming", "tokens", "chain"):
        tree = ast.parse(Path(grammar.__file__).with_name(f"{name}.py").read_text(encoding="utf-8"))
        imported = {a.name.split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        imported |= {str(n.module).split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert not imported & heavy


def test_a_known_name_that_begins_within_a_phrase_and_ends_after_it_is_kept() -> None:
    names = ["mug", "door", "front door"]
    assert expression_of("mug in front door", class_names=names).reference == "front door"
    assert expression_of("mug in front of door", class_names=names).relation == "front"
    assert expression_of("mug in front of front door", class_names=names).reference == "front door"


def test_a_known_name_after_an_article_is_kept_whole_too() -> None:
    names = ["mug", "car", "front of car", "left side of stage"]
    assert triple("mug in the front of car", class_names=names) == ("mug", "in", "front of car")
    assert triple("mug on the left side of stage", class_names=names) == ("mug", "on", "left side of stage")
    assert triple("mug in the front of the car", class_names=names) == ("mug", "front", "car")
    assert triple("mug on the left side of the car", class_names=names) == ("mug", "left", "car")


def test_a_phrase_does_not_reach_into_quotes() -> None:
    assert triple('mug in the "front of house"') == ("mug", "in", "front of house")
    assert triple('"mug" on the "left of field"') == ("mug", "on", "left of field")
    assert triple('mug in "front" of "car"', class_names=["front", "car"])[1] == "in"
    assert triple('the "left" of centre left of "right"')[1:] == ("left", "right")


@pytest.mark.parametrize("other", ["the other mug", "another mug", "some other mug", "that other mug"])
def test_another_thing_of_the_same_name(other: str) -> None:
    assert triple(f"the mug left of {other}") == ("mug", "left", "mug")
    assert triple(f"{other} left of the laptop") == ("mug", "left", "laptop")
    assert triple("the mug left of the other furniture", class_names=["other furniture"])[2] == "other furniture"
    assert triple("other left of another", class_names=["other", "another"]) == ("other", "left", "another")


@pytest.mark.parametrize(
    "lead",
    ["where can I find the", "help me find the", "is it true that the", "can you see a", "spot the", "I can see the"],
)
def test_more_ways_to_ask(lead: str) -> None:
    assert triple(f"{lead} mug left of the laptop") == ("mug", "left", "laptop")
    assert triple("spot left of the laptop") == ("spot", "left", "laptop")


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("the mug left of the laptop", "relation"), ("Where is the mug that is on the table?", "question"),
        ("which mug is on the table", "question"), ("the lamp", "name"), ("the box, not the brick", "negation"),
        ("the mug that is not on the red table", "negation"), ("the box between the bed and the lamp", "between"),
        ("the red mug left of the box on the table?", "two-relations"), ("third mug from the left", "ordinal"),
        ("the leftmost red mug", "extreme"), ("the chair closest to the bookcase", "extreme"),
        ("the box on the left", "side"), ("the mug on the red table", "attribute"), ("left of", "unread"),
    ],
)  # fmt: skip
def test_the_kind_of_a_sentence_is_one_word(text: str, kind: str) -> None:
    assert sentence_kind(text) == kind
