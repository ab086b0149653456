"""The lexicon of spatial expressions, as data: phrases of each relation, and words without meaning.

A phrase is written as lower-case words with single spaces. The grammar that reads expressions with these tables is
in `pipeline.language.grammar`.
"""

from __future__ import annotations

import re
from functools import lru_cache

from pipeline.language.openers import LEADING_WORDS, phrases
from pipeline.language.relation import DECLARED
from pipeline.language.relation_names import RELATIONS


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


SAYS: dict[str, tuple[str, ...]] = {r.name: r.reads for r in DECLARED}
"""Phrases by the relation that they say of TARGET to REFERENCE."""

FAR = ("far from", "far away from", "far off from", "a long way from", "distant from")
"""Not near, which nothing here judges: no superlative, so that `farthest from` would be a guess."""

SAYS_SWAPPED: dict[str, tuple[str, ...]] = {r.name: r.swapped_reads for r in DECLARED if r.swapped_reads}
"""Phrases of the same relations said from the other side: REFERENCE to TARGET."""

POSSESSIVE_TAILS = {"on its top": "on", "on their top": "on"}
"""Phrases that end a `with a lamp on its top` and stand nowhere else."""

BARE_TAILS = frozenset(
    {
        "on top",
        "on the top",
        "atop",
        "underneath",
        "beneath",
        "below",
        "under",
        "above",
        "inside",
        "within",
        "behind",
        "in front",
        "nearby",
        *POSSESSIVE_TAILS,
    }
)
"""Phrases that may end a `with a lamp ...` without naming the target again."""

UNDER = frozenset({"under", "underneath", "beneath", "underneath of"})
"""Phrases of `below` that say a little more than it where there is no `on`."""

SUPERLATIVES = frozenset({"closest", "nearest", "farthest", "furthest", "most distant"})
"""Relation phrases that may also stand before the noun: `the nearest chair to the door`."""

NEARER = {"closer": "closest", "nearer": "closest", "farther": "farthest", "further": "farthest"}
"""Comparatives before a noun that may be a relation of it: `the closer chair to the door`."""
BEFORE_NOUNS = SUPERLATIVES | NEARER.keys()

ANYTHING = _words("thing things object objects item items one ones stuff something anything everything")
"""Heads that say no more than that it is a thing."""

VIEWERS = _words("me you us camera viewer observer photographer robot i yourself myself")
"""Who looks, where no class is called so."""

SCENE_ORDER = {
    "left": "left",
    "right": "right",
    "front": "near",
    "behind": "far",
    "between": "middle",
    "below": "bottom",
}
"""The side that a relation to the scene names: `on the left of the room`, `in the middle of the picture`."""
BARE_SIDES = {"in front": "near", "behind": "far", "in back": "far", "on top": "high", "on the top": "high"}
BARE_SIDES |= {"closest": "near", "nearest": "near", "farthest": "far", "furthest": "far", "most distant": "far"}
"""Relation phrases that name a side where no reference follows."""

SURFACES = _words("table desk counter countertop shelf bookshelf bed couch sofa bench dresser nightstand rug tray")
"""Things that others stand on, so that their left side may be a place on them."""
PARTS = _words(
    "shelf drawer door leg arm armrest seat back backrest lid rim handle surface step tier level compartment foot "
    "cover frame base side half part section edge corner end tabletop headboard"
)
"""Heads before `of the` that name a part of a thing."""
LYING = _words(
    "standing sitting lying laying resting placed put located positioned situated kept stands sits lies rests"
)
STACKS = _words("stack pile heap")
SCENE = _words("room picture image photo photograph scene view frame screen shot")
PICTURES = _words("picture image photo photograph frame screen shot")
"""What holds all of the frame: its sides are those of the picture."""

WITH = frozenset({"with", "has", "have", "having", "got"})
CONTRACTIONS = {
    "whats": "what's",
    "wheres": "where's",
    "whos": "who's",
    "thats": "that's",
    "theres": "there's",
    "heres": "here's",
    "whichs": "which's",
    "isnt": "isn't",
    "arent": "aren't",
    "wasnt": "wasn't",
    "werent": "weren't",
    "doesnt": "doesn't",
    "dont": "don't",
    "didnt": "didn't",
    "cant": "can't",
    "couldnt": "couldn't",
    "shouldnt": "shouldn't",
    "wouldnt": "wouldn't",
    "hasnt": "hasn't",
    "havent": "haven't",
    "im": "i'm",
    "ive": "i've",
    "youre": "you're",
    "theyre": "they're",
    "lets": "let's",
}
"""Words that are typed without their apostrophe."""
SHORTHAND = {
    "plz": "please",
    "pls": "please",
    "plse": "please",
    "pleas": "please",
    "thx": "thanks",
    "thanx": "thanks",
    "lookin": "looking",
    "searchin": "searching",
    "tryin": "trying",
    "u": "you",
    "ya": "you",
    "ur": "your",
    "btwn": "between",
    "tha": "the",
    "da": "the",
}
"""What is typed short."""

