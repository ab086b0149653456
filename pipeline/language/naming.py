"""What class names mean: one normal form for spellings, a table of synonyms, and which names answer a query."""

from __future__ import annotations

import difflib
import json
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from pipeline.system.errors import InputError

TABLE = Path(__file__).with_name("synonyms.json")


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


DETERMINERS = _words("the a an this that these those my your our their its his her some any")

_UNCHANGED = _words(
    "bus gas glasses sunglasses eyeglasses goggles scissors pants trousers jeans shorts tights pliers tweezers tongs "
    "binoculars clothes stairs news series species headquarters chassis canvas atlas christmas tennis chess lens "
    "iris rhinoceros brassiere molasses thermos cosmos asbestos alias bias pancreas forceps pyjamas adidas citrus"
)
_IRREGULAR = {
    "mice": "mouse", "men": "man", "women": "woman", "people": "person", "children": "child", "feet": "foot",
    "teeth": "tooth", "geese": "goose", "oxen": "ox", "cacti": "cactus", "fungi": "fungus", "dice": "die",
    "buses": "bus", "gases": "gas", "lenses": "lens", "canvases": "canvas", "irises": "iris", "atlases": "atlas",
    "octopuses": "octopus", "cactuses": "cactus", "axes": "axe", "caches": "cache", "quizzes": "quiz",
    "headaches": "headache", "campuses": "campus", "walruses": "walrus", "viruses": "virus",
}  # fmt: skip
_VES = {"kni": "knife", "lea": "leaf", "shel": "shelf", "loa": "loaf", "hal": "half", "cal": "calf",
        "scar": "scarf", "hoo": "hoof", "wi": "wife", "li": "life", "thie": "thief", "wol": "wolf", "sel": "self",
        "el": "elf"}  # fmt: skip
_IE_NOUNS = re.compile(
    r"cookie|movie|brownie|hoodie|selfie|smoothie|zombie|beanie|(?:mag|pot)?pie|(?:neck|bow)?tie|die|lie|genie"
    r"|birdie|bookie|talkie|onesie|collie|veggie|laddie|eerie|calorie|prairie|sortie|budgie|pixie|rookie"
)
_NOT_MEN = ("specimen", "omen", "abdomen", "stamen", "acumen", "ramen", "semen", "hymen", "regimen")
_OE_NOUNS = re.compile(r".*shoe|(?:tip)?toe|mistletoe|hoe|canoe|oboe|doe|foe")
_NO_PLURAL_ENDINGS = ("ss", "us", "is")
_S_AFTER_ENDING = _words("skis taxis bikinis kiwis zucchinis khakis menus emus gnus tofus salamis")
HEAD_ENDS = re.compile(r"(?<=.) (?=(?:of|with|in|on|for|without|from)\b)")
CAMEL_CASE = re.compile(r"(?<=[a-z]{2})(?=[A-Z][a-z])|(?<=[A-Z])(?=[A-Z][a-z]{2})")
QUALIFIER = re.compile(r"\s*\(([^()]*)\)\s*$")
_EITHER = re.compile(r"/|[\s_]or[\s_]", re.IGNORECASE)
_GAPS = re.compile(r"[\s_\-‐-―/]+")


def singular(noun: str) -> str:
    """The singular of one English word in lower case; a word that is no plural comes back as it is."""
    if noun in _UNCHANGED or len(noun) < 3:
        return noun
    if noun in _IRREGULAR:
        return _IRREGULAR[noun]
    if not noun.endswith("s") or noun.endswith("'s"):
        return _mended(noun)
    if noun.endswith("ves"):
        for stem, one in _VES.items():
            if noun[:-3] == stem or (len(stem) > 2 and noun.endswith(stem + "ves")):
                return noun[: -len(stem) - 3] + one
    if noun.endswith("ies") and len(noun) > 3:
        return noun[:-1] if _IE_NOUNS.fullmatch(noun[:-1]) else noun[:-3] + "y"
    if noun.endswith("oes"):
        return noun[:-1] if _OE_NOUNS.fullmatch(noun[:-1]) else noun[:-2]
    if noun.endswith(("sses", "shes", "ches", "xes", "zzes")):
        return _mended(noun[:-2])
    if noun.endswith(_NO_PLURAL_ENDINGS) and noun not in _S_AFTER_ENDING:
        return noun
    return noun[:-1]


def _mended(noun: str) -> str:
    """The singular of a compound that ends in an irregular plural, such as `policemen` and `dormice`."""
    for plural, one in (("women", "woman"), ("men", "man"), ("mice", "mouse")):
        if noun.endswith(plural) and noun not in _NOT_MEN:
            return noun[: -len(plural)] + one
    return noun


