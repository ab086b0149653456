"""Systems that the paper is compared with: a detector and a vision-language model that are given whole expressions.

The model is asked LLaVA's questions: for the box of a sentence, and whether the relations of a pair hold.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.batch import StageClock
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets import Dataset
from pipeline.diagnosis.frame_evidence import matched
from pipeline.evaluation.leakage import Measured, measured_of
from pipeline.evaluation.model_answers import parse_yes_no
from pipeline.evaluation.place_reading import PlaceReading
from pipeline.evaluation.records import asked_columns, overlaps
from pipeline.evaluation.relation_cases import RelationSpec, read_pairs
from pipeline.evaluation.relation_records import RelationRecords, SystemRecords, struct_of
from pipeline.evaluation.systems import OWN, AskedPairs, EvalSpec, Records, System
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Annotation, Frame
from pipeline.labels.cases import HIT, Case, FrameCases
from pipeline.labels.exports.vqa_questions import ask_relation, can_be_asked
from pipeline.labels.reading import Labels
from pipeline.metrics.splits import DROPPED
from pipeline.paper.pointing import Pointed, cut_words, decided_readings, point_by_model, view_of
from pipeline.proposals.base import Detector, detect_expression
from pipeline.system.arrow import pa, pq
from pipeline.system.chat import ChatAnswer, ChatClient, ChatQuestion
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

VLM_FILE = "relation_records_vlm.parquet"
UNKNOWN = 0.5
_YES_NO_TOKENS = 32


@dataclass(frozen=True)
class Referring:
    """A detector fed the whole expression, as a sentence or as a class name; its best box is the answer."""

    name: str = "referring"
    processes: bool = True

    def title(self, source: Pipeline) -> str:
        return f"{source.needed_detector().name}, whole expression"

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        return replace(measured_of(source, relations), scorer=None, network=None, rule_too=())

    def decided(self, spec: EvalSpec, source: Pipeline, labels: Labels) -> tuple[Referring, tuple[str, ...]]:
        return self, ()

    def kept(self, spec: EvalSpec, source: Pipeline, folder: Path, out: Path) -> tuple[EvalSpec, dict[str, Any]]:
        return spec, {}

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        detector = source.needed_detector()
        return _pointing(source, clock, lambda frame, texts: point_by_detector(detector, frame, texts))


def point_by_detector(detector: Detector, frame: Frame, texts: Sequence[str]) -> list[Pointed]:
    """Best box of a detector for each expression, in order."""
    found = []
    for text in texts:
        try:
            proposals = detect_expression(detector, frame, text)
        except InputError as error:
            found.append(Pointed(None, problem=str(error)))
            continue
        if not len(proposals):
            found.append(Pointed(None, problem="nothing detected"))
            continue
        best = int(np.argmax(proposals.scores))
        found.append(Pointed(proposals.boxes[best].astype(np.float64), float(proposals.scores[best])))
    return found


@dataclass(frozen=True)
class Vlm:
    """A vision-language model behind an OpenAI-compatible server, by the server's address and the model's name."""

    url: str
    model: str
    requests_per_minute: float | None = None
    readings: tuple[PlaceReading, ...] = ()
    """What its numbers mean, as far as it is known; what is left is decided over a sample before the run."""
    name: str = "vlm"
    processes: bool = False

    def client(self) -> ChatClient:
        """Open the server."""
        return ChatClient(self.url, self.model, requests_per_minute=self.requests_per_minute)

    def title(self, source: Pipeline) -> str:
        return f"VLM {self.model}"

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        return Measured(None, None)

    def kept(self, spec: EvalSpec, source: Pipeline, folder: Path, out: Path) -> tuple[EvalSpec, dict[str, Any]]:
        return spec, {"vlm": self.record()}

    def record(self) -> dict[str, Any]:
        told = {"places": list(map(str, self.readings))} if self.readings else {}
        return {"url": self.url, "model": self.model, **told}

    def decided(self, spec: EvalSpec, source: Pipeline, labels: Labels) -> tuple[Vlm, tuple[str, ...]]:
        readings, notes = decided_readings(self.client(), self.model, source.dataset, labels, spec.limit, self.readings)
        return replace(self, readings=readings), notes

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        client = self.client()
        return _pointing(source, clock, partial(point_by_model, client, model=self.model, readings=self.readings))

    def ask(
        self,
        how: RelationSpec,
        dataset: Dataset,
        labels: Labels,
        records: RelationRecords,
        counted: np.ndarray,
        folder: Path,
    ) -> AskedPairs:
        """Ask of a sample of the counted pairs whether each relation holds, and write every answer into a run's folder.

        A probability is 0.5, a no, where the answer is not known.

        Raises ServerError: the server gives no answer at all.
        """
        client, rows, relations = self.client(), np.flatnonzero(counted), records.systems[0].relations
        if how.vlm_pairs < len(rows):
            rows = np.sort(np.random.default_rng([how.seed, 53]).choice(rows, how.vlm_pairs, replace=False))
        p = np.empty((len(rows), len(relations)), np.float32)
        reasons: Counter[str] = Counter()
        tables: list[pa.Table] = []
        for index in np.unique(records.frame_index[rows]):
            (pairs,) = read_pairs(labels, int(index), int(index) + 1)
            # The rows of a frame stand in one piece and in the order of its pairs.
            first = int(np.searchsorted(records.frame_index, index))
            mine = np.flatnonzero(records.frame_index[rows] == index)
            chosen = rows[mine] - first
            named = zip(pairs.numbers.tolist(), pairs.labels, pairs.geometry["bbox"], strict=True)
            objects = [Annotation(number, name, box) for number, name, box in named]
            asked = np.stack([pairs.a[chosen], pairs.b[chosen]], axis=1)
            found = score_pairs(client, dataset.load(pairs.key.frame), objects, asked, relations)
            p[mine] = found.probabilities
            reasons.update(found.reasons)
            states = pairs.states[chosen][:, [pairs.relations.index(r) for r in relations]]
            columns = {"state": states.T, "p": p[mine].T, "answer": zip(*found.texts, strict=True)}
            tables.append(
                pa.table(
                    {
                        "frame": [pairs.key.frame] * len(mine),
                        "frame_index": np.full(len(mine), index, np.int32),
                        "a": pairs.numbers[asked[:, 0]].astype(np.int32),
                        "b": pairs.numbers[asked[:, 1]].astype(np.int32),
                        **{name: struct_of(relations, values) for name, values in columns.items()},
                    }
                )
            )
        pq.write_table(pa.concat_tables(tables), folder / VLM_FILE, compression="zstd")
        title = f"VLM {self.model}, yes/no question, {len(rows)} pairs"
        system = SystemRecords("vlm", title, relations, p, np.full(len(rows), DROPPED, np.int8))
        note = (
            f"The VLM was asked about {len(rows)} pairs drawn at random (seed {how.seed}), {sum(reasons.values())} of "
            f"{p.size} answers are not known and count as no."
        )
        record = {"pairs": len(rows), "answers": int(p.size), "unknown": dict(reasons), "requests": client.requests}
        return AskedPairs(rows, system, note, record)


def recorded_system(manifest: Mapping[str, Any]) -> System | None:
    """The system of a run's `run.json`, None for the pipeline.

    Raises InputError: a vision-language model, which is not asked again unasked.
    """
    name = manifest.get("system", OWN)
    if name == "vlm":
        raise InputError("no model is named", expected="the address of a server and a model")
    return Referring() if name == "referring" else None


def _pointing(source: Pipeline, clock: StageClock, point: Callable[[Frame, Sequence[str]], list[Pointed]]) -> Records:
    """Records of a system with a single box for each expression."""

    def records(truth: FrameCases, given: PreparedFrame | None) -> list[dict[str, Any]]:
        with clock.stage("read"):
            frame = source.dataset.load(truth.frame) if given is None else given.frame
        truth.check_picture(frame)
        pointed = point(frame, [case.text for case in truth.cases])
        return [record_whole(c, truth, p) for c, p in zip(truth.cases, pointed, strict=True)]

    return records


def record_whole(case: Case, truth: FrameCases, pointed: Pointed) -> dict[str, Any]:
    """Row of an expression, as far as a single box can be measured."""
    box = pointed.box
    overlap = iou_2d(np.zeros((0, 4)) if box is None else box[None], truth.boxes)
    iou, strict, lenient = overlaps(None if box is None else 0, case, overlap)
    row = asked_columns(case, truth) | {
        "parse_ok": True,
        "problem": pointed.problem,
        "iou": iou,
        "strict_iou": strict,
        "set_iou": lenient,
        "correct": iou >= HIT,
        "strict_correct": strict >= HIT,
        "set_correct": lenient >= HIT,
    }
    if box is not None:
        index = int(matched(overlap, truth.alike[[case.target_object]])[0])
        row |= {"box": box.tolist(), "p_target": pointed.score, "matched_target": None if index < 0 else index}
    return row


@dataclass(frozen=True)
class PairScores:
    """Answers of the model about N ordered pairs and R relations."""

    probabilities: np.ndarray  # (N, R) float64: 1 for yes, 0 for no, UNKNOWN for an answer that is not known
    texts: tuple[tuple[str, ...], ...]  # N by R
    reasons: dict[str, int]  # counts of why answers are not known


def score_pairs(
    client: ChatClient, frame: Frame, objects: Sequence[Annotation], pairs: np.ndarray, relations: Sequence[str]
) -> PairScores:
    """Ask of each pair whether each relation holds, in LLaVA's words; things are told apart by their names only.

    `pairs` (N, 2) int: indices of a and b in `objects`. `relations`: out of `PAIRWISE`.

    Raises ServerError: no answer from the server to any question.
    """
    asked = [_question(r, objects[a].label, objects[b].label) for a, b in pairs for r in relations]
    # Things of one name ask the same, and are asked about once.
    prompts = [text for text in dict.fromkeys(asked) if text is not None]
    picture = view_of(frame.rgb).picture
    answers = dict(
        zip(prompts, client.ask_many([ChatQuestion(t, picture, _YES_NO_TOKENS) for t in prompts]), strict=True)
    )
    probabilities, reasons = np.full((len(pairs), len(relations)), UNKNOWN), Counter[str]()
    for cell, text in enumerate(asked):
        value, reason = (None, "a name that cannot stand in a question") if text is None else _judged(answers[text])
        if value is None:
            reasons[reason] += 1
        else:
            probabilities.flat[cell] = float(value)
    said = iter("" if text is None else answers[text].text for text in asked)
    texts = tuple(tuple(next(said) for _ in relations) for _ in pairs)
    return PairScores(probabilities, texts, dict(reasons))


def _question(relation: str, a: str, b: str) -> str | None:
    """None where a name cannot be said."""
    if not (can_be_asked(a) and can_be_asked(b)):
        return None
    try:
        return ask_relation(relation, a, b, 0)
    except InputError:
        return None


def _judged(answer: ChatAnswer) -> tuple[bool | None, str]:
    """Yes or no, or None and the reason."""
    if answer.failure is not None:
        return None, "the server failed"
    verdict = parse_yes_no(answer.text)
    return verdict.value, f"{verdict.reason}{cut_words(answer)}"
