"""Sentences of auto-labels as people say them: read back as meant, true of just their answers, off by default."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.answering import PreparedFrame, SceneObject, open_pipeline, prepare_frame, record_detections
from pipeline.evaluation import evaluate_sentences
from pipeline.labels import (
    SENTENCE_KINDS,
    SENTENCES_FILE,
    LabelConfig,
    Labels,
    SourceSpec,
    canonical_hash,
    label_dataset,
    label_objects,
    open_labeller,
    open_labels,
)
from pipeline.labels.labelling import FrameLabels
from pipeline.labels.report import dataset_card
from pipeline.labels.sentence_maker import (
    COUNTED,
    EXTREME_WORDS,
    LOOKS,
    PHRASES,
    SECONDS,
    SIDES,
    MadeSentence,
    make_sentences,
    tree_text,
)
from pipeline.labels.tree_truth import TreeTruth
from pipeline.language import PAIRWISE, Attachment, Choice, Node, attribute, parse, same_names
from pipeline.relations import F, T, U
from pipeline.system import InputError

DEMO = SourceSpec("demo")
FRAMES = 6
ALL = LabelConfig(sentences=SENTENCE_KINDS, sentences_a_kind=50)


@dataclass(frozen=True)
class Seen:
    """A labelled frame with its sentences."""

    context: PreparedFrame
    objects: tuple[SceneObject, ...]
    labels: FrameLabels
    made: tuple[MadeSentence, ...]

    @property
    def truth(self) -> TreeTruth:
        judged, rows = self.labels.judged, self.labels.objects
        assert judged is not None
        return TreeTruth(self.context, self.objects, judged.states, rows["usable"], rows["occluded"])


@pytest.fixture(scope="module")
def names() -> tuple[str, ...]:
    return tuple(open_pipeline("demo").dataset.class_names)


@pytest.fixture(scope="module")
def seen(names: tuple[str, ...]) -> tuple[Seen, ...]:
    labeller = open_labeller(DEMO, ALL)
    source, detector, found = labeller.source, labeller.source.needed_detector(), []
    for frame_id in source.dataset.frame_ids[::2]:
        context = prepare_frame(source.dataset, source.dataset.load(frame_id))
        objects = context.lift(detector.detect(context.frame, None), detector)
        labels = label_objects(context, objects, ALL, frame_index=0, scene="s", exact=True, network=labeller.network)
        found.append(Seen(context, objects, labels, make_sentences(context, objects, labels, ALL, names)))
    return tuple(found)


def test_every_sentence_is_read_as_the_tree_it_was_made_from(seen: tuple[Seen, ...], names: tuple[str, ...]) -> None:
    counts = Counter(sentence.kind for frame in seen for sentence in frame.made)
    assert min(counts[kind] for kind in SENTENCE_KINDS) >= 5, counts
    for sentence in (s for frame in seen for s in frame.made):
        query = parse(sentence.text, class_names=names)
        assert [r.root for r in query.readings] == [sentence.tree], sentence.text
        assert not query.unused, sentence.text
        assert query.kind == sentence.kind, sentence.text


NOUNS = st.sampled_from(["mug", "coffee table", "book", "armchair", "potted plant", "scissors"])
CHOICES = st.one_of(
    st.sampled_from([(Choice(order, 1, text),) for order, words in EXTREME_WORDS.items() for text in words]),
    st.sampled_from([(Choice(order, 2, text),) for order, text in SECONDS.items()]),
    st.sampled_from([(Choice("left", k, f"{word} from the left"),) for k, word in enumerate(COUNTED, 2)]),
    st.sampled_from(
        [tuple(Choice(o, None, text) for o in orders) for orders, words in SIDES.items() for text in words]
    ),
    st.just(()),
)


@st.composite
def nouns(draw: st.DrawFn, mention: int = 0) -> Node:
    name, word = draw(NOUNS), draw(st.sampled_from([None, *(word for words in LOOKS for word in words)]))
    if word is None:
        return Node(name, mention=mention)
    told = attribute(word)
    assert told is not None
    return Node(f"{word} {name}", mention=mention, head=name, attributes=(told,))


@st.composite
def trees(draw: st.DrawFn) -> Node:
    relations = draw(st.lists(st.sampled_from([(r, p) for r in PAIRWISE for p in PHRASES[r]]), max_size=2))
    negated = draw(st.booleans())
    attachments = tuple(
        Attachment(r, (draw(nouns(k)),), False, phrase, negated=negated and k == len(relations))
        for k, (r, phrase) in enumerate(relations, start=1)
    )
    # A side or an end after the noun takes no relation after it.
    choices = draw(CHOICES)
    alone = any(c.rank is None for c in choices)
    return replace(draw(nouns()), attachments=() if alone else attachments, choices=choices)


@settings(max_examples=75, deadline=None)
@given(trees(), st.sets(st.integers(0, 2)), st.integers(0, 2**64 - 1))
def test_a_tree_in_words_is_read_as_that_tree(tree: Node, several: set[int], key: int) -> None:
    names = ("mug", "coffee table", "book", "armchair", "potted plant", "scissors")
    text = tree_text(tree, several, key)
    assert parse(text, class_names=names).default.root == tree, text
    for node in tree.walk():
        article = {True: ("a ", "an ", "some "), False: ("the ",)}[node.mention in several]
        assert any(f"{a}{node.label}" in text for a in article) or node.choices, text


def alone(frame: Seen, sentence: MadeSentence) -> np.ndarray:
    """(N,) bool: objects of the target's name, by the names alone."""
    same = same_names([o.label for o in frame.objects])
    return same[sentence.answers[0]]


