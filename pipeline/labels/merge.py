"""Merging shards: all frames, objects and relations, and the expressions that are selected of all candidates."""

from __future__ import annotations

import os
import platform
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.settings import ASSUMED, DECLARE
from pipeline.labels.frame_stream import frame_spans
from pipeline.labels.labelling import row_hash
from pipeline.labels.plan import Plan, Shard, TextStyle, load_plan
from pipeline.labels.provenance import makers_of
from pipeline.labels.reading import (
    CANDIDATES,
    MANIFEST_FILE,
    ROW_GROUP,
    SENTENCES,
    SENTENCES_FILE,
    Labels,
    RowHash,
    arrow_schema,
)
from pipeline.labels.report import dataset_card
from pipeline.labels.schema import SCHEMA_VERSION, SENTENCES_OF, Manifest, TableFile, write_schemas
from pipeline.labels.store import PLAN_FILE, LabelStore
from pipeline.labels.wording import expression_text
from pipeline.language.noun_phrase import alone
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.plugins import versions_of
from pipeline.system.version import __version__
from pipeline.system.whole_files import clear_abandoned, sha256_of, temporary_folder, write_synced

LISTED_WARNINGS = 100
CARD_FILE = "README.md"


def merge_labels(where: str | Path, selection: SelectConfig | None = None, out: Path | None = None) -> Manifest:
    """Merge the finished shards of a labels folder.

    Tables are written part by part, so that memory does not grow with their
    length; of the candidate expressions five numbers a row are held. All is
    written aside and then put into place at once: what fails before leaves
    earlier tables as they were.

    `where`: the labels folder, or a URL; then `out` is needed. `out`: where the merged tables go; the labels folder by
    default.

    Raises InputError: shards are missing or damaged, or the folder holds no labels.
    """
    selection = selection or SelectConfig()
    store = LabelStore(where)
    plan = load_plan(store)
    missing = [shard for shard in plan.shards if not store.has_part(shard.name)]
    require(
        not missing,
        f"{len(missing)} of {len(plan.shards)} shards are missing",
        got=", ".join(str(s.index) for s in missing[:8]) + (" ..." if len(missing) > 8 else ""),
        cause=f"finish them with: spatialviz label {plan.spec.path} --out {store.where} --resume "
        "and the options it was begun with",
        path=store.where,
    )
    if out is None:
        require(
            not store.remote, "labels at a URL are merged into a local folder", expected="--to FOLDER", path=store.where
        )
        out = store.folder
    with as_input_error("merged tables go into a folder", FileExistsError, NotADirectoryError, got="a file", path=out):
        out.mkdir(parents=True, exist_ok=True)
    require(
        not (any(out.iterdir()) and not (out / PLAN_FILE).is_file() and not (out / MANIFEST_FILE).is_file()),
        "the folder holds something else",
        expected="a new or empty folder, or labels",
        path=out,
    )
    for shard in plan.shards:
        store.check_part(shard.name, shard.key)
    clear_abandoned(out)
    with temporary_folder(out / "merged") as staging:
        manifest = _write_all(staging, plan, store, selection)
        (out / MANIFEST_FILE).unlink(missing_ok=True)
        move_all(staging, out)
    return manifest


