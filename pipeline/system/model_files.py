"""Model files by path, or by their id on the Hugging Face hub: fetched once, checked, kept in the user's cache.

An id is OWNER/REPO[:FILE][@REVISION]. What a revision meant when it was first fetched is kept, so that a model stays
the same file until another revision is asked for.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.system.errors import InputError, MissingExtra, require
from pipeline.system.onnx_session import is_verbose
from pipeline.system.paths import cache_folder
from pipeline.system.whole_files import sha256_of

_ID = re.compile(
    r"(?P<repo>[A-Za-z0-9][\w.-]{0,95}/[\w.-]{1,96})(?::(?P<file>[^@:\\]+))?(?:@(?P<revision>[\w.][\w./-]*))?"
)
_ON_HUB = re.compile(
    r"(?:www\.)?(?:huggingface\.co|hf\.co)/(?P<repo>[\w.-]+/[\w.-]+)/(?:resolve|blob|raw)/(?P<revision>[^/]+)/(?P<file>[^?#]+).*"
)
"""The address of a file on the hub, without its scheme."""
_FILE_ENDINGS = (".onnx", ".ort", ".json", ".toml", ".npz", ".txt")
_COMMIT = re.compile(r"[0-9a-f]{40}")
COMPANIONS = ("tokenizer.json", "vocab.txt")
"""Files that are fetched with a model, from its folder or the one above."""
WEIGHTS = ("_data", ".data")
"""Endings of the file that a model's weights are in, where they are in a file of their own."""
DEFAULT_REVISION = "main"


@dataclass(frozen=True)
class HubId:
    """A file on the hub.

    Attributes
    ----------
    repo : str
        OWNER/REPO.
    file : str or None
        Its path there; None for the one that is meant.
    revision : str or None
        A commit, tag or branch.
    """

    repo: str
    file: str | None = None
    revision: str | None = None

    def __str__(self) -> str:
        return self.repo + (f":{self.file}" if self.file else "") + (f"@{self.revision}" if self.revision else "")


def parse_hub_id(given: str | Path) -> HubId | None:
    """The id that is meant; None for a path: one that is there, or that looks like one."""
    text = given.as_posix() if isinstance(given, Path) else given
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
    """The file of a model, fetched from the hub where it is named by its id and was not fetched before.

    Raises
    ------
    InputError
        The hub has no such file, cannot be reached, or gives another file than the one that is known; or it is given by
        its address.
    MissingExtra
        Where the library `huggingface_hub` is not installed.
    """
    hub_id = parse_hub_id(given)
    if hub_id is None:
        refuse_address(given)
        return Path(given)
    return fetched(hub_id) or fetch(hub_id)


def refuse_address(given: str | Path) -> None:
    """Raise InputError for the address of a web page or file; where it is of the hub, with the id that it has there."""
    # A path has lost the second slash.
    address = re.fullmatch(r"(?P<scheme>https?):/+(?P<rest>.+)", given.as_posix() if isinstance(given, Path) else given)
    if address is None:
        return
    on_hub = _ON_HUB.fullmatch(address["rest"])
    known = "" if on_hub is None else f", here {on_hub['repo']}:{on_hub['file']}@{on_hub['revision']}"
    raise InputError(
        "a model is not given by its address",
        got=f"{address['scheme']}://{address['rest']}",
        expected=f"a path, or an id of the hub{known}",
        cause=None if known else "download it first",
    )


def model_folder() -> Path:
    """Where fetched models are: `models` in the cache folder, and below it OWNER--REPO/COMMIT."""
    return cache_folder() / "models"


def fetched(hub_id: HubId) -> Path | None:
    """The file, where it was fetched before."""
    folder = _folder(hub_id.repo)
    revision = _revision(hub_id)
    if not _COMMIT.fullmatch(revision):
        try:
            revision = (folder / "refs" / _plain(revision)).read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError):
            return None
    name = hub_id.file or _default_file(hub_id.repo)
    if name is not None:
        path = folder / revision / name
        return path if path.is_file() else None
    found = sorted((folder / revision).rglob("*.onnx"))
    return found[0] if len(found) == 1 else None


