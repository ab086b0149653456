"""What many tests ask for and nobody changes, made once: for all workers of a run, and for later runs of the same code.

It stands in pytest's own cache under a key of everything that makes it, so that a clean clone begins with nothing, and
nothing outlives the code that made it.
"""

from __future__ import annotations

import platform
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
import xxhash

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ("pipeline/**/*.py", "assets/**/*", "tests/*.py", "tests/*/[!t]*.py")
LIBRARIES = ("numpy", "scipy", "pyarrow", "opencv-python-headless", "trimesh", "torch", "onnx")


@cache
def source_key() -> str:
    """A hash of the code, the assets and the libraries that can take part in making something."""
    found = xxhash.xxh3_128()
    for pattern in SOURCES:
        for path in sorted(p for p in ROOT.glob(pattern) if p.is_file()):
            found.update(path.relative_to(ROOT).as_posix().encode())
            found.update(path.read_bytes())
    found.update(platform.python_version().encode())
    for name in LIBRARIES:
        try:
            found.update(f"{name} {version(name)}".encode())
        except PackageNotFoundError:
            found.update(f"no {name}".encode())
    return found.hexdigest()


def made_once(config: pytest.Config, name: str, make: Callable[[Path], object], copy: Path) -> Path:
    """A copy, of the asker's own, of the folder that `make` fills.

    Parameters
    ----------
    config
        Of the run: its cache keeps the folder.
    name
        What it is; one name has one `make`.
    make
        Fills the empty folder that it is given. What it writes names no path of it.
    copy
        Where the copy is put; it must not exist.
    """
    home = config.cache.mkdir("made") / name  # pyright: ignore[reportOptionalMemberAccess]
    kept = home / source_key()
    with _locked(home):
        if not kept.is_dir():
            for old in home.iterdir():
                shutil.rmtree(old) if old.is_dir() else None
            part = home / "part"
            part.mkdir()
            make(part)
            part.rename(kept)
        shutil.copytree(kept, copy)
    return copy


@contextmanager
def _locked(home: Path) -> Iterator[None]:
    """Alone in a folder among the processes of this machine."""
    home.mkdir(parents=True, exist_ok=True)
    with open(home / "lock", "w") as file:
        try:
            import fcntl
        except ImportError:  # Windows: workers make it twice there, each in turn
            yield
            return
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