@lru_cache(maxsize=65536)
def normal_form(name: str) -> str:
    """The spelling under which names are compared.

    Lower case; underscores, hyphens, slashes, camel case and runs of space become one space each; leading articles
    and possessives go; the head noun becomes singular (`boxes_of_tissues` -> `box of tissues`). A qualifier in
    parentheses stays (`bat (animal)`). Applying it twice changes nothing.

    Parameters
    ----------
    name : str
        A class name as a dataset, a detector or a person writes it.
    """
    text = unicodedata.normalize("NFKC", name)
    text = CAMEL_CASE.sub(" ", text).lower().replace("’", "'").replace("‘", "'")
    text = re.sub(r"[\"“”„«»,;:?!]+", " ", text)
    qualifier = QUALIFIER.search(text)
    if qualifier and qualifier.start():
        inside = " ".join(_GAPS.split(qualifier[1].strip()))
        return f"{_plain(text[: qualifier.start()])} ({inside})" if inside else _plain(text[: qualifier.start()])
    return _plain(text)


def _plain(text: str) -> str:
    words = [w for w in (w.strip(".'") for w in _GAPS.split(text)) if w]
    while len(words) > 1 and words[0] in DETERMINERS:
        words.pop(0)
    head, *rest = HEAD_ENDS.split(" ".join(words), maxsplit=1)
    words = head.split()
    if words:
        # Eyewear has no singular, but wine glasses are several wine glasses.
        if words[-1] == "glasses" and len(words) > 1 and words[-2] not in ("reading", "eye", "sun", "safety", "3d"):
            words[-1] = "glass"
        words[-1] = singular(words[-1])
    return " ".join([*words, *rest])


def _key(normal: str) -> str:
    """`trash can` and `trashcan` are one name."""
    return normal.replace(" ", "")


@dataclass(frozen=True, eq=False)
class Synonyms:
    """Which names mean the same, and which are not what their last word says.

    Attributes
    ----------
    groups : tuple of frozenset of str
        Names, in normal form, that mean the same. A name may stand in several groups (`computer` with `laptop` and
        with `desktop`), and meaning is not chained through it.
    exceptions : frozenset of str
        Names, in normal form, that their last word must not match: a `hot dog` is no `dog`.
    """

    groups: tuple[frozenset[str], ...]
    exceptions: frozenset[str] = frozenset()
    _places: dict[str, frozenset[int]] = field(init=False, repr=False)
    _excepted: frozenset[str] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        places: dict[str, set[int]] = {}
        for number, group in enumerate(self.groups):
            for name in group:
                places.setdefault(_key(name), set()).add(number)
        excepted = {_key(n) for n in self.exceptions}
        # What holds for the trash can holds for the garbage can.
        excepted |= {_key(n) for group in self.groups if any(_key(n) in excepted for n in group) for n in group}
        object.__setattr__(self, "_places", {k: frozenset(v) for k, v in places.items()})
        object.__setattr__(self, "_excepted", frozenset(excepted))

    @classmethod
    def load(cls, extra: str | Path | None = None) -> Synonyms:
        """The table of the project, extended by a file of the user's.

        Parameters
        ----------
        extra : str or Path, optional
            A JSON file `{"groups": [["bin", "my bin"], ...], "exceptions": ["hot dog", ...]}`, both keys optional.
            A group of it that shares a name with one of ours adds its names to that group.

        Raises
        ------
        InputError
            Where the file is missing, is no JSON or has another shape.
        """
        groups, exceptions = _read_table(TABLE)
        if extra is None:
            return cls(tuple(groups), frozenset(exceptions))
        more_groups, more_exceptions = _read_table(Path(extra))
        return cls(tuple(groups), frozenset(exceptions)).extended(more_groups, more_exceptions)

    def extended(self, groups: Iterable[Iterable[str]], exceptions: Iterable[str] = ()) -> Synonyms:
        """A new table with more groups and exceptions, added as `load` describes."""
        merged = list(self.groups)
        for names in groups:
            group = frozenset(normal_form(n) for n in names)
            shares = [i for i, old in enumerate(merged) if {_key(n) for n in group} & {_key(n) for n in old}]
            for i in shares:
                merged[i] = merged[i] | group
            if not shares:
                merged.append(group)
        return Synonyms(tuple(merged), self.exceptions | frozenset(normal_form(n) for n in exceptions))

    def of(self, name: str) -> frozenset[str]:
        """All names in the table that mean the same as `name`, in normal form, itself included."""
        normal = normal_form(name)
        return frozenset({normal}).union(*(self.groups[i] for i in self._places.get(_key(normal), ())))

    def same(self, a: str, b: str) -> bool:
        """Whether two names in normal form are one spelling or share a group."""
        a, b = _key(a), _key(b)
        return a == b or not self._places.get(a, frozenset()).isdisjoint(self._places.get(b, frozenset()))

    def is_exception(self, name: str) -> bool:
        """Whether the last word of a name in normal form does not say what the thing is."""
        return _key(name) in self._excepted


@lru_cache(maxsize=1)
def default_synonyms() -> Synonyms:
    """The project's own table, read once."""
    return Synonyms.load()