def _write_all(out: Path, plan: Plan, store: LabelStore, selection: SelectConfig) -> Manifest:
    shards = plan.shards
    warnings: list[str] = []
    tables = {
        name: write_merged(out, name, (store.read_part(s.name, name) for s in shards))
        for name in ("frames", "objects", "relations")
    }
    made = _write_sentences(out, shards, store) if plan.config.sentences else {}
    candidates, chosen = choose(shards, store, selection)
    tables["expressions"] = write_merged(out, "expressions", _worded(shards, store, chosen, plan.config.style))
    frames_ok = assumed = 0
    for shard in shards:
        rows = store.read_part(shard.name, "frames", ["frame", "ok", "problem", "up_source"]).to_pylist()
        frames_ok += sum(row["ok"] for row in rows)
        assumed += sum(row["up_source"] == "assumed" for row in rows)
        warnings += [f"{row['frame']}: {row['problem']}" for row in rows if not row["ok"]]
    more = len(warnings) - LISTED_WARNINGS
    if more > 0:
        warnings = [*warnings[:LISTED_WARNINGS], f"and {more} more frames"]
    if assumed:
        warnings.insert(0, f"{assumed} of {frames_ok} frames: {ASSUMED}; {DECLARE}")
    if (network := plan.spec.options.get("depth_model")) is not None:
        warnings.insert(0, f"all geometry rests on depth that is estimated: --depth-model {network}")
    manifest = Manifest(
        schema_version=SCHEMA_VERSION,
        tool="spatialviz",
        version=__version__,
        config={**plan.config.record(), "relations": list(plan.config.relations)},
        config_hash=plan.config.hash,
        profile={"name": plan.config.profile, "parameters": plan.config.rules.parameters},
        profile_hash=plan.config.rules.hash,
        selection=asdict(selection),
        dataset={
            "path": plan.spec.path,
            "options": {k: str(v) for k, v in plan.spec.options.items() if v is not None},
            "format": plan.format,
            "input_hash": plan.input_hash,
        },
        models=plan.models,
        seed=plan.config.seed,
        counts={
            "frames": tables["frames"].rows,
            "frames_usable": frames_ok,
            "frames_up_assumed": assumed,
            "objects": tables["objects"].rows,
            "pairs": tables["relations"].rows,
            "candidates": candidates,
            "expressions": tables["expressions"].rows,
            **{f"{SENTENCES_OF}{kind}": made[kind] for kind in plan.config.sentences},
        },
        warnings=warnings,
        tables=tables,
        environment=environment(),
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )
    return write_labels(out, manifest)


def write_labels(folder: Path, manifest: Manifest) -> Manifest:
    """Write manifest, card and schemas of merged tables, with the makers."""
    manifest.makers = makers_of(manifest).record()
    write_schemas(folder / "schemas")
    write_manifest(Labels(folder, manifest))
    return manifest


def _write_sentences(out: Path, shards: Sequence[Shard], store: LabelStore) -> Counter[str]:
    found = [store.read_part(shard.name, SENTENCES) for shard in shards]
    lines = (line for part in found for line in part.column("line").to_pylist())
    write_synced(out / SENTENCES_FILE, "".join(f"{line}\n" for line in lines).encode())
    return Counter(kind for part in found for kind in part.column("kind").to_pylist())


def write_manifest(labels: Labels) -> None:
    """Write the card, and last the manifest of merged tables."""
    write_synced(labels.root / CARD_FILE, dataset_card(labels).encode())
    write_synced(labels.root / MANIFEST_FILE, labels.manifest.model_dump_json(indent=1).encode())


def move_all(staging: Path, out: Path) -> None:
    """Move all files of labels into their folder, the manifest last."""
    for file in sorted(filter(Path.is_file, staging.rglob("*")), key=lambda p: (p.name == MANIFEST_FILE, p)):
        final = out / file.relative_to(staging)
        final.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, final)


_CHOSEN_BY = ("id", "frame_index", "relation", "target", "reference", "acceptable", "same_class")


def choose(shards: Sequence[Shard], store: LabelStore, selection: SelectConfig) -> tuple[int, dict[str, np.ndarray]]:
    """Number of candidates, and the chosen rows by shard."""
    codes: dict[str, int] = {}
    columns: list[list[np.ndarray]] = []
    for shard in shards:
        part = store.read_part(shard.name, CANDIDATES, list(_CHOSEN_BY))
        ids = np.array([int(i, 16) for i in part.column("id").to_pylist()], np.uint64)
        named = [
            np.array([codes.setdefault(v, len(codes)) for v in part.column(n).to_pylist()], np.int32)
            for n in ("target", "reference")
        ]
        relation = np.array([PAIRWISE.index(r) for r in part.column("relation").to_pylist()], np.int32)
        frame = part.column("frame_index").to_numpy().astype(np.int32)
        answers = np.array([len(a) for a in part.column("acceptable").to_pylist()], np.int32)
        same_class = part.column("same_class").to_numpy()
        columns.append([ids, frame, relation, *named, (answers < same_class) | (same_class == 1)])
    if not columns:
        return 0, {}
    ids, *codes_of, telling = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    kept = telling if selection.telling else np.ones_like(telling)
    kept[kept] = select(ids[kept], *(column[kept] for column in codes_of), config=selection)
    parts = np.split(kept, np.cumsum([len(part[0]) for part in columns])[:-1])
    return len(kept), {shard.name: part for shard, part in zip(shards, parts, strict=True)}


