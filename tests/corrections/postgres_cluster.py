"""A PostgreSQL cluster of one's own: in a temporary folder, on a free loopback port, gone at the end."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from waiting import LONG_S

OWNER = "postgres"


def binaries() -> Path | None:
    """The newest server's folder of programs; None where there is none."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda p: float(p.parts[-3]))
    if found:
        return found[-1].parent
    initdb = shutil.which("initdb")
    return None if initdb is None else Path(initdb).parent


def missing() -> str | None:
    """Why no cluster can be started here; None where one can."""
    if binaries() is None:
        return "PostgreSQL is not installed (Debian: apt-get install postgresql)"
    if os.getuid() == 0 and shutil.which("setpriv") is None:
        return "initdb refuses root, and setpriv is not there"
    try:
        import psycopg  # noqa: F401
    except ImportError:
        return "psycopg is not installed: pip install 'spatialviz[postgres]'"
    return None


@dataclass(frozen=True)
class Cluster:
    """A running server of its own.

    Attributes
    ----------
    url : str
        Of an empty database.
    folder : Path
        Of the sockets and the log; the data are in `folder/data`.
    options : str
        Of the server.
    as_owner : tuple of str
        Before a command, to run it as the server's user.
    """

    url: str
    folder: Path
    options: str
    as_owner: tuple[str, ...]

    def control(self, *arguments: str) -> None:
        """pg_ctl."""
        programs = binaries()
        assert programs is not None
        command = (str(programs / "pg_ctl"), "-D", str(self.folder / "data"), "-w", *arguments)
        _run(self.folder, *self.as_owner, *command)

    def start(self) -> None:
        self.control("-l", str(self.folder / "log"), "-o", self.options, "start")

    def crash(self) -> None:
        """Stop it without a checkpoint, as a power cut would."""
        self.control("-m", "immediate", "stop")


def _run(folder: Path, *command: str) -> None:
    log = folder / "log"
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=LONG_S, check=False)
    said = log.read_text(errors="replace") if log.exists() else ""
    assert done.returncode == 0, done.stdout + done.stderr + said


@contextmanager
def started_cluster(password: str | None = None, folder: Path | None = None) -> Iterator[Cluster]:
    """A cluster, and its end.

    Parameters
    ----------
    password : str, optional
        Of the owner, asked for by SCRAM-SHA-256; without one everybody is trusted.
    folder : Path, optional
        An empty one to put it in. Not below pytest's own folder: the server's user may not enter that.
    """
    programs = binaries()
    assert programs is not None
    own = Path(tempfile.mkdtemp(prefix="spatialviz-pg-")) if folder is None else folder
    as_owner: tuple[str, ...] = ()
    if os.getuid() == 0:
        shutil.chown(own, OWNER, OWNER)
        as_owner = ("setpriv", f"--reuid={OWNER}", f"--regid={OWNER}", "--clear-groups")
    try:
        login = ("-A", "trust")
        if password is not None:
            (own / "password").write_text(password + "\n")
            login = ("-A", "scram-sha-256", "--pwfile", str(own / "password"))
        _run(
            own,
            *as_owner,
            str(programs / "initdb"),
            "-D",
            str(own / "data"),
            "-U",
            OWNER,
            *login,
            "--no-sync",
            "-E",
            "UTF8",
            "--locale=C",
        )
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        options = f"-c listen_addresses=127.0.0.1 -p {port} -k {own} -c max_connections=40"
        cluster = Cluster(f"postgresql://{OWNER}@127.0.0.1:{port}/postgres", own, options, as_owner)
        cluster.start()
        try:
            yield cluster
        finally:
            if (own / "data" / "postmaster.pid").exists():
                cluster.crash()
    finally:
        if folder is None:
            shutil.rmtree(own, ignore_errors=True)


@contextmanager
def running_cluster() -> Iterator[str]:
    """The URL of an empty database."""
    with started_cluster() as cluster:
        yield cluster.url
