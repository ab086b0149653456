"""Adjectives of things: colours, sizes, shapes, materials and others, each with its plain form.

A colour is judged from pixels, a size and a shape from boxes and masks (see `pipeline.relations.attributes`);
a material and the others are only known as such, so that a sentence can say what was not judged.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Literal

from pipeline.system.frozen import dataclass

KINDS = Literal["color", "size", "shape", "material", "other"]
Shade = Literal["light", "dark"]


# The docstring is part of the schema that `llm_reader` sends: other words ask models anew.
@dataclass(frozen=True)
class Attribute:
    """An adjective of a thing.

    Attributes
    ----------
    kind : {"color", "size", "shape", "material", "other"}
    value : str
        The plain form: "red" of "reddish", "gray" of "grey", "big" of "large"; "light" and "dark" alone are
        colours too.
    shade : {"light", "dark"} or None
        Of a colour: "light blue".
    """

    kind: KINDS
    value: str
    shade: Shade | None = None

    def __str__(self) -> str:
        return self.value if self.shade is None else f"{self.shade} {self.value}"

    @property
    def judged(self) -> bool:
        """Test if `pipeline.relations.attributes` judges the attribute."""
        return self.kind in ("color", "size") or self.value in JUDGED_SHAPES


JUDGED_SHAPES = frozenset({"flat", "round", "square", "rectangular"})


def _words(lines: str) -> dict[str, str]:
    """Map words to plain forms, from lines of "plain: word word"."""
    plain = dict(line.split(":") for line in lines.strip().splitlines())
    return {word: value.strip() for value, rest in plain.items() for word in (value.strip(), *rest.split())}


BASIC_COLORS = ("black", "blue", "brown", "gray", "green", "orange", "pink", "purple", "red", "white", "yellow")
"""The eleven basic colour terms of English (B. Berlin and P. Kay, Basic Color Terms, 1969)."""
FURTHER_COLORS = ("turquoise", "beige", "gold", "magenta")
"""Terms that people use so often for what lies between basic ones that they are judged on their own."""

_COLORS = _words(
    """
    black: ebony jet
    blue: azure cobalt indigo denim
    brown: chocolate chestnut bronze copper rust rusty auburn sienna
    gray: grey silver silvery slate ash
    green: lime emerald jade
    orange: amber apricot coral tangerine terracotta
    pink: rose rosy salmon peach
    purple: violet mauve plum
    red: scarlet crimson ruby cherry vermilion
    white: ivory snowy offwhite
    yellow: lemon golden-yellow
    turquoise: teal cyan aqua aquamarine
    beige: tan cream creamy khaki sand sandy taupe ecru
    gold: golden mustard ochre
    magenta: fuchsia
    light: pale pastel bright
    dark:
    """
)
_SHADED: dict[str, tuple[str, Shade]] = {
    "navy": ("blue", "dark"),
    "maroon": ("red", "dark"),
    "burgundy": ("red", "dark"),
    "wine": ("red", "dark"),
    "olive": ("green", "dark"),
    "charcoal": ("gray", "dark"),
    "mint": ("green", "light"),
    "lavender": ("purple", "light"),
    "lilac": ("purple", "light"),
}
_SIZES = _words(
    """
    big: large huge giant gigantic enormous massive sizable oversized largish
    small: little tiny mini miniature wee smallish petite
    tall: high tallish
    short: low shortish
    long: longish elongated
    wide: broad
    narrow: slim slender skinny
    thin:
    thick: fat chunky
    """
)
_SHAPES = _words(
    """
    flat:
    round: rounded circular roundish spherical oval elliptical
    square: squarish cubic cubical boxy
    rectangular: oblong rectangle
    triangular: triangle
    cylindrical: tubular
    curved: curvy bent
    straight:
    pointed: pointy
    """
)
_MATERIALS = _words(
    """
    wooden: wood hardwood plywood oak walnut pine timber
    metal: metallic steel iron aluminum aluminium tin brass chrome stainless
    plastic: plasticky acrylic
    glass: crystal
    leather: leathery suede
    cardboard: carton
    paper:
    ceramic: porcelain clay earthenware
    cloth: fabric cotton linen woolen woollen wool silk velvet denim canvas upholstered
    foam: styrofoam
    rubber: rubbery
    stone: marble granite concrete
    wicker: rattan woven bamboo straw
    fur: furry
    mesh:
    """
)
_OTHERS = _words(
    """
    old: ancient antique vintage used
    new: modern
    empty: vacant
    full: filled
    open: opened
    closed: shut
    striped: stripy stripey
    patterned: floral plaid checkered chequered dotted spotted
    colorful: colourful multicolored multicoloured rainbow
    plain: solid
    transparent: clear translucent see-through
    shiny: glossy
    dirty: dusty stained
    clean:
    broken: damaged cracked
    soft: fluffy cuddly
    hard:
    heavy:
    wet:
    dry:
    folded:
    framed:
    stacked:
    lit:
    messy: cluttered
    fancy: ornate decorative
    nice: beautiful pretty cute ugly
    """
)
_TABLE: dict[str, Attribute] = {
    **{word: Attribute("other", value) for word, value in _OTHERS.items()},
    **{word: Attribute("material", value) for word, value in _MATERIALS.items()},
    **{word: Attribute("shape", value) for word, value in _SHAPES.items()},
    **{word: Attribute("size", value) for word, value in _SIZES.items()},
    **{word: Attribute("color", value, shade) for word, (value, shade) in _SHADED.items()},
    **{word: Attribute("color", value) for word, value in _COLORS.items()},
}

_LIGHT = _words("light: lighter pale pastel soft faded sky baby powder ice lemon")
_DARK = _words("dark: darker deep forest hunter army bottle midnight blood brick chocolate")
_SHADES: dict[str, Shade] = {**dict.fromkeys(_LIGHT, "light"), **dict.fromkeys(_DARK, "dark")}
"""Words that before a colour say how light it is: "sky blue", "forest green"."""
INTENSIFIERS = frozenset(
    _words("very: really quite rather somewhat fairly extremely super so too kind of sort kinda sorta bit")
)
_VIVID = frozenset(_words("bright: vivid neon hot electric royal solid plain mostly all metallic jet snow off"))
"""Words before a colour that leave its name and its shade as they are."""
SINGLE_WORDS = frozenset(_TABLE)
"""The words that alone say how a thing looks, for the mending of misspelt ones."""
_SUFFIX = re.compile(r"(?:colou?red|colou?r|tinted|toned|painted|shaped|sized?)$")
_JOINED = re.compile(r"(light|dark|pale|deep|bright|sky|navy)([a-z]{3,}?)")
_ISH = re.compile(r"([a-z]+?)(?:[dr](?=d?ish$))?(?:ish|y)")


@lru_cache(maxsize=4096)
def attribute(words: str) -> Attribute | None:
    """Attribute of an adjective, alone or with words before; None if unknown.

    "red", "dark blue", "light-grey", "reddish brown", "cream-coloured", "very big", "round", "wooden".
    Whether a word stands as an adjective at all ("an orange", "glass") is for the reader of the sentence to say.

    >>> from pipeline.language import attribute
    >>> str(attribute("navy")), attribute("large").kind, attribute("laptop")
    ('dark blue', 'size', None)
    """
    tokens = [t if t in _TABLE else _SUFFIX.sub("", t) for t in re.split(r"[\s\-_]+", words.strip().lower())]
    tokens = [token for token in tokens if token]
    while len(tokens) > 1 and tokens[0] in INTENSIFIERS:
        tokens = tokens[1:]
    if tokens[-1:] == ["ish"]:
        tokens = [*tokens[:-2], "".join(tokens[-2:])]
    if not tokens:
        return None
    whole = _TABLE.get("-".join(tokens)) or _TABLE.get("".join(tokens))
    if whole is not None:
        return whole
    if len(tokens) == 1:
        return _single(tokens[0])
    last = _single(tokens[-1])
    if last is not None and last.kind == "color":
        return _qualified(tokens[:-1], last)
    # "stainless steel": the same twice.
    return last if last is not None and all(_single(t) == last for t in tokens) else None


def _single(token: str) -> Attribute | None:
    """Attribute of one word, which may be joined ("lightblue") or made soft ("reddish")."""
    found = _TABLE.get(token)
    if found is not None:
        return found
    if joined := _JOINED.fullmatch(token):
        color = _single(joined[2])
        return _qualified([joined[1]], color) if color is not None and color.kind == "color" else None
    if soft := _ISH.fullmatch(token):
        stem = soft[1]
        return next((_TABLE[s] for s in (stem, stem + "e", stem[:-1]) if s in _COLORS or s in _SIZES), None)
    return None


def _qualified(before: list[str], color: Attribute) -> Attribute | None:
    """Colour with the words before; None where a word is none for a colour."""
    value, shade = color.value, color.shade
    for word in before:
        if word in _SHADES:
            shade = _SHADES[word]
        elif word in _SHADED:
            shade = _SHADED[word][1]
        elif word not in _VIVID and word not in INTENSIFIERS:
            other = _single(word)
            if other is None or other.kind != "color":
                return None
            if {other.value, value} == {"blue", "green"}:
                value = "turquoise"
    return Attribute("color", value, shade)