PRONOUNS = _words("it them itself themselves they he she him her me you something anything someone one what")
PLACE_PRONOUNS = frozenset({"it", "them", "itself", "themselves"})

AMONG_FIRST = re.compile(
    r"(?:(?:out )?of|among(?:st)?|from among) (?:all )?(?=(?:the|these|those|my|all|\w+ \w+s) )"
    r"|in (?:the|this|that|a) (?:group|row|line|set|pair|bunch|cluster|collection) of (?=\w)"
)
"""Words at the start that say among which things the one meant is."""

LINKING = _words(
    "that which who what is are was were be been being that's which's who's it's they're there there's also directly "
    "immediately just right straight exactly slightly somewhere anywhere still currently located positioned placed "
    "situated standing stood sitting seated lying laying laid resting hanging hung leaning mounted kept found put "
    "parked the a an can could may should would might must will shall seen visible propped stored stacked "
    "arranged displayed perched tucked nestled almost nearly very quite closely pictured appears seems looks "
    "approximately about does do did hidden partially partly attached fixed connected wedged tossed thrown stuck "
    "draped built hanged nailed pinned suspended supposed lieing siting sited"
)
"""Words between a noun and its relation that say nothing: `the mug that is standing on`."""

HOW_EXACTLY = _words("directly immediately just right straight exactly slightly almost nearly closely")
"""Words before a relation that say more than it, which no relation judges."""

COPULAS = _words("does do did that which who is are was were be been being that's which's who's it's there also")

SEEMS = re.compile(r"what (?:appears|seems|looks|look|appear|seem) (?:to be|like)(?= |$)")
"""Words before a noun that say only that its name is a guess."""
BE = _words("is are was were be being been isn't aren't wasn't weren't it's that's which's who's they're looks seems")
DEGREES = _words("also very quite just rather or nor really both mostly all")
"""What may stand between `is` and an adjective."""

RELATIVE = frozenset({"that", "which", "who"})
RELATIVE_COPULAS = RELATIVE | {"that's", "which's", "who's"}
POSTURES = _words(
    "resides stays stands sits lies rests hangs leans stand sit lie rest hang lean sat goes belongs appears"
)
"""Linking words only after `that`, since `tv stands` are things."""

SOMEBODY = _words("somebody someone nobody anybody everybody he she you i we they")
COUNTING = re.compile(r"(?:how many|how much|(?:the |a )?(?:number|count|amount) of|count)(?= )")
"""Questions for a number, at the start of a sentence."""
POINTING = _words("over up down out back right")
DEIXIS = re.compile(r"(?:(?:right|over|up|down|out|back|just) )+(?:there|here)(?= |$)")
"""Words that point to a place."""
DOING = re.compile(
    r"(?:(?:the |a |an |that |this |some |my )?(?:man|woman|boy|girl|person|people|child|kid|baby|guy|lady|cat|dog)"
    r"|somebody|someone|nobody|anybody|everybody|he|she|you|i|we|they) "
    r"(?:(?:is|are|was|were|am|has|have|can|will) )?(?:been )?\w+(?:ing|s|ed)"
    r"(?: (?:on|in|at|with|to|against|for))?(?= |$)"
)
"""What somebody does with a thing."""
PURPOSE = re.compile(
    r"(?:(?:i|you|we|one|they|people|someone|somebody) (?:(?:can|could|may|might|want to|would) )?"
    r"|to (?!the |a |an |my |your |our |his |her |its |left|right))"
    r"\w+(?: (?:on|in|from|with|at|into|out of|up))?(?= |$)"
)
"""What a thing is for: `to sit on`, `you can drink from`."""

ADDRESS = _words(
    "yo hey hi hello look listen hmm hm ah oh ok okay right well so robot computer assistant alexa siri google dude "
    "dear darling madam miss boss man guys folks mate friend buddy sir please quick hurry now then actually"
)
"""Words before a comma at the start that call for attention."""
CLOSING = _words("please thanks is are there now asap where located gone")
CLOSING_PHRASES = phrases(
    "for me, for us, would you, will you, could you, can you, if you can, if you could, if you please, thank you, "
    "do you see it, can you see it, if possible, if you don't mind, right now, right away, thank you so much, "
    "please and thank you, please & thank you, many thanks, thanks a lot, for me please, "
    "thank you very much"
)
"""What may stand after the last noun and says nothing about it."""
AND = frozenset({"and", "but", "&"})
EVERY = _words("any all every each everything anything")
"""Before a noun they make `but` mean `except`."""
NEGATIONS = _words(
    "not no isn't aren't wasn't weren't doesn't don't didn't hasn't haven't can't without except excluding neither nor "
    "never cannot nowhere"
)

