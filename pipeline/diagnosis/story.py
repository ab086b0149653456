"""Story of an answer: what is said of it by its verdict and the evidence, in the words of `story_words`."""

from __future__ import annotations

from collections.abc import Collection
from math import ceil, floor
from typing import Any

import numpy as np

from pipeline.answering.answer_words import best_pair, stands, why_no_answer
from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import HOLDS, ScoredPair
from pipeline.diagnosis.minimal_repair import FactorRepair, threshold
from pipeline.diagnosis.needed_score import NeededScore
from pipeline.diagnosis.story_words import TRUTHS, WORDS, Change, Story, capital, story, words
from pipeline.diagnosis.verdict import Diagnosis, Missed
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.cases import HIT, Case
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.language.tree import Query
from pipeline.system.errors import InputError

CLEARLY = 1.95
"""From so many times on a score is told as that many times the other."""
TOUCHES = 0.1
"""A box that overlaps a label at least this much is of that object, in part."""
DOUBTED = ("label.perhaps", "label.box", "label.text")
"""Kinds of which nobody can say that the answer is right."""
NUMBERS = {2: "two", 3: "three", 4: "four", 5: "five"}


def judged_story(
    d: Diagnosis,
    query: Query | None = None,
    problem: InputError | None = None,
    unknown: Collection[str] = (),
) -> Story:
    """Story of a verdict.

    `query`: what the parser read; `problem`: why it could not be read; `unknown`: names that the
    detector does not know.
    """
    case, plain = d.case, d.case.meant is None and bool(d.case.relation)
    values: dict[str, Any] = {
        "target": case.target,
        "reference": case.reference or None,
        "phrase": PHRASE.get(case.relation) if plain else None,
        "both": f"“{case.target}” and “{case.reference}”" if case.target != case.reference else f"“{case.target}”",
        "pair": "pair" if case.reference else "one",
        "place": f"another {case.target}" if case.target == case.reference else f"the {case.reference}",
        "mine": None if d.winner is None else really(d, d.winner.target, case.target_object),
    }
    values["ending"] = _ending(d, values["mine"])
    told = {
        "CORRECT": _right,
        "LABEL": _label,
        "OPM-TARGET": _missed,
        "OPM-REF": _missed,
        "UNEXPLAINED": _unexplained,
        "PARSE": _misread,
    }.get(d.verdict, _lost)
    kind, more = told(d, query=query, problem=problem, unknown=unknown)
    found = story(kind, **values | more)
    words, change = ("", None) if d.verdict in ("CORRECT", "LABEL", "UNEXPLAINED") else mend(d)
    return Story(found.kind, found.tone, found.head, found.sentence, words, change)


def unjudged_story(trace: Trace | None, problem: str | None, unjudged: str | None) -> Story:
    """Story of an answer without a verdict: not asked, not answered, or with no truth to judge by."""
    if trace is None:
        return story("refused", reason=capital((problem or "no answer").rstrip(".")))
    if trace.missing:
        return story("unseen", target=" and no ".join(trace.missing))
    if (reason := why_no_answer(trace)) is not None:
        return story("unanswered", reason=reason)
    if trace.answered is None and (pair := best_pair(trace)) is not None and stands(trace, pair) is False:
        return story("nearest")
    return story("unjudged", reason=(unjudged or WORDS["no truth"]).rstrip("."))


def _ending(d: Diagnosis, mine: str | None) -> str | None:
    """What was answered in place of what was missed; None where the answer is not among the detections."""
    if mine is not None:
        return words("ending", "another", mine=mine)
    answers = d.evidence.answers
    found, line = answers.candidates, answers.source.line
    empty = any(name in found and not len(found[name].index) for name in (d.case.target, d.case.reference))
    none = empty if line is None or line.ranked else line.answer is None
    return words("ending", "nothing") if none else None


def change_words(changed: bool, before: Story, after: Story) -> str:
    """Whether an answer under edits is another one, and right, in a few words."""
    was, now = (told.tone in ("right", "also right") for told in (before, after))
    known = all(told.tone != "none" and told.kind not in DOUBTED for told in (before, after))
    kind = "unknown" if not known else f"{'still ' if was == now else ''}{'right' if now else 'wrong'}"
    return words("changes", kind if changed else "same")


Kind = tuple[str, dict[str, Any]]


def _right(d: Diagnosis, **_: Any) -> Kind:
    case, winner = d.case, d.winner
    if not d.lucky:
        if winner is None or not case.relation or case.meant is not None:
            return "right.alone", {}
        return "right" if winner.p_relation >= HOLDS else "right.nearest", {"ours": _p(winner.p_relation)}
    if winner is None or winner.reference is None:
        return "lucky.given" if d.evidence.answers.source.line is not None else "lucky.alone", {}
    if d.false_reference:
        return "lucky.false", {"beside": _beside(d, winner)}
    return "lucky.another", {"phrase": PHRASE.get(case.relation)}


