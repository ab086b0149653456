"""Predictions of another pipeline in a case: the lines of its frame, and findings from the whole file.

A ranking and a scorer that cannot be asked again are known by all pairs of their file (`pair_rules`, `fitted_scorer`);
a case has those of one frame, and so keeps what was found.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import BaseModel, FiniteFloat

from pipeline.answering.ask import AskConfig
from pipeline.answering.fitted_ranking import FittedRanking, Scale
from pipeline.answering.fitted_scorer import FittedScorer
from pipeline.answering.imported import ImportedDetector, ImportedPipeline, config_of, scorer_of
from pipeline.answering.pair_rules import RunRules
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.predictions import Predictions, as_json, read_predictions
from pipeline.datasets.base import Dataset
from pipeline.language.naming import Synonyms
from pipeline.relations import RelationScorer, RuleScorer
from pipeline.relations.scorer import SuppliedRelations


class ShownRankingRecord(BaseModel, extra="forbid"):
    """`FittedRanking` as JSON."""

    weights: tuple[FiniteFloat, ...]
    unit: FiniteFloat
    scale: Scale = "values"


class ShownRecord(BaseModel, extra="forbid"):
    """Findings from a whole file of predictions."""

    level: int
    true_scores: tuple[FiniteFloat, FiniteFloat]
    ranking: ShownRankingRecord | None = None
    # The scorer's fit by relation; None where the file names its scorer
    relations: dict[str, tuple[FiniteFloat, ...] | None] | None = None

    @property
    def rules(self) -> RunRules:
        """Rules for `ImportedPipeline`."""
        shown = self.ranking and FittedRanking(np.array(self.ranking.weights), self.ranking.unit, self.ranking.scale)
        return RunRules(shown, self.true_scores)


def keep_predictions(source: ImportedPipeline, frame: str) -> tuple[bytes, ShownRecord]:
    """Lines of a frame as a file of predictions, with the findings from the whole file."""
    file, rules, stand_in = source.predictions, source.rules, named_scorer(source)
    lines = (as_json(thing) for thing in (replace(file.header, events=False), *file.of_frame(frame)))
    ranking = rules.shown and ShownRankingRecord(
        weights=tuple(rules.shown.weights.tolist()), unit=rules.shown.unit, scale=rules.shown.scale
    )
    relations = None
    if isinstance(stand_in, FittedScorer):
        relations = {k: None if w is None else tuple(w.tolist()) for k, w in stand_in.weights.items()}
    shown = ShownRecord(level=file.level, true_scores=rules.true_scores, ranking=ranking, relations=relations)
    return "".join(f"{line}\n" for line in lines).encode(), shown


def named_scorer(source: ImportedPipeline) -> RelationScorer:
    """Scorer of pairs missing in the file."""
    assert isinstance(source.scorer, SuppliedRelations)
    return source.scorer.stand_in


def kept_source(
    file: Path,
    shown: ShownRecord,
    dataset: Dataset,
    scorer: RelationScorer | None,
    config: AskConfig,
    synonyms: Synonyms | None,
) -> ImportedPipeline:
    """Pipeline of a case, by its own file; `scorer` is named by the file's header."""
    read = replace(read_predictions(file), least=shown.level)
    return _source(read, dataset, scorer or _shown_scorer(read, shown, dataset), config, synonyms, shown.rules)


def newer_source(
    read: Predictions, shown: ShownRecord | None, before: Pipeline, rules: RunRules | None = None
) -> ImportedPipeline:
    """Pipeline of a case with newer predictions.

    The ranking is found in their file, or given as `rules`; the stand-in of their scorer is the case's, or the rule.
    """
    scorer = RuleScorer() if shown is None else _shown_scorer(read, shown, before.dataset)
    return _source(read, before.dataset, scorer, config_of(read), before.synonyms, rules)


def _shown_scorer(read: Predictions, shown: ShownRecord, dataset: Dataset) -> FittedScorer:
    told = {k: None if w is None else np.array(w) for k, w in (shown.relations or {}).items()}
    return FittedScorer(read, dataset, told)


def _source(
    read: Predictions,
    dataset: Dataset,
    scorer: RelationScorer,
    config: AskConfig,
    synonyms: Synonyms | None,
    rules: RunRules | None = None,
) -> ImportedPipeline:
    relations = scorer_of(read, None, scorer)
    return ImportedPipeline(dataset, ImportedDetector(read), relations, config, synonyms, predictions=read, shown=rules)