FILLER = re.compile(
    r"(?:(?:(?:only|just|about) )?(?:a |one |two |three |several |some )?(?:few |couple of |couple |little |bit )?"
    r"(?:feet|foot|inch|inches|meters|metres|centimeters|steps|bit|little|ways?)(?: away| off| over| back| up| down)?"
    r"|of (?:the |these |those )?(?:two|three|four|five|six|\d+|them all|them|all|both|lot|bunch)"
    r"|(?:(?:high|low|way) )?(?:up|down|over|out|off)|(?:all the way|in place|by itself|here|located)"
    r"|(?:you|i|we) (?:can |could )?see"
    r"|in (?:colou?r|size|shape)|of (?:any|whatever|some) (?:colou?r|size|shape|kind|sort|type)) ?(?= |$)"
)
"""A distance or a direction before a relation, which no relation judges: `a few feet to the left of`."""

SMALL_WORDS = _words(
    "or plus of for few couple little bit feet foot inch inches meters metres centimeters steps way ways up down over "
    "back all place by what looks look like seem seems appear see color colour size shape"
)
"""Words of fillers and lists, which say nothing alone."""

ACTIONS = _words(
    "put place move turn open close push pull throw pour clean wash wipe fold lift drop carry stack arrange fill empty "
    "switch press cut eat drink read write sit stand walk go"
)
"""Commands that ask for more than to point at a thing."""

LOOK_AFTER = re.compile(
    r"(?:(?:in|(?P<part>of|with|has|have|having)) (?:a |the )?(?P<says>colou?r )?|colou?red |colou?r |painted )"
    r"(?P<look>(?:(?:light|dark|bright|pale|deep) |\w+ (?=\w+ colou?r))?\w+)(?P<color> colou?r)?(?= |$)"
)
"""A colour after the thing: `the mug in red`, `of a red colour`."""
PARTITIVE = re.compile(
    r"(?:(?:which|whichever|the|any|some|each|every|just|only) )?"
    r"(?:ones?|any|some|all|both|each|either|whichever|which|several|many|most|none) of "
    r"(?=(?:the|these|those|my|your|our|their|his|her|its|them|all|both|two|three|four|five|six|\d+) )"
)
"""What stands before things of which one is meant: `one of the mugs`."""
OF_SEVERAL = re.compile(
    r"(?P<side>left|right|top|front) of (?=(?:the |these |those )?(?:two|three|four|five|\d+|both) )"
)
"""`the left of the two lamps`, which is one of them."""
EXCEPT = re.compile(r"(?:and |but )?(?:other than|apart from|aside from|rather than|instead of|minus)(?= )")
"""Words that say what is not meant."""
RECIPROCAL = ("each other", "one another")

OTHER = frozenset({"another", "other"})
"""Before a noun they tell two things of one name apart, `the mug left of the other mug`, and say nothing more."""

ARTICLES = _words("the a an this these those my your our")
ARTICLE_BEARING = _words("of with for or")
"""Words after which an article belongs to the same name: `leg of the table`."""

UNKNOWN_RELATIONS = _words(
    "against along among amongst around across opposite past through throughout toward towards off out outside into "
    "via at to from than beyond aside after before until during facing touching surrounding covering amid amidst "
    "away per"
)
"""Words that relate two nouns in English and that no relation here stands for. Never guessed."""

VERBS = _words("that which who whose is are was were has have should where")

DISTINGUISHING = _words(
    "left right top front behind above below under underneath beneath beside between near nearer nearest nearby next "
    "close closer closest farther farthest further furthest distant far higher lower inside outside within atop "
    "adjacent alongside middle center centre ahead most opposite without except excluding same "
    "apart aside instead rather"
)
"""Words that tell things apart wherever they stand: left out of all parts, they are told."""

STRUCTURAL = (
    AND | WITH | NEGATIONS | LINKING | RELATIVE | UNKNOWN_RELATIONS | VERBS | POSTURES | PLACE_PRONOUNS | {"of", "or"}
)
"""Words that no name begins with."""

SIDE_OF_OWNER = re.compile(r"\S+'s? (?:own )?(?:left|right|front|back|rear)(?: (?:hand )?side)?(?= |$)")
"""An object's own side, where no noun follows: `the couch's left`, and not `the dog's left paw`."""

