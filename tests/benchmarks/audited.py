"""Wrong truths planted in sentences about rendered rooms: how far up the audit ranks them.

    python -m tests.benchmarks.audited [--seed N] [--rooms N] [--views N] [--people 0|1]

What is true follows from the exact 3D boxes of the rooms. The audit does not see these: its annotations have masks that
are eroded, dilated or leak into what lies beside, over depth with noise, so that its geometry differs from the truth as
that of any benchmark does. Systems are simulated detectors of three seeds, with the relation networks and rules that
every pipeline here has; their errors are their own, and alike. In a tenth of the sentences the truth is made wrong:

same class   another thing of the asked class is said to be right
other class  a thing of another class is
word         the sentence says the opposite relation
several      one of several right things is said to be the only one (and the sentence says "the")

With `--people` the sentences have people's words (`people_words`), a fifth is wrong, as many of each of the first three
ways as there can be, and people's own sentences about annotated frames follow, sound and with every wrong truth that is
possible.

Printed for each way to rank: the area under the ROC curve with the middle 95 % when items are drawn again, and the
share of planted items among the first k, of which k are planted. Weights were set on seed 11, of people's words on
part 0; seed 12 and part 1 were held out.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.audit.sentences import audit_sentences
from pipeline.audit.suspicion import AuditItem, Evidence, SystemAnswers, wrong_probability
from pipeline.datasets import demo_path, open_dataset
from pipeline.datasets.base import InMemoryDataset, resolve_frame
from pipeline.evaluation.sentence_files import Sentence, SentenceFile
from pipeline.geometry.frame import Annotation, Frame
from pipeline.language.naming import same_class
from pipeline.language.noun_phrase import readable, same_names
from pipeline.language.relation_names import INVERSE, PAIRWISE, PHRASE
from pipeline.proposals.simulated import SimulatedDetector, SimulationOptions, leaked, resized
from pipeline.relations.pair_measures import AllMeasures, Profile, T, U, measure_pairs
from pipeline.relations.relations import PREDICATES, pair_states
from pipeline.synthetic import render_dataset
from pipeline.system.errors import InputError

from .people_words import LANGUAGE, Made, opposite, people_sentences, referring

YCBV = LANGUAGE.parent / "real" / "ycbv-bop"
WAYS = ("same class", "other class", "word", "several")
PLANTED, PLANTED_PEOPLE, PER_FRAME, SYSTEMS = 0.1, 0.2, 24, 3
DEPTH_NOISE, LEAKS, PIXELS = 0.01, 0.1, 3
RELATIONS = tuple(r for r in PAIRWISE if not PREDICATES[r].reads_points)


@dataclass(frozen=True)
class Planted:
    """A sentence, and in which way its truth was made wrong; None where it was not."""

    sentence: Sentence
    way: str | None


@dataclass(frozen=True)
class Ranking:
    """How well planted items are told from others.

    Attributes
    ----------
    auc : float
    precision : float
        Among the first k, of k that are planted.
    """

    auc: float
    precision: float


def noisy(frame: Frame, rng: np.random.Generator) -> Frame:
    """The frame as the audit sees it: other masks, noise on the depth, no exact boxes."""

    def mask_of(a: Annotation) -> np.ndarray:
        assert a.mask is not None
        if rng.random() < LEAKS:
            return leaked(a.mask, float(rng.uniform(0, 2 * np.pi)), ~a.mask & (frame.depth > 0))
        found = resized(a.mask, int(rng.integers(-PIXELS, PIXELS + 1)))
        return found if found.any() else a.mask

    annotations = tuple(replace(a, mask=mask_of(a), box=None) for a in frame.annotations)
    noise = rng.normal(1, DEPTH_NOISE, frame.depth.shape).astype(np.float32)
    return replace(frame, depth=frame.depth * noise, annotations=annotations)


def exact_states(source: Pipeline, frame: Frame) -> np.ndarray:
    """(N, N, R) int8: the relations of the things' whole boxes."""
    matrix = source.prepare(frame.id).viewer.matrix
    corners = [a.box.corners @ matrix.T for a in frame.annotations if a.box is not None]
    lo, hi = (np.array([f(c, axis=0) for c in corners]) for f in (np.min, np.max))
    known = np.ones(len(lo), np.bool_)
    return pair_states(AllMeasures(measure_pairs(lo, hi, Profile()), Profile()), known, RELATIONS)


