"""Recordings at a URL (s3://, gs://, hf://, https://; extra: remote): listed once, files fetched when opened.

The user's cache holds the whole tree. A file before its fetch has its size, no content, and a mode without read access;
`safe_files` fetches it before anything opens it. Its time of change stands for the file's version there, and stays the
same at the fetch.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit
from uuid import uuid4

from pipeline.system.errors import as_input_error, extra_module, first_line, kind_and_text, require
from pipeline.system.limits import Limits, current_limits, within
from pipeline.system.paths import cache_folder

_URL = re.compile(r"[a-z][a-z0-9+.-]+://")
_VERSIONS = ("ETag", "etag", "md5Hash", "blob_id", "checksum", "LastModified", "last_modified", "mtime", "created")
"""Under one of these the file systems of fsspec tell a file's version."""
_HERE = "file://"
_UNKNOWN_SIZE = 1
"""The size that stands for one that the listing does not tell (HTTP)."""
_LARGEST = 1 << 40
_INDEX = ".spatialviz-index.json"
Entry = tuple[int | None, str]
"""Size and version of a file there."""


def is_url(path: str | Path) -> bool:
    """Return True for a URL, False for a path."""
    return _URL.match(str(path)) is not None


def is_elsewhere(path: str | Path) -> bool:
    """Return True for a URL but file://."""
    return is_url(path) and not str(path).startswith(_HERE)


def local_path(path: str | Path, without: str = "") -> Path:
    """Path of a dataset on this machine: a path unchanged, the copy of a URL (listed once a process).

    `without`: a folder in it that is not wanted, and not listed.

    Raises
    ------
    InputError
        Nothing at the URL, no connection, or no room in the cache.
    MissingExtra
        fsspec is not installed.
    """
    if not is_url(path):
        return Path(path).expanduser()
    url = str(path)
    if not is_elsewhere(url):
        return Path(unquote(urlsplit(url).path))
    return _mirrored(url.rstrip("/") if without else url, _copies(), without)


def list_anew() -> None:
    """Forget what was listed in this process."""
    _mirrored.cache_clear()


def named_before(path: str) -> str:
    """Dataset or labels as named by a file; InputError for a URL never opened on this machine."""
    if is_url(path):
        known = (_copy_of(path, _copies()) / _INDEX).is_file()
        require(known, "a URL that was not opened here", got=path, expected="its URL or path, given")
    return path


def url_of(path: Path) -> str | None:
    """URL that a file or folder is the copy of; None for what is of this machine."""
    cache, path = _copies(), Path(os.path.abspath(path))
    if not path.is_relative_to(cache) or len(path.relative_to(cache).parts) < 2:
        return None
    copy, _, *below = path.relative_to(cache).parts
    index = cache / copy / _INDEX
    if not index.is_file():
        return None
    return "/".join((_read_index(index, index.stat().st_mtime_ns)[0].rstrip("/"), *below))


def _copies() -> Path:
    return cache_folder().absolute() / "remote"


def _copy_of(url: str, cache: Path) -> Path:
    return cache / hashlib.sha256(url.encode()).hexdigest()[:16]


@lru_cache(maxsize=64)
def _mirrored(url: str, cache: Path, without: str = "") -> Path:
    system, root = connected(url)
    # What the file system listed before does not count: others write there too.
    system.invalidate_cache()
    copy = _copy_of(url, cache)
    top, index = copy / (PurePosixPath(root).name or "root"), copy / _INDEX
    kept = f"what was fetched is in {top}" if index.is_file() else None
    found: dict[str, Entry] = {}
    with (
        as_input_error("the URL cannot be listed", Exception, got=kind_and_text, cause=kept, path=url),
        suppress(FileNotFoundError),
    ):
        found.update(_listed(system, root, url, without))
    what = "are no labels" if without else "is no such dataset"
    require(found, f"there {what}", expected="a folder or a file at this URL", cause=kept, path=url)
    parents = {PurePosixPath(folder) for folder in {name.rpartition("/")[0] for name in found}}
    folders = {str(above) for parent in parents for above in (parent, *parent.parents)}
    # Object stores may have a file and a folder of one name; the file is left out.
    files = {name: entry for name, entry in found.items() if name not in folders}
    with as_input_error("the copy of a URL cannot be kept", OSError, got=lambda e: e.strerror, path=copy):
        copy.mkdir(mode=0o700, parents=True, exist_ok=True)
        known = _read_index(index, index.stat().st_mtime_ns)[1] if index.is_file() else {}
        for name in known.keys() - files.keys():
            (top / name).unlink(missing_ok=True)
        for folder in () if "" in files else sorted(folders):
            (top / folder).mkdir(exist_ok=True)
        for name, entry in files.items():
            _mark(top / name, entry, known.get(name) == list(entry))
        temporary = copy / f".{uuid4().hex}.tmp"
        temporary.write_text(json.dumps({"url": url, "files": files}))
        temporary.replace(index)
    return top


