"""What an evaluated system shares with what made the labels it is measured by, and what its figures can say then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pipeline.answering.pipeline import Pipeline
from pipeline.labels.profiles import NONE, profile_of
from pipeline.labels.provenance import (
    ANNOTATIONS,
    OF_ANNOTATIONS,
    RECORDED,
    Makers,
    MaskMakers,
    Model,
    makers_of,
    mask_makers,
)
from pipeline.labels.reading import Labels, open_labels
from pipeline.metrics.tables import Table
from pipeline.relations import RULE, TRAINED, RelationScorer, RuleScorer
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import PROFILE
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import file_hash
from pipeline.system.remote import named_before
from pipeline.system.version import __version__

AGREEMENT = "shares rule and cloud with the labels: agreement, not accuracy"
SIMULATED = "errors are simulated out of the truth's own masks"
CHECKED = "people checked the detector's own proposals: what it missed does not count"
HAD_A_PART = "a detector measured had a part in the truth: agreement, not accuracy"
PERFECT = "OPM is the truth itself here"
REPEATED = "the detector made its own truth: repetition, not accuracy"
OF_FRAME = Makers(MaskMakers((Model(ANNOTATIONS),)), __version__, PROFILE, profile_of(PROFILE).hash, NONE, NONE)
"""What makes the truth of a frame without labels."""
_RANK = ("", SIMULATED, CHECKED, HAD_A_PART, PERFECT, REPEATED)
Kind = Literal[
    "same detector",
    "shared detector",
    "annotations",
    "simulated",
    "same segmenter",
    "unknown maker",
    "same rule",
    "rule elsewhere",
    "second opinion",
    "same geometry",
]


@dataclass(frozen=True)
class Share:
    """One thing that labels and a measured system have from the same maker."""

    about: Literal["masks", "relations", "boxes"]
    kind: Kind
    title: str  # in a few words what the figures are then; empty where accuracy stays accuracy
    text: str  # what the figures can show and cannot

    @property
    def sentence(self) -> str:
        """Sentence for people."""
        return f"{self.about}: {self.text}"

    def record(self) -> dict[str, str]:
        """Convert to JSON."""
        return {"about": self.about, "kind": self.kind, "title": self.title, "said": self.text}


@dataclass(frozen=True)
class Measured:
    """What is measured, as far as labels may share it."""

    masks: MaskMakers | None  # None where no detector takes part, or none that is known
    scorer: str | None  # "rule", "trained", or what the network is called; None where relations are not judged
    network: str | None = None  # hash of the network's file, where that is known
    rule_too: tuple[str, ...] = ()  # relations that the rule judges because the network has no output for them

    @property
    def imported(self) -> bool:
        """True of predictions of another pipeline, with boxes from elsewhere."""
        return self.masks is not None and any(str(m.content).startswith("imported:") for m in self.masks.detectors)

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        masks = None if self.masks is None else self.masks.record()
        return {"masks": masks, "scorer": self.scorer, "network": self.network, "rule_too": list(self.rule_too)}


def measured_of(source: Pipeline, relations: Sequence[str]) -> Measured:
    """Measured parts of a pipeline."""
    detector = source.needed_detector()
    masks = mask_makers(f"{detector.name}: {detector.fingerprint()}")
    scorer = source.scorer
    if not isinstance(scorer, OnnxScorer):
        return Measured(masks, scorer.name)
    rest = tuple(r for r in relations if r not in scorer.contract.vocabulary)
    return Measured(masks, scorer.path.stem, file_hash(scorer.path), rest)


def measured_of_run(manifest: Mapping[str, Any]) -> Measured:
    """Measured parts from `run.json`, of any release; unknown parts are None."""
    system = str(manifest.get("system", "pipeline"))
    if system == "vlm":
        return Measured(None, None)
    masks = mask_makers(str(manifest.get("detector", "")))
    text = manifest.get("measured")
    if isinstance(text, dict):
        rest = tuple(str(r) for r in text.get("rule_too") or ())
        return Measured(masks, text.get("scorer"), text.get("network"), rest)
    spec = manifest.get("spec")
    options = spec.get("options", {}) if isinstance(spec, dict) else {}
    scorer = str(options.get("srm", TRAINED)) if isinstance(options, dict) else None
    return Measured(masks, scorer if system == "pipeline" else None)


def leakage(makers: Makers, measured: Measured) -> tuple[Share, ...]:
    """Shares of answers with the judging labels; first the shares by which accuracy is only agreement."""
    found = [*_masks(makers, measured.masks), *_relations(makers, measured)]
    if measured.masks is not None and not measured.imported and not any(share.title for share in found):
        found.append(
            Share(
                "boxes",
                "same geometry",
                "",
                "the labels' boxes are lifted from depth as the answers' are: LIFT costs what other masks change, and "
                "what lifting itself does wrong costs nothing",
            )
        )
    return tuple(sorted(found, key=lambda share: not share.title))


def shares_of_run(manifest: Mapping[str, Any], labels: str | Path | None) -> tuple[Share, ...]:
    """Recorded shares of a run; for an earlier release, derived from both manifests.

    `labels`: where the run's labels are, as far as that is known.
    """
    text = manifest.get("shares")
    if isinstance(text, list):
        with suppress(KeyError, TypeError):
            return tuple(Share(s["about"], s["kind"], str(s["title"]), str(s["said"])) for s in text)
    try:
        if labels is None:
            raise InputError("the run does not say where its labels are")
        makers = makers_of(open_labels(named_before(str(labels))).manifest)
    except InputError:
        text = "the run was made by an earlier release and its labels are not at hand: who made its truth is not known"
        return (Share("masks", "unknown maker", "", text),)
    return leakage(makers, measured_of_run(manifest))


def shares_of_answer(source: Pipeline, labels: Labels | None) -> tuple[Share, ...]:
    """Shares of an answer with the judge: labels, or by default the frame's annotations."""
    relations = profile_of(PROFILE).relations if labels is None else labels.relation_names
    return leakage(OF_FRAME if labels is None else makers_of(labels.manifest), measured_of(source, relations))


