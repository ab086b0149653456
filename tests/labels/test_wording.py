"""Sentences of auto-labels: correct English, varied, and read back by the parser as they were meant."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

import pytest
from expression_checks import expression_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from slow_cases import mostly_slow

from pipeline.datasets import open_dataset
from pipeline.labels import expression_text
from pipeline.labels.wording import STYLES, can_be_worded, question_text
from pipeline.language import DIRECTIONAL, PAIRWISE, PHRASE, VOCABULARIES, is_named, match, normal_form, parse, readable
from pipeline.language.noun_phrase import indefinite_article, noun_phrase
from pipeline.system import InputError


def _listed(names: str, between: str = ",") -> list[str]:
    return names.split(between)


COCO = _listed(
    "person,bicycle,car,motorcycle,airplane,bus,train,truck,boat,traffic light,fire hydrant,stop sign,"
    "parking meter,bench,bird,cat,dog,horse,sheep,cow,elephant,bear,zebra,giraffe,backpack,umbrella,handbag,tie,"
    "suitcase,frisbee,skis,snowboard,sports ball,kite,baseball bat,baseball glove,skateboard,surfboard,"
    "tennis racket,bottle,wine glass,cup,fork,knife,spoon,bowl,banana,apple,sandwich,orange,broccoli,carrot,"
    "hot dog,pizza,donut,cake,chair,couch,potted plant,bed,dining table,toilet,tv,laptop,mouse,remote,keyboard,"
    "cell phone,microwave,oven,toaster,sink,refrigerator,book,clock,vase,scissors,teddy bear,hair drier,"
    "toothbrush"
)
AVD = _listed(
    "advil_liqui_gels,aunt_jemima_original_syrup,bumblebee_albacore,cholula_chipotle_hot_sauce,"
    "coca_cola_glass_bottle,crest_complete_minty_fresh,crystal_hot_sauce,expo_marker_red,hersheys_bar,"
    "honey_bunches_of_oats_honey_roasted,honey_bunches_of_oats_with_almonds,hunts_sauce,listerine_green,"
    "mahatma_rice,nature_valley_granola_thins_dark_chocolate,nutrigrain_harvest_blueberry_bliss,pepto_bismol,"
    "pringles_bbq,progresso_new_england_clam_chowder,quaker_chewy_low_fat_chocolate_chunk,red_bull,"
    "softsoap_clear,softsoap_gold,softsoap_white,spongebob_squarepants_fruit_snaks,tapatio_hot_sauce,"
    "vo5_tea_therapy_healthful_green_tea_smoothing_shampoo,nature_valley_sweet_and_salty_nut_almond,"
    "nature_valley_sweet_and_salty_nut_cashew,nature_valley_sweet_and_salty_nut_peanut,"
    "nature_valley_sweet_and_salty_nut_roasted_mix_nut,paper_plate,red_cup"
)
SEMANTIC_ABSTRACTION = _listed(
    "television,tv,sofa,couch,house plant,plant in a pot,bookcase,bookshelf,baseball bat,"
    "rawlings big stick maple bat,pillow,cushion,arm chair,recliner,bread,loaf of sourdough,cell phone,"
    "mobile phone,desktop,computer,dresser,wardrobe,dumbbell,gym weights,fridge,refridgerator,garbage can,"
    "trash can,laptop,outlet,eletric plug,stairs,staircase,pot,mug,safe,teddy bear,basket ball,wine bottle"
)
HOSTILE = [
    "front door", "on switch", "left shoe", "table behind glass", "pillow on bed", "plant in a pot", "top shelf",
    "nearest neighbour", "looking glass", "ShowCase", "show case", "find x", "TV stand", "tv stands", "in", "on",
    "left", "to the left of", "front of car", "car", "of mice and men", "hat with a wide brim",
    "salt and pepper shaker", "it", "is", "what", "which mug", "camera", "front facing camera", "view",
    "couch's left", "dog's left paw", "not a box", "bed next to window", "built-in oven", "by-pass valve",
    "close up lens", "M&M's", '15" monitor', "'s", "in front", "mailbox_(at_home)", "bat (animal)",
    "bookcase / shelf", "Monitor/TV", "w/o lid", "and/or sign", "and", "with", "between", "closest",
    "supporting beam", "stand", "standing lamp", "hanging", "there", "other", "another", "my view", "the beast",
    "0 bottle", "obj_000012", "100% juice", "#1 mug", "机", "café table", "image", "in the image", "please",
    "Dr. Pepper", "x" * 120, "left " * 20, "side", "left side", "between the lines", "box (left)", "bottle, plastic",
]  # fmt: skip
FUNCTION_WORDS = {
    "in", "on", "left", "it", "is", "what", "camera", "image", "and", "with", "between", "closest", "other", "another",
    "there", "view", "in the image", "my view", "to the left of", "in front", "side", "please", "stand",
}  # fmt: skip
"""Names that stand in the sentences themselves; a dataset with such a class may leave no sentence for another."""
UNSAYABLE = ["", "  ", "\t", "-", "mug 😀", "<b>", "\x00", "a" * 300, "a\u202eb", "£5", "()", '"']
BRIEF = ["trash_can", "Dining Table", "scissors", "TV", "USB cable", "hot-dog", "sunglasses", "shelves", "people"]
SETS = {
    "coco": COCO, "avd": AVD, "semantic-abstraction": SEMANTIC_ABSTRACTION, "hostile": HOSTILE, "brief": BRIEF,
    "mixed": [*COCO, *(n for n in HOSTILE if n not in FUNCTION_WORDS)],
}  # fmt: skip


def check_read_back(text: str, target: str, relation: str, reference: str, names: tuple[str, ...]) -> None:
    query = parse(text, class_names=names)
    assert len(query.readings) == 1, text
    found = query.expression
    assert found is not None, text
    assert (found.relation, found.inverse, found.second_reference) == (relation, False, None), text
    for label, name in ((found.target, target), (found.reference, reference)):
        assert is_named(label, name), (text, label, name)
        assert name in match(label, names), (text, label, name)


def check_all(names: list[str], keys: range) -> None:
    known = tuple(names)
    for number, target in enumerate(known):
        reference = known[(number * 7 + keys[0] + 1) % len(known)]
        for relation in PAIRWISE:
            for key in keys:
                for style in STYLES if key == keys[0] else ("varied",):
                    text = expression_text(target, relation, reference, key, style=style, class_names=known)
                    check_read_back(text, target, relation, reference, known)
            text = question_text(relation, target, reference, keys[0] + number, class_names=known)
            check_read_back(text, target, relation, reference, known)


@pytest.mark.slow
@pytest.mark.parametrize(("names", "keys"), [(["mug", "laptop"], 80), (BRIEF, 24)], ids=["plain", "brief"])
def test_every_sentence_of_ordinary_names_is_read_back(names: list[str], keys: int) -> None:
    check_all(names, range(keys))


@pytest.mark.slow
@pytest.mark.parametrize("kind", mostly_slow(["avd", "coco", "semantic-abstraction"]))
def test_the_classes_of_known_datasets_are_read_back(kind: str) -> None:
    check_all(SETS[kind], range(11, 14))


@pytest.mark.slow
def test_the_classes_of_the_demo_are_read_back() -> None:
    demo = open_dataset(Path(__file__).resolve().parents[2] / "assets" / "demo")
    assert len(demo.class_names) > 20
    check_all(list(demo.class_names), range(3, 6))


@pytest.mark.slow
def test_the_classes_of_real_data_are_read_back(shared_data: Path) -> None:
    path = shared_data / "real" / "avd-format" / "instance_id_map.txt"
    listed = [line.split()[0] for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    assert set(AVD) <= set(listed)
    info = json.loads((shared_data / "real" / "ycbv-bop" / "models" / "models_info.json").read_text(encoding="utf-8"))
    ycb = [entry.get("name", f"obj_{int(number):06d}") for number, entry in info.items()]
    assert len(ycb) > 10
    check_all(listed, range(5, 7))
    check_all(ycb, range(5, 7))
    names = [p.stem for p in (shared_data / "real").iterdir()]
    check_all(names, range(2))


def sentences(target: str, relation: str, reference: str, key: int, style: str, names: tuple[str, ...]) -> list[str]:
    return [
        expression_text(target, relation, reference, key, style=style, class_names=names),
        question_text(relation, target, reference, key, class_names=names),
    ]


@given(
    st.data(), st.sampled_from(sorted(SETS)), st.sampled_from(PAIRWISE), st.integers(0, 2**64 - 1),
    st.sampled_from(STYLES), st.booleans(),
)  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_any_names_any_relation_any_key_is_read_back(
    data: st.DataObject, kind: str, relation: str, key: int, style: str, told: bool
) -> None:
    target, reference = data.draw(st.sampled_from(SETS[kind])), data.draw(st.sampled_from(SETS[kind]))
    assert can_be_worded(target)
    # Without the list of the dataset, the two names themselves are all that the sentence may count on.
    names = tuple(SETS[kind]) if told else (target, reference)
    try:
        texts = sentences(target, relation, reference, key, style, names if told else ())
    except InputError:
        if kind != "hostile":
            raise
        return
    for text in texts:
        check_read_back(text, target, relation, reference, names)


WORDS = st.sampled_from(
    _listed(
        "mug laptop left right of front in on top the a with and between near to by that is side door box from camera "
        "view not it other find show me where standing closest hold's stand image looking for above which supports",
        " ",
    )
)
NAMES = st.one_of(
    st.text(max_size=30),
    st.lists(WORDS, min_size=1, max_size=4).map(" ".join),
    st.tuples(st.lists(WORDS, min_size=1, max_size=3), st.sampled_from("_-/()'&,. ")).map(lambda p: p[1].join(p[0])),
)


@given(NAMES, NAMES, st.lists(NAMES, max_size=3), st.sampled_from(PAIRWISE), st.integers(0, 2**64 - 1))
@example("front of car", "car", [], "in", 0)
@example("mug", "car", ["front of car"], "front", 0)
@example("mug", "laptop", ["the"], "left", 3)
@example("the", "mug", [], "left", 3)
@example("mug", "image (framed)", [], "in", 3)
@example("other_other", "other_other", [], "left", 0)
@example("box (left)", "couch's left", [], "left", 0)
@example("000:000", "000%000", [], "left", 0)
@example("mug left", "laptop", ["mug"], "left", 0)
@settings(max_examples=62, deadline=None)
def test_any_text_as_a_name_is_read_back_or_refused(
    target: str, reference: str, others: list[str], relation: str, key: int
) -> None:
    for names in (tuple(dict.fromkeys((target, reference, *others))), ()):
        for style in STYLES:
            try:
                texts = sentences(target, relation, reference, key, style, names)
            except InputError:
                continue
            for text in texts:
                check_read_back(text, target, relation, reference, names or (target, reference))


@pytest.mark.parametrize("name", UNSAYABLE)
def test_what_no_sentence_can_carry_is_refused(name: str) -> None:
    assert not can_be_worded(name)
    for style in STYLES:
        with pytest.raises(InputError, match="cannot be said"):
            expression_text(name, "left", "mug", 1, style=style)
        with pytest.raises(InputError, match="cannot be said"):
            expression_text("mug", "left", name, 1, style=style)
    with pytest.raises(InputError, match="cannot be said"):
        question_text("left", "mug", name, 1)


def test_two_long_names_that_do_not_fit_together_are_refused() -> None:
    assert can_be_worded("x" * 200)
    with pytest.raises(InputError, match="no sentence"):
        expression_text("x" * 200, "left", "y" * 200, 3)
    text = expression_text("x" * 140, "left", "y" * 145, 19)
    assert len(text) <= 300
    check_read_back(text, "x" * 140, "left", "y" * 145, ("x" * 140, "y" * 145))


def test_only_names_that_need_them_stand_in_quotes() -> None:
    for key in range(40):
        for name in ("front door", "left shoe", "tv stand", "plant in a pot"):
            assert '"' not in expression_text(name, "left", "mug", key, class_names=(name, "mug"))
    assert expression_text("on", "left", "mug", 0, style="plain") == '"on" left of the mug'
    assert expression_text("mug", "in", "front of car", 0, style="plain") == "mug in the front of car"
    assert expression_text("mug", "left", "left shoe", 0) == "mug left of the left shoe"


def test_a_short_name_that_another_class_shares_is_said_in_full() -> None:
    assert expression_text("bat (animal)", "left", "mug", 0, style="plain") == "bat left of the mug"
    names = ("bat (animal)", "bat (sports)", "mug", "bookcase / shelf", "bookcase")
    text = expression_text("bat (animal)", "left", "mug", 0, style="plain", class_names=names)
    assert text == "bat (animal) left of the mug"
    assert "shelf" in expression_text("bookcase / shelf", "left", "mug", 0, style="plain", class_names=names)
    assert "shelf" not in expression_text("bookcase", "left", "mug", 0, style="plain", class_names=names)


def test_the_sentences_say_no_more_than_a_vocabulary_without_on_allows() -> None:
    for relation in DIRECTIONAL:
        for key in range(100):
            text = expression_text("mug", relation, "laptop", key)
            expression = expression_of(text, relations=VOCABULARIES["avd"])
            assert (expression.relation, expression.mapped_from) == (relation, None)


# ---- variety and determinism -------------------------------------------------------------------------------------


@pytest.mark.parametrize("relation", mostly_slow(PAIRWISE, fast=(0, 4, 8)))
@pytest.mark.parametrize("step", [1, 0x9E3779B97F4A7C15])
def test_shapes_are_many_and_evenly_used(relation: str, step: int) -> None:
    keys = [k * step % 2**64 for k in range(1000)]
    shapes = Counter(expression_text("mug", relation, "laptop", k).replace(PHRASE[relation], "R") for k in keys)
    assert len(shapes) >= 16
    frames = Counter(
        re.sub(r"(?<=mug ).*?(?=(?:the |a )?laptop)|(?<=mug that is ).*?(?=(?:the |a )?laptop)", "R ", t) for t in
        (expression_text("mug", relation, "laptop", k) for k in keys)
    )  # fmt: skip
    assert max(frames.values()) <= 0.25 * len(keys)
    exact = Counter(expression_text("mug", relation, "laptop", k) for k in keys)
    assert max(exact.values()) < 2.0 * len(keys) / len(exact)
    assert min(exact.values()) > 0.4 * len(keys) / len(exact)


@given(st.integers(0, 2**64 - 1), st.sampled_from(PAIRWISE))
def test_equal_input_gives_equal_text(key: int, relation: str) -> None:
    first = expression_text("front door", relation, "bookcase / shelf", key)
    assert first == expression_text("front door", relation, "bookcase / shelf", key)
    assert question_text(relation, "mug", "tv", key) == question_text(relation, "mug", "tv", key)


def test_plain_and_published_forms_are_fixed() -> None:
    for key in (0, 1, 12345678901234567890):
        assert expression_text("mug", "left", "Laptop", key, style="plain") == "mug left of the laptop"
        style = "semantic-abstraction"
        assert expression_text("mug", "left", "laptop", key, style=style) == "mug on the left of a laptop"
        assert expression_text("mug", "front", "arm_chair", key, style=style) == "mug in front of a arm chair"
        assert expression_text("mug", "below", "laptop", key, style=style) == "mug below a laptop"


# ---- English -----------------------------------------------------------------------------------------------------


def all_texts(target: str, relation: str, reference: str) -> set[str]:
    return {expression_text(target, relation, reference, k) for k in range(160)} | {
        question_text(relation, target, reference, k) for k in range(40)
    }


def test_examples_are_among_the_sentences() -> None:
    assert {
        "the mug to the left of the laptop", "mug left of laptop", "which mug is left of the laptop?",
        "the mug on the left side of a laptop", "a mug that is left of the laptop", "Is the mug left of the laptop?",
    } <= all_texts("mug", "left", "laptop")  # fmt: skip
    assert "find the mug in front of the laptop" in all_texts("mug", "front", "laptop")


@pytest.mark.parametrize("name", ["scissors", "sunglasses", "shelves", "people", "wine glasses", "trousers"])
def test_plurals_take_plural_verbs_and_no_a(name: str) -> None:
    for relation in PAIRWISE:
        ahead, after = all_texts(name, relation, "mug"), all_texts("mug", relation, name)
        assert not [t for t in ahead | after if re.search(rf"\ban? {name}", t)]
        assert not [t for t in ahead if re.search(r"\bis\b", t) and not t.startswith("Is it true")]
        assert not [t for t in after if re.search(r"\bare\b", t)]
    assert "the scissors that are left of the mug" in all_texts("scissors", "left", "mug")
    assert any(f"some {name}" in t for t in all_texts(name, "left", "mug"))


@pytest.mark.parametrize("name", ["rice", "honey", "bread", "mahatma_rice", "toilet paper"])
def test_mass_nouns_take_no_a_and_singular_verbs(name: str) -> None:
    texts = all_texts(name, "on", "mug") | all_texts("mug", "on", name)
    assert not [t for t in texts if re.search(rf"\ban? {readable(name)}", t) or re.search(r"\bare\b", t, re.I)]


def test_a_thing_beside_its_like_is_beside_another() -> None:
    """Not beside "the other" one: there may be more than two."""
    texts = all_texts("mug", "left", "mug")
    assert "the mug left of another mug" in texts
    assert "Is the mug left of another mug?" in texts
    assert not [t for t in texts if "the other" in t]
    assert not [t for t in texts if re.search(r" (?:the|a) mug\b.* (?:the|a) mug\b", t)]
    for text in texts:
        check_read_back(text, "mug", "left", "mug", ("mug",))


@given(
    st.sampled_from([*COCO, *AVD, *BRIEF]), st.sampled_from([*COCO, *AVD, *BRIEF]), st.sampled_from(PAIRWISE),
    st.integers(0, 2**64 - 1), st.sampled_from(("varied", "plain")), st.tuples(st.booleans(), st.booleans()),
)  # fmt: skip
@settings(max_examples=50, deadline=None)
def test_the_is_said_only_of_what_is_alone(
    target: str, reference: str, relation: str, key: int, style: str, several: tuple[bool, bool]
) -> None:
    if is_named(target, reference) or is_named(reference, target):
        several = (True, True)
    text = expression_text(target, relation, reference, key, style=style, several=several)
    check_read_back(text, target, relation, reference, (target, reference))
    for name, many in zip((target, reference), several, strict=True):
        phrase = noun_phrase(readable(name))
        if many:
            assert f"the {phrase.words}" not in text, text
        for article in {"a", "an"} - {phrase.article}:
            assert not re.search(rf"\b{article} {re.escape(phrase.words)}\b", text), text

    # The sentence is the same one, whatever its articles.
    def bare(said: str) -> str:
        return re.sub(r"\b(?:the|an?|some other|some|another) ", "", said)

    assert bare(text) == bare(expression_text(target, relation, reference, key, style=style))


def test_examples_of_several() -> None:
    def texts(*several: bool) -> set[str]:
        return {expression_text("mug", "left", "book", k, several=(several[0], several[1])) for k in range(160)}

    assert "the mug to the left of a book" in texts(False, True)
    assert "an apple left of the mug" in {
        expression_text("apple", "left", "mug", k, several=(True, False)) for k in range(160)
    }
    assert not [t for t in texts(True, True) if "the mug" in t or "the book" in t]
    assert {"a mug left of a book", "where is a mug left of a book?", "mug left of book"} <= texts(True, True)
    assert expression_text("mug", "left", "book", 0, style="plain", several=(False, True)) == "mug left of a book"
    shoes = {expression_text("mug", "near", "scissors", k, several=(False, True)) for k in range(160)}
    assert "the mug near some scissors" in shoes


@pytest.mark.parametrize(
    ("article", "names"),
    [
        ("an", "umbrella;LED lamp;led lamp;hourglass;honest man;heirloom;oven;MRI scanner;x-ray;X-ray machine;"
         "8 ball;11 keys;18 wheeler;80s poster;ATM;HDMI cable;hdmi cable;SUV;SD card;sd card;urn;usher;unopened box;"
         "umpire;iPod;AC unit;RC car;L-shaped sofa;F1 car;A4 sheet;LCD monitor;IKEA shelf;eraser;ottoman;mp3 player;"
         "éclair;M&M;N64;island;ultrasound probe;uninflated ball;utterance;onion;XL box;11000 piece puzzle"),
        ("a", "mug;TV;tv;USB cable;usb stick;unicorn;uniform;one-way sign;onesie;university book;European flag;euro;"
         "ukulele;urinal;utensil;user manual;UFO;ufo;NASA mug;LEGO brick;SIM card;ewer;eucalyptus;7up can;0 bottle;"
         "U-shaped pillow;T-shirt;t shirt;CD player;PC;hand;heron;xylophone;yo-yo;hot dog;Mr Potato Head;gym mat;"
         "100 dollar bill;1100 box;机;ouija board;hymnal"),
    ],
)  # fmt: skip
def test_articles_follow_the_sound(article: str, names: str) -> None:
    for name in names.split(";"):
        assert indefinite_article(name) == article, name


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("trash_can", "trash can"), ("Dining Table", "dining table"), ("bookcase / shelf", "bookcase"),
        ("aunt_jemima_original_syrup", "aunt jemima original syrup"), ("0 bottle", "0 bottle"), ("TV", "TV"),
        ("USB cable", "USB cable"), ("hot-dog", "hot dog"), ("T-shirt", "T-shirt"), ("one-way sign", "one-way sign"),
        ("CoffeeTable", "coffee table"), ("SOFA", "sofa"), ("TV_STAND", "TV stand"), ("iPod", "iPod"), ("HAT", "hat"),
        ("European flag", "European flag"), ("bat_(animal)", "bat"), ("Monitor/TV", "monitor"), ("TV/monitor", "TV"),
        ("CD/DVD player", "CD/DVD player"), ("24/7 sign", "24/7 sign"), ("w/o lid", "w/o lid"), ("the_door", "door"),
        ("  table\n lamp ", "table lamp"), ("obj_000012", "obj 000012"), ("CD_player", "CD player"), ("", ""),
    ],
)  # fmt: skip
def test_class_names_become_readable_words(name: str, words: str) -> None:
    assert readable(name) == words
    assert readable(words) == words


@given(st.text(max_size=40))
def test_readable_names_the_class_and_settles(name: str) -> None:
    whole = readable(name, brief=False)
    assert whole == " ".join(whole.split())
    phrase = noun_phrase(whole)
    assert phrase.article in ("a", "an")
    assert not (phrase.plural and phrase.mass)
    if normal_form(name).isascii() and re.fullmatch(r"[\w -]*", name):
        assert normal_form(whole) == normal_form(name)


@pytest.mark.parametrize(
    ("name", "plural"),
    [
        ("bus", False), ("lens", False), ("canvas", False), ("thermos", False), ("chess board", False),
        ("glass", False),
        ("pair of scissors", False), ("box of tissues", False), ("books on shelf", True), ("wine glasses", True),
        ("policemen", True), ("mice", True), ("stairs", True), ("tennis", False), ("compass", False), ("shelf", False),
        ("hibiscus", False), ("bat (animals)", False), ('"left shoes"', True), ("dress", False),
    ],
)  # fmt: skip
def test_number(name: str, plural: bool) -> None:
    assert noun_phrase(name).plural is plural
    assert noun_phrase(name).verb == ("are" if plural else "is")


@pytest.mark.parametrize("key", [-1, 2**64, 1.5, "3", None])
def test_bad_keys_are_refused(key: object) -> None:
    with pytest.raises(InputError, match="key"):
        expression_text("mug", "left", "tv", key)  # type: ignore[arg-type]


def test_other_bad_arguments_are_refused() -> None:
    for bad in (
        lambda: expression_text("mug", "between", "tv", 0),
        lambda: expression_text("mug", "left of", "tv", 0),
        lambda: question_text("", "mug", "tv", 0),
        lambda: expression_text("mug", "left", "tv", 0, style="fancy"),
        lambda: expression_text(None, "left", "tv", 0),  # type: ignore[arg-type]
    ):
        with pytest.raises(InputError):
            bad()
    assert not can_be_worded(None)  # type: ignore[arg-type]
