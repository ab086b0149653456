"""Class names as they are compared: one normal form of all spellings, and the forms that one name has."""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


DETERMINERS = _words("the a an this that these those my your our their its his her some any")

_UNCHANGED = _words(
    "bus gas glasses sunglasses eyeglasses goggles scissors pants trousers jeans shorts tights pliers tweezers tongs "
    "binoculars clothes stairs news series species headquarters chassis canvas atlas christmas tennis chess lens "
    "iris rhinoceros brassiere molasses thermos cosmos asbestos alias bias pancreas forceps pyjamas adidas citrus"
)
_IRREGULAR = {
    "mice": "mouse",
    "men": "man",
    "women": "woman",
    "people": "person",
    "children": "child",
    "feet": "foot",
    "teeth": "tooth",
    "geese": "goose",
    "oxen": "ox",
    "cacti": "cactus",
    "fungi": "fungus",
    "dice": "die",
    "buses": "bus",
    "gases": "gas",
    "lenses": "lens",
    "canvases": "canvas",
    "irises": "iris",
    "atlases": "atlas",
    "octopuses": "octopus",
    "cactuses": "cactus",
    "axes": "axe",
    "caches": "cache",
    "quizzes": "quiz",
    "headaches": "headache",
    "campuses": "campus",
    "walruses": "walrus",
    "viruses": "virus",
}
_VES = {
    "kni": "knife",
    "lea": "leaf",
    "shel": "shelf",
    "loa": "loaf",
    "hal": "half",
    "cal": "calf",
    "scar": "scarf",
    "hoo": "hoof",
    "wi": "wife",
    "li": "life",
    "thie": "thief",
    "wol": "wolf",
    "sel": "self",
    "el": "elf",
}
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
    """Singular of one English word in lower case; a word that is no plural comes back unchanged."""
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
    return noun if noun.endswith(_NO_PLURAL_ENDINGS) and noun not in _S_AFTER_ENDING else noun[:-1]


def _mended(noun: str) -> str:
    """Singular of a compound that ends in an irregular plural, such as `policemen` and `dormice`."""
    for plural, one in (("women", "woman"), ("men", "man"), ("mice", "mouse")):
        if noun.endswith(plural) and noun not in _NOT_MEN:
            return noun[: -len(plural)] + one
    return noun


@lru_cache(maxsize=65536)
def normal_form(name: str) -> str:
    """Normal form of a class name, for comparisons.

    Lower case; underscores, hyphens, slashes, camel case and runs of space become one space each; leading articles
    and possessives go; the head noun becomes singular. A qualifier in parentheses stays (`bat (animal)`). Applying it
    twice changes nothing.

    >>> from pipeline.language import normal_form
    >>> normal_form("boxes_of_tissues"), normal_form("The CoffeeTables")
    ('box of tissues', 'coffee table')
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


def key_of(normal: str) -> str:
    """Key of a name in normal form: without gaps, so that `trash can` and `trashcan` are one name."""
    return normal.replace(" ", "")


@lru_cache(maxsize=65536)
def forms_of(name: str) -> tuple[str, ...]:
    """Forms of a name, in normal form: whole, without qualifier, each of `Monitor/TV` and of `cup or mug`."""
    whole = normal_form(name)
    forms = (whole, base_of(whole), *(normal_form(p) for p in _EITHER.split(name)))
    return tuple(dict.fromkeys(form for form in forms if form))


@lru_cache(maxsize=65536)
def spellings(name: str) -> frozenset[str]:
    """Keys of all forms of a name."""
    return frozenset(map(key_of, forms_of(name)))


def base_of(normal: str) -> str:
    """Name without qualifier: `bus` means `bus (vehicle)`."""
    return QUALIFIER.sub("", normal)