def _label(d: Diagnosis, **_: Any) -> Kind:
    case = d.case
    if d.detail in ("BAD_BOX", "BAD_LABEL"):
        return "label.box" if d.detail == "BAD_BOX" else "label.text", {}
    if d.detail == "SUSPECT":
        return "label.unlisted", {}
    sure = (
        len(case.strict) == len(case.acceptable)
        if d.winner is None
        else bool((d.evidence.overlap[d.winner.target, case.strict] >= HIT).any())
    )
    return "label.another" if sure else "label.perhaps", {"count": len(case.acceptable)}


def _misread(d: Diagnosis, query: Query | None, problem: InputError | None, **_: Any) -> Kind:
    meant = {"meant": _meant(d.case)}
    if query is None:
        return "misread.refused", meant | {"problem": None if problem is None else problem.what}
    if len(query.readings) > 1:
        return "misread.several", meant | {"count": len(query.readings)}
    e = query.expression
    read = query.default.description if e is None else f"{e.target} {PHRASE.get(e.relation, e.relation)} {e.reference}"
    return "misread", meant | {"read": read}


def _meant(case: Case) -> str:
    return " ".join(filter(None, (case.target, PHRASE.get(case.relation), case.reference)))


def _missed(d: Diagnosis, unknown: Collection[str], **_: Any) -> Kind:
    missed = d.missed
    assert missed is not None
    kind = "unknown" if d.missed_name in unknown else "suppressed" if missed.suppressed else missed.kind.lower()
    if kind == "localisation" and d.verdict == "OPM-TARGET" and d.winner is not None:
        # The answer may be the very box that fits badly.
        best = d.evidence.overlap[d.winner.target, d.case.acceptable].max(initial=0.0)
        kind = "loose" if best >= max(TOUCHES, missed.overlap - 1e-6) else kind
    role = "target" if d.verdict == "OPM-TARGET" else "reference"
    return f"{role if kind in ('absent', 'threshold') else 'missed'}.{kind}", {
        "name": d.missed_name,
        "score": None if missed.score is None else _p(missed.score),
        "overlap": _p(missed.overlap),
        "rank": missed.rank,
        "k": d.evidence.answers.source.config.k,
    }


def _unexplained(d: Diagnosis, **_: Any) -> Kind:
    line = d.evidence.answers.source.line
    answered = line is None or line.ranked or line.answer is not None
    level = {"ANSWER": 0, "PROPOSALS": 1, "BOXES": 2}.get(d.detail or "", 3)
    return f"level.{level}", {"Wrong": "Wrong" if answered else "Not answered"}


def _lost(d: Diagnosis, **_: Any) -> Kind:
    """Story of an acceptable pair that stood among the candidates and lost."""
    case, winner, right = d.case, d.winner, d.right
    if winner is None or right is None:
        if "LIFT" in d.repair:
            line = d.evidence.answers.source.line
            return "box.alike" if line is None or line.ranked else "box.given", {}
        kind = "one.alone" if winner is None else "one.alike" if case.target == case.reference else "one"
        return kind, {"targets": counted(2, case.target).removeprefix("2 ")}
    if d.detail == "DEGENERATE":
        return "ranked.tie", {}
    if d.detail == "SCORE":
        return "ranked.score", {}
    phrase, ours, theirs = _contrast(d, winner, right)
    numbers = {"phrase": phrase, "ours": ours, "theirs": theirs}
    if d.verdict == "LIFT":
        return "box", numbers | _worst_box(d, winner, right)
    if d.verdict == "ATTRIBUTE":
        return "looks", numbers
    if d.verdict == "SRM":
        return {"CHOICE": "relation.choice", "CONSTANT": "relation.constant"}.get(d.detail or "", "relation"), numbers
    if d.verdict == "COMPOUND":
        return _several(d, winner, right, phrase)
    return (_false if d.verdict == "OPM-CONF" else _outranked)(d, winner, right)


