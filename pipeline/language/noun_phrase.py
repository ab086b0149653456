"""Class names as English noun phrases: readable words, number, and the article that goes with them."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pipeline.language.naming import CAMEL_CASE, DETERMINERS, HEAD_ENDS, QUALIFIER, normal_form, same_class, singular
from pipeline.system.frozen import dataclass


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_PLURAL_ONLY = _words(
    "glasses sunglasses eyeglasses goggles scissors pants trousers jeans shorts tights pliers tweezers tongs forceps "
    "pyjamas binoculars clothes stairs cattle police"
)
"""Plurals that have no singular, or whose singular is no such thing."""

_MASS = _words(
    "asphalt bacon baggage bbq beef beer bread broccoli butter cardboard cement cereal champagne cheese china "
    "chocolate clay clothing cloth coal coffee concrete cookware corn cotton cream crockery cutlery dirt dishware "
    "dough dust electricity equipment fabric flour foam foliage food footwear fur furniture garbage garlic gasoline "
    "glassware grass gravel gum hair ham hay headgear honey hummus ice ink ivy jam jelly jewellery jewelry juice "
    "ketchup kitchenware laundry lava leather lettuce linen lingerie linoleum litter luggage lumber machinery mail "
    "marmalade mayonnaise meat metal milk money mouthwash mud mustard oatmeal oil paint paper parsley pasta plastic "
    "playdough popcorn pork porridge powder quinoa rice rubber rubbish rum salad salt sand sauce scenery seafood "
    "sellotape shampoo silk silverware sky smoke snow soap soda soup spaghetti spinach stationery steam steel stone "
    "straw sugar syrup tableware tape tea tissue tobacco tofu toothpaste traffic trash underwear vinegar vodka "
    "wallpaper waste water wax whiskey whisky wine wood wool yarn yeast yoghurt yogurt"
)
"""Nouns that `a` reads badly before. Some may also be counted; `the` or no article is right for both uses."""

_INITIALISMS = _words(
    "ac ai atm cpu diy dna ecg faq fbi gpu hdmi hvac iphone ipad id led mri nba rfid sos suv uav ufo uhd uk ups url "
    "usa usb upc uv vip"
)
"""Letters said one by one although a vowel among them would let them be said as a word."""

_PRONOUNCED_AS_WORDS = _words("sim ram rom lan nes mac nas sap")
_ABBREVIATIONS = _words("mr mrs ms st")
_VOWELS = frozenset("aeiou")
_SPELLED_WITH_VOWEL = frozenset("aefhilmnorsx")
"""Letters whose own names begin with a vowel: an F, but a U."""

_SILENT_H = re.compile(r"heir(?!l?ing)|hono(?:u?r|rary)|honest|hour|hors$")
_CONSONANT_SOUND = re.compile(r"eu|ewe|ouija|one(?:[sp]|$)|once$|uni(?:[^nmd]|mo|$)|u(?!t[th])[bcfhjkqrst][aeiou]")
"""Words written with a vowel first and spoken with `y` or `w`: euro, ewer, one-way, unicorn, utensil, ukulele. After
D. Conway, An algorithmic approach to English pluralization (1998)."""

_FIRST_WORD = re.compile(r"[^\W_]+")


@dataclass(frozen=True)
class NounPhrase:
    """A class name ready to stand in a sentence."""

    words: str  # The name in readable words, possibly in double quotes
    plural: bool  # It takes `are`
    mass: bool  # It cannot be counted and so takes no `a`
    article: str  # The indefinite article by sound, for a name that is neither plural nor mass

    @property
    def verb(self) -> str:
        """Verb, `is` or `are`."""
        return "are" if self.plural else "is"

    def definite(self, *, other: bool = False) -> str:
        """Definite phrase, `the mug`; besides another of its kind `another mug`: there may be more than two."""
        return self.indefinite(other=True) if other else f"the {self.words}"

    def indefinite(self, *, other: bool = False) -> str:
        """Indefinite phrase: `a mug`, `some scissors`, `some rice`; `another mug`, `some other scissors`."""
        if self.plural or self.mass:
            return f"some other {self.words}" if other else f"some {self.words}"
        return f"another {self.words}" if other else f"{self.article} {self.words}"


@lru_cache(maxsize=65536)
def noun_phrase(words: str) -> NounPhrase:
    """Noun phrase of a name in readable words, which may stand in double quotes."""
    bare = words.strip('"')
    tail = HEAD_ENDS.split(QUALIFIER.sub("", bare.lower()), maxsplit=1)[0].split()
    head = re.split(r"[-/]", tail[-1])[-1] if tail else ""
    plural = head in _PLURAL_ONLY or singular(head) != head
    return NounPhrase(words, plural, not plural and head in _MASS, indefinite_article(bare))


def indefinite_article(words: str) -> str:
    """Article `a` or `an` by the sound of the first word: an hour, a unicorn, an LED lamp, a USB cable, an 8 ball.

    Capitals count: `US` is spelled out.
    """
    found = _FIRST_WORD.search(words)
    if found is None:
        return "a"
    first = found[0]
    if first[0].isdecimal():
        return "an" if _number_sounds_open(re.match(r"\d+", first)[0]) else "a"  # type: ignore[index]
    plain = unicodedata.normalize("NFKD", first)
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    lower = plain.lower()
    if _is_spelled_out(plain):
        return "an" if lower[0] in _SPELLED_WITH_VOWEL else "a"
    vowel = lower[0] in _VOWELS or (lower[0] == "x" and lower[1:2] not in (*_VOWELS, "y"))
    return "an" if _SILENT_H.match(lower) or (vowel and not _CONSONANT_SOUND.match(lower)) else "a"


def _number_sounds_open(digits: str) -> bool:
    """Test digits for eight, eleven, eighteen and numbers that begin so."""
    return digits[0] == "8" or (digits[:2] in ("11", "18") and len(digits) % 3 == 2)


def _is_spelled_out(word: str) -> bool:
    """Test if a word is said letter by letter: `LED`, `usb`, the `x` of `x-ray`, the `F` of `F1`."""
    letters = re.match(r"[^\W\d_]+", word)
    if letters is None or word.lower() in _ABBREVIATIONS:
        return False
    lower = letters[0].lower()
    if len(lower) == 1 or lower in _INITIALISMS:
        return lower != "a" or word != "a"
    if not lower.isascii() or lower in _PRONOUNCED_AS_WORDS:
        return False
    if _VOWELS.isdisjoint(lower) and "y" not in lower:
        return len(lower) <= 5
    return len(lower) <= 3 and letters[0].isupper()


@lru_cache(maxsize=65536)
def readable(name: str, *, brief: bool = True) -> str:
    """Readable words of a class name: `hot_sauce` -> `hot sauce`, `CoffeeTable` -> `coffee table`.

    With `brief`, only the first of several spellings (`bookcase / shelf`) stays and a qualifier (`bat (animal)`) goes.

    >>> from pipeline.language import readable
    >>> readable("Monitor/TV"), readable("T-Shirt_stack")
    ('monitor', 'T-Shirt stack')
    """
    text = unicodedata.normalize("NFKC", name).replace("_", " ")
    if brief:
        text = _first_spelling(QUALIFIER.sub("", text))
    text = re.sub(r"[\"“”„«»,;:?!\s]+", " ", CAMEL_CASE.sub(" ", text)).replace("’", "'").strip()
    words = _without_hyphens(re.sub(r" ?/ ?", "/", text)).split()
    while len(words) > 1 and words[0].lower() in DETERMINERS:
        words.pop(0)
    shouted, titled = text.isupper(), not any(w[0].islower() for w in words)
    return " ".join(_recased(w, shouted=shouted, titled=titled) for w in words)


def _first_spelling(text: str) -> str:
    """First spelling, `bookcase` of `bookcase / shelf`; `CD/DVD player` and `24/7 sign` stay whole."""
    parts = [p.strip() for p in text.split("/")]
    if not all(p and p[0].isalpha() for p in parts):
        return text
    alternatives = " " not in text.strip() or " / " in text or len(parts[0]) > 2
    return parts[0] if alternatives else text


def _without_hyphens(text: str) -> str:
    """Replace hyphens by spaces where they do the work of underscores: `hot-dog`, not `t-shirt` or `one-way sign`."""
    parts = re.split(r"[-‐-―]", text)
    return text if " " in text or any(len(p) < 3 for p in parts) else " ".join(parts)


def _recased(word: str, *, shouted: bool, titled: bool) -> str:
    """Word without the capitals that come from the spelling of class names; `TV` and `iPod` keep theirs."""
    if len(word) == 1:
        return word
    if word.isupper():
        return word.lower() if shouted and not _is_spelled_out(word.lower()) else word
    is_title = word[1:] == word[1:].lower() and not re.match(r"\w[-‐-―&]", word)
    return word.lower() if titled and is_title else word


_same = lru_cache(maxsize=1 << 14)(same_class)


def same_names(labels: Sequence[str]) -> np.ndarray:
    """Matrix, (N, N) bool, of objects with class names of the same meaning."""
    names = list(dict.fromkeys(labels))
    alike = np.array([[a == b or _same(*sorted((a, b))) for b in names] for a in names], np.bool_)
    alike = alike.reshape(len(names), len(names))
    index = np.array([names.index(label) for label in labels], np.int64)
    return alike[np.ix_(index, index)]


def alone(labels: Sequence[str]) -> np.ndarray:
    """Mask, (N,) bool, of names for one object only: no second of the class, and no kind of it."""
    # As they are said: `bat (animal)` and `bat (club)` may both be said `bat`.
    readings = [readable(label) for label in labels]
    single = (same_names(labels).sum(axis=1) == 1) & (same_names(readings).sum(axis=1) == 1)
    forms = [normal_form(name) for name in readings]
    general = [any(other.endswith(f" {form}") for other in forms) for form in forms]
    return single & ~np.array(general, np.bool_)
