"""Model files by path or by their id on the Hugging Face hub: fetched once, checked, kept in the user's cache.

An id is OWNER/REPO[:FILE][@REVISION]. What a revision meant when it was first fetched is kept, so that a model stays
the same file until another revision is asked for.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.system.errors import InputError, extra_module, require
from pipeline.system.execution import is_verbose
from pipeline.system.frozen import dataclass
from pipeline.system.paths import cache_folder
from pipeline.system.whole_files import sha256_of, write_whole

_ID = re.compile(
    r"(?P<repo>[A-Za-z0-9][\w.-]{0,95}/[\w.-]{1,96})(?::(?P<file>[^@:\\]+))?(?:@(?P<revision>[\w.][\w./-]*))?"
)
_ON_HUB = re.compile(
    r"https?:/+(?:www\.)?(?:huggingface\.co|hf\.co)/([\w.-]+/[\w.-]+)/(?:resolve|blob|raw)/([^/]+)/([^?#]+).*"
)
"""The address of a file on the hub; a path has lost the second slash."""
_FILE_ENDINGS = (".onnx", ".ort", ".json", ".toml", ".npz", ".txt")
_COMMIT = re.compile(r"[0-9a-f]{40}")
COMPANIONS = ("tokenizer.json", "vocab.txt")
"""Files that are fetched with a model, from its folder or the one above."""
WEIGHTS = ("_data", ".data")
"""Endings of the file that a model's weights are in, where they are in a file of their own."""
DEFAULT_REVISION = "main"


@dataclass(frozen=True)
class HubId:
    """File on the hub: OWNER/REPO, its path there (None for the default one), and a commit, tag or branch."""

    repo: str
    file: str | None = None
    revision: str | None = None

    def __str__(self) -> str:
        return self.repo + (f":{self.file}" if self.file else "") + (f"@{self.revision}" if self.revision else "")


def parse_hub_id(given: str | Path) -> HubId | None:
    """Id on the hub, also of a file's address there; None for a path, existing or by the look."""
    text = _ON_HUB.sub(r"\1:\3@\2", given.as_posix() if isinstance(given, Path) else given)
    found = _ID.fullmatch(text)
    if found is None or Path(given).exists():
        return None
    if found["file"] is None and found["revision"] is None and found["repo"].lower().endswith(_FILE_ENDINGS):
        return None
    inside = PurePosixPath(found["file"] or "model.onnx")
    if inside.is_absolute() or ".." in inside.parts:
        return None
    return HubId(found["repo"], found["file"], found["revision"])


def resolve_model(given: str | Path) -> Path:
    """File of a model, fetched from the hub at the first use of an id.

    Raises
    ------
    InputError
        No such file on the hub, no network, another file than the known one, or a web address.
    MissingExtra
        The library `huggingface_hub` is not installed.
    """
    hub_id = parse_hub_id(given)
    if hub_id is None:
        refuse_address(given)
        return Path(given)
    return fetched(hub_id) or fetch(hub_id)


def refuse_address(given: str | Path) -> None:
    """Raise InputError for a web address."""
    require(
        re.match("https?:/", str(given)) is None,
        "a model is not given by its address",
        got=given,
        expected="a path, or an id of the hub",
        cause="download it first",
    )


def model_folder() -> Path:
    """Folder of fetched models: `models` in the cache folder, and below it OWNER--REPO/COMMIT."""
    return cache_folder() / "models"


def fetched(hub_id: HubId) -> Path | None:
    """Fetched file; None before the first fetch."""
    folder = _folder(hub_id.repo)
    revision = _revision(hub_id)
    if not _COMMIT.fullmatch(revision):
        try:
            revision = (folder / "refs" / revision.replace("/", "--")).read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError):
            return None
    name = hub_id.file or _default_file(hub_id.repo)
    if name is not None:
        path = folder / revision / name
        return path if path.is_file() else None
    found = sorted((folder / revision).rglob("*.onnx"))
    return found[0] if len(found) == 1 else None


def all_fetched() -> Iterator[tuple[HubId, Path]]:
    """Fetched ONNX files."""
    root = model_folder()
    for path in sorted(root.glob("*--*/*/**/*.onnx")) if root.is_dir() else ():
        owner_repo, commit, *parts = path.relative_to(root).parts
        if _COMMIT.fullmatch(commit):
            yield HubId(owner_repo.replace("--", "/", 1), "/".join(parts), commit), path


