"""Class names: one spelling, synonyms, kinds, and the user's own table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.language import Synonyms, match, normal_form, same_class, suggest
from pipeline.language.naming import singular
from pipeline.system import InputError

_COCO = (
    "person|bicycle|car|motorcycle|airplane|bus|train|truck|boat|traffic light|fire hydrant|stop sign|parking meter"
    "|bench|bird|cat|dog|horse|sheep|cow|elephant|bear|zebra|giraffe|backpack|umbrella|handbag|tie|suitcase|frisbee"
    "|skis|snowboard|sports ball|kite|baseball bat|baseball glove|skateboard|surfboard|tennis racket|bottle"
    "|wine glass|cup|fork|knife|spoon|bowl|banana|apple|sandwich|orange|broccoli|carrot|hot dog|pizza|donut|cake"
    "|chair|couch|potted plant|bed|dining table|toilet|tv|laptop|mouse|remote|keyboard|cell phone|microwave|oven"
    "|toaster|sink|refrigerator|book|clock|vase|scissors|teddy bear|hair drier|toothbrush"
)
COCO = _COCO.split("|")

SEMANTIC_ABSTRACTION = [
    ("television", "tv"),
    ("sofa", "couch"),
    ("house plant", "plant in a pot"),
    ("bookcase", "bookshelf"),
    ("baseball bat", "rawlings big stick maple bat"),
    ("pillow", "cushion"),
    ("arm chair", "recliner"),
    ("bread", "loaf of sourdough"),
    ("cell phone", "mobile phone"),
    ("desktop", "computer"),
    ("dresser", "wardrobe"),
    ("dumbbell", "gym weights"),
    ("fridge", "refridgerator"),
    ("garbage can", "trash can"),
    ("laptop", "computer"),
    ("outlet", "eletric plug"),
    ("stairs", "staircase"),
]


@pytest.mark.parametrize(
    ("plural", "one"),
    [
        ("mugs", "mug"),
        ("boxes", "box"),
        ("dishes", "dish"),
        ("couches", "couch"),
        ("shelves", "shelf"),
        ("bookshelves", "bookshelf"),
        ("knives", "knife"),
        ("leaves", "leaf"),
        ("loaves", "loaf"),
        ("mice", "mouse"),
        ("glasses", "glasses"),
        ("scissors", "scissors"),
        ("bus", "bus"),
        ("buses", "bus"),
        ("chess", "chess"),
        ("canvas", "canvas"),
        ("canvases", "canvas"),
        ("tennis", "tennis"),
        ("series", "series"),
        ("vases", "vase"),
        ("houses", "house"),
        ("gloves", "glove"),
        ("olives", "olive"),
        ("sleeves", "sleeve"),
        ("stoves", "stove"),
        ("cookies", "cookie"),
        ("berries", "berry"),
        ("neckties", "necktie"),
        ("tomatoes", "tomato"),
        ("shoes", "shoe"),
        ("potatoes", "potato"),
        ("pianos", "piano"),
        ("lens", "lens"),
        ("lenses", "lens"),
        ("people", "person"),
        ("children", "child"),
        ("policemen", "policeman"),
        ("specimen", "specimen"),
        ("glass", "glass"),
        ("dresses", "dress"),
        ("mattresses", "mattress"),
        ("compass", "compass"),
        ("tvs", "tv"),
        ("skis", "ski"),
        ("menus", "menu"),
        ("cactus", "cactus"),
        ("gas", "gas"),
        ("pizzas", "pizza"),
        ("benches", "bench"),
        ("suitcases", "suitcase"),
        ("feet", "foot"),
        ("sofas", "sofa"),
    ],
)
def test_singular(plural: str, one: str) -> None:
    assert singular(plural) == one
    assert singular(one) == one


@pytest.mark.parametrize(
    ("written", "normal"),
    [
        ("The Red_Cup", "red cup"),
        ("paper-plate", "paper plate"),
        ("  trash   CANS ", "trash can"),
        ("boxes_of_tissues", "box of tissues"),
        ("GarbageCan", "garbage can"),
        ("TVStand", "tv stand"),
        ("iPod", "ipod"),
        ("CDs", "cd"),
        ("wine glasses", "wine glass"),
        ("reading glasses", "reading glasses"),
        ("bat_(animal)", "bat (animal)"),
        ("obj_000012", "obj 000012"),
        ("a", "a"),
        ("the", "the"),
        ("", ""),
        ("my sister's mug", "sister's mug"),
        ("ｔａｂｌｅ", "table"),
    ],
)
def test_normal_form(written: str, normal: str) -> None:
    assert normal_form(written) == normal


@given(st.text(max_size=40))
def test_normal_form_is_stable_and_never_fails(text: str) -> None:
    once = normal_form(text)
    assert once == once.strip()
    assert normal_form(once.upper()) == normal_form(once) or not once.isascii()
    assert same_class(text, text)


@given(st.sampled_from(COCO), st.sampled_from(["the ", "a ", "", "my "]), st.sampled_from(" _-"), st.booleans())
def test_article_case_and_separator_do_not_matter(name: str, article: str, gap: str, loud: bool) -> None:
    written = (article + name).replace(" ", gap)
    written = written.upper() if loud else written
    assert same_class(written, name)
    assert match(written, COCO)[0] == name


@pytest.mark.slow
def test_normal_form_of_real_names_is_a_fixed_point(shared_data: Path) -> None:
    names = np.load(shared_data / "vectors" / "clip_vitb32_object_names.npz")["names"]
    assert len(names) > 1000
    for name in map(str, names):
        assert normal_form(normal_form(name)) == normal_form(name)
        assert match(name, [str(n) for n in names[:40]] + [name])[:1] != ()


def test_coco_names_stay_apart() -> None:
    for name in COCO:
        assert match(name, COCO) == (name,)
        assert match(name, [n for n in COCO if n != name]) == (), name


@pytest.mark.parametrize(("a", "b"), SEMANTIC_ABSTRACTION)
def test_semantic_abstraction_synonyms(a: str, b: str) -> None:
    assert same_class(a, b)
    assert same_class(b.upper(), f"the {a}")
    assert match(a, [b, "zebra"]) == (b,)


@pytest.mark.parametrize(
    ("query", "coco"),
    [
        ("sofa", "couch"),
        ("television", "tv"),
        ("fridge", "refrigerator"),
        ("remote control", "remote"),
        ("mobile phone", "cell phone"),
        ("phone", "cell phone"),
        ("house plant", "potted plant"),
        ("plant", "potted plant"),
        ("table", "dining table"),
        ("tables", "dining table"),
        ("ball", "sports ball"),
        ("glass", "wine glass"),
        ("light", "traffic light"),
        ("bike", "bicycle"),
        ("mice", "mouse"),
        ("doughnut", "donut"),
        ("hair dryer", "hair drier"),
        ("knives", "knife"),
        ("people", "person"),
        ("purse", "handbag"),
        ("ski", "skis"),
        ("wineglass", "wine glass"),
    ],
)
def test_coco_is_found_by_other_words(query: str, coco: str) -> None:
    assert match(query, COCO) == (coco,)


@pytest.mark.parametrize("query", ["glasses", "can", "lamp", "top", "stop", "dining", "zzz", "", "the"])
def test_coco_has_no_such_class(query: str) -> None:
    assert match(query, COCO) == ()


def test_bin_is_a_trash_can_in_every_spelling() -> None:
    names = ["bin", "trash can", "garbage can", "trashcan", "waste basket", "TrashCan", "garbage_can", "wastebasket"]
    for a in names:
        assert set(match(a, names)) == set(names)
        for b in names:
            assert same_class(a, b)
    assert not same_class("bin", "can")


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ("cup", "mug"),
        ("tv", "monitor"),
        ("desktop", "laptop"),
        ("box", "cracker box"),
        ("glass", "glasses"),
        ("table", "dining table"),
        ("dog", "hot dog"),
        ("chair", "couch"),
        ("can", "trash can"),
    ],
)
def test_these_are_not_the_same_class(a: str, b: str) -> None:
    assert not same_class(a, b)


def test_a_general_name_matches_its_kinds_only() -> None:
    names = ["cracker box", "sugar box", "master chef can", "trash can", "table lamp", "dining table", "coffee_table"]
    assert match("box", names) == ("cracker box", "sugar box")
    assert match("can", names) == ("master chef can",)
    assert match("table", names) == ("dining table", "coffee_table")
    assert match("chef can", names) == ("master chef can",)
    assert match("lamp", names) == ("table lamp",)
    assert match("dog", ["hot dog", "teddy bear"]) == match("bear", ["hot dog", "teddy bear"]) == ()
    assert match("box", ["box of tissues", "boxing glove"]) == ("box of tissues",)


def test_exact_and_synonym_win_over_kinds() -> None:
    assert match("cup", ["red cup", "cup", "paper cup"]) == ("cup",)
    assert match("sofa", ["leather sofa", "couch"]) == ("couch",)
    assert match("couch", ["sofa", "couch", "leather couch"]) == ("couch", "sofa")
    assert match("cup", ["red_cup"]) == ("red_cup",)


def test_qualified_and_double_names() -> None:
    assert match("bus", ["bus_(vehicle)", "school bus"]) == ("bus_(vehicle)",)
    assert match("TV", ["Monitor/TV"]) == ("Monitor/TV",)
    assert match("mug", ["cup or mug"]) == ("cup or mug",)
    assert match("bow (weapon)", ["bow_(weapon)", "bow_(decorative_ribbons)"]) == ("bow_(weapon)",)


@given(st.lists(st.sampled_from(COCO)), st.text(max_size=20))
def test_match_and_suggest_answer_with_known_names(names: list[str], query: str) -> None:
    found = match(query, names)
    assert set(found) <= set(names)
    assert len(set(found)) == len(found)
    near = suggest(query, names)
    assert set(near) <= set(names)
    assert len(near) <= 3


def test_suggestions() -> None:
    assert suggest("mgu", ["laptop", "mug", "zebra"]) == ("mug",)
    assert suggest("red mug", ["laptop", "mug"])[0] == "mug"
    assert suggest("table lamp", COCO, n=1) == ("dining table",)
    assert suggest("xyzzy", COCO) == ()
    assert len(suggest("tennis ball", COCO, n=1)) == 1


def test_a_user_extends_the_table(tmp_path: Path) -> None:
    extra = tmp_path / "mine.json"
    extra.write_text(json.dumps({"groups": [["bin", "Abfalleimer"], ["foo", "bar"]], "exceptions": ["mega box"]}))
    mine = Synonyms.load(extra)
    assert same_class("abfalleimer", "garbage can", mine)
    assert not same_class("abfalleimer", "garbage can")
    assert same_class("foo", "the bars", mine)
    assert match("box", ["mega box", "small box"], mine) == ("small box",)
    assert match("abfalleimer", ["TrashCan"], mine) == ("TrashCan",)
    assert "abfalleimer" in mine.of("bin")


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "{",
        '{"groups": 3}',
        '{"groups": [3]}',
        '{"groups": [["one"]]}',
        '{"groups": [["a", 1]]}',
        '{"synonyms": []}',
        '{"exceptions": "hot dog"}',
        '{"groups": [["a", ""]]}',
        "[" * 100_000,
    ],
)
def test_a_broken_table_is_refused_with_its_path(tmp_path: Path, content: str) -> None:
    path = tmp_path / "mine.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"mine\.json"):
        Synonyms.load(path)


def test_a_missing_or_binary_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        Synonyms.load(tmp_path / "nowhere.json")
    (tmp_path / "b.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"b\.json"):
        Synonyms.load(tmp_path / "b.json")
