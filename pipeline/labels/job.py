"""The labelling job: plan, run the shards that are missing, and merge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from pipeline.labels.engines import ShardReport, needed_ray, run_local, run_ray
from pipeline.labels.merge import SelectConfig, merge_labels
from pipeline.labels.plan import LabelConfig, SourceSpec, input_changed, make_plan, part_of, save_plan
from pipeline.labels.profiles import NONE, TRAINED, open_second_opinion
from pipeline.labels.reading import Labels, open_labels
from pipeline.labels.schema import Manifest
from pipeline.labels.store import LabelStore
from pipeline.system.detector_setup import with_files
from pipeline.system.errors import as_input_error, require

Engine = Literal["local", "ray"]
Progress = Callable[[int, int], None]
"""Called with (frames done, frames in all)."""


@dataclass(frozen=True)
class LabelReport:
    """What a labelling run did."""

    frames: int
    """Frames of the shards that were asked for."""
    reused: int
    """Of those, frames whose shard was there already."""
    broken: int
    """Frames that could not be used."""
    objects: int
    pairs: int
    candidates: int
    seconds: float
    manifest: Manifest | None
    """Of the merged labels; None where only a part was asked for."""

    def __repr__(self) -> str:
        return f"<LabelReport: {self.frames} frames, {self.objects} objects, {self.seconds:.1f} s>"


def label_dataset(
    spec: SourceSpec,
    out: str | Path,
    config: LabelConfig | None = None,
    selection: SelectConfig | None = None,
    *,
    engine: Engine = "local",
    workers: int = 1,
    part: tuple[int, int] | None = None,
    resume: bool = False,
    limit: int | None = None,
    frames_of: Sequence[str] = (),
    frames_a_shard: int | None = None,
    gpus_a_detector: float = 0.0,
    progress: Progress | None = None,
) -> LabelReport:
    """Label a dataset into a folder (or URL), and merge the shards.

    `out`: must be new or empty; with `resume` and `part` it may hold labels made with the same arguments. `engine`:
    "local" or "ray"; the rows are the same. `part`: only task k of n (from 1), for arrays of jobs that share `out`; the
    last to finish, or anyone after, merges. `resume`: go on in a folder where a run was stopped: finished shards are
    kept. `limit`: only the first so many frames. `frames_of`: only the frames of these splits of the dataset's own.

    Raises InputError: for a dataset that cannot be opened or changes meanwhile, a folder that holds something else.
    """
    config = config or LabelConfig()
    if config.second_opinion not in (NONE, TRAINED):
        config = replace(config, second_opinion=str(Path(config.second_opinion).absolute()))
    start = perf_counter()
    if "://" not in str(out):
        out = Path(out).expanduser().absolute()
    store = LabelStore(out)
    require(workers >= 1, "at least one worker is needed", got=workers)
    require(0 <= gpus_a_detector <= 1e3, "GPUs of a detector", got=gpus_a_detector, expected="a number from 0 to 1000")
    require(
        resume or part is not None or store.is_empty(),
        "the folder for the labels is not empty",
        cause="--resume goes on where a run was stopped",
        path=out,
    )
    require(
        not store.holds_something_else(),
        "the folder holds something else than labels",
        cause="use another folder",
        path=out,
    )
    plan = make_plan(spec.absolute(), config, frames_a_shard=frames_a_shard, limit=limit, frames_of=frames_of, out=out)
    open_second_opinion(config.second_opinion)
    if engine == "ray":
        needed_ray()
    shards = plan.shards if part is None else part_of(plan.shards, *part)
    store.prepare()
    total = sum(len(s.frames) for s in shards)
    reports: list[ShardReport] = []

    def done(report: ShardReport) -> None:
        reports.append(report)
        if progress is not None:
            progress(sum(r.frames for r in reports), total)

    # Readers tell what they cannot read: what the system refuses here is writing.
    with as_input_error(
        "the labels cannot be written",
        OSError,
        got=lambda e: e.strerror or str(e),
        cause="when there is room, --resume goes on where this ended",
        path=out,
    ):
        save_plan(plan, store)
        store.clear_unfinished()
        try:
            if engine == "ray":
                run_ray(plan, shards, store, workers, done, gpus_a_detector=gpus_a_detector)
            else:
                run_local(plan, shards, store, workers, done)
        finally:
            store.clear_unfinished()
        require(
            not input_changed(plan, out),
            "the dataset changed while it was labelled",
            cause="remove the labels, and label it again",
            path=out,
        )
        manifest = merge_labels(out, selection) if part is None and not store.remote else None
    return LabelReport(
        total,
        sum(r.frames for r in reports if r.reused),
        sum(r.broken for r in reports),
        sum(r.objects for r in reports),
        sum(r.pairs for r in reports),
        sum(r.candidates for r in reports),
        perf_counter() - start,
        manifest,
    )


def label(
    dataset: str | Path,
    out: str | Path,
    *,
    config: LabelConfig | None = None,
    selection: SelectConfig | None = None,
    detector: str | None = None,
    segmenter: str | None = "depth",
    engine: Engine = "local",
    workers: int = 1,
    resume: bool = False,
    limit: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Labels:
    """Label a dataset: objects, all pairwise relations, and true sentences.

    Parameters
    ----------
    dataset : str or Path
        A folder, or "demo". Workers open it again: a dataset in memory cannot be labelled.
    out : str or Path
        Folder for the labels; new or empty, but for `resume`.
    config, selection
        How frames are labelled, and which sentences are kept; by default as on the command line.
    detector : str, optional
        What finds the objects. Default: the dataset's annotations.
    segmenter : str, optional
        Makes masks for boxes that have none.
    engine, workers, resume, limit, progress
        As for `label_dataset`. More than one worker needs a script that starts under `if __name__ == "__main__":`.
    options
        Further arguments of `open_pipeline`: model, min_score, up, intrinsics, ...

    Raises InputError as `label_dataset`.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     label("demo", f"{folder}/labels", limit=1)
    <Labels labels: 1 frames, 20 objects, 380 relations, 40 expressions>
    """
    spec = SourceSpec(str(dataset), {"detector": detector, "segmenter": segmenter, **with_files(options, str)})
    label_dataset(
        spec, out, config, selection, engine=engine, workers=workers, resume=resume, limit=limit, progress=progress
    )
    return open_labels(out)
