"""Sentences with people's words about rendered rooms, and people's sentences about frames with annotations.

The words are those of SUN-Spot (as SUNSPOT_3D.pkl of UncleMEDM/Refer-it-in-RGBD has them) and of the SPARE corpus,
which lie in the folder of test data; `people_sentences.tsv` says of each by its line which words name things, and, in
words that the grammar reads, what it means, as written down by hand. Names of things are replaced by names of things
of the room, as people call them (NAMES; a word for several classes, `table`, means all of them), in a tenth of the
sentences one with a letter lost, added, changed or swapped, or a space. What is true follows from the exact 3D boxes,
the picture's order and the meaning (not from how the sentence is read) by the logic of three values in which labels are
made: sentences are taken where it is beyond doubt of every thing. `on` and `in` are those of the rooms' clean masks.

Every second line and every second name are for setting weights, the others are held out.
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.objects import PreparedFrame, all_objects
from pipeline.labels.labelling import label_objects
from pipeline.labels.plan import LabelConfig
from pipeline.labels.tree_truth import TreeTruth
from pipeline.language.expression import parse
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.relations.pair_measures import AllMeasures, F, Profile, T, U, measure_pairs
from pipeline.relations.relations import PREDICATES, pair_states

LANGUAGE = Path(os.environ.get("SPATIALVIZ_SHARED", "../shared")) / "data" / "language"
LINES = Path(__file__).with_name("people_sentences.tsv")
MISSPELT = 0.1
TRIES = 40
"""Choices of names that are tried for a sentence and a frame."""
EXACT = tuple(r for r in PAIRWISE if not PREDICATES[r].reads_points)
TABLES, CHAIRS = ("desk", "dining table", "coffee table"), ("chair", "office chair", "armchair")
SHELVES = ("shelf", "bookshelf")
NAMES: dict[str, tuple[str, ...]] = {
    "desk": ("desk", "writing desk", "table", "computer desk"),
    "dining table": ("dining table", "table", "dinner table", "table"),
    "coffee table": ("coffee table", "table", "low table", "table"),
    "chair": ("chair", "chair", "dining chair", "chair"),
    "office chair": ("office chair", "desk chair", "computer chair", "chair"),
    "armchair": ("armchair", "arm chair", "easy chair", "chair"),
    "sofa": ("sofa", "couch", "couch", "sofa"),
    "stool": ("stool", "stool"),
    "bed": ("bed", "bed"),
    "nightstand": ("nightstand", "night stand", "bedside table", "night table"),
    "wardrobe": ("wardrobe", "closet", "armoire", "wardrobe"),
    "cabinet": ("cabinet", "sideboard", "cupboard", "cabinet"),
    "bookshelf": ("bookshelf", "bookcase", "book shelf", "book case"),
    "shelf": ("wall shelf", "shelf"),
    "potted plant": ("plant", "potted plant", "house plant", "plant"),
    "laptop": ("laptop", "computer", "laptop computer", "laptop"),
    "tv": ("tv", "television", "tv", "tv set"),
    "mouse": ("mouse", "computer mouse"),
    "mug": ("mug", "cup", "coffee mug", "coffee cup"),
    "bottle": ("bottle", "bottle"),
    "bowl": ("bowl", "fruit bowl"),
    "plate": ("plate", "dish", "dinner plate", "plate"),
    "teapot": ("teapot", "tea pot", "kettle", "teapot"),
    "vase": ("vase", "flower vase"),
    "candle": ("candle", "candle"),
    "lamp": ("lamp", "table lamp", "light", "lamp"),
    "clock": ("clock", "wall clock"),
    "picture": ("picture", "painting", "picture frame", "photo"),
    "book": ("book", "book"),
    "box": ("box", "cardboard box"),
    "basket": ("basket", "laundry basket", "wicker basket", "hamper"),
    "trash can": ("trash can", "garbage can", "trash bin", "waste basket"),
    "backpack": ("backpack", "bag", "back pack", "rucksack"),
    "pillow": ("pillow", "cushion"),
    "rug": ("rug", "carpet", "mat", "rug"),
    "ball": ("ball", "ball"),
    "teddy bear": ("teddy bear", "bear", "stuffed animal", "teddy"),
}
"""What people call the things of the rooms; those at even places are for setting weights."""
MEANT = {"table": TABLES, "chair": CHAIRS, "shelf": SHELVES}
"""Classes that a word may mean, where they are several."""
SWAPS = (
    ("left", "right"),
    ("in front of", "behind"),
    ("above", "below"),
    ("over", "under"),
    ("on top of", "underneath"),
    ("closest", "farthest"),
    ("nearest", "farthest"),
    ("taller", "shorter"),
    ("bigger", "smaller"),
    ("top", "bottom"),
    ("upper", "lower"),
)
_SAME = {"over": "above", "under": "below", "underneath": "below", "nearest": "closest", "furthest": "farthest"}
_NO_SIDE = re.compile(r"right (?=next|behind|in front|above|below|beside|under|over)")


@dataclass(frozen=True)
class Made:
    """A sentence about a frame.

    `named` (N,) bool: what its first name may mean. `right` (K,) int64: what it means. `opposite`: the sentence with an
    opposite word, of which the right thing is not true; None where there is none. `misspelt` tells a misspelt name.
    """

    text: str
    named: np.ndarray
    right: np.ndarray
    opposite: str | None
    misspelt: bool = False


@dataclass(frozen=True)
class Words:
    """A sentence of a person, with the places of its names."""

    pieces: tuple[str, ...]
    """Text and letters of slots, in turn."""
    meaning: str

    def filled(self, names: dict[str, str]) -> str:
        return "".join(names.get(piece, piece) for piece in self.pieces)


@cache
def people(part: int) -> tuple[Words, ...]:
    """Sentences of a part: 0 for setting weights, 1 held out."""
    found = []
    with LINES.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file, delimiter="\t"))
    for source, line, slots, meaning in rows[part::2]:
        text = json.loads(_lines(source)[int(line)])["sentence"]
        slot_of = dict(slot.split("=") for slot in slots.split("; "))
        pattern = "|".join(re.escape(name) for name in sorted(slot_of, key=len, reverse=True))
        pieces = re.split(rf"\b({pattern})\b", text)
        assert {*slot_of} <= {*pieces}, (source, line, slots)
        found.append(Words(tuple(slot_of.get(piece, piece) for piece in pieces), meaning))
    return tuple(found)


@cache
def _lines(source: str) -> list[str]:
    return (LANGUAGE / f"{source}.jsonl").read_text(encoding="utf-8").splitlines()


def opposite(text: str, rng: np.random.Generator) -> tuple[str, tuple[str, str]] | None:
    """Text with one word for a side or an order turned, and which ones; None where it has none."""
    shown = _NO_SIDE.sub(lambda m: "_" * len(m[0]), text.lower()).replace("furthest", "farthest")
    places = [
        (m, a, b) for pair in SWAPS for a, b in (pair, pair[::-1]) for m in re.finditer(rf"\b{a}(?=\b|most)", shown)
    ]
    if not places or len(shown) != len(text):
        return None
    m, a, b = places[int(rng.integers(len(places)))]
    return _with_preposition(text[: m.start()] + (b.upper() if text.isupper() else b) + text[m.end() :]), (a, b)


def turned(meaning: str, pair: tuple[str, str]) -> str | None:
    """Meaning with that word turned; None where it is not there just once."""
    a, b = (_SAME.get(word, word) for word in pair)
    said, once = re.sub(r"\b(under|over|nearest)\b", lambda m: _SAME[m[0]], meaning), rf"\b{a}(?=\b|most)"
    return _with_preposition(re.sub(once, b, said)) if len(re.findall(once, said)) == 1 else None


def _with_preposition(text: str) -> str:
    text = re.sub(r"\b(closest|nearest) from\b", r"\1 to", text, flags=re.IGNORECASE)
    return re.sub(r"\bfarthest to\b", "farthest from", text, flags=re.IGNORECASE)


def misspelt(name: str, rng: np.random.Generator) -> str:
    """Name with a letter lost, added, changed or swapped, not the first; or with a space lost or added."""
    k, way = (
        int(rng.integers(1, max(len(name) - 1, 2))),
        str(rng.choice(["lost", "added", "changed", "swapped", "space"])),
    )
    letter = "abcdefghijklmnopqrstuvwxyz"[int(rng.integers(26))]
    if way == "space":
        return name.replace(" ", "") if " " in name else name[:k] + " " + name[k:]
    if way == "swapped":
        return name[:k] + name[k : k + 2][::-1] + name[k + 2 :]
    return name[:k] + {"lost": "", "added": name[k] * 2, "changed": letter}[way] + name[k + 1 :]


class RoomTruth(TreeTruth):
    """What is true of a rendered room by its exact boxes; a name means what MEANT and NAMES say."""

    def __init__(self, context: PreparedFrame) -> None:
        boxes = {a.index: a.box for a in context.frame.annotations}
        objects = all_objects(context, AnnotationDetector())
        found = label_objects(context, objects, LabelConfig(vocabulary="all"), frame_index=0, scene="", exact=True)
        assert found.judged is not None
        states = found.judged.states.copy()
        corners = [boxes[o.id].corners @ context.viewer.matrix.T for o in objects]  # pyright: ignore[reportOptionalMemberAccess]
        lo, hi = (np.array([f(c, axis=0) for c in corners]) for f in (np.min, np.max))
        exact = pair_states(AllMeasures(measure_pairs(lo, hi, Profile()), Profile()), np.ones(len(lo), np.bool_), EXACT)
        states[..., [PAIRWISE.index(r) for r in EXACT]] = exact
        whole = [replace(o, lifted=replace(o.lifted, lo=a, hi=b)) for o, a, b in zip(objects, lo, hi, strict=True)]
        super().__init__(context, whole, states, [True] * len(whole), [0.0] * len(whole))

    def _named(self, name: str) -> np.ndarray:
        meant = next((MEANT.get(name, (one,)) for one, names in NAMES.items() if name in (one, *names)), (name,))
        return np.where(np.isin([o.label for o in self.objects], meant), T, F).astype(np.int8)

    def of(self, meaning: str, names: dict[str, str]) -> np.ndarray:
        """(N,) int8: states under a meaning with these names."""
        text = re.sub(r"\b[A-D]\b", lambda m: names[m[0]], meaning)
        query = parse(text, class_names=tuple(dict.fromkeys(names.values())))
        assert not query.unused, text
        return self.means(query.default.root)

    def called(self, name: str) -> np.ndarray:
        return self._named(name) == T


def people_sentences(context: PreparedFrame, rng: np.random.Generator, part: int) -> Iterator[Made]:
    """Sentences of a part about a frame in a random order, each at most once, and nothing in them too close to call."""
    truth = RoomTruth(context)
    here = sorted({o.label for o in truth.objects})
    words = people(part)
    for at in rng.permutation(len(words)):
        one = words[at]
        slots = sorted({piece for piece in one.pieces if len(piece) == 1 and piece in "ABCD"})
        for attempt in range(TRIES):
            if len(here) < len(slots):
                break
            chosen = rng.choice(here, len(slots), replace=False).tolist()
            names = {s: str(rng.choice(NAMES[c][part::2])) for s, c in zip(slots, chosen, strict=True)}
            if len({*names.values()}) < len(slots):
                continue
            state = truth.of(one.meaning, names)
            right, named = np.flatnonzero(state == T), truth.called(names["A"])
            # People say more than a name where there are several things of it: those are looked for first.
            if (state == U).any() or not len(right) or (named.sum() < 2 and attempt < TRIES * 2 / 3):
                continue
            said, bad = dict(names), rng.random() < MISSPELT
            if bad:
                slot = str(rng.choice(slots))
                said[slot] = misspelt(names[slot], rng)
            upper = one.filled({}).isupper()
            text = one.filled({k: v.upper() if upper else v for k, v in said.items()})
            yield Made(text, named, right, _false_opposite(text, one, names, truth, right, rng), bad)
            break


def _false_opposite(
    text: str, one: Words, names: dict[str, str], truth: RoomTruth, right: np.ndarray, rng: np.random.Generator
) -> str | None:
    found = opposite(text, rng)
    meaning = None if found is None else turned(one.meaning, found[1])
    if found is None or meaning is None or (truth.of(meaning, names)[right] != F).any():
        return None
    return found[0]


def referring(name: str, part: int) -> list[dict[str, Any]]:
    """Sentences of a part that people wrote about a dataset, with what they mean."""
    lines = [json.loads(line) for line in _lines("referring")][part::2]
    return [line for line in lines if line["dataset"] == name]
