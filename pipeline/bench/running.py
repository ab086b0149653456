"""Run of the bench: each part in a process of its own, a tree and the one before it in turns."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pipeline.bench.claims import BenchRun, SpeedClaim, declared, machine, read_bench, unmeasured
from pipeline.bench.clock import ONE_THREAD, Setup
from pipeline.system.errors import require
from pipeline.system.whole_files import scratch_folder

HERE = Path(__file__).resolve().parent
TREE = HERE.parents[1]
PARTS = {name: HERE / f"{name}_part.py" for name in ("label", "lift", "start", "steps", "eval", "docs")}
_STARTER = """
import importlib.util, sys
spec = importlib.util.spec_from_file_location(
    "pipeline.bench", sys.argv[1] + "/__init__.py", submodule_search_locations=[sys.argv[1]]
)
sys.modules["pipeline.bench"] = room = importlib.util.module_from_spec(spec)
spec.loader.exec_module(room)
importlib.import_module("pipeline.bench." + "child").main(*sys.argv[2:])
"""
"""Another tree has no such room, or an earlier one: it is measured by this one."""
STOPPED = "stopped"


def run_bench(
    only: Sequence[str] = (),
    setup: Setup | None = None,
    *,
    before: Path | None = None,
    further: Mapping[str, Path] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> BenchRun:
    """Measure claims; what was measured when the user stops it is kept.

    Parameters
    ----------
    only : sequence of str
        Names of claims or of parts; all by default.
    before : Path, optional
        File of an earlier run, or the folder of another checkout, which is measured in turns with this one.
    further : mapping of str to Path, optional
        Parts of the page, by the files that measure them.
    progress : callable
        Told each step in a few words.

    Raises
    ------
    InputError
        There is no such claim, or `before` is neither a run nor a checkout.
    """
    setup = setup or Setup()
    claims = declared(tuple(only))
    earlier, trees = None, [TREE]
    if before is not None and before.is_dir():
        folder = before.resolve()
        require((folder / "pipeline" / "__init__.py").exists(), "this folder is no checkout", path=before)
        trees.append(folder)
    elif before is not None:
        earlier = replace(read_bench(before), before=None)
    parts = {**PARTS, **(further or {})}
    found: list[dict[str, SpeedClaim]] = [{c.name: c for c in unmeasured(claims, STOPPED)} for _ in trees]
    try:
        for turn, part in enumerate(dict.fromkeys(c.name.partition(".")[0] for c in claims)):
            # The other tree first in every other part: what comes second has warmer files.
            for at in range(len(trees))[:: -1 if turn % 2 else 1]:
                progress(f"{part}{' before' * at}")
                _measure(parts.get(part), trees[at], setup, part, found[at], progress)
    except KeyboardInterrupt:
        progress(STOPPED)
    runs = [BenchRun(machine(tree), tuple(of.values()), setup.quick) for tree, of in zip(trees, found, strict=True)]
    return replace(runs[0], before=runs[1] if len(runs) > 1 else earlier)


def _measure(
    file: Path | None,
    tree: Path,
    setup: Setup,
    part: str,
    found: dict[str, SpeedClaim],
    progress: Callable[[str], None],
) -> None:
    """Put the figures of one part of a tree in their places."""
    reason = "" if file is not None else "the page is not installed"
    for line in _figures(file.resolve(), tree, setup) if file is not None else ():
        reason = line.get("reason", reason)
        claim = found.get(line.get("name", ""))
        if claim is not None:
            measured = replace(
                claim, value=_short(line["value"]), floor=_short(line["floor"]), reason=line.get("why", "")
            )
            found[claim.name] = measured
            progress(f"{claim.name} {measured.reason or f'{measured.value:g} {claim.unit}'}")
        if not any(_waits(c, part) for c in found.values()):
            return
    if reason:
        progress(f"{part} not measured: {reason}")
    for name, claim in found.items():
        if _waits(claim, part):
            found[name] = replace(claim, reason=reason or "the part gave no figure")


def _waits(claim: SpeedClaim, part: str) -> bool:
    return claim.name.startswith(f"{part}.") and claim.reason == STOPPED


def _figures(file: Path, tree: Path, setup: Setup) -> Iterator[dict[str, Any]]:
    """Lines of a part's process, and at its end the reason where it did not end well."""
    with scratch_folder() as folder:
        own = {
            "PYTHONPATH": str(tree),
            "XDG_DATA_HOME": str(folder / "data"),
            "XDG_CONFIG_HOME": str(folder / "config"),
        }
        env = (
            {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
            | dict.fromkeys(ONE_THREAD, "1")
            | own
        )
        words = [sys.executable, "-c", _STARTER, str(HERE), str(file), json.dumps(asdict(setup))]
        # A folder without modules: Python looks where it stands before it looks anywhere else.
        with subprocess.Popen(
            words, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as it:
            try:
                assert it.stdout is not None
                yield from map(json.loads, it.stdout)
            except BaseException:
                it.terminate()
                raise
        if it.returncode:
            yield {"reason": f"its process ended with status {it.returncode}"}


def _short(value: float | None) -> float | None:
    """Four digits that count."""
    return None if value is None else float(f"{value:.4g}")
