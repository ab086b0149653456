"""A vision-language model measured on relations: LLaVA's yes/no question about a sample of the labelled pairs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.datasets import Dataset
from pipeline.evaluation.relation_cases import read_pairs
from pipeline.evaluation.relation_records import RelationRecords, SystemRecords
from pipeline.evaluation.whole_expression import VlmOptions
from pipeline.labels.reading import Labels
from pipeline.metrics.splits import DROPPED

if TYPE_CHECKING:
    import pyarrow as pa

FILE = "relation_records_vlm.parquet"


@dataclass(frozen=True)
class Shown:
    """A labelled object as a question names it."""

    label: str
    bbox: np.ndarray


@dataclass(frozen=True, eq=False)
class VlmRecords:
    """What the model said.

    Attributes
    ----------
    rows : (M,) int64
        Places of its pairs in the relation records, rising.
    system : SystemRecords
        Of these M pairs; 0.5, a no, where the answer is not known.
    unknown : dict of str to int
        Why answers are not known, and how often.
    requests : int
        Sent to the server; the others stood in the cache.
    """

    rows: np.ndarray
    system: SystemRecords
    unknown: dict[str, int]
    requests: int


def sample_pairs(records: RelationRecords, counted: np.ndarray, number: int, seed: int) -> np.ndarray:
    """(M,) int64: places of at most so many of the counted pairs, without replacement, rising."""
    places = np.flatnonzero(counted)
    if number >= len(places):
        return places
    return np.sort(np.random.default_rng([seed, 53]).choice(places, number, replace=False))


def ask_relations(
    options: VlmOptions,
    dataset: Dataset,
    labels: Labels,
    records: RelationRecords,
    rows: np.ndarray,
    relations: tuple[str, ...],
    path: Path,
) -> VlmRecords:
    """Ask of each of these pairs whether each relation holds, and write every answer to `path`.

    Raises
    ------
    ServerError
        The server gives no answer at all.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from pipeline.evaluation.vlm.client import ChatClient
    from pipeline.evaluation.vlm.relations import RelationConfig, score_pairs

    client = ChatClient(
        options.url, options.model, timeout_s=options.timeout_s, requests_per_minute=options.requests_per_minute
    )
    config = RelationConfig(workers=options.workers, keep_going=True)
    p = np.empty((len(rows), len(relations)), np.float32)
    reasons: Counter[str] = Counter()
    tables: list[pa.Table] = []
    for index in np.unique(records.frame_index[rows]):
        (pairs,) = read_pairs(labels, int(index), int(index) + 1)
        # The rows of a frame stand in one piece and in the order of its pairs.
        first = int(np.searchsorted(records.frame_index, index))
        mine = np.flatnonzero(records.frame_index[rows] == index)
        chosen = rows[mine] - first
        objects = [Shown(n, box) for n, box in zip(pairs.labels, pairs.geometry["bbox"], strict=True)]
        asked = np.stack([pairs.a[chosen], pairs.b[chosen]], axis=1)
        frame = dataset.load(pairs.key.frame)
        found = score_pairs(client, frame, objects, asked, relations, config=config)
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
    pq.write_table(pa.concat_tables(tables), path, compression="zstd")
    title = f"VLM {options.model}, yes/no question, {len(rows)} pairs"
    system = SystemRecords("vlm", title, relations, p, np.full(len(rows), DROPPED, np.int8))
    return VlmRecords(rows, system, dict(reasons), client.usage.requests)