def _several(d: Diagnosis, winner: ScoredPair, right: ScoredPair, phrase: str | None) -> Kind:
    if d.repair == ("RECALL",):
        return "several.unseen", {}
    change = mend(d)[1]
    name, ours, theirs = _lead(d, winner, right, of="" if change is None else change.name)
    box = _worst_box(d, winner, right)
    values = {"phrase": phrase, "name": name, "times": _times(ours, theirs), "metres": box["metres"]}
    values["box"] = f"{box['whose']} {box['name']}"
    known = {"SRM": phrase, "CONF": values["times"], "LIFT": box["metres"]}
    short = [f"{part}.short" if part in known else part for part in d.repair]
    long = [part if known.get(part, "") is not None else f"{part}.short" for part in d.repair]
    long, short = (_joined([words("faults", kind, **values) for kind in kinds], ", and ") for kinds in (long, short))
    return "several", {"Number": NUMBERS[len(d.repair)], "faults": long, "short": short}


def _false(d: Diagnosis, winner: ScoredPair, right: ScoredPair) -> Kind:
    case = d.case
    if d.false_target and d.false_reference:
        mine, beside = really(d, winner.target, case.target_object), _beside(d, winner)
        times = _times(winner.p_target * winner.p_reference, right.p_target * right.p_reference)
        kind = "false.nothing" if mine == beside == words("really", "nothing") else "false.both"
        return kind, {"beside": beside, "times": times}
    false = case.target if d.false_target else case.reference
    name, ours, theirs = _lead(d, winner, right, of=false)
    shown = dict(zip(("ours", "theirs"), distinct_digits(ours, theirs), strict=True)) | {"times": _times(ours, theirs)}
    thing = really(d, winner.target, case.target_object) if d.false_target else _beside(d, winner)
    return "false" if name == false else "false.other", shown | {"name": false, "really": thing, "other": name}


def _outranked(d: Diagnosis, winner: ScoredPair, right: ScoredPair) -> Kind:
    case = d.case
    name, mine, other = _lead(d, winner, right)
    p_ours, p_theirs = distinct_digits(mine, other)
    values = {"name": name, "times": _times(mine, other), "p_ours": p_ours, "p_theirs": p_theirs}
    if not case.relation:
        return "ranked.thing", values
    ours, theirs = distinct_digits(winner.p_relation, right.p_relation)
    kind = "equal" if ours == theirs else "favoured" if winner.p_relation > right.p_relation else ""
    values |= {"phrase": PHRASE.get(case.relation, case.relation), "ours": ours, "theirs": theirs}
    return f"ranked.{kind}" if kind else "ranked", values


def _lead(d: Diagnosis, winner: ScoredPair, right: ScoredPair, of: str = "") -> tuple[str, float, float]:
    """Name whose score speaks most for the answer, with the scores of the answer and of the right pair.

    `of`: the name that is taken where its score clearly does.
    """
    both = (
        (d.case.target, winner.target, right.target, winner.p_target, right.p_target),
        (d.case.reference, winner.reference, right.reference, winner.p_reference, right.p_reference),
    )
    apart = [(name, ours, theirs) for name, mine, other, ours, theirs in both if mine != other]
    ratios = {t: t[1] / max(t[2], 1e-9) for t in apart}
    same = (d.case.target, winner.p_target, right.p_target)
    return max(apart, key=lambda t: (t[0] == of and ratios[t] >= CLEARLY, ratios[t]), default=same)


def _contrast(d: Diagnosis, winner: ScoredPair, right: ScoredPair) -> tuple[str | None, str | None, str | None]:
    """Part of the question speaking most for the answer, by kind where to blame, with both probabilities."""
    case = d.case
    if case.meant is None:
        return (PHRASE.get(case.relation), *distinct_digits(winner.p_relation, right.p_relation))
    of_one = {"ATTRIBUTE": ("attribute",), "SRM": ("choice", "negation", "viewer")}.get(d.verdict)
    factors = [(f, g) for f, g in zip(winner.factors, right.factors, strict=True) if of_one is None or f.kind in of_one]
    told = [(f.text, f.probability, g.probability) for f, g in factors]
    if d.verdict != "ATTRIBUTE":
        links = zip(winner.links, right.links, strict=True)
        told += [(PHRASE.get(k.relation, k.relation), k.probability, other.probability) for k, other in links]
    if not told:
        return None, None, None
    phrase, ours, theirs = max(told, key=lambda t: t[1] / max(t[2], 1e-9))
    return (phrase, *distinct_digits(ours, theirs))


def really(d: Diagnosis, index: int, example: int) -> str:
    """What a box of the answer really is: `index` among the detections, `example` a labelled object of the class."""
    evidence, truth = d.evidence, d.truth
    overlap = evidence.overlap[index]
    alike = truth.alike[example]
    if (overlap[alike] >= HIT).any():
        return words("really", "another", name=truth.labels[example])
    k = int(overlap.argmax())
    size, of_label = (np.prod(box[2:] - box[:2]) for box in (evidence.answers.boxes[index], truth.boxes[k]))
    if overlap[k] < TOUCHES:
        inside = _inside(d, index)
        if inside is None:
            return words("really", "nothing")
        k, of_label = inside, size
    loose = ("own", "own wide") if alike[k] else ("part", "wide")
    kind = "other" if overlap[k] >= HIT else loose[int(size > of_label)]
    return words("really", kind, label=truth.labels[k])