def test_relations_are_those_of_the_labels(seen: tuple[Seen, ...]) -> None:
    checked = 0
    for frame in seen:
        judged = frame.labels.judged
        assert judged is not None
        labels = [o.label for o in frame.objects]
        for sentence in (s for s in frame.made if s.kind in ("two-relations", "negation")):
            holds = alone(frame, sentence)
            for attachment in sentence.tree.attachments:
                state = judged.states[..., PAIRWISE.index(attachment.relation)]
                to = np.array([label == attachment.nodes[0].label for label in labels])
                some, maybe = (state[:, to] == T).any(axis=1), (state[:, to] >= U).any(axis=1)
                # What is undecided decides nothing: sure to hold of the answers, sure not to of all others.
                holds = holds & (~maybe if attachment.negated else some)
            assert tuple(np.flatnonzero(holds)) == sentence.answers, sentence.text
            checked += 1
    assert checked > 60


def test_orders_are_those_of_the_picture_and_of_space(seen: tuple[Seen, ...]) -> None:
    keys = {
        "left": lambda o: o.bbox[0] + o.bbox[2],
        "right": lambda o: -o.bbox[0] - o.bbox[2],
        "near": lambda o: o.lifted.quality.distance,
        "far": lambda o: -o.lifted.quality.distance,
    }
    checked: Counter[str] = Counter()
    for frame in seen:
        for sentence in (s for s in frame.made if s.kind in ("ordinal", "extreme") and not s.tree.attachments):
            (choice,) = sentence.tree.choices
            if choice.order in keys:
                ours = np.flatnonzero(alone(frame, sentence))
                order = sorted(ours, key=lambda k: keys[choice.order](frame.objects[k]))
                assert choice.rank is not None
                assert (order[choice.rank - 1],) == sentence.answers, sentence.text
                assert sentence.kind == "extreme" or len(ours) >= 3
                checked[choice.order] += 1
    assert min(checked[order] for order in keys) >= 3, checked


def test_an_attribute_decides(seen: tuple[Seen, ...]) -> None:
    for frame in seen:
        for sentence in (s for s in frame.made if s.kind == "attribute" and s.tree.attributes):
            bare = replace(sentence.tree, label=sentence.tree.name, head="", attributes=())
            assert (frame.truth.means(bare) >= U).sum() > max(1, len(sentence.answers)), sentence.text


def test_the_article_says_how_many(seen: tuple[Seen, ...]) -> None:
    for frame, sentence in ((f, s) for f in seen for s in f.made):
        one = len(sentence.answers) == 1
        phrase = sentence.text.split(sentence.tree.name)[0]
        assert (" the " in f" {phrase} ") == one, sentence.text
        assert one or 2 * len(sentence.answers) <= alone(frame, sentence).sum(), sentence.text