def _masks(makers: Makers, measured: MaskMakers | None) -> list[Share]:
    if measured is None:
        return []
    truth = makers.masks
    if truth is None or (RECORDED in {m.name for m in (*truth.detectors, *measured.detectors)} and truth != measured):
        who = (
            "the labels do not say what made their masks"
            if truth is None
            else ("a recording does not say which detector made it")
        )
        text = f"{who}: where it is the one that is measured, accuracy only says that the pipeline repeats itself"
        return [Share("masks", "unknown maker", "", text)]
    common = [m for m in measured.detectors if m in truth.detectors]
    derived = [m for m in measured.detectors if m.name in OF_ANNOTATIONS]
    if makers.annotated and measured.detectors == truth.detectors:
        return [
            Share(
                "masks",
                "annotations",
                PERFECT,
                "the dataset's annotations are the truth and the detector: OPM and LIFT cannot fail; the figures show "
                "what relations and ranking make of perfect proposals, and nothing of a detector",
            )
        ]
    if common:
        names = " & ".join(map(str, common))
        alone = len(common) == len(measured.detectors) == len(truth.detectors)
        if alone and makers.decided is not None and 0 < makers.decided.objects[1] == makers.decided.objects[0]:
            text = (
                f"{names} proposed the truth's objects and is measured by it; people decided each, so that wrong names "
                "count, and what it missed only where somebody added it"
            )
            return [Share("masks", "same detector", CHECKED, text)]
        return [
            Share(
                "masks",
                "same detector" if alone else "shared detector",
                REPEATED if alone else HAD_A_PART,
                f"{names} made the truth and is measured by it: accuracy says only that the pipeline repeats itself; "
                f"what it misses or misnames is true here, and so OPM and LIFT cost nothing{_but(makers, 'objects')}",
            )
        ]
    if derived and any(m.name in OF_ANNOTATIONS for m in truth.detectors):
        return [
            Share(
                "masks",
                "simulated",
                SIMULATED,
                f"{derived[0].name} and the truth are made of the same annotations: misses, wrong names and scores are "
                "put in by options; the figures compare modules and systems under these errors, and say nothing of how "
                "accurate a detector is here",
            )
        ]
    theirs = (*truth.detectors, *truth.segmenters)
    alike = [m for m in (*measured.detectors, *measured.segmenters) if m in theirs]
    if alike:
        text = f"{alike[0]} may make masks on both sides, where boxes have none: what it cuts wrong alike costs nothing"
        return [Share("masks", "same segmenter", "", text)]
    return []