def _inside(d: Diagnosis, index: int) -> int | None:
    """Labelled object of which a detection is a small part: half of the pixels are its own; None for none."""
    truth, mask, box = (
        d.truth,
        getattr(d.evidence.answers.objects[index], "mask", None),
        d.evidence.answers.boxes[index],
    )
    if mask is None or not mask.any():
        return None
    sides = np.minimum(box[2:], truth.boxes[:, 2:]) - np.maximum(box[:2], truth.boxes[:, :2])
    shared = sides.clip(0).prod(axis=1) >= np.prod(box[2:] - box[:2]) / 2
    codes = [(int(k), truth.masks[k]) for k in np.flatnonzero(shared)]
    shares = {k: decode_run_length(mask.shape, code)[mask].mean() for k, code in codes if code is not None}
    best = max(shares, key=lambda k: shares[k], default=None)
    return best if best is not None and shares[best] >= HIT else None


def _beside(d: Diagnosis, winner: ScoredPair) -> str:
    assert winner.reference is not None
    return really(d, winner.reference, d.case.reference_object)


def _worst_box(d: Diagnosis, winner: ScoredPair, right: ScoredPair) -> dict[str, Any]:
    """The box of either pair that is farthest off: of which thing, and by how much."""
    case, evidence = d.case, d.evidence
    true = d.truth.geometry
    found: list[tuple[float, str, str | None]] = [(0.0, case.target, None)]
    for pair, whose in ((right, "correct"), (winner, "answered")) if "lo" in true else ():
        for index, name in ((pair.target, case.target), (pair.reference, case.reference)):
            if index is None or (k := int(evidence.match[index])) < 0 or not evidence.objects.known[k]:
                continue
            own = evidence.answers.objects[index].lifted
            found.append((float(np.abs([own.lo - true["lo"][k], own.hi - true["hi"][k]]).max()), name, whose))
    metres, name, whose = max(found, key=lambda f: f[0])
    by = " by estimated depth" if evidence.answers.context.frame.depth_source else ""
    return {"name": name, "whose": whose, "metres": f"{metres:.2f}" if whose else None, "by": by}


def mend(d: Diagnosis) -> tuple[str, Change | None]:
    """Smallest change to make the answer right, in words and as a what-if can try it."""
    if d.verdict == "PARSE":
        # Of a sentence with more than a relation, these words would leave out some of what was meant.
        asked = None if d.case.meant is not None or not d.case.relation else _meant(d.case)
        return ("", None) if asked is None else (words("mends", "asked", meant=asked), Change("question", asked))
    if d.missed is not None:
        return _found(d, d.missed)
    if d.needed_box is not None:
        place, k = d.needed_box
        name = d.case.target if place in [p.target for p in (d.right, d.winner) if p] else d.case.reference
        labelled = ((name, int(d.truth.numbers[k])),)
        return words("mends", "box", name=name), Change("boxes", name, (place,), labelled=labelled)
    rise = next(((n, n.right_above) for n in d.needed if n.right_above is not None), None)
    if rise is not None:
        return _moved(d, rise[0], "right", rise[0].right, rise[1], d.right)
    falls = [(n, n.winner_below) for n in d.needed if n.winner_below is not None]
    if falls:
        least, below = min(falls, key=lambda f: f[0].winner - f[1])
        return _moved(d, least, "winner", least.winner, below, d.winner)
    if d.needed_score is not None:
        names = list(dict.fromkeys(name for name, _ in d.needed_score.scored))
        kind = "both" if len(names) > 1 else "alike"
        return _scored(d, d.needed_score, None, kind, name=names[0], targets=counted(2, names[0]).removeprefix("2 "))
    if d.repair:
        return words("mends", "truths", truths=_joined([TRUTHS[part] for part in d.repair])), None
    return words("mends", "none") if d.needed or d.verdict == "PRM" else "", None


