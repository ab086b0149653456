"""Claims of speed: each a figure beside its peer or floor of the same run, with what is promised of it."""

from __future__ import annotations

import os
import platform
import subprocess
from dataclasses import asdict, dataclass, fields, replace
from datetime import date
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from operator import ge, le
from pathlib import Path
from typing import Any

from pipeline.system.errors import InputError, as_input_error
from pipeline.system.safe_files import read_json
from pipeline.system.version import __version__
from pipeline.system.whole_files import write_json

BARE = "`import numpy, cv2, onnxruntime`"
DECODING = "decoding its files with OpenCV"
_SIGNS = {"<=": le, ">=": ge}


@dataclass(frozen=True)
class SpeedClaim:
    """One figure and the figure beside it.

    Examples
    --------
    >>> SpeedClaim("start.ask", "`ask`", "s", "bare imports", "ratio <= 2.5", value=0.3, floor=0.15).kept
    'yes'
    """

    name: str
    """The part that measures it, a dot, and the figure."""
    what: str
    unit: str
    """Of both figures."""
    beside: str
    """Peer or floor, measured in the same run."""
    promise: str = ""
    """"ratio", "value" or "extra" (the value less the floor), a sign, a number."""
    value: float | None = None
    floor: float | None = None
    """Figure of the peer or floor."""
    reason: str = ""
    """Why there is no figure."""

    @property
    def ratio(self) -> float | None:
        """Value over floor; None where either is missing."""
        return self.value / self.floor if self.value is not None and self.floor else None

    @property
    def kept(self) -> str:
        """ "yes", "no", "not measured", or "" where nothing is promised."""
        if self.value is None:
            return "not measured"
        if not self.promise:
            return ""
        of, sign, bound = self.promise.split()
        extra = None if self.floor is None else self.value - self.floor
        found = {"ratio": self.ratio, "value": self.value, "extra": extra}[of]
        return "not measured" if found is None else "yes" if _SIGNS[sign](found, float(bound)) else "no"


def _starts(command: str, what: str) -> SpeedClaim:
    return SpeedClaim(f"start.{command}", what, "s", BARE, "ratio <= 2.5")


def _lifts(key: str, peer: str, promise: str = "") -> SpeedClaim:
    return SpeedClaim(f"lift.{key}", "lifting and relations of a frame", "frames/s", peer, promise)


CLAIMS = (
    SpeedClaim("label.packed", "a labelled frame of 29 objects, masks as the demo's", "ms", DECODING, "ratio <= 2.5"),
    SpeedClaim("label.written", "the same, masks written by `cv2.imwrite`", "ms", DECODING, "ratio <= 3.5"),
    SpeedClaim("label.sentences", "the same with sentences of every kind", "ms", "without"),
    SpeedClaim("label.growth", "a labelled frame of 300 objects", "ms", "of 30 objects", "ratio <= 12"),
    SpeedClaim("label.job", "`label` of the demo by one process", "frames/s", "decoding alone"),
    SpeedClaim("label.memory", "memory after all of many frames", "MB", "after the first quarter"),
    _lifts("open3d", "Open3D recipe", "ratio >= 60"),
    _lifts("spatialrgpt", "SpatialRGPT's functions"),
    _lifts("vqasynth", "VQASynth's functions"),
    _lifts("vqasynth_cut", "the same, without its canonicalisation"),
    _lifts("trimesh", "trimesh: oriented bounds of the same points"),
    SpeedClaim("lift.faces", "error of box faces, mean", "cm", "Open3D recipe"),
    SpeedClaim("lift.pairs", "six relations of 60 objects with margins", "pairs/s", "pair by pair"),
    _starts("ask", '`ask demo 000001/000000 "mug left of the laptop"`'),
    _starts("relations", "`relations demo 000001/000000`"),
    _starts("frames", "`frames demo`"),
    _starts("check", "`check` of the demo's labels"),
    SpeedClaim("start.help", "`--help`", "s", "`python -c pass`", "value <= 0.3"),
    SpeedClaim("page.first_byte", "`view demo` until its first byte, wall clock", "s", BARE, "value <= 0.8"),
    SpeedClaim("page.first_points", "`view demo` until points are drawn, wall clock", "s", BARE, "value <= 2"),
    SpeedClaim(
        "page.frame", "another frame until its points are sent, wall clock", "ms", "reading and lifting", "extra <= 150"
    ),
    SpeedClaim(
        "page.first_cloud", "points sent of a frame before anything is seen", "MB", "all as float32", "value <= 0.8"
    ),
    SpeedClaim("page.cloud", "points sent of a frame", "MB", "all as float32", "value <= 2.8"),
    SpeedClaim(
        "page.label", "a label set, processor of the page's server", "ms", "a row synced by SQLite", "value <= 20"
    ),
    SpeedClaim("steps.label", "a label set, the core's part", "ms", "a row synced by SQLite", "value <= 20"),
    SpeedClaim("steps.whatif", "a what-if step with 60 objects", "ms", "answering anew", "value <= 50"),
    SpeedClaim(
        "eval.verdicts", "50,000 expressions with verdicts on two cores", "s", "answering alone", "ratio <= 1.5"
    ),
    SpeedClaim("eval.singly", "expressions answered by frames", "1/s", "asked one by one"),
    SpeedClaim("eval.search", "a search of 500,000 records", "ms", "DuckDB on the same file", "value <= 100"),
    SpeedClaim("eval.memory", "memory that the opened records take", "MB", "their file"),
    SpeedClaim("docs.names_load", "loading the table of names", "ms", "reading its files"),
    SpeedClaim("docs.names_query", "a name among 1,203", "ms", "the first one, with the index"),
    SpeedClaim("docs.frames", "`frames`, 1,000 frames", "s", "opening their files"),
    SpeedClaim("docs.decode", "`frames --decode`, 1,000 frames", "s", "decoding with OpenCV"),
    SpeedClaim("docs.doctor", "`doctor` of a dataset", "s", "decoding its files"),
    SpeedClaim("docs.attributes", "attributes of 50 objects", "ms", "decoding the frame"),
)
"""Everything that is measured, in the order of the table."""


