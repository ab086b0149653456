"""Small worlds for the diagnosis: labelled objects, detections of them, relations, all drawn from few values so that
ties are common. No picture and no geometry: LIFT's probabilities are drawn as well."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from pipeline.answering import Candidates, FrameAnswers, StageClock
from pipeline.answering.ranking import RankConfig
from pipeline.diagnosis import FrameEvidence
from pipeline.geometry import iou_2d
from pipeline.labels import Case, FrameCases
from pipeline.proposals import Proposals, no_proposals
from pipeline.relations import U

SIDE, STEP = 10.0, 40.0
SHIFTS = (0.0, 2.0, 6.0, 15.0)
"""Overlaps of 1, .67, .25 and 0."""
SHARES = (0.55, 0.25, 0.1, 0.1)
SCORES, PROBABILITIES = (0.1, 0.4, 0.4, 0.9), (0.02, 0.3, 0.5, 0.7, 0.98)


class NoDetector:
    """Sees nothing; the candidates of a world are given."""

    name, vocabulary, exact = "none", None, False

    def fingerprint(self) -> str:
        return "none"

    def detect(self, frame: Any, labels: Any) -> Proposals:
        return no_proposals(1, 1)


def world(seed: int, rank: RankConfig | None = None) -> tuple[FrameEvidence, Case]:
    """An expression "mug left of the box" in a world of that seed."""
    rng = np.random.default_rng(seed)
    n, d = int(rng.integers(2, 6)), int(rng.integers(0, 9))
    labels = ("mug", "box", *rng.choice(["mug", "box", "lamp"], n - 2).tolist())
    x = STEP * np.arange(n)
    boxes = np.stack([x, np.zeros(n), x + SIDE, np.full(n, SIDE)], axis=1)
    states = rng.choice([-1, 0, 1], (n, n)).astype(np.int8)
    states[0, 1] = 1
    np.fill_diagonal(states, -1)
    names = np.array(labels)
    alike = names[:, None] == names[None, :]
    judged = rng.random((n, n)) < 0.9
    judged[0, 1] = True
    states[~judged] = -1
    truth = FrameCases(
        "f",
        0,
        "s",
        labels,
        boxes,
        alike,
        {"left": states},
        (),
        np.arange(n),
        judged,
        {},
        {},
        (None,) * n,
    )
    possible = alike[0][:, None] & alike[1][None, :]
    acceptable = np.flatnonzero((possible & (states >= U)).any(axis=1))
    strict = np.flatnonzero((possible & (states > U)).any(axis=1))
    case = Case("e", "mug left of the box", "mug", "left", "box", 0, 1, strict, acceptable, len(acceptable) > 1, 0.1)
    who = rng.integers(0, n, d)
    found = boxes[who] + rng.choice(SHIFTS, d, p=SHARES)[:, None] * np.array([1.0, 0, 1, 0])
    p = rng.choice(PROBABILITIES, (d + n, d + n))
    same = np.eye(d, dtype=np.bool_) | (iou_2d(found, found) >= 0.7) | (rng.random((d, d)) < 0.1)
    same |= same.T
    answers: Any = FrameAnswers.__new__(FrameAnswers)
    detector = NoDetector()
    source = SimpleNamespace(
        line=None,
        predictions=None,
        scorer=None,
        config=SimpleNamespace(rank=rank or RankConfig(), k=10, score_calibration=None),
        needed_detector=lambda: detector,
        unfiltered_detector=lambda: detector,
    )
    answers.source, answers.context = source, SimpleNamespace(frame=SimpleNamespace(depth_source=""))
    answers.objects = tuple(SimpleNamespace(id=-1) for _ in range(d))
    answers.boxes, answers.same, answers.mask_sizes = found, same, rng.choice([100, 200], d)
    answers.unknown, answers.clock = {}, StageClock()
    answers._scores = SimpleNamespace(of=lambda relation: p[:d, :d]) if d else None
    answers.candidates = {}
    for name in ("mug", "box"):
        chance = np.where(names[who] == name, 0.85, 0.2)
        index = rng.permutation(np.flatnonzero(rng.random(d) < chance)).astype(np.int64)
        answers.candidates[name] = Candidates(index, rng.choice(SCORES, len(index)))
    evidence: Any = FrameEvidence.__new__(FrameEvidence)
    evidence.truth, evidence.answers, evidence.confidence = truth, answers, 0.6
    evidence.detections, evidence.labelled = d, n
    evidence.overlap = iou_2d(found, boxes).reshape(d, n)
    best = evidence.overlap.argmax(axis=1) if d else np.zeros(0, np.int64)
    evidence.match = np.where(evidence.overlap[np.arange(d), best] >= 0.5, best, -1)
    evidence.objects = SimpleNamespace(known=rng.random(n) < 0.9, pseudo=np.zeros(n, np.bool_))
    evidence._cases, evidence._probabilities, evidence.roles, evidence.missed = (case,), {}, {}, {}
    evidence.same = np.zeros((d + n, d + n), np.bool_)
    evidence.same[:d, :d] = same
    evidence.same[:d, d:] = evidence.overlap >= 0.7
    evidence.same[d:, :d] = evidence.same[:d, d:].T
    evidence.same[d:, d:] = np.eye(n, dtype=np.bool_)
    evidence.same_box = evidence.same.copy()
    evidence.same_box[:d, :d] &= np.eye(d, dtype=np.bool_) | (iou_2d(found, found) >= 0.7)
    evidence.mask_sizes = np.concatenate([answers.mask_sizes, np.full(n, 150)])
    hidden = np.concatenate([np.zeros(d, np.bool_), ~evidence.objects.known])
    table = np.where(hidden[:, None] | hidden[None, :], np.nan, p)
    evidence.probabilities = lambda relation: table
    return evidence, case
