"""Words of asking before the first thing of an expression, without meaning for it, as data."""

from __future__ import annotations

from functools import lru_cache
from itertools import chain, product


def phrases(text: str) -> frozenset[str]:
    return frozenset(text.split(", "))


_WHO = ("i", "you", "we", "one", "anyone", "anybody", "somebody", "someone")
_ASKED_TO = phrases(
    "find, spot, locate, show, pick, grab, get, give, bring, fetch, take, select, choose, detect, segment, highlight, "
    "ground, identify, mark, reach, click, hand, pass, see, look, search, point, retrieve, deliver, collect, indicate, "
    "have, use, borrow"
)
_ALONE = _ASKED_TO - {"have", "use", "see", "look", "search", "point", "borrow"}
"""Verbs that ask for a thing without a word between."""
_HELPED_BY = phrases("up, over, out, at, for, to, on, me, us, me up, me to, me at, me over, over to me, to me, on to")
_MODALS = phrases("can, could, would, will, may, might, should, shall, do, does, did")
_TRYING = phrases("help me, help us, help me to, to, and, go, go and, try to, try and")
_WHERE = phrases("where, where exactly, where else, how")
_SEEN = phrases("find, see, spot, get, leave, put, place, left, seen, reach, lose, keep")
_AT_IT = phrases("i am, i'm, we are, we're, i was, i have been, i've been")
_AFTER = phrases(
    "needing, wanting, after, searching for, trying to find, looking for, looking at, asking for, asking about, "
    "talking about, interested in, thinking of, referring to"
)
_SPEAKING = phrases("i, we, you, i'd, we'd, i would, we would, i will, i'll, i really, i just, i also, i only")
_WANTING = phrases(
    "want, need, like, love, mean, meant, see, seek, require, wish, have, prefer, want to, need to, like to, love to, "
    "have to, wish to, want you to, need you to, like you to, would like, would like to, lost, forgot, left, take, "
    "to have, like to have, would like to have, can't find, cannot find, can't see, couldn't find, don't see"
)
_KNOWING = phrases(
    "do you, do you happen to, can you, could you, would you, you, does anyone, did you, have you, do we, i, i do not, "
    "i don't"
)
_TOLD = phrases("know, tell me, see, remember, recall, seen, found, noticed, recognize, show me")
_WHICH = phrases(
    "where, which, what, where is, where are, which is, which one is, what is, if there is, whether there is"
)
_LIES = phrases("lies, stands, sits, hangs, rests, do you see, can you see, can i see, do we see, do you find, else is")
_JOINED = (
    (_MODALS, _WHO),
    (_TRYING, _ASKED_TO),
    (_ASKED_TO, _HELPED_BY),
    (("to", "help me"), _ASKED_TO, _HELPED_BY),
    (_WHERE, _MODALS | {"have"}, (*_WHO, "they"), _SEEN),
    (("did", "have", "had"), ("i", "we", "you", "they", "anyone", "somebody"), _SEEN),
    (_AT_IT, _AFTER),
    (_SPEAKING, _WANTING),
    (_KNOWING, _TOLD, _WHICH),
    (("what", "which one", "which thing", "which object"), _LIES),
)
"""Phrases of which one of each stands behind another."""
_FRAMES = phrases(
    "where can, where could, where might, where would, where should, could, would, should, "
    "whatever is, whatever's, you'll find, you'll see, you will find, you will see, you find, you can find, "
    "can't find, cannot find, couldn't find, can't see, have you seen, has anyone seen, where has, where have, "
    "where did, "
    "isn't, aren't, wasn't, isn't there, aren't there, can't you see, "
    "where, know, know where, to know, to know where, wanna know, want to know where, please, now, ok, okay, hey, "
    "hello, robot, just, then, hi, so, well, oh, um, also, and, maybe, perhaps, alright, yes, dear robot, hey "
    "robot, ok robot, thanks, sorry, excuse me, pardon me, kindly, quickly, can you please, i want, i want you "
    "to, i need, i need you to, i'd like, i'd like you to, i see, you see, you should, you need to, i wonder if "
    "you could, i was wondering if you could, i wonder, i wonder if, i think, i believe, i guess, i hope, i was "
    "wondering, i was wondering if, let me see, let me have, let's see, let's find, let us  find, let's take, "
    "let's get, lemme see, gimme, lemme have, i would like, i would like you to, i am looking  for, i'm looking "
    "for, looking for, searching for, trying to find, in search of, pickup, try to, go to, move  to, navigate to, "
    "drive to, walk to, head to, go get, go find, direct me to, lead me to, lead the way to, guide me to, take me "
    "to, bring over, please could i have, could i have, can i have, may i have, i'll have, could we have, would "
    "you mind, do you mind, be so kind as to, would you be so kind as to, would you be able  to, are you able to, "
    "be able to, is it possible to, passing me, passing, handing me, handing, giving me, bringing me, fetching "
    "me, fetching, getting me, grabbing, picking up, finding, showing me, taking, pointing  out, pointing at, "
    "telling me, pass us, give us, hand us, where is, where are, where's, where exactly is, where exactly are, "
    "where exactly, whereabouts is, where was, where were, where on earth is, what is, what  are, what's, what "
    "was, which is, which are, which one is, which one's, which ones are, which one of, which  of, which, what, "
    "what about, how about, and what about, and how about, what of, who is, is there, are there, there's, there "
    "is, there are, was there, is it true that, is it the, this is, these are, it is, it's, that  is, here is, "
    "here's, here are, is, are, does, was, were, do you see, can you see, can i see, i can see, you  can see, we "
    "see, we can see, tell me where, tell me which, tell me what, tell me, tell me where is, tell me  where i can "
    "find, tell me about, any idea where, any idea where is, any idea which, any chance of, what can  you tell me "
    "about, say where, say where is, say which, mind, the location of, the position of, the  whereabouts of, the "
    "place of"
)
LEADING_WORDS = frozenset(
    word for phrases in (_ALONE, _FRAMES, *chain(*_JOINED)) for phrase in phrases for word in phrase.split()
)
"""Words of `leading`."""