def all_fetched() -> Iterator[tuple[HubId, Path]]:
    """Every ONNX file that was fetched."""
    root = model_folder()
    for path in sorted(root.glob("*--*/*/**/*.onnx")) if root.is_dir() else ():
        owner_repo, commit, *parts = path.relative_to(root).parts
        if _COMMIT.fullmatch(commit):
            yield HubId(owner_repo.replace("--", "/", 1), "/".join(parts), commit), path


def fetch(hub_id: HubId) -> Path:
    """Fetch a file with what belongs to it; raises as `resolve_model`."""
    try:
        import huggingface_hub
    except ImportError as error:
        raise MissingExtra(f"the model {hub_id}", "hub") from error
    endpoint = os.environ.get("HF_ENDPOINT") or None
    revision = _revision(hub_id)
    try:
        info = huggingface_hub.HfApi(endpoint=endpoint).model_info(
            hub_id.repo, revision=revision, files_metadata=True, timeout=30
        )
    except Exception as error:  # The library raises its own classes and those of the HTTP library below it.
        raise _unreachable(hub_id, error) from error
    listed = {s.rfilename: s for s in info.siblings or ()}
    file = hub_id.file or _default_file(hub_id.repo) or _only_model(hub_id, listed)
    require(
        file in listed,
        f"the hub has no file {file!r} in {hub_id.repo}",
        expected=_some([n for n in listed if n.endswith(".onnx")]) or "an ONNX file, of which there is none",
    )
    commit = info.sha or ""
    require(
        _COMMIT.fullmatch(commit),
        "the hub does not say which commit the model is of",
        got=repr(commit),
        path=hub_id.repo,
    )
    # The model comes last: where it is, all that belongs to it is.
    for name in [*_companions(file, list(listed)), file]:
        _fetch_file(hub_id, name, commit, _expected(hub_id.repo, commit, name, listed[name]), endpoint)
    if not _COMMIT.fullmatch(revision):
        ref = _folder(hub_id.repo) / "refs" / _plain(revision)
        ref.parent.mkdir(parents=True, exist_ok=True)
        ref.write_text(commit, encoding="ascii")
    return _folder(hub_id.repo) / commit / file


def _fetch_file(hub_id: HubId, name: str, commit: str, expected: KnownFile, endpoint: str | None) -> None:
    """Fetch into a folder beside, check, and only then move to where it is found."""
    import huggingface_hub

    target = _folder(hub_id.repo) / commit / name
    if target.is_file():
        return
    partial = _folder(hub_id.repo) / f"{commit}.partial"
    log = huggingface_hub.utils.logging
    before = log.get_verbosity()
    if not is_verbose():
        # Each of its attempts would be told of; what they come to is in the error.
        log.set_verbosity_error()
    try:
        path = Path(
            huggingface_hub.hf_hub_download(hub_id.repo, name, revision=commit, local_dir=partial, endpoint=endpoint)
        )
    except Exception as error:  # As above.
        raise _unreachable(hub_id, error) from error
    finally:
        log.set_verbosity(before)
    size = path.stat().st_size
    if expected.bytes is not None and size != expected.bytes:
        path.unlink()
        raise InputError(f"{name} of {hub_id.repo} is incomplete", got=f"{size} bytes", expected=expected.bytes)
    if expected.sha256 is not None:
        found = sha256_of(path)
        if found != expected.sha256:
            path.unlink()
            raise InputError(
                f"{name} of {hub_id.repo} is not the file that is known",
                got=f"sha256 {found}",
                expected=expected.sha256,
                cause="it was damaged or exchanged on its way; nothing was kept",
            )
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(path, target)


