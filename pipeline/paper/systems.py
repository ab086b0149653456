"""Systems that the paper is compared with: a detector and a vision-language model that are given whole expressions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.batch import StageClock
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets import Dataset
from pipeline.diagnosis.frame_evidence import matched
from pipeline.evaluation.leakage import Measured, measured_of
from pipeline.evaluation.records import asked_columns, overlaps
from pipeline.evaluation.relation_cases import RelationSpec, read_pairs
from pipeline.evaluation.relation_records import RelationRecords, SystemRecords
from pipeline.evaluation.systems import OWN, AskedPairs, EvalSpec, Records, System
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Annotation, Frame
from pipeline.labels.cases import HIT, Case, FrameCases
from pipeline.labels.reading import Labels
from pipeline.metrics.splits import DROPPED
from pipeline.paper.questions import ground_many, score_pairs
from pipeline.proposals.base import Detector, detect_expression
from pipeline.system.arrow import pa, pq
from pipeline.system.chat import ChatClient
from pipeline.system.errors import InputError

VLM_FILE = "relation_records_vlm.parquet"


@dataclass(frozen=True)
class Pointed:
    """A box for an expression's target."""

    box: np.ndarray | None  # (4,) float: x0, y0, x1, y1, pixels
    score: float | None = None
    problem: str | None = None  # why there is no box


@dataclass(frozen=True)
class Referring:
    """A detector fed the whole expression, as a sentence or as a class name; its best box is the answer."""

    name: str = "referring"
    processes: bool = True

    def title(self, source: Pipeline) -> str:
        return f"{source.needed_detector().name}, whole expression"

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        return replace(measured_of(source, relations), scorer=None, network=None, rule_too=())

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
class VlmOptions:
    """Address and name of a vision-language model behind an OpenAI-compatible server."""

    url: str
    model: str
    requests_per_minute: float | None = None

    def client(self) -> ChatClient:
        """Open the server."""
        return ChatClient(self.url, self.model, requests_per_minute=self.requests_per_minute)


@dataclass(frozen=True)
class Vlm:
    """A vision-language model, asked LLaVA's questions for the box of a sentence and for the relations of a pair."""

    options: VlmOptions
    name: str = "vlm"
    processes: bool = False

    def title(self, source: Pipeline) -> str:
        return f"VLM {self.options.model}"

    def measured(self, source: Pipeline, relations: Sequence[str]) -> Measured:
        return Measured(None, None)

    def kept(self, spec: EvalSpec, source: Pipeline, folder: Path, out: Path) -> tuple[EvalSpec, dict[str, Any]]:
        return spec, {"vlm": self.record()}

    def record(self) -> dict[str, Any]:
        return {"url": self.options.url, "model": self.options.model}

    def open(self, spec: EvalSpec, source: Pipeline, labels: Labels, clock: StageClock) -> Records:
        client = self.options.client()

        def point(frame: Frame, texts: Sequence[str]) -> list[Pointed]:
            found = ground_many(client, frame, texts)
            return [Pointed(g.box, problem=g.reason if g.box is None else None) for g in found]

        return _pointing(source, clock, point)

    def ask(
        self,
        how: RelationSpec,
        dataset: Dataset,
        labels: Labels,
        records: RelationRecords,
        counted: np.ndarray,
        folder: Path,
    ) -> AskedPairs:
        client, title = self.options.client(), f"VLM {self.options.model}"
        return ask_pairs(client, title, how, dataset, labels, records, counted, folder)


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


def sample_pairs(counted: np.ndarray, number: int, seed: int) -> np.ndarray:
    """(M,) int64: indices of at most so many of the counted pairs, without replacement, rising."""
    indices = np.flatnonzero(counted)
    if number >= len(indices):
        return indices
    return np.sort(np.random.default_rng([seed, 53]).choice(indices, number, replace=False))


def ask_pairs(
    client: ChatClient,
    title: str,
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
    rows = sample_pairs(counted, how.vlm_pairs, how.seed)
    relations = records.systems[0].relations
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
        frame = dataset.load(pairs.key.frame)
        found = score_pairs(client, frame, objects, asked, relations)
        p[mine] = found.probabilities
        reasons.update(found.reasons)

        def struct(columns: list[pa.Array]) -> pa.StructArray:
            return pa.StructArray.from_arrays(columns, names=list(relations))

        tables.append(
            pa.table(
                {
                    "frame": pa.array([pairs.key.frame] * len(mine), pa.string()),
                    "frame_index": pa.array(np.full(len(mine), index, np.int32)),
                    "a": pa.array(pairs.numbers[asked[:, 0]].astype(np.int32)),
                    "b": pa.array(pairs.numbers[asked[:, 1]].astype(np.int32)),
                    "ambiguous": pa.array(found.ambiguous),
                    "state": struct([pa.array(pairs.states[chosen, pairs.relations.index(r)]) for r in relations]),
                    "p": struct([pa.array(p[mine, k]) for k in range(len(relations))]),
                    "known": struct([pa.array(found.known[:, k]) for k in range(len(relations))]),
                    "answer": struct(
                        [pa.array([t[k] for t in found.texts], pa.string()) for k in range(len(relations))]
                    ),
                }
            )
        )
    pq.write_table(pa.concat_tables(tables), folder / VLM_FILE, compression="zstd")
    asked = f"{title}, yes/no question, {len(rows)} pairs"
    system = SystemRecords("vlm", asked, relations, p, np.full(len(rows), DROPPED, np.int8))
    note = (
        f"The VLM was asked about {len(rows)} pairs drawn at random (seed {how.seed}), {sum(reasons.values())} of "
        f"{p.size} answers are not known and count as no."
    )
    record = {"pairs": len(rows), "answers": int(p.size), "unknown": dict(reasons), "requests": client.requests}
    return AskedPairs(rows, system, note, record)