def _relations(makers: Makers, measured: Measured) -> list[Share]:
    if measured.scorer is None:
        return []
    found = []
    if _had_vote(makers, measured):
        found.append(
            Share(
                "relations",
                "second opinion",
                "",
                f"the network {measured.scorer} had a vote in the labels: where it and the rule differ they are "
                "undecided and make no expression, so that SRM seems better than it is",
            )
        )
    if makers.rule == PROFILE and (measured.scorer == RULE or measured.rule_too):
        too = "" if measured.scorer == RULE else f", which scores {', '.join(measured.rule_too)},"
        text = f"the rule{too} made the labels: where it is wrong costs nothing; SRM costs what other masks change"
        found.append(Share("relations", "same rule" if measured.scorer == RULE else "rule elsewhere", "", text))
    return found


def scorer_share(makers: Makers, name: str, scorer: RelationScorer) -> Share | None:
    """Share of a scorer with labels of pairs on the labels' own objects; None where only the cloud is shared.

    The objects are those of the labels, lifted again or as stored: the cloud is shared by every row. With the rule
    shared too, the row says how alike two computations are.
    """
    if isinstance(scorer, RuleScorer) and makers.rule == PROFILE:
        other = "" if makers.rule_hash == profile_of(PROFILE).hash else ", as it was in an earlier release"
        text = f"the scorer is the rule that made the labels{other}, on the same cloud: near 100 by construction"
        return Share("relations", "same rule", AGREEMENT, f"{text}{_but(makers, 'relations')}")
    network = file_hash(scorer.path) if isinstance(scorer, OnnxScorer) else None
    if _had_vote(makers, Measured(None, name, network)):
        text = (
            "the scorer was the labels' second opinion, on the same cloud: cells where it and the rule differ became U "
            "and do not count, near 100 by construction; label with --second-opinion none to measure it"
        )
        return Share("relations", "second opinion", AGREEMENT, f"{text}{_but(makers, 'relations')}")
    return None


def title_of(shares: Sequence[Share]) -> str:
    """Title of a system's figures in a few words; empty where accuracy stays accuracy."""
    return next((share.title for share in shares if share.title), "")


def rank(title: str) -> int:
    """Rank of a block of rows: the more their truth is their own, the lower."""
    return _RANK.index(title)


def titles_of(shares: Mapping[str, Sequence[Share]]) -> str:
    """Titles of several systems by name; different titles each with the systems concerned."""
    by_title: dict[str, list[str]] = {}
    for name, found in shares.items():
        by_title.setdefault(title_of(found), []).append(name)
    return "; ".join(
        title if len(by_title) == 1 else f"{', '.join(names)}: {title}" for title, names in by_title.items() if title
    )


def with_caveats(table: Table, shares: Mapping[str, Sequence[Share]]) -> Table:
    """Add to a table's title and notes the limits of the figures.

    `shares`: by the systems that it is of.
    """
    named: dict[str, list[str]] = {}
    for name, found in shares.items():
        for share in found:
            named.setdefault(share.sentence, []).append(name)
    caveats = tuple(
        text if len(names) == len(shares) else f"{', '.join(names)}: {text}" for text, names in named.items()
    )
    titles = titles_of(shares)
    title = f"{table.title} ({titles})" if titles else table.title
    return replace(table, title=title, caveats=(*table.caveats, *caveats))


def _had_vote(makers: Makers, measured: Measured) -> bool:
    """Tell whether the network was the labels' second opinion: by file hash, else by name."""
    if measured.scorer == RULE or makers.second_opinion in (None, NONE):
        return False
    if measured.network is not None:
        return measured.network == makers.second_opinion
    return measured.scorer == makers.second_opinion_name


def _but(makers: Makers, what: str) -> str:
    """Note on values decided by people, and so of no maker."""
    if makers.decided is None:
        return "; people corrected some of it, how much was not counted" if makers.corrected else ""
    n, of = getattr(makers.decided, what)
    return f", but for {n} of {of} {what} that people decided" if n else ""
