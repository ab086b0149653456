"""A whole synthetic dataset: rooms, views, BOP files, put in place only when complete."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.datasets.synthetic.bop_writer import SceneRecord, write_frame, write_json, write_scene
from pipeline.datasets.synthetic.render import render_view
from pipeline.datasets.synthetic.rooms import make_room
from pipeline.datasets.synthetic.views import choose_views
from pipeline.system.errors import InputError

ROOMS_A_SEED = 1_000_000
"""Room i of dataset seed s has the room seed s * ROOMS_A_SEED + i, so datasets never share a room."""

SMALLEST_SIDE = 16


@dataclass(frozen=True)
class RenderReport:
    """What was rendered.

    Attributes
    ----------
    out : Path
    frames, rooms : int
    objects : int
        Annotated instances, summed over frames.
    classes : tuple of str
        Class names that are annotated somewhere, sorted.
    seconds : float
    """

    out: Path
    frames: int
    rooms: int
    objects: int
    classes: tuple[str, ...]
    seconds: float

    @property
    def frames_per_second(self) -> float:
        return self.frames / max(self.seconds, 1e-9)


def render_dataset(
    out: Path,
    *,
    rooms: int = 4,
    views: int = 3,
    seed: int = 0,
    width: int = 640,
    height: int = 480,
    progress: Callable[[int, int], None] | None = None,
    workers: int = 1,
) -> RenderReport:
    """Render annotated RGB-D rooms in BOP format.

    Parameters
    ----------
    out : Path
        Folder to make; it may exist if it is empty.
    rooms, views : int
        Rooms, and frames of each.
    seed : int
        Equal arguments give byte-identical files, whatever `workers`.
    width, height : int
        Pixels.
    progress : callable, optional
        Called with (frames done, frames in all).
    workers : int
        Processes; with more than one, each renders whole rooms, `progress` is
        called once a room, and the calling script must be importable
        (`if __name__ == "__main__"`): they are spawned. Hence one by default.

    Raises
    ------
    InputError
        `out` is not empty, or an argument makes no sense.
    MissingExtra
        embreex is not installed.
    """
    out = Path(out)
    _check(out, rooms, views, seed, width, height, workers)
    started = time.perf_counter()
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".partial", dir=out.parent))
    try:
        jobs = [(partial / f"{k + 1:06d}", seed * ROOMS_A_SEED + k, views, width, height) for k in range(rooms)]
        records = _run(jobs, views, workers, progress)
        models = {key: info for record in records for key, info in record.models.items()}
        numbers = {key: k + 1 for k, key in enumerate(models)}
        for job, record in zip(jobs, records, strict=True):
            write_scene(job[0], record, numbers)
        write_json(partial / "models" / "models_info.json", {str(numbers[key]): models[key] for key in models})
        command = (
            f"spatialviz render OUT --rooms {rooms} --views {views} --seed {seed} --width {width} --height {height}"
        )
        (partial / "spatialviz.toml").write_text(_declaration(command, seed), encoding="utf-8")
        partial.chmod(0o755)
        if out.exists():
            out.rmdir()
        os.replace(partial, out)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    objects = sum(len(entries) for record in records for entries in record.gt.values())
    classes = tuple(sorted({str(info["name"]) for info in models.values()}))
    return RenderReport(out, rooms * views, rooms, objects, classes, time.perf_counter() - started)


def _check(out: Path, rooms: int, views: int, seed: int, width: int, height: int, workers: int) -> None:
    for name, value in (("rooms", rooms), ("views", views), ("workers", workers)):
        if value < 1:
            raise InputError(f"{name} must be at least 1", got=value)
    if seed < 0:
        raise InputError("a seed must not be negative", got=seed)
    if min(width, height) < SMALLEST_SIDE:
        raise InputError(
            "the picture is too small", got=f"{width}x{height}", expected=f"at least {SMALLEST_SIDE} pixels a side"
        )
    if out.exists() and not out.is_dir():
        raise InputError("the output is a file", expected="a folder that is empty or does not exist", path=out)
    if out.is_dir() and any(out.iterdir()):
        raise InputError(
            "the output folder is not empty",
            expected="a folder that is empty or does not exist",
            cause="is an earlier rendering in it?",
            path=out,
        )


Job = tuple[Path, int, int, int, int]


def _run(jobs: list[Job], views: int, workers: int, progress: Callable[[int, int], None] | None) -> list[SceneRecord]:
    total = views * len(jobs)
    tell = progress or (lambda done, of: None)
    if min(workers, len(jobs)) == 1:
        records = []
        for k, job in enumerate(jobs):
            record = SceneRecord()
            for view in _render_room(job, record):
                tell(k * views + view + 1, total)
            records.append(record)
        return records
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    pool = ProcessPoolExecutor(min(workers, len(jobs)), mp_context=multiprocessing.get_context("spawn"))
    try:
        futures = [pool.submit(_whole_room, job) for job in jobs]
        for done, future in enumerate(as_completed(futures), start=1):
            future.result()
            tell(done * views, total)
        return [future.result() for future in futures]
    finally:
        # A worker must not go on writing into a folder that is being removed.
        pool.shutdown(wait=True, cancel_futures=True)


def _whole_room(job: Job) -> SceneRecord:
    record = SceneRecord()
    for _ in _render_room(job, record):
        pass
    return record


def _render_room(job: Job, record: SceneRecord) -> Iterator[int]:
    """Render the views of one room, yielding each view's number when its files are written."""
    folder, room_seed, views, width, height = job
    room = make_room(room_seed)
    cameras = choose_views(room, views, np.random.default_rng([room_seed, 11]), width, height)
    for k, camera in enumerate(cameras):
        frame = render_view(room, camera, np.random.default_rng([room_seed, 13, k]))
        write_frame(folder, k, room, frame, record)
        yield k


def _declaration(command: str, seed: int) -> str:
    """The dataset's own file: what BOP cannot say, that z is up in its world."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        tool = version("spatialviz")
    except PackageNotFoundError:
        tool = "unknown"
    return (
        'name = "spatialviz synthetic rooms"\n'
        "world_up = [0, 0, 1]\n\n"
        "[generator]\n"
        'tool = "spatialviz render"\n'
        f"version = {json.dumps(tool)}\n"
        f"seed = {seed}\n"
        f"command = {json.dumps(command)}\n"
    )
