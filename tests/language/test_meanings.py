"""Which known names a query may stand for: tiers, scores, kinds, brands, compounds, misspelt words."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.language import Meaning, match, meanings, normal_form
from pipeline.language.name_files import NameFile
from pipeline.language.name_forms import key_of
from pipeline.language.name_table import NAMES, Synonyms, default_synonyms
from pipeline.language.naming import GENERIC, is_compound, spelt
from pipeline.proposals.class_names import synonyms_hash
from tests.language.test_naming import COCO

_YCB = (
    "master chef can|cracker box|sugar box|tomato soup can|mustard bottle|tuna fish can|pudding box|gelatin box"
    "|potted meat can|banana|pitcher base|bleach cleanser|bowl|mug|power drill|wood block|scissors|large marker"
    "|large clamp|extra large clamp|foam brick"
)
YCB = _YCB.split("|")
FILES = sorted(NAMES.glob("*.json"))


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("cup", "mug"),
        ("coffee mug", "mug"),
        ("jello box", "gelatin box"),
        ("jello", "gelatin box"),
        ("domino sugar box", "sugar box"),
        ("sugar", "sugar box"),
        ("mustard", "mustard bottle"),
        ("drill", "power drill"),
        ("french's", "mustard bottle"),
        ("bottle of mustard", "mustard bottle"),
        ("mustard container", "mustard bottle"),
        ("spam", "potted meat can"),
        ("spam can", "potted meat can"),
        ("the pudding", "pudding box"),
        ("jello pudding", "pudding box"),
        ("cheez-it box", "cracker box"),
        ("crackers", "cracker box"),
        ("coffee can", "master chef can"),
        ("coffee", "master chef can"),
        ("block of wood", "wood block"),
        ("wooden block", "wood block"),
        ("red foam block", "foam brick"),
        ("tuna", "tuna fish can"),
        ("fruit", "banana"),
        ("soup", "tomato soup can"),
        ("pitcher", "pitcher base"),
        ("soup tin", "tomato soup can"),
        ("marker pen", "large marker"),
        ("pair of scissors", "scissors"),
        ("bleach", "bleach cleanser"),
    ],
)
def test_objects_of_ycb_as_people_call_them(query: str, found: str) -> None:
    assert match(query, YCB) == (found,)


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("mug", "cup"),
        ("coffee mug", "cup"),
        ("pint glass", "cup"),
        ("armchair", "chair"),
        ("monitor", "tv"),
        ("pickup truck", "truck"),
        ("coffee table", "dining table"),
        ("kitchen table", "dining table"),
        ("lady", "person"),
        ("wooden chair", "chair"),
        ("wall clock", "clock"),
        ("fruit bowl", "bowl"),
    ],
)
def test_the_nearest_name_of_a_fixed_vocabulary(query: str, found: str) -> None:
    assert match(query, COCO) == (found,)


def test_a_general_word_finds_all_its_kinds() -> None:
    assert match("furniture", COCO) == ("bench", "chair", "couch", "bed", "dining table")
    assert match("box", YCB) == ("cracker box", "sugar box", "pudding box", "gelatin box")
    assert match("furniture", ["leather office chair", "table lamp"]) == ("leather office chair",)


def test_words_before_the_head_may_go_and_never_the_head() -> None:
    assert match("wall clock", ["clock", "wall"]) == ("clock",)
    assert match("laundry basket", ["basket", "laundry"]) == ("basket",)
    assert match("table lamp", ["table"]) == ()
    assert match("mustard", ["mustard table"]) == ()
    assert match("cheese box", YCB) == (), "what is inside decides"
    assert match("teddy bear", ["bear"]) == match("trash can", ["can"]) == match("hot dog", ["dog"]) == ()


def test_a_worse_tier_counts_only_where_no_better_one_has_a_name() -> None:
    names = ["stool", "armchair", "office chair", "chair"]
    assert match("chair", names) == ("chair",)
    assert match("chair", names[:3]) == ("armchair", "office chair")
    found = meanings("chair", names)
    assert found[0] == Meaning("chair", 1.0, "exact", "")
    assert [m.name for m in found] == ["chair", "armchair", "office chair", "stool"]
    assert [m.score for m in found] == sorted((m.score for m in found), reverse=True)
    assert meanings("couch", ["sofa"]) == (Meaning("sofa", 0.9, "synonym", "sofa"),)


def test_a_misspelt_word_is_a_guess_of_meanings_and_not_of_match() -> None:
    assert meanings("mustart bottle", YCB)[0] == Meaning("mustard bottle", 0.85, "spelling", "mustard bottle")
    assert match("mustart", YCB) == match("chiar", COCO) == ()
    assert meanings("keybaord", COCO)[0].name == "keyboard"
    assert meanings("bowk", YCB) == (), "short words are words of their own"
    assert not any(m.how == "spelling" for m in meanings("house", ["horse", "mouse"])), "so are known ones"


def test_a_misspelt_word_of_a_known_name_is_mended_before_it_is_left_out() -> None:
    assert spelt("puding box", YCB) == "pudding box", "and not any box"
    assert meanings("puding box", YCB)[0].name == "pudding box"
    found = meanings("deskk lamp", ["lamp", "candle"])[0]
    assert (found.name, found.how, found.left) == ("lamp", "spelling", ()), "a lamp of which nothing was left out"
    assert spelt("fruit bwol", ["bowl"]) == "fruit bowl"
    assert meanings("zorb lamp", ["lamp"])[0].left == (0,), "what nobody knows is told"


def test_what_a_package_holds_may_stand_behind_it() -> None:
    assert [m.name for m in meanings("tin of meat", YCB)] == ["potted meat can"]
    assert meanings("tin of paint", YCB) == ()


@given(st.lists(st.sampled_from([*COCO, *YCB])), st.one_of(st.text(max_size=30), st.sampled_from(sorted(GENERIC))))
def test_meanings_are_known_names_once_each_best_first(names: list[str], query: str) -> None:
    found = meanings(query, names)
    assert len({m.name for m in found}) == len(found)
    assert {m.name for m in found} <= set(names)
    assert all(0 < m.score <= 1 and (m.via == "") == (m.how == "exact") for m in found)
    assert set(match(query, names)) <= {m.name for m in found}


@pytest.mark.parametrize("file", FILES, ids=lambda p: p.stem)
def test_the_files_of_names_are_sound(file: Path) -> None:
    table = json.loads(file.read_text(encoding="utf-8"))
    assert all(table[key] for key in ("about", "source", "licence"))
    read = NameFile.model_validate(table)
    kinds = [name for general, names in read.kinds.items() for name in (general, *names)]
    listed = [n for group in (*read.groups, *read.near, read.exceptions, read.names) for n in group]
    assert [n for n in (*kinds, *listed) if normal_form(n) != n] == []
    spelled = [frozenset(map(key_of, group)) for group in read.groups]
    assert all(len(group) > 1 for group in spelled)
    assert len(set(spelled)) == len(spelled)


def test_nothing_is_a_kind_of_itself() -> None:
    table = default_synonyms()
    rings = []
    for name in sorted(table.names):
        above, level = set[str](), {name}
        while level:
            level = {g for one in level for g in table.general(one)} - above
            above |= level
        rings += [name] * (name in above)
    assert rings == []


def test_known_words_and_compounds() -> None:
    assert {"mug", "sofa", "whiteboard", "jello"} <= default_synonyms().words
    assert all(map(is_compound, [("front", "door"), ("white", "board"), ("parking", "meter"), ("Wall", "clocks")]))
    assert not any(map(is_compound, [("red", "mug"), ("mug",), (), ("chair", "table")]))


def test_a_users_file_may_say_kinds_and_near_names(tmp_path: Path) -> None:
    extra = tmp_path / "mine.json"
    extra.write_text(json.dumps({"kinds": {"Vessels": ["blorb"]}, "near": [["blorb", "flarp"]]}))
    mine = Synonyms.load(extra)
    assert match("vessel", ["the Blorb"], mine) == ("the Blorb",)
    assert match("blorb", ["flarp"], mine) == ("flarp",)
    assert match("blorb", ["flarp"]) == ()
    assert len({synonyms_hash(t) for t in (mine, None, Synonyms(mine.groups, mine.exceptions, mine.kinds))}) == 3


def test_matching_among_many_names_is_quick(shared_data: Path) -> None:
    names = [str(n) for n in np.load(shared_data / "vectors" / "clip_vitb32_object_names.npz")["names"]][:1200]
    queries = ["mug", "jello box", "furniture", "kichen table", "zzz zzz", "desk chair", "thing"]
    match("cup", names)
    start = time.perf_counter()
    for query in queries:
        meanings(query, names)
    assert (time.perf_counter() - start) / len(queries) < 0.05, "5 ms on a quiet machine"