def connected(url: str) -> tuple[Any, str]:
    """File system of a URL, and the place's name in it.

    Raises InputError: an unknown kind of URL, or a package is missing for it; MissingExtra without fsspec.
    """
    fsspec = extra_module("fsspec", f"reaching {url}", "remote")
    package = "pip install 'spatialviz[remote]' for HTTP; s3fs, gcsfs or huggingface_hub for their own"
    with (
        as_input_error("this kind of URL cannot be reached", ValueError, got=first_line, path=url),
        as_input_error("a package is missing for this URL", ImportError, got=first_line, cause=package, path=url),
    ):
        system, root = fsspec.core.url_to_fs(url)
    return system, root.rstrip("/")


def _listed(system: Any, root: str, url: str, without: str = "") -> Iterator[tuple[str, Entry]]:
    """Visible files below a place by relative name; "" for a file itself."""
    web = url.startswith(("http:", "https:"))
    # A web server says "file" of everything: there a name with an ending is one.
    ending = bool(PurePosixPath(urlsplit(url).path).suffix) and not url.endswith("/")
    info = system.info(root) if ending or not web else {"type": "directory"}
    if info["type"] == "file":
        yield "", _entry(info)
        return
    count = 0
    for above, folders, files in system.walk(root, detail=True, on_error="raise"):
        if above.strip("/") == root.strip("/"):
            folders.pop(without, None)
        count += len(folders) + len(files)
        within(count, "names", "a folder", url, current_limits())
        for info in files.values():
            name = info["name"][len(root) :].strip("/")
            parts = name.split("/")
            odd = any(p[:1] in ("", ".") or {"\0", "\\"} & set(p) or len(p.encode()) > 255 for p in parts)
            if not odd and not (web and set("?#") & set(name)):
                yield name, _entry(info)


def _entry(info: dict[str, Any]) -> Entry:
    return info.get("size"), str(next((info[key] for key in _VERSIONS if info.get(key) is not None), ""))


def _mark(path: Path, entry: Entry, unchanged: bool) -> None:
    """Put a file without content in place of a file of this version, unless present."""
    version_ns = int(hashlib.sha256(repr(entry).encode()).hexdigest()[:16], 16) % 10**9 * 10**9
    if path.exists():
        if unchanged or path.stat().st_mtime_ns == version_ns:
            return
        path.unlink()
    # Another process may put it there meanwhile.
    with (
        suppress(FileExistsError),
        open(path, "xb", opener=lambda name, flags: os.open(name, flags, 0)) as file,
    ):
        file.truncate(_UNKNOWN_SIZE if entry[0] is None else min(entry[0], _LARGEST))
        os.utime(path, ns=(version_ns, version_ns))


def fetch(path: Path, state: os.stat_result, limit: str, limits: Limits) -> None:
    """Fetch a file of a copy before the first use; nothing for any other file.

    Raises
    ------
    InputError
        No connection, another size than listed, or above the limit of this name.
    """
    cache = _copies()
    if not path.is_relative_to(cache):
        return
    copy, _, *below = path.relative_to(cache).parts
    index = cache / copy / _INDEX
    url, files = _read_index(index, index.stat().st_mtime_ns)
    name = "/".join(below)
    source, size = f"{url}: {name}" if name else url, files[name][0]
    system, root = connected(url)
    temporary = path.with_name(f".{uuid4().hex}.tmp")
    try:
        with (
            as_input_error("a file cannot be fetched", Exception, got=kind_and_text, path=source),
            system.open(f"{root}/{name}" if name else root, "rb") as there,
            open(temporary, "wb") as here,
        ):
            while (block := there.read(1 << 20)) and (size is None or here.tell() <= size):
                within(here.tell() + len(block), limit, "a file", source, limits)
                here.write(block)
            require(
                size in (None, here.tell()),
                "a file changed since it was listed",
                got=f"{here.tell()} bytes",
                expected=size,
                cause="open the dataset again",
                path=source,
            )
        os.utime(temporary, ns=(state.st_mtime_ns, state.st_mtime_ns))
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@lru_cache(maxsize=8)
def _read_index(index: Path, _changed: int) -> tuple[str, dict[str, Entry]]:
    record = json.loads(index.read_text())
    return record["url"], record["files"]