def _read_table(path: Path) -> tuple[list[frozenset[str]], set[str]]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(
            "the synonym table cannot be read", got=str(error), expected="a JSON file", path=path
        ) from None
    form = '{"groups": [["bin", "trash can"], ...], "exceptions": ["hot dog", ...]}'
    if not isinstance(table, dict):
        raise InputError("the synonym table has the wrong shape", got=type(table).__name__, expected=form, path=path)
    unknown = sorted(set(table) - {"groups", "exceptions", "about"})
    if unknown:
        raise InputError("unknown key in the synonym table", got=repr(unknown[0]), expected=form, path=path)
    groups, exceptions = table.get("groups", []), table.get("exceptions", [])
    if not isinstance(groups, list):
        raise InputError("groups of the synonym table are no list", got=repr(groups)[:60], expected=form, path=path)
    for names in [*groups, exceptions]:
        good = isinstance(names, list) and all(isinstance(n, str) and normal_form(n) for n in names)
        if not good:
            raise InputError("a group of the synonym table is no list of names", got=repr(names)[:60], path=path)
    for group in groups:
        if len(group) < 2:
            raise InputError("a group of the synonym table needs two names", got=repr(group)[:60], path=path)
    return [frozenset(map(normal_form, g)) for g in groups], set(map(normal_form, exceptions))


def same_class(a: str, b: str, synonyms: Synonyms | None = None) -> bool:
    """Whether two names mean the same class: one spelling, or synonyms. `box` and `cracker box` do not."""
    return (synonyms or default_synonyms()).same(normal_form(a), normal_form(b))


def is_named(query: str, name: str, synonyms: Synonyms | None = None) -> bool:
    """Whether a query names this very class, by one of its spellings (`Monitor` for `Monitor/TV`, `bus` for
    `bus (vehicle)`) or by a synonym, and not by a more general word."""
    return _key(normal_form(query)) in _spellings(name) or same_class(query, name, synonyms)


def match(query: str, names: Sequence[str], synonyms: Synonyms | None = None) -> tuple[str, ...]:
    """The names, out of those a dataset or a detector knows, that a query means.

    The same spelling comes first (of a name such as `cup or mug` or `Monitor/TV`, either half), then synonyms.
    Only where there is neither, a more general query matches what is a kind of it: its words are the last words
    of the name's head (`box` -> `cracker box`, `box of tissues`; `table` -> `dining table` and not `table lamp`),
    save the table's exceptions (`can` never means `trash can`).

    Parameters
    ----------
    query : str
        What the user wrote.
    names : sequence of str
        Known class names, in any spelling.
    synonyms : Synonyms, optional
        The project's own table by default.

    Returns
    -------
    tuple of str
        Names out of `names` as they are spelled there, without repeats, in their order within each of the two
        kinds; empty where the query is unknown.
    """
    table = synonyms or default_synonyms()
    wanted = normal_form(query)
    if not wanted:
        return ()
    known = {name: normal_form(name) for name in names}
    exact = [name for name in known if _key(wanted) in _spellings(name)]
    alike = [n for n, form in known.items() if n not in exact and table.same(form, wanted)]
    if exact or alike:
        return (*exact, *alike)
    words = wanted.split()
    return tuple(
        name
        for name, form in known.items()
        if HEAD_ENDS.split(_base(form), maxsplit=1)[0].split()[-len(words) :] == words and not table.is_exception(form)
    )


@lru_cache(maxsize=65536)
def _spellings(name: str) -> frozenset[str]:
    """The keys that a name answers to: itself, itself without its qualifier, each of `Monitor/TV`, `cup or mug`."""
    whole = normal_form(name)
    parts = [normal_form(p) for p in _EITHER.split(name)]
    return frozenset(_key(form) for form in (whole, _base(whole), *parts) if form)


def _base(normal: str) -> str:
    """A name without its qualifier: who writes `bus` means `bus (vehicle)`."""
    return QUALIFIER.sub("", normal)


def suggest(query: str, names: Iterable[str], n: int = 3) -> tuple[str, ...]:
    """The known names nearest to one that is not known, best first: by letters, and by words in common.

    Parameters
    ----------
    query : str
    names : iterable of str
    n : int
        At most so many.
    """
    wanted = normal_form(query)
    words = set(wanted.split())
    scored = []
    for name in dict.fromkeys(names):
        form = normal_form(name)
        letters = difflib.SequenceMatcher(None, wanted, form).ratio()
        shared = words & set(form.split())
        common = len(shared) / max(len(words | set(form.split())), 1)
        score = max(letters, 0.6 + 0.4 * common if shared else 0.0)
        if score >= 0.6:
            scored.append((-score, name))
    return tuple(name for _, name in sorted(scored)[:n])


def is_compound(words):
    return " ".join(words) in {"tv stand", "white board", "front door", "wine glass"}


def known_words():
    return frozenset()