def sentences_of(context: PreparedFrame, states: np.ndarray, rng: np.random.Generator) -> Iterator[Made]:
    """Some sentences "the A RELATION the B" with one B, some A and nothing too close to call, in a random order."""
    labels = [a.label for a in context.frame.annotations]
    alike = same_names(labels)
    found = []
    for b in np.flatnonzero(alike.sum(axis=1) == 1):
        for name in sorted(set(labels) - {labels[b]}):
            targets = alike[labels.index(name)]
            for r, relation in enumerate(RELATIONS):
                column = states[:, b, r]
                if not (column[targets] == U).any() and (column[targets] == T).any():
                    ends = f"the {readable(name)}", f"the {readable(labels[b])}"
                    other = INVERSE.get(relation, relation)
                    turned = None if other == relation else f" {PHRASE[other]} ".join(ends)
                    right = np.flatnonzero(targets & (column == T))
                    found.append(Made(f" {PHRASE[relation]} ".join(ends), targets, right, turned))
    rng.shuffle(found)  # pyright: ignore[reportArgumentType]
    yield from found


def planted_sentences(
    source: Pipeline, seed: int, frames: Sequence[str], per_frame: int, part: int | None = None
) -> Iterator[Planted]:
    """Sentences with their truth, a tenth of them made wrong in one of WAYS; `part` of people's words, or our own."""
    rng = np.random.default_rng(seed)
    line = 0
    planted: Counter[str] = Counter()
    for frame_id in frames:
        context = source.prepare(frame_id)
        numbers = np.array([a.index for a in context.frame.annotations])
        plain = several = 0
        if part is None:
            made = sentences_of(context, exact_states(source, context.frame), rng)
        else:
            made = people_sentences(context, rng, part)
        for one in made:
            way: str | None = None
            said, right = one.text, one.right
            if len(right) > 1:
                # Of these each is planted: one of several right things is said to be the only one.
                several += 1
                way, right = "several", right[:1]
                if several > max(1, round(per_frame * PLANTED / len(WAYS))) or (part is not None and "the" not in said):
                    continue
            else:
                plain += 1
                if plain > per_frame:
                    continue
                others = np.setdiff1d(np.arange(len(numbers)), right)
                alternatives = {
                    "same class": others[one.named[others]],
                    "other class": others[~one.named[others]],
                    "word": others if one.opposite else others[:0],
                }
                possible = [name for name in WAYS if len(alternatives.get(name, ()))]
                if rng.random() < (PLANTED if part is None else PLANTED_PEOPLE) and possible:
                    # Of people's words as many of each way as there can be: other classes would be most.
                    way = str(rng.choice(possible)) if part is None else min(possible, key=lambda w: planted[w])
                    planted[way] += 1
                    if way == "word":
                        said = one.opposite or said
                    else:
                        right = rng.choice(alternatives[way], 1)
            line += 1
            told = way or ("misspelt" if one.misspelt else "sound")
            yield Planted(Sentence(line, frame_id, said, told, targets=tuple(numbers[right].tolist())), way)