def test_what_is_near_a_threshold_is_in_no_sentence(seen: tuple[Seen, ...]) -> None:
    frame = next(f for f in seen if sum(o.label == "mug" for o in f.objects) == 2)
    a, b = (k for k, o in enumerate(frame.objects) if o.label == "mug")
    leftmost, red = Node("mug", choices=(Choice("left", 1, "leftmost"),)), Node("red mug", head="mug")
    red = replace(red, attributes=(attribute("red"),))  # type: ignore[arg-type]
    assert sorted(frame.truth.means(leftmost)[[a, b]]) == [F, T]

    def moved(**changed: Any) -> TreeTruth:
        objects = list(frame.objects)
        objects[b] = replace(objects[b], **changed)
        return replace(frame, objects=tuple(objects)).truth

    assert moved(bbox=frame.objects[a].bbox + 2).means(leftmost)[[a, b]].tolist() == [U, U]
    # What may not be asked for may still be the leftmost, or else is none that comes before.
    first = frame.truth.means(leftmost)[a]
    for unusable, expected in ((a, {T: [U, U], F: [F, T]}), (b, {T: [T, F], F: [U, U]})):
        truth = frame.truth
        truth.usable[unusable] = False
        assert truth.means(leftmost)[[a, b]].tolist() == expected[first]
    # What is half of a colour, and half of another, has neither for sure.
    split = frame.context.frame.rgb.copy()
    mask = frame.objects[a].mask
    split[mask] = (200, 20, 20)
    rows = np.flatnonzero(mask.any(axis=1))
    painted = {T: split.copy(), U: split.copy(), F: split.copy()}
    painted[U][rows[len(rows) // 2] :][mask[rows[len(rows) // 2] :]] = (20, 40, 200)
    painted[F][mask] = (20, 40, 200)
    for state, rgb in painted.items():
        context = frame.context
        context = replace_frame(context, rgb)
        assert replace(frame, context=context).truth.means(red)[a] == state


def replace_frame(context: PreparedFrame, rgb: np.ndarray) -> PreparedFrame:
    return PreparedFrame(replace(context.frame, rgb=rgb), context.config)


def test_a_relation_that_is_undecided_decides_nothing(seen: tuple[Seen, ...]) -> None:
    frame = next(f for f in seen if any(s.kind == "two-relations" for s in f.made))
    judged = frame.labels.judged
    assert judged is not None
    doubted = replace(frame.labels, judged=replace(judged, states=np.full_like(judged.states, U)))
    names = [o.label for o in frame.objects]
    made = make_sentences(frame.context, frame.objects, doubted, ALL, names)
    assert not [s for s in made if s.kind in ("two-relations", "negation")]
    assert [s for s in made if s.kind == "extreme"]


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Labels:
    out = tmp_path_factory.mktemp("sentences") / "labels"
    label_dataset(DEMO, out, LabelConfig(sentences=SENTENCE_KINDS), limit=FRAMES, frames_a_shard=2)
    return open_labels(out)


def lines(labels: Labels) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (labels.root / SENTENCES_FILE).read_text().splitlines()]


@pytest.mark.slow
def test_the_evaluation_reads_the_file_and_answers_it(labelled: Labels) -> None:
    report = evaluate_sentences(labelled.root / SENTENCES_FILE, open_pipeline("demo"), name="demo")
    assert len(report.judged) == sum(labelled.manifest.sentences.values()) > 60
    assert all(j.read for j in report.judged)
    wrong = [(j.sentence.text, j.outcome, j.detail) for j in report.judged if not j.right]
    assert len(wrong) <= 0.03 * len(report.judged), wrong


@pytest.mark.slow
def test_the_card_and_the_manifest_count_them(labelled: Labels) -> None:
    counts = Counter(line["kind"] for line in lines(labelled))
    assert labelled.manifest.sentences == {kind: counts[kind] for kind in SENTENCE_KINDS}
    per_frame = Counter((line["frame"], line["kind"]) for line in lines(labelled))
    assert max(per_frame.values()) == 4
    card = dataset_card(labelled)
    assert all(f"| {kind} | {n} |" in card for kind, n in counts.items())
    assert SENTENCES_FILE not in dataset_card(labelled, files={t: f"{t}.parquet" for t in labelled.manifest.tables})


@pytest.mark.slow
def test_without_the_option_all_is_as_it_was(labelled: Labels, tmp_path: Path) -> None:
    manifest = label_dataset(DEMO, tmp_path / "plain", limit=FRAMES, frames_a_shard=2).manifest
    assert manifest is not None
    assert not manifest.sentences
    assert not (tmp_path / "plain" / SENTENCES_FILE).exists()
    assert {n: t.content_hash for n, t in manifest.tables.items()} == {
        n: t.content_hash for n, t in labelled.manifest.tables.items()
    }
    for text in ((tmp_path / "plain" / name).read_text() for name in ("plan.json", "manifest.json", "README.md")):
        assert "sentences_" not in text
    config = LabelConfig()
    assert config.hash == canonical_hash(config.record()) != LabelConfig(sentences=("side",)).hash
    assert not [name for name in config.record() if name.startswith("sentences")]
    assert LabelConfig(sentences_a_kind=9).hash == config.hash


@pytest.mark.slow
def test_the_same_seed_gives_the_same_sentences(labelled: Labels, tmp_path: Path) -> None:
    again, other = (LabelConfig(sentences=("side", "ordinal"), seed=seed) for seed in (0, 1))
    label_dataset(DEMO, tmp_path / "again", again, limit=FRAMES, frames_a_shard=1)
    label_dataset(DEMO, tmp_path / "other", other, limit=FRAMES)
    found = [lines(open_labels(tmp_path / name)) for name in ("again", "other")]
    assert found[0] == [line for line in lines(labelled) if line["kind"] in ("side", "ordinal")]
    assert found[1] != found[0]


def test_what_a_detector_found_is_told_by_boxes(tmp_path: Path) -> None:
    source = open_pipeline("demo")
    record_detections(
        source, tmp_path / "found.json", source.dataset.class_names, frame_ids=source.dataset.frame_ids[:2]
    )
    spec = SourceSpec("demo", {"detector": "recorded", "model": str(tmp_path / "found.json")})
    label_dataset(spec, tmp_path / "labels", LabelConfig(sentences=("extreme",)), limit=2)
    found = lines(open_labels(tmp_path / "labels"))
    assert found
    assert all("targets" not in line and len(line["boxes"][0]) == 4 for line in found)
    report = evaluate_sentences(tmp_path / "labels" / SENTENCES_FILE, source, name="demo")
    assert all(j.right for j in report.judged)


def test_a_kind_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match=r"no such kind of sentence; got riddle; expected attribute \| ordinal"):
        LabelConfig(sentences=("riddle",))
    with pytest.raises(InputError, match="at least one sentence of a kind"):
        LabelConfig(sentences_a_kind=0)