def _worded(
    shards: Sequence[Shard], store: LabelStore, chosen: dict[str, np.ndarray], style: TextStyle
) -> Iterator[pa.Table]:
    """The chosen candidates, put into words: a row's own hash chooses its sentence."""
    labels = (store.read_part(s.name, "objects", ["label"]).column("label").unique().to_pylist() for s in shards)
    class_names = tuple(sorted({name for found in labels for name in found}))

    def worded(target: str, relation: str, reference: str, key: str, several: tuple[bool, bool]) -> str | None:
        try:
            return expression_text(
                target, relation, reference, int(key, 16), style=style, class_names=class_names, several=several
            )
        except InputError:
            return None

    for shard in shards:
        rows = store.read_part(shard.name, CANDIDATES).filter(pa.array(chosen[shard.name]))
        single = _single(store.read_part(shard.name, "objects", ["frame_index", "object", "label"]))
        frames, *pairs = (rows.column(n).to_pylist() for n in ("frame_index", "target_object", "reference_object"))
        several = [((k, a) not in single, (k, b) not in single) for k, a, b in zip(frames, *pairs, strict=True)]
        columns = (rows.column(n).to_pylist() for n in ("target", "relation", "reference", "id"))
        texts = pa.array([worded(*row) for row in zip(*columns, several, strict=True)], pa.string())
        schema = arrow_schema("expressions")
        columns = [texts if n == "text" else rows.column(n).combine_chunks() for n in schema.names]
        yield pa.table(columns, schema.names).filter(texts.is_valid()).cast(schema)


def _single(objects: pa.Table) -> set[tuple[int, int]]:
    """(frame_index, object) of the objects whose name means no other of their frame."""
    found = set()
    numbers, labels = (objects.column(name).to_pylist() for name in ("object", "label"))
    for frame, start, stop in frame_spans(objects.column("frame_index").to_numpy()):
        found |= {(frame, numbers[start + k]) for k in np.flatnonzero(alone(labels[start:stop])).tolist()}
    return found


def write_merged(out: Path, name: str, parts: Iterator[pa.Table]) -> TableFile:
    """Write a table from its parts; returns rows and hashes."""
    path = out / f"{name}.parquet"
    digest = RowHash(name)
    waiting: list[pa.Table] = []
    with pq.ParquetWriter(path, arrow_schema(name), compression="zstd") as writer:
        for part in parts:
            digest.update(part)
            if part.num_rows:
                waiting.append(part)
            if sum(rows.num_rows for rows in waiting) >= ROW_GROUP:
                _write_group(writer, waiting)
        _write_group(writer, waiting)
    with open(path, "rb") as written:
        os.fsync(written.fileno())
    return TableFile(file=path.name, rows=digest.rows, content_hash=digest.hexdigest(), sha256=sha256_of(path))


def _write_group(writer: Any, waiting: list[pa.Table]) -> None:
    if waiting:
        writer.write_table(pa.concat_tables(waiting).combine_chunks(), row_group_size=ROW_GROUP)
    waiting.clear()


