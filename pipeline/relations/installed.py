"""Relation networks installed by a user under a name, beside the shipped one."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import clear_abandoned, take_places, temporary_folder

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
TAKEN = ("rule", "trained")


@dataclass(frozen=True)
class InstalledNetwork:
    """Network by name."""

    name: str  # What `--srm` takes
    path: Path


def network_folder() -> Path:
    """Folder of installed networks: the user's, or SPATIALVIZ_NETWORKS."""
    from platformdirs import user_data_path

    given = os.environ.get("SPATIALVIZ_NETWORKS")
    return Path(given) if given else user_data_path("spatialviz") / "networks"


def installed_networks() -> tuple[InstalledNetwork, ...]:
    """All installed networks, by name."""
    folder = network_folder()
    files = sorted(folder.glob("*.onnx")) if folder.is_dir() else []
    return tuple(InstalledNetwork(f.stem, f) for f in files if _NAME.fullmatch(f.stem))


def installed_network(name: str) -> Path | None:
    """File of an installed network; None for an unknown name."""
    if not _NAME.fullmatch(name):
        return None
    path = network_folder() / f"{name}.onnx"
    return path if path.is_file() else None


def is_named(scorer: str | None) -> bool:
    """True for a relation scorer named by something known here: None, rule, trained, or an installed network."""
    return scorer in (None, *TAKEN) or (scorer is not None and installed_network(scorer) is not None)


def install_network(network: Path, name: str, *, overwrite: bool = False) -> InstalledNetwork:
    """Copy a network, with its card and its vectors, to where `--srm NAME` finds it.

    Raises
    ------
    InputError
        No such network, one that cannot be fed, a name that is none or is taken, a folder that cannot be written.
    """
    from pipeline.relations.class_vectors import vectors_path
    from pipeline.relations.model import OnnxScorer

    require(
        _NAME.fullmatch(name) and name not in TAKEN and not name.endswith(".onnx"),
        "no name for a network",
        got=repr(name),
        expected="letters, digits, . _ -; not rule or trained",
    )
    OnnxScorer(network)
    folder = network_folder()
    target = folder / f"{name}.onnx"
    require(
        not (target.exists() and not overwrite),
        "there is a network of this name",
        expected="another name, or --overwrite",
        path=target,
    )
    companions = (network.with_suffix(".json"), vectors_path(network))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        clear_abandoned(folder)
        with temporary_folder(target) as staging:
            for source in (*(f for f in companions if f.is_file()), network):
                shutil.copyfile(source, staging / f"{name}{source.name.removeprefix(network.stem)}")
            take_places(staging / target.name, target)
    except OSError as error:
        raise InputError("the network cannot be installed", got=error.strerror or str(error), path=folder) from error
    return InstalledNetwork(name, target)
