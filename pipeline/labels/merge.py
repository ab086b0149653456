"""Merging shards: all frames, objects and relations, and the expressions that are selected of all candidates."""

from __future__ import annotations

import os
import platform
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets.settings import ASSUMED, DECLARE
from pipeline.labels.frame_stream import frame_spans
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
from pipeline.labels.selection import SelectConfig, kept_by_quota, kept_of_frames, order_key_of
from pipeline.labels.store import PLAN_FILE, LabelStore
from pipeline.labels.wording import expression_text
from pipeline.language.noun_phrase import alone
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.arrow import pa, pq
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.plugins import versions_of
from pipeline.system.remote import list_anew
from pipeline.system.version import __version__
from pipeline.system.whole_files import clear_abandoned, scratch_folder, sha256_of, temporary_folder, write_synced

LISTED_WARNINGS = 100
CARD_FILE = "README.md"


def merge_labels(where: str | Path, selection: SelectConfig | None = None, out: str | Path | None = None) -> Manifest:
    """Merge the finished shards of a labels folder.

    Tables are written part by part, so that memory does not grow with their
    length; of the candidate expressions that each frame may keep (40 by default)
    three numbers are held. All is written aside and then put into place at once: what
    fails before leaves earlier tables as they were. Shards at a URL are fetched into
    the system's temporary files first, and the merged tables are put there, the manifest last.

    `where`: the labels folder, or a URL. `out`: where the merged tables go; the labels folder or URL by default.

    Raises InputError: shards are missing or damaged, or the folder holds no labels.
    """
    selection = selection or SelectConfig()
    store = LabelStore(where)
    plan = load_plan(store)
    shards = plan.shards
    unfinished = store.unfinished([shard.name for shard in shards])
    missing = [str(shard.index) for shard in shards if shard.name in unfinished]
    require(
        not missing,
        f"{len(missing)} of {len(shards)} shards are missing",
        got=", ".join(missing[:8]) + (" ..." if len(missing) > 8 else ""),
        cause=f"finish them with: spatialviz label {plan.spec.path} --out {store.where} --resume "
        "and the options it was begun with",
        path=store.where,
    )
    target = store if out is None else LabelStore(out)
    with _filled(target) as staging, store.nearby([shard.name for shard in shards]) as near:
        for shard in shards:
            near.check_part(shard.name, shard.key)
        return _write_all(staging, plan, near, selection)


@contextmanager
def _filled(target: LabelStore) -> Iterator[Path]:
    """Folder to write merged labels into; at the good end of the block all files there go to their place at once."""
    place, folder = target.there, target.folder
    if place is not None:
        _require_labels(target, place.names())
        with scratch_folder() as staging:
            yield staging
            place.remove(MANIFEST_FILE)
            for file in _in_order(staging):
                place.put_file(file.relative_to(staging).as_posix(), file)
        list_anew()
        return
    with as_input_error(
        "merged tables go into a folder", FileExistsError, NotADirectoryError, got="a file", path=folder
    ):
        folder.mkdir(parents=True, exist_ok=True)
    _require_labels(target, {path.name for path in folder.iterdir()})
    clear_abandoned(folder)
    with temporary_folder(folder / "merged") as staging:
        yield staging
        (folder / MANIFEST_FILE).unlink(missing_ok=True)
        move_all(staging, folder)


def _require_labels(target: LabelStore, names: set[str]) -> None:
    require(
        not names or {PLAN_FILE, MANIFEST_FILE} & names,
        "the folder holds something else",
        expected="a new or empty folder, or labels",
        path=target.where,
    )


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
        broken = [row for row in rows if not row["ok"]][: LISTED_WARNINGS - len(warnings)]
        warnings += [f"{row['frame']}: {row['problem']}" for row in broken]
    more = tables["frames"].rows - frames_ok - LISTED_WARNINGS
    if more > 0:
        warnings.append(f"and {more} more frames")
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
    kinds: Counter[str] = Counter()
    with open(out / SENTENCES_FILE, "wb") as file:
        for shard in shards:
            part = store.read_part(shard.name, SENTENCES)
            kinds.update(part.column("kind").to_pylist())
            file.write("".join(f"{line}\n" for line in part.column("line").to_pylist()).encode())
        file.flush()
        os.fsync(file.fileno())
    return kinds


def write_manifest(labels: Labels) -> None:
    """Write the card, and last the manifest of merged tables."""
    write_synced(labels.root / CARD_FILE, dataset_card(labels).encode())
    write_synced(labels.root / MANIFEST_FILE, labels.manifest.model_dump_json(indent=1).encode())


def move_all(staging: Path, out: Path) -> None:
    """Move all files of labels into their folder, the manifest last."""
    for file in _in_order(staging):
        final = out / file.relative_to(staging)
        final.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, final)


def _in_order(staging: Path) -> list[Path]:
    return sorted(filter(Path.is_file, staging.rglob("*")), key=lambda p: (p.name == MANIFEST_FILE, p))


_CHOSEN_BY = ("id", "frame_index", "relation", "target", "reference", "acceptable", "same_class")


def choose(shards: Sequence[Shard], store: LabelStore, selection: SelectConfig) -> tuple[int, dict[str, np.ndarray]]:
    """Number of candidates, and the indices of the chosen rows by shard.

    A shard holds whole frames: what each frame keeps is settled shard by shard, and only that is held for the quotas.
    """
    codes: dict[str, int] = {}
    rows_of: dict[str, np.ndarray] = {}
    held: list[tuple[np.ndarray, ...]] = []
    count = 0
    for shard in shards:
        part = store.read_part(shard.name, CANDIDATES, list(_CHOSEN_BY))
        count += part.num_rows
        ids = np.array([int(i, 16) for i in part.column("id").to_pylist()], np.uint64)
        target, reference = (
            np.array([codes.setdefault(v, len(codes)) for v in part.column(n).to_pylist()], np.int32)
            for n in ("target", "reference")
        )
        relation = np.array([PAIRWISE.index(r) for r in part.column("relation").to_pylist()], np.int8)
        frame = part.column("frame_index").to_numpy()
        answers = np.array([len(a) for a in part.column("acceptable").to_pylist()], np.int32)
        same_class = part.column("same_class").to_numpy()
        telling = (answers < same_class) | (same_class == 1) if selection.telling else np.ones(len(ids), np.bool_)
        rows = np.flatnonzero(telling)
        few = kept_of_frames(*(column[rows] for column in (ids, frame, relation, target, reference)), config=selection)
        rows_of[shard.name] = rows = rows[few].astype(np.int32)
        held.append((order_key_of(ids[rows], selection), relation[rows], target[rows]))
    if not held:
        return 0, {}
    kept = kept_by_quota(*(np.concatenate(columns) for columns in zip(*held, strict=True)), config=selection)
    parts = np.split(kept, np.cumsum([len(rows) for rows in rows_of.values()])[:-1])
    return count, {name: rows[of] for (name, rows), of in zip(rows_of.items(), parts, strict=True)}


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
        rows = store.read_part(shard.name, CANDIDATES).take(pa.array(chosen[shard.name]))
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