def environment() -> dict[str, str]:
    """Versions and platform of the run, for the record; rows' hashes do not depend on either."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        **versions_of("numpy", "opencv-python-headless", "pyarrow", "pycocotools", "scipy"),
    }


SCARCE = 20
"""The rarest relation counts as at least so many, so that one odd row does not empty the rest."""


def select(
    ids: np.ndarray,
    frame: np.ndarray,
    relation: np.ndarray,
    target: np.ndarray,
    reference: np.ndarray,
    config: SelectConfig,
) -> np.ndarray:
    """Choose the candidates to keep.

    First, one of each question: candidates of a frame with equal target,
    relation and reference say the same sentence. Then `per_frame` of each
    frame, rarest relation first. Then every relation gets its quota, filled
    in turn from its target classes.

    `ids` (N,) uint64: the rows' hashes. `frame`, `relation`, `target`, `reference` (N,) int: codes of what the rows
    say. Returns (N,) bool.
    """
    n = len(ids)
    if not n:
        return np.zeros(0, np.bool_)
    # A second hash, so that another selection seed chooses others of the same candidates.
    order_key = _mixed(ids, row_hash(config.seed, "select"))
    kept = _rank((frame, relation, target, reference), order_key) == 0

    def keep_few(of: np.ndarray, in_turn: np.ndarray, most: np.ndarray) -> None:
        """Keep at most so many rows of each `of`, with `in_turn` taking turns."""
        rows = np.flatnonzero(kept)
        within = _rank((of[rows], in_turn[rows]), order_key[rows])
        order = np.lexsort((order_key[rows], within, of[rows]))
        group = of[rows][order]
        kept[rows[order[_running_count(group) >= most[group]]]] = False

    if config.per_frame is not None:
        keep_few(frame, relation, np.full(frame.max() + 1, config.per_frame))
    keep_few(relation, target, _quotas(np.bincount(relation[kept], minlength=relation.max() + 1), config))
    return kept


def _mixed(ids: np.ndarray, seed: int) -> np.ndarray:
    """(N,) uint64: the splitmix64 finaliser of each hash with a seed (Steele et al., 2014)."""
    with np.errstate(over="ignore"):
        x = ids.astype(np.uint64) ^ np.uint64(seed)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return x ^ (x >> np.uint64(31))


def _rank(groups: tuple[np.ndarray, ...], key: np.ndarray) -> np.ndarray:
    """(N,) rank of each row within the row's group, by key."""
    order = np.lexsort((key, *reversed(groups)))
    ranks = np.empty(len(key), np.int64)
    ranks[order] = _running_count(*(group[order] for group in groups))
    return ranks


def _running_count(*columns: np.ndarray) -> np.ndarray:
    """(N,) how many rows of equal values come right before each."""
    at = np.arange(len(columns[0]))
    new = np.any([np.diff(column, prepend=column[:1]) != 0 for column in columns], axis=0)
    return at - np.maximum.accumulate(np.where(new, at, 0))


def _quotas(counts: np.ndarray, config: SelectConfig) -> np.ndarray:
    quota = counts.copy()
    present = counts > 0
    if config.balance is not None and present.any():
        rarest = max(int(counts[present].min()), SCARCE)
        quota = np.minimum(quota, config.balance * rarest).astype(quota.dtype)
    if config.total is None or quota.sum() <= config.total:
        return quota
    # Fill all relations to one level; what a rare one leaves goes to the others.
    low, high = 0, int(quota.max())
    while low < high:
        level = (low + high + 1) // 2
        low, high = (level, high) if np.minimum(quota, level).sum() <= config.total else (low, level - 1)
    levelled = np.minimum(quota, low)
    rest = config.total - int(levelled.sum())
    levelled[np.flatnonzero(quota > low)[:rest]] += 1
    return levelled


@dataclass(frozen=True)
class SelectConfig:
    """Which of all candidate expressions are kept."""

    total: int | None = None
    """At most so many; None for as many as the other rules allow."""
    per_frame: int | None = 40
    """At most so many of one frame."""
    balance: float | None = 3.0
    """No relation has more than so many times the expressions of the rarest one; None keeps the relations as they
    come."""
    seed: int = 0
    telling: bool = True
    """Leave out what is true of every object of the target's class, where there are several: such a sentence tells
    nothing apart."""

    def __post_init__(self) -> None:
        for name in ("total", "per_frame"):
            value = getattr(self, name)
            require(value is None or value >= 1, f"{name} must be at least 1", got=value)
        require(
            self.balance is None or 1 <= self.balance < inf, "balance must be a number of at least 1", got=self.balance
        )
