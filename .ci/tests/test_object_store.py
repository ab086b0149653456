"""An S3-compatible store between machines: tasks of an array, and Ray on two nodes, each with a place of its own."""

from __future__ import annotations

import json
import logging
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from socket import socket
from typing import Any
from urllib.request import Request, urlopen

import pytest
from needs import needs
from waiting import wait_until

from pipeline.datasets import demo_path
from pipeline.labels import open_labels

ROOT = Path(__file__).resolve().parents[2]
SHARDS = 3
FRAMES_A_SHARD = 4
BUCKET = "rooms"
KILLED = """
import os, signal
from pipeline.labels.job import label_dataset
from pipeline.labels.plan import SourceSpec
from pipeline.system.remote_folder import RemoteFolder

put = RemoteFolder.put

def put_or_die(self, name, data):
    if "/relations-" in name:
        os.kill(os.getpid(), signal.SIGKILL)
    put(self, name, data)

RemoteFolder.put = put_or_die
spec = SourceSpec("s3://rooms/demo", {"segmenter": "depth"})
label_dataset(spec, "s3://rooms/labels", frames_a_shard=4, part=(2, 3))
"""
BY_RAY = """
import pipeline.labels.job as job

job.LEAST_FRAMES_A_BLOCK = 1  # So that twelve frames are work for two nodes.
spec = job.SourceSpec("s3://rooms/demo")
print(job.label_dataset(spec, "s3://rooms/by_ray", engine="ray", workers=2, frames_a_shard=1))
"""
pytestmark = [pytest.mark.slow, needs("s3fs", "moto", "flask", "flask_cors")]


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """A server of S3 in this process that holds the demo."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    for name, value in {
        "AWS_ENDPOINT_URL": "http://{}:{}".format(*server.get_host_and_port()),
        "AWS_ACCESS_KEY_ID": "somebody",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "SPATIALVIZ_CACHE": str(tmp_path / "cache_here"),
    }.items():
        monkeypatch.setenv(name, value)
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    system = s3fs.S3FileSystem()
    # The server's content is the process's, and stays from test to test.
    urlopen(Request(f"{os.environ['AWS_ENDPOINT_URL']}/moto-api/reset", method="POST")).close()
    system.mkdir(BUCKET)
    for path in demo_path().rglob("*"):
        if path.is_file():
            system.pipe_file(f"{BUCKET}/demo/{path.relative_to(demo_path()).as_posix()}", path.read_bytes())
    try:
        yield system
    finally:
        server.stop()
        s3fs.S3FileSystem.clear_instance_cache()


def machine(tmp_path: Path, name: str) -> dict[str, Any]:
    """Working folder and environment of a machine of its own, as arguments of `subprocess`."""
    folder = tmp_path / name
    (folder / "work").mkdir(parents=True, exist_ok=True)
    place = {"SPATIALVIZ_CACHE": str(folder / "cache"), "TMPDIR": str(folder), "HOME": str(folder)}
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {"cwd": folder / "work", "env": {**os.environ, **place, "PYTHONPATH": path}}


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "spatialviz", *words]


def run(words: list[str], expected: int = 0, **place: Any) -> str:
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, **place)
    assert done.returncode == expected, done.stdout + done.stderr
    return done.stdout + done.stderr


def hashes(where: str | Path) -> dict[str, str]:
    return {name: entry.content_hash for name, entry in open_labels(where).manifest.tables.items()}


@pytest.fixture
def expected(tmp_path: Path) -> dict[str, str]:
    """Of labels of this machine alone."""
    out = tmp_path / "alone"
    run(command("label", "demo", "--out", str(out), "--workers", "1"))
    return hashes(out)


def fetched(tmp_path: Path, name: str) -> set[str]:
    """Pictures of the bucket that a machine has fetched."""
    found = (tmp_path / name / "cache" / "remote").glob("*/demo/*/rgb/*")
    return {"/".join(path.parts[-3:]) for path in found if path.stat().st_mode & stat.S_IWUSR}


def test_an_array_of_tasks_from_a_bucket_to_a_bucket(store: Any, tmp_path: Path, expected: dict[str, str]) -> None:
    words = ["label", f"s3://{BUCKET}/demo", "--out", f"s3://{BUCKET}/labels", "--workers", "2"]
    tasks = [
        subprocess.Popen(command(*words, "--shard", f"{k}/{SHARDS}"), **machine(tmp_path, f"machine{k}"))
        for k in (1, SHARDS)
    ]
    run([sys.executable, "-c", KILLED], expected=-signal.SIGKILL, **machine(tmp_path, "machine2"))
    assert [task.wait(600) for task in tasks] == [0, 0]
    merge = command("label", "--merge", f"s3://{BUCKET}/labels")
    assert "1 of 3 shards are missing; got 1" in run(merge, expected=2, **machine(tmp_path, "machine4"))
    left = [path for path in store.find(f"{BUCKET}/labels/parts", refresh=True) if "/000001-" in path]
    assert left
    assert not any(path.endswith("part.json") for path in left)
    # Another machine takes the task over, and one that never had the dataset merges.
    run(command(*words, "--shard", f"2/{SHARDS}"), **machine(tmp_path, "machine5"))
    run(merge, **machine(tmp_path, "machine4"))
    assert hashes(f"s3://{BUCKET}/labels") == expected
    every = fetched(tmp_path, "machine1") | fetched(tmp_path, "machine5") | fetched(tmp_path, f"machine{SHARDS}")
    assert len(every) == SHARDS * FRAMES_A_SHARD
    assert not fetched(tmp_path, "machine4")
    reader = machine(tmp_path, "machine6")
    assert "0 errors" in run(command("check", f"s3://{BUCKET}/labels"), **reader)
    shown = run(command("show", f"s3://{BUCKET}/labels", "0", "--object", "1", "--json"), **reader)
    assert json.loads(shown.splitlines()[0])["object"] == 1
    run(command("export", f"s3://{BUCKET}/labels", "--out", "out", "--format", "jsonl"), **reader)
    run(
        command("eval", "demo", "--labels", f"s3://{BUCKET}/labels", "--out", "run", "--limit", "5", "--no-plots"),
        **reader,
    )
    refused = command("undo", f"s3://{BUCKET}/labels", "--author", "ann")
    assert "no journal beside them; expected --journal" in run(refused, expected=2, **reader)


def test_what_a_store_refuses_is_told_in_one_line(store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(out: str) -> str:
        said = run(command("label", "demo", "--out", out, "--limit", "1"), expected=2, **machine(tmp_path, "machine"))
        (line,) = (line for line in said.splitlines() if not line.startswith("spatialviz: working"))
        return line

    assert "bucket does not exist" in refused("s3://nobody/labels")
    assert store.ls("", refresh=True) == [BUCKET]
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    assert "Unable to locate credentials" in refused(f"s3://{BUCKET}/labels")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "somebody")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    assert "Could not connect to the endpoint" in refused(f"s3://{BUCKET}/labels")


@pytest.fixture
def address(store: Any, tmp_path: Path) -> Iterator[str]:
    """Two nodes of Ray on this machine, each with its working folder and its cache."""
    ray = [sys.executable, "-c", "from ray.scripts.scripts import main; main()", "start", "--block"]
    least = ["--num-cpus", "2", "--object-store-memory", "100000000", "--disable-usage-stats"]
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    head = ["--head", "--node-ip-address", "127.0.0.1", "--port", str(port), "--include-dashboard", "false"]
    nodes = []
    try:
        for name, own in (("head", head), ("node", ["--address", f"127.0.0.1:{port}"])):
            log, place = tmp_path / f"{name}.log", ray_place(tmp_path, name)
            with open(log, "w") as said:
                nodes.append(node := subprocess.Popen([*ray, *own, *least], stdout=said, stderr=said, **place))
            wait_until(lambda log=log, node=node: node.poll() is not None or "runtime started" in log.read_text())
            assert node.poll() is None, log.read_text()
        yield f"127.0.0.1:{port}"
    finally:
        for node in reversed(nodes):
            node.terminate()
        for node in nodes:
            with suppress(subprocess.TimeoutExpired):
                node.wait(30)
            with suppress(ProcessLookupError):
                os.killpg(node.pid, signal.SIGKILL)


def ray_place(tmp_path: Path, name: str) -> dict[str, Any]:
    """As `machine`, with the temporary folder of all: Ray's sockets have short paths."""
    place = machine(tmp_path, name)
    return {**place, "env": {k: v for k, v in place["env"].items() if k != "TMPDIR"}, "start_new_session": True}


@needs("ray")
def test_ray_on_two_nodes_with_a_folder_each(address: str, tmp_path: Path, expected: dict[str, str]) -> None:
    place = ray_place(tmp_path, "driver")
    place["env"]["RAY_ADDRESS"] = address
    assert "12 frames" in run([sys.executable, "-c", BY_RAY], **place)
    assert hashes(f"s3://{BUCKET}/by_ray") == expected
    first, second = fetched(tmp_path, "head"), fetched(tmp_path, "node")
    assert first
    assert second
    assert len(first | second) == SHARDS * FRAMES_A_SHARD
    # What the driver opened of the dataset was its list.
    assert not fetched(tmp_path, "driver")