def system_answers(source: Pipeline, asked: Sequence[Planted], seed: int) -> SystemAnswers:
    """A pipeline with a simulated detector, asked all sentences."""
    options = SimulationOptions(seed=seed, recall=0.9, cross_class=0.4, corrupted=0.2)
    detector = SimulatedDetector(options, class_names=source.dataset.class_names, synonyms=source.synonyms)
    own = replace(source, detector=detector)
    found: dict[tuple[str, str], tuple[float, ...]] = {}
    contexts = {frame: own.prepare(frame) for frame in dict.fromkeys(p.sentence.frame for p in asked)}
    for sentence in (p.sentence for p in asked):
        try:
            trace = own.ask(contexts[sentence.frame], sentence.text)
        except InputError:
            continue
        if trace.ranking is not None and trace.ranking.pairs:
            bbox = trace.objects[trace.ranking.pairs[0].target].bbox
            found[sentence.frame, sentence.text] = tuple(float(v) for v in bbox)
    return SystemAnswers(f"simulated {seed}", found)


def ranking(items: Sequence[AuditItem], ways: Sequence[str | None], kept: Callable[[Evidence], bool]) -> Ranking:
    """How well the score by some of the evidence tells planted items; equal scores count a half."""
    score = np.array([wrong_probability(e for e in item.evidence if kept(e)) for item in items])
    wrong = np.array([way is not None for way in ways])
    above = score[wrong][:, None] - score[~wrong][None]
    auc = float(((above > 0) + 0.5 * (above == 0)).mean())
    # Among equal scores the expected share.
    order = np.argsort(-score, kind="stable")
    k = int(wrong.sum())
    edge = score[order[k - 1]]
    sure, tied = wrong[score > edge], wrong[score == edge]
    return Ranking(auc, float((sure.sum() + tied.mean() * (k - len(sure))) / k))


RANKED: dict[str, Callable[[Evidence], bool]] = {
    "geometry, class, frame, several": lambda e: e.kind != "systems",
    "systems": lambda e: e.kind == "systems",
    "all": lambda e: True,
}


def audited(
    root: Path,
    seed: int,
    frames: slice = slice(None),
    per_frame: int = PER_FRAME,
    systems: int = SYSTEMS,
    part: int | None = None,
) -> tuple[list[AuditItem], list[Planted]]:
    """Every item with its evidence, and in which way it was planted; `part` of people's words, or our own."""
    dataset = open_dataset(root)
    source = open_pipeline(dataset)
    ids = dataset.frame_ids[frames]
    asked = list(planted_sentences(source, seed, ids, per_frame, part))
    answered = [system_answers(source, asked, seed * 100 + k) for k in range(systems)]
    rng = np.random.default_rng(seed + 1)
    seen = InMemoryDataset(noisy(dataset.load(frame_id), rng) for frame_id in ids)
    file = SentenceFile(root, tuple(p.sentence for p in asked), {})
    return list(audit_sentences(open_pipeline(seen), file, answered)), asked


def audited_referring(part: int, seed: int, systems: int = SYSTEMS) -> tuple[list[AuditItem], list[Planted]]:
    """People's sentences about annotated frames, as they are and with each wrong truth that is possible."""
    items: list[AuditItem] = []
    asked: list[Planted] = []
    for name, root in (("demo", demo_path()), ("ycbv-bop", YCBV)):
        rng = np.random.default_rng(seed)
        source = open_pipeline(open_dataset(root))
        mine = [p for line in referring(name, part) for p in _planted_referring(line, source, rng)]
        answered = [system_answers(source, mine, seed * 100 + k) for k in range(systems)]
        file = SentenceFile(root, tuple(p.sentence for p in mine), {})
        items += [by_line for _, by_line in sorted((int(i.id), i) for i in audit_sentences(source, file, answered))]
        asked += mine
    return items, asked


def _planted_referring(line: dict[str, Any], source: Pipeline, rng: np.random.Generator) -> Iterator[Planted]:
    frame_id = resolve_frame(source.dataset, line["frame"])
    labels = {a.index: a.label for a in source.dataset.load(frame_id).annotations}
    text, right = line["sentence"], tuple(line["targets"])
    _lines_used.append(text)
    alike = [k for k in labels if k not in right and same_class(labels[k], labels[right[0]])]
    others = [k for k in labels if k not in right and k not in alike]
    turned = None if re.search("second|third|between|first|last", text) else opposite(text, rng)
    yield Planted(Sentence(len(_lines_used), frame_id, text, "sound", targets=right), None)
    wrong = [("same class", text, (int(rng.choice(alike)),))] if alike else []
    wrong += [("other class", text, (int(rng.choice(others)),))]
    wrong += [("word", turned[0], right)] if turned else []
    for way, said, targets in wrong:
        _lines_used.append(said)
        yield Planted(Sentence(len(_lines_used), frame_id, said, way, targets=targets), way)