_VIEWER = r"(?:(?:the|my|your|our|this) )?(?:camera|viewer|observer|robot|photographer|user|me|here)"
_VIEW = r"(?:point of view|viewpoint|vantage point|view|perspective|position|frame)"
_OWN = r"(?:my|our|your|this|the|the current|the given)"
_SEEN = r"(?:(?:as |when )?(?:seen|viewed|observed|looking) )"
CAMERA_VIEW = (
    rf"{_SEEN}(?:by|from|in|through) {_VIEWER}(?:'s)?(?: {_VIEW})?"
    rf"|{_SEEN}?(?:from {_VIEWER}(?:'s)?(?: {_VIEW})?|in {_VIEWER}(?:'s)? {_VIEW})"
    rf"|{_SEEN}?(?:from|in) {_OWN} {_VIEW}(?: of {_VIEWER}|(?! of))"
)
VIEW_FIRST = re.compile(
    rf"(?:{CAMERA_VIEW}|(?:{_SEEN})?in (?:the|this) (?:image|picture|photo|frame|scene|view))(?= |$)"
)
"""The camera's view named at the start of an expression; it is the frame in which all is judged."""

VIEW_WORDS = _words(
    "camera camera's viewer viewer's observer observer's robot robot's photographer photographer's user user's me here "
    "view viewpoint point perspective position frame image scene picture photo vantage"
)
NO_PLACES = VIEW_WORDS | _words(
    "there you us it them above below behind front left right top bottom back side angle outside inside standpoint"
)
"""Last words of what nobody can stand at: the camera, or a direction."""
VIEW = re.compile(rf"(?:{CAMERA_VIEW})(?= |$)")
VIEW_LAST = re.compile(rf"(?<= )(?:{CAMERA_VIEW}|in (?:the|this) (?:image|scene))$")

OBJECT_VIEW = re.compile(
    r"\bfacing (?:the|a|an|this|that|it|them|me|us|you|my|your|toward|towards|away|forward)\b"
    r"|^(?:when |if |while )?facing\b"
    r"|\b(?:faces|(?:turned|pointing|pointed|aimed|points) (?:to|at|toward|towards)) (?:the|a|an|this|that|me|it)\b"
    r"|\b(?:looking|look) (?:from|out|toward|towards|the|away)\b|\blooking at\b|\blook at the (?:front|back|face) of\b"
    r"|\S+'s? (?:point of view|viewpoint|view|perspective)\b"
    r"|\bfrom (?:the |its |their |his |her )?(?:point of view|viewpoint|perspective|view|side|position|standpoint)\b"
    r"|\b(?:seen|viewed|observed) (?:from|by)\b|\b(?:if|when|where|while|as) you "
    r"(?!(?:would|could|can|will|might|please) (?:please |kindly |just )?"
    r"(?:be|show|tell|help|find|give|bring|pass|hand|get|fetch|point|locate|identify|mind|spot)\b)(?:are |were )?\w+"
    r"|\b(?:when|while|if) (?:sitting|standing|lying|seated|looking|facing|entering)\b"
    r"|\bwith (?:your|its|the) back to\b|\bits own (?:left|right|front|back)\b"
)
"""Expressions judged from an object's own front, or from where somebody stands."""

OBJECT_VIEW_WORDS = _words(
    "facing faces turned pointing pointed points aimed looking look view viewpoint perspective seen viewed "
    "observed you when while if back own side position standpoint"
)
"""No expression without one of these words matches OBJECT_VIEW."""


GRAMMAR_WORDS = (
    LINKING
    | POSTURES
    | NEGATIONS
    | UNKNOWN_RELATIONS
    | VERBS
    | ACTIONS
    | ANYTHING
    | {"apart", "aside", "instead", "rather"}
    | LEADING_WORDS
)
"""Words that are never taken for misspelt ones."""


def wording(relation: str, *, inverse: bool = False) -> str:
    """Wording of a relation between two nouns: `left of`; for `on` from the other side, `supporting`."""
    declared = RELATIONS[relation]
    return declared.swapped_phrase or f"reached by {declared.phrase}" if inverse else declared.phrase


@lru_cache(maxsize=1)
def phrase_table() -> dict[str, tuple[str, bool]]:
    """All phrases, each with its relation and whether target and reference are swapped."""
    table = {phrase: (relation, False) for relation, phrases in SAYS.items() for phrase in phrases}
    table |= {phrase: (relation, True) for relation, phrases in SAYS_SWAPPED.items() for phrase in phrases}
    return table | {phrase: (relation, False) for phrase, relation in POSSESSIVE_TAILS.items()}