@dataclass(frozen=True)
class BenchRun:
    """Claims with the machine that they were measured on."""

    machine: dict[str, Any]
    """processor, cores, ram_gb, os, python, versions of numpy, cv2 and onnxruntime, date, version, commit."""
    claims: tuple[SpeedClaim, ...]
    quick: bool = False
    """Fewer passes, and rates of fewer expressions and records scaled up."""
    before: BenchRun | None = None
    """Another tree by the same script, in turns; or an earlier run."""

    def claim(self, name: str) -> SpeedClaim | None:
        """Find a claim by its name."""
        return next((c for c in self.claims if c.name == name), None)

    def record(self) -> dict[str, Any]:
        """Convert to JSON, with the ratios and whether promises are kept."""
        claims = [{**asdict(c), "ratio": c.ratio, "kept": c.kept} for c in self.claims]
        before = None if self.before is None else self.before.record()
        return {"machine": self.machine, "quick": self.quick, "claims": claims, "before": before}

    def write(self, path: Path) -> None:
        """Write as JSON."""
        write_json(path, self.record())


def read_bench(path: Path) -> BenchRun:
    """Read a saved run; InputError where the file is none."""
    with as_input_error("this is no file of `spatialviz bench --out`", KeyError, TypeError, ValueError, path=path):
        return _run_of(read_json(path))


def _run_of(record: dict[str, Any]) -> BenchRun:
    names = {f.name for f in fields(SpeedClaim)}
    claims = tuple(SpeedClaim(**{k: v for k, v in c.items() if k in names}) for c in record["claims"])
    before = record.get("before")
    return BenchRun(record["machine"], claims, bool(record["quick"]), None if before is None else _run_of(before))


def declared(only: tuple[str, ...] = ()) -> tuple[SpeedClaim, ...]:
    """Claims to measure, all or those of these names or parts; InputError for an unknown one."""
    parts = dict.fromkeys(c.name.partition(".")[0] for c in CLAIMS)
    for name in only:
        if name not in parts and not any(c.name == name for c in CLAIMS):
            raise InputError(
                "there is no such claim", got=name, expected=f"{', '.join(parts)}, or a claim as label.packed"
            )
    return tuple(c for c in CLAIMS if not only or {c.name, c.name.partition(".")[0]} & set(only))


def unmeasured(claims: tuple[SpeedClaim, ...], reason: str) -> tuple[SpeedClaim, ...]:
    """Claims with the reason why there is no figure."""
    return tuple(replace(c, reason=reason) for c in claims)


def machine(tree: Path) -> dict[str, Any]:
    """Describe this machine, and the state of a tree of the program."""
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text(encoding="utf-8", errors="replace").splitlines() if cpu.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    ram = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 0
    return {
        "date": date.today().isoformat(),
        "processor": model or platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "ram_gb": round(ram / 2**30, 1),
        "os": platform.platform(),
        "python": platform.python_version(),
        "numpy": _version("numpy"),
        "cv2": _version("opencv-python-headless"),
        "onnxruntime": _version("onnxruntime"),
        "version": __version__,
        "commit": _commit(tree),
    }


def _version(package: str) -> str | None:
    try:
        return version_of(package)
    except PackageNotFoundError:
        return None


def _commit(tree: Path) -> str | None:
    """Short commit of a checkout, with "+" where files differ; None elsewhere."""
    git = ["git", "-C", str(tree), "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        return subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