@lru_cache(maxsize=1)
def leading() -> frozenset[str]:
    """All that may stand before the first noun and says nothing about it: some 20,000 phrases."""
    return _ALONE | _FRAMES | {" ".join(words) for parts in _JOINED for words in product(*parts)}


def is_leading(said: str) -> bool:
    """Test if words are one of `leading`, which is made only where they may be."""
    return said in _ALONE or said in _FRAMES or (LEADING_WORDS.issuperset(said.split()) and said in leading())


ASKERS = phrases(
    "i, we, you, me, us, i'd, we'd, i'm, we're, i'll, we'll, i've, we've, please, kindly, anyone, anybody, someone, "
    "somebody, possible, need, want, wanna, looking, seeking, searching, trying"
)
"""Words of which a frame of asking has one, whatever else it is made of."""
_OF_FRAMES = (_ASKED_TO, _HELPED_BY, _MODALS, _TRYING, _AFTER, _AT_IT, _SPEAKING, _WANTING, _TOLD)
FRAMING = (
    ASKERS
    | frozenset(word for group in _OF_FRAMES for phrase in group for word in phrase.split())
    | phrases(
        "so, as, good, kind, nice, very, much, trouble, bother, ask, request, beg, urge, allow, permit, let, oblige, "
        "be, being, been, had, seek, seeking, hunt, hunting, hope, hoping, spotting, finding, locating, wonder, "
        "wondering, if, desire, appreciate, grateful, glad, happy, care, kindness, possible, possibly, perhaps, maybe, "
        "just, really, also, now, able, about, enough, mind, rather, it, who, pray, obliged, thankful, delighted, got, "
        "gonna, gotta, shown"
    )
) - phrases("left, lost, forgot, cannot, can't, couldn't, don't, not, on, up, over, out")
"""Words of frames of asking: `might I trouble you for`, `be so good as to show me`."""