_lines_used: list[str] = []


def interval(items: Sequence[AuditItem], ways: Sequence[str | None], kept: Callable[[Evidence], bool]) -> str:
    """The middle 95 % of the AUC when items are drawn again, 1,000 times."""
    rng = np.random.default_rng(0)
    score = np.array([wrong_probability(e for e in item.evidence if kept(e)) for item in items])
    wrong = np.array([way is not None for way in ways])
    found = []
    for _ in range(1000):
        drawn = rng.integers(len(score), size=len(score))
        ranks = rankdata(score[drawn])
        k = wrong[drawn].sum()
        found.append((ranks[wrong[drawn]].sum() - k * (k + 1) / 2) / (k * (len(drawn) - k)))
    return "{:.3f} to {:.3f}".format(*np.quantile(found, (0.025, 0.975)))


def told(title: str, items: Sequence[AuditItem], asked: Sequence[Planted], worst: int = 0) -> None:
    """Print the figures; of `worst` items each, those that rank most wrongly."""
    ways = [p.way for p in asked]
    k = sum(way is not None for way in ways)
    print(f"{title}: {len(items)} sentences, {k} planted, {sum(i.unjudged is not None for i in items)} not judged")
    for name, kept in RANKED.items():
        found = ranking(items, ways, kept)
        at = f"AUC {found.auc:.3f} ({interval(items, ways, kept)})"
        print(f"  {name:<34} {at}  precision at {k}: {found.precision:.2f}")
    scores = np.array([item.score for item in items])
    order = np.argsort(-scores, kind="stable")
    first = set(order[:k].tolist())
    for kind in (*WAYS, "misspelt", "sound"):
        of_kind = [n for n, p in enumerate(asked) if p.sentence.kind == kind]
        if of_kind:
            share = sum(n in first for n in of_kind) / len(of_kind)
            mean = scores[of_kind].mean()
            print(f"  {kind:<12} {len(of_kind):4d}  among the first {share:.2f}  mean score {mean:.2f}")
    for low, high in ((0, 0.05), (0.05, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 1.01)):
        here = [way is not None for way, s in zip(ways, scores, strict=True) if low <= s < high]
        if here:
            print(f"  score {low:.2f} to {min(high, 1):.2f}: {len(here):4d} items, {np.mean(here):.2f} planted")
    sound = [n for n in order if ways[n] is None][:worst]
    missed = [n for n in order[::-1] if ways[n] is not None][:worst]
    for n in (*sound, *missed):
        item, reasons = items[n], "; ".join(f"{e.kind} {e.weight:.2f}: {e.text}" for e in items[n].evidence)
        print(f"  {item.score:.2f} {asked[n].sentence.kind}: {item.text!r} = {item.truth} [{item.unjudged}] {reasons}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--rooms", type=int, default=12)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--rendered", type=Path)
    parser.add_argument("--people", type=int, choices=(0, 1), help="people's words: 0 for setting weights, 1 held out")
    parser.add_argument("--worst", type=int, default=0, help="print so many items that rank most wrongly")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = options.rendered or Path(folder) / "rooms"
        if not root.exists():
            render_dataset(root, rooms=options.rooms, views=options.views, seed=options.seed, width=400, height=300)
        told(f"rooms of seed {options.seed}", *audited(root, options.seed, part=options.people), options.worst)
    if options.people is not None:
        told("referring", *audited_referring(options.people, options.seed), options.worst)


if __name__ == "__main__":
    main()