def fetch(hub_id: HubId) -> Path:
    """Fetch a file with all companions; raises as `resolve_model`."""
    hub = extra_module("huggingface_hub", f"the model {hub_id}", "hub")
    repo, folder, revision, endpoint = (
        hub_id.repo,
        _folder(hub_id.repo),
        _revision(hub_id),
        os.environ.get("HF_ENDPOINT"),
    )
    with _reached(hub_id):
        api = hub.HfApi(endpoint=endpoint or None)
        info = api.model_info(repo, revision=revision, files_metadata=True, timeout=30)
    hashes = {s.rfilename: getattr(s.lfs, "sha256", None) for s in info.siblings or ()}
    commit, models = info.sha or "", [name for name in hashes if name.endswith(".onnx")]
    require(_COMMIT.fullmatch(commit), "the hub does not say which commit the model is of", got=repr(commit), path=repo)
    # Our own table goes before what the hub says of its large files.
    ours = [m for m in known_models() if (m.repo, m.revision) == (repo, commit)]
    hashes |= {f.file: f.sha256 for m in ours for f in m.files if f.sha256 and f.file in hashes}
    file = hub_id.file or _default_file(repo) or (models[0] if len(models) == 1 else None)
    some = ", ".join(models[:8]) + (f" and {len(models) - 8} more" if len(models) > 8 else "")
    if file is None:
        what, wanted = f"{repo} holds {len(models) or 'no'} ONNX files", f"one of them: {repo}:FILE" if models else None
        raise InputError(what, got=some or None, expected=wanted)
    expected = some or "an ONNX file, of which there is none"
    require(file in hashes, f"the hub has no file {file!r} in {repo}", expected=expected)
    inside = PurePosixPath(file).parent
    beside = [file + ending for ending in WEIGHTS]
    beside += [(place / name).as_posix() for place in (inside, inside.parent) for name in COMPANIONS]
    # The model comes last: where it is, all that belongs to it is.
    for name in [*(n for n in dict.fromkeys(beside) if n in hashes), file]:
        if not (folder / commit / name).is_file():
            with _reached(hub_id), _quiet(hub.utils.logging):
                path = Path(api.hf_hub_download(repo, name, revision=commit, local_dir=folder / f"{commit}.partial"))
            _take(path, folder / commit / name, f"{name} of {repo}", hashes[name])
    if not _COMMIT.fullmatch(revision):
        write_whole(folder / "refs" / revision.replace("/", "--"), commit.encode(), "the model's commit")
    return folder / commit / file


def _take(path: Path, target: Path, what: str, sha256: str | None) -> None:
    """Move a file with the expected hash into place; remove any other."""
    found = sha256_of(path) if sha256 else None
    if found != sha256:
        path.unlink()
        cause = "it was damaged or exchanged on its way; nothing was kept"
        raise InputError(f"{what} is not the file that is known", got=f"sha256 {found}", expected=sha256, cause=cause)
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(path, target)


@contextmanager
def _quiet(log: Any) -> Iterator[None]:
    """Silence the library's line for each try, unless asked for."""
    before = log.get_verbosity()
    if not is_verbose():
        log.set_verbosity_error()
    try:
        yield
    finally:
        log.set_verbosity(before)


def _default_file(repo: str) -> str | None:
    return next((m.files[0].file for m in known_models() if m.repo == repo and m.files), None)


def _revision(hub_id: HubId) -> str:
    pinned = next((m.revision for m in known_models() if m.repo == hub_id.repo), None)
    return hub_id.revision or pinned or DEFAULT_REVISION


def _folder(repo: str) -> Path:
    return model_folder() / repo.replace("/", "--")


_MISSING = {
    "RepositoryNotFoundError": "there is no such repository, or it is not public",
    "GatedRepoError": "its owner asks for an agreement first: accept it on the hub, and set HF_TOKEN",
    "RevisionNotFoundError": "there is no such revision",
    "RemoteEntryNotFoundError": "there is no such file",
    "EntryNotFoundError": "there is no such file",
    "OfflineModeIsEnabled": "HF_HUB_OFFLINE is set",
}


@contextmanager
def _reached(hub_id: HubId) -> Iterator[None]:
    """Turn the hub library's many lines into a single line."""
    try:
        yield
    except Exception as error:  # The library raises its own classes and those of the HTTP library below it.
        missing = _MISSING.get(type(error).__name__)
        raise InputError(
            f"the model {hub_id} cannot be fetched",
            got=missing or f"{type(error).__name__}: {' '.join(str(error).split())[:160]}",
            cause=None if missing else "is there a network? a file's path does as well",
        ) from error


TABLE = Path(__file__).with_name("models.json")


@dataclass(frozen=True)
class KnownFile:
    """File of a known model: path in the repository or whole address; hash and size (10**6 or 2**20 B) if stated."""

    file: str
    sha256: str | None = None
    megabytes: float | None = None


@dataclass(frozen=True)
class KnownModel:
    """Public model with a reader here."""

    option: str
    """Such as "--detector grounding-dino"."""
    name: str
    repo: str | None
    """On the Hugging Face hub; None for files that are elsewhere, and are downloaded by hand."""
    revision: str | None
    """Commit of the hashes."""
    licence: str
    """Of the weights."""
    files: tuple[KnownFile, ...]
    """The repository's id alone means the first."""
    note: str


@lru_cache(maxsize=1)
def known_models() -> tuple[KnownModel, ...]:
    """Models of the table."""
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    return tuple(
        KnownModel(
            m["option"],
            m["name"],
            m["repo"],
            m["revision"],
            m["licence"],
            tuple(KnownFile(f["file"], f["sha256"], f["megabytes"]) for f in m["files"]),
            m["note"],
        )
        for m in table["models"]
    )