def _found(d: Diagnosis, missed: Missed) -> tuple[str, Change | None]:
    """What an object that was missed would have to be: found, and with which score."""
    needed, done = d.needed_score, words("done", missed.kind)
    if needed is None:
        others = [part for part in d.repair if part != "RECALL"]
        short = (f"{part}.short" if part in ("LIFT", "SRM", "CONF") else part for part in others)
        faults = _joined([words("faults", kind, name="thing") for kind in short])
        kind = "found.more" if others else "found"
        return words("mends", kind, name=d.missed_name, done=done, faults=faults) if d.repair else "", None
    names = _joined(list(dict.fromkeys(name for name, _ in needed.missing)))
    # A detection that was cut off, or that does not fit, has a score; what nobody saw may have any.
    own = missed.score if missed.kind != "ABSENT" and len(needed.missing) == 1 else None
    likely = d.evidence.confidence if own is None else own
    if needed.above < likely < needed.below and not needed.scored:
        return words("mends", "found", name=names, done=done), _change(d, needed, own, likely)
    kind = "fit.above" if needed.loose is not None else "right"
    kind = "found.both" if needed.scored else "found.above" if own is None else kind
    return _scored(d, needed, own, kind, name=names, done=done, what=words("factors", "target", target=names))


def _scored(
    d: Diagnosis, needed: NeededScore, own: float | None, kind: str, **values: Any
) -> tuple[str, Change | None]:
    """Mend by a score above what is needed; `own`: what it is now."""
    shown, now = threshold(needed.above, own or 0.0)
    # A little more: the pixels of a labelled thing are lifted anew.
    enough = beyond(1.05 * needed.above, len(shown.partition(".")[2]), up=True)
    after = min(enough, (needed.above + needed.below) / 2)
    others = _joined(list(dict.fromkeys(name for name, _ in needed.scored)))
    said = words("mends", kind, value=shown, now=now, others=others, **values)
    return said, _change(d, needed, own, after)


def _change(d: Diagnosis, needed: NeededScore, own: float | None, after: float) -> Change:
    labelled = tuple((name, int(d.truth.numbers[k])) for name, k in needed.missing)
    names, places = zip(*needed.scored, strict=True) if needed.scored else ((), ())
    if needed.loose is not None:
        return Change("masks", labelled[0][0], (needed.loose, *places), own, after, labelled, (labelled[0][0], *names))
    field = "added" if labelled else "confidences"
    return Change(field, (*(name for name, _ in labelled), *names)[0], places, own, after, labelled, names)


def _moved(
    d: Diagnosis, n: FactorRepair, whose: str, now: float, bound: float, pair: ScoredPair | None
) -> tuple[str, Change | None]:
    case = d.case
    shown, before = threshold(bound, now)
    # Of two pairs that are both next to 0: what is enough says more than what is just enough.
    enough = whose == "right" and bound < 0.01 and now < 0.005 and n.factor != "reference"
    kind = f"{whose}.enough" if enough else f"{whose}.tie" if shown == before else whose
    phrase = PHRASE.get(case.relation, case.relation)
    factor = n.factor if whose == "right" else f"{n.factor}.winner"
    what = words("factors", factor, target=case.target, reference=case.reference, phrase=phrase)
    said = words("mends", kind, what=what, value="0.01" if enough else shown, now=f"{now:.2f}" if enough else before)
    if pair is None or n.factor == "attributes":
        return said, None
    after = 0.01 if enough else beyond(bound, len(shown.partition(".")[2]), up=whose == "right")
    if n.factor == "relation":
        ends = tuple(k for k in (pair.target, pair.reference) if k is not None)
        return said, Change("relations", case.relation, ends, now, after)
    end, name = (pair.target, case.target) if n.factor == "target" else (pair.reference, case.reference)
    return said, None if end is None else Change("confidences", name, (end,), now, after)


def beyond(bound: float, digits: int, up: bool) -> float:
    """Probability just beyond a bound, of so many digits where there is one."""
    step = 10.0**-digits
    found = (floor(bound / step) + 1) * step if up else (ceil(bound / step) - 1) * step
    return round(found, digits) if 0 < found < 1 else (bound + up) / 2


def distinct_digits(one: float, other: float) -> tuple[str, str]:
    """Two probabilities with two digits, or with as many more as distinguish them."""
    for digits in range(2, 10):
        shown = f"{one:.{digits}f}", f"{other:.{digits}f}"
        if (shown[0] == shown[1]) == (one == other):
            return shown
    return f"{one:.2f}", f"{other:.2f}"


def _times(ours: float, theirs: float) -> str | None:
    """Ratio in words; None where it is next to nothing."""
    ratio = ours / max(theirs, 1e-9)
    return None if ratio < CLEARLY else f"{ratio:.0f}" if ratio < 1000 else "over 1,000"


def _joined(parts: list[str], last: str = " and ") -> str:
    return last.join(filter(None, (", ".join(parts[:-1]), parts[-1]))) if parts else ""


def _p(value: float) -> str:
    return f"{value:.2f}"
