"""Relations of labelled pairs, asked of a vision-language model one by one."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from pipeline.datasets import Dataset
from pipeline.evaluation.relation_cases import RelationSpec, read_pairs
from pipeline.evaluation.relation_records import RelationRecords, SystemRecords
from pipeline.evaluation.systems import AskedPairs
from pipeline.geometry.frame import Annotation
from pipeline.labels.reading import Labels
from pipeline.metrics.splits import DROPPED
from pipeline.paper.questions import score_pairs
from pipeline.system.arrow import pa, pq
from pipeline.system.chat import ChatClient

VLM_FILE = "relation_records_vlm.parquet"


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

    Raises
    ------
    ServerError
        The server gives no answer at all.
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