def _expected(repo: str, commit: str, name: str, listed: Any) -> KnownFile:
    """Size and hash, by our own table first, then by what the hub says of its large files."""
    lfs = getattr(listed, "lfs", None)
    says = getattr(lfs, "sha256", None)
    ours = next(
        (f.sha256 for m in known_models() if (m.repo, m.revision) == (repo, commit) for f in m.files if f.file == name),
        None,
    )
    return KnownFile(name, ours or says, None, getattr(listed, "size", None))


def _companions(file: str, listed: Sequence[str]) -> list[str]:
    folder = PurePosixPath(file).parent
    companions = [folder / n for n in COMPANIONS] + [folder.parent / n for n in COMPANIONS]
    wanted = [*(file + ending for ending in WEIGHTS), *(p.as_posix() for p in companions)]
    return [n for n in dict.fromkeys(wanted) if n in listed]


def _default_file(repo: str) -> str | None:
    return next((m.files[0].file for m in known_models() if m.repo == repo and m.files), None)


def _revision(hub_id: HubId) -> str:
    pinned = next((m.revision for m in known_models() if m.repo == hub_id.repo), None)
    return hub_id.revision or pinned or DEFAULT_REVISION


def _only_model(hub_id: HubId, listed: dict[str, Any]) -> str:
    models = [n for n in listed if n.endswith(".onnx")]
    if len(models) == 1:
        return models[0]
    raise InputError(
        f"{hub_id.repo} holds {len(models) or 'no'} ONNX files",
        got=_some(models) or None,
        expected=f"one of them: {hub_id.repo}:FILE" if models else None,
    )


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _folder(repo: str) -> Path:
    return model_folder() / repo.replace("/", "--")


def _plain(revision: str) -> str:
    return revision.replace("/", "--")


def _unreachable(hub_id: HubId, error: Exception) -> InputError:
    """One line of what the hub's library says in many."""
    kind = type(error).__name__
    missing = {
        "RepositoryNotFoundError": "there is no such repository, or it is not public",
        "GatedRepoError": "its owner asks for an agreement first: accept it on the hub, and set HF_TOKEN",
        "RevisionNotFoundError": "there is no such revision",
        "RemoteEntryNotFoundError": "there is no such file",
        "EntryNotFoundError": "there is no such file",
        "OfflineModeIsEnabled": "HF_HUB_OFFLINE is set",
    }.get(kind)
    words = " ".join(str(error).split())[:160]
    return InputError(
        f"the model {hub_id} cannot be fetched",
        got=missing or f"{kind}: {words}",
        cause=None if missing else "is there a network? a file's path does as well",
    )


TABLE = Path(__file__).with_name("models.json")


@dataclass(frozen=True)
class KnownFile:
    """A file.

    Attributes
    ----------
    file : str
        Path in the repository, or its whole address.
    sha256 : str or None
        None where no public text states it.
    megabytes : float or None
        As stated, in 10**6 bytes or in 2**20; None where it is not.
    bytes : int or None
        The exact size.
    """

    file: str
    sha256: str | None = None
    megabytes: float | None = None
    bytes: int | None = None


@dataclass(frozen=True)
class KnownModel:
    """A model that is known to be read.

    Attributes
    ----------
    option : str
        "--detector grounding-dino".
    name : str
    repo : str or None
        On the Hugging Face hub; None for files that are elsewhere, and are downloaded by hand.
    revision : str or None
        The commit that the hashes are of.
    licence : str
        Of the weights.
    files : tuple of KnownFile
        The first is what the repository's id alone means.
    note : str
    """

    option: str
    name: str
    repo: str | None
    revision: str | None
    licence: str
    files: tuple[KnownFile, ...]
    note: str


@lru_cache(maxsize=1)
def known_models() -> tuple[KnownModel, ...]:
    """All of the table."""
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    return tuple(
        KnownModel(
            m["option"], m["name"], m["repo"], m["revision"], m["licence"],
            tuple(KnownFile(f["file"], f["sha256"], f["megabytes"]) for f in m["files"]), m["note"],
        )
        for m in table["models"]
    )  # fmt: skip
