"""Fixtures shared by the tests of the core."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

from pipeline.system.worker_pool import THREAD_VARIABLES

if TYPE_CHECKING:
    from chat_server import ChatServer, Clock, Make

    from pipeline.corrections import Corrector, Journal
    from pipeline.datasets import Dataset
    from pipeline.labels import Labels
    from pipeline.system import ChatClient

ROOT = Path(__file__).resolve().parent.parent

# Workers of pytest-xdist share the cores, and threads that wait for one another would take half of them. The
# variables are read when numpy is loaded, and handed on to children.
for _variable in THREAD_VARIABLES:
    os.environ.setdefault(_variable, "1")

# No test is about time: on a busy machine one example may well take a second. A third of hypothesis's own number of
# examples keeps five thousand tests under five minutes; each run draws others.
settings.register_profile("untimed", deadline=None, max_examples=30)
settings.load_profile("untimed")


def pytest_configure(config: pytest.Config) -> None:
    """Without the slow tests, no worker reads all sources for constants that property tests might draw."""
    if config.option.markexpr == "not slow":
        from hypothesis.internal.conjecture import providers

        # It takes four seconds in each worker and has no option; releases that do it otherwise just do it.
        if hasattr(providers, "_get_local_constants"):
            providers._get_local_constants = lambda: providers._local_constants


def pytest_collection_finish() -> None:
    """What all test files loaded stays to the end: the collector need not walk it again and again, nor run so often."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def demo_frames_once() -> Iterator[None]:
    """No test reads again from the disk what another has read of the demo."""
    from demo_memory import demo_remembered

    with demo_remembered():
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real test input, kept beside the project and never inside it."""
    folder = Path(os.environ.get("SPATIALVIZ_SHARED", ROOT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"real test data are not at {folder}; set SPATIALVIZ_SHARED to the folder that holds data/")
    return folder


@pytest.fixture(scope="session")
def label_sets(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Labels]:
    """Labels of the whole demo, ones with everything odd, and empty ones; not to be changed."""
    from label_sets import hostile_labels, label_demo, write_labels
    from made_once import made_once

    from pipeline.labels import open_labels

    def make(folder: Path) -> None:
        label_demo(folder / "demo")
        hostile_labels(folder / "hostile")
        write_labels(folder / "empty", {})

    folder = made_once(pytestconfig, "label_sets", make, tmp_path_factory.mktemp("labels") / "sets")
    return {name: open_labels(folder / name) for name in ("demo", "hostile", "empty")}


@pytest.fixture(scope="session")
def demo_labels(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Labels:
    """Labels of the demo's first two rooms, half of all: enough for what is of single cells; not to be changed."""
    from label_sets import label_demo
    from made_once import made_once

    from pipeline.labels import open_labels

    copy = tmp_path_factory.mktemp("labels") / "two_rooms"
    return open_labels(made_once(pytestconfig, "two_rooms", lambda folder: label_demo(folder, 6), copy))


@pytest.fixture(scope="session")
def bare_corrector(demo_labels: Labels) -> Corrector:
    """Corrections of the labels of two rooms, without the pictures."""
    from pipeline.corrections import Corrector

    return Corrector(demo_labels)


@pytest.fixture(scope="session")
def demo_dataset() -> Dataset:
    """The built-in dataset."""
    from pipeline.answering import open_pipeline

    return open_pipeline("demo", srm="rule").dataset


@pytest.fixture(scope="session")
def full_corrector(demo_labels: Labels, demo_dataset: Dataset) -> Corrector:
    """Corrections of the labels of two rooms, with the pictures."""
    from pipeline.corrections import Corrector

    return Corrector(demo_labels, demo_dataset)


@pytest.fixture
def journal(demo_labels: Labels, tmp_path: Path) -> Iterator[Journal]:
    """An empty journal of the labels of two rooms."""
    from pipeline.corrections import journal_of

    with journal_of(demo_labels, tmp_path / "j.sqlite") as opened:
        yield opened


@pytest.fixture(scope="session")
def word_vectors(label_sets: dict[str, Labels], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vector for every word of the demo's class names, and for a word that is none of them."""
    import numpy as np

    path = tmp_path_factory.mktemp("vectors") / "words.npz"
    names = label_sets["demo"].objects.column("label").unique().to_pylist()
    words = sorted({w for n in names for w in n.lower().replace("_", " ").split()} | {"zebra"})
    vectors = np.random.default_rng(0).normal(size=(len(words), 5)).astype(np.float32)
    np.savez(path, words=np.array(words), vectors=vectors, kind=np.str_("word"))
    return path


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Time that passes only where it is slept, also between the tries of the chat client's library."""
    import openai._base_client
    from chat_server import Clock

    clock = Clock()
    monkeypatch.setattr(openai._base_client, "time", SimpleNamespace(sleep=clock.sleep, time=time.time))
    return clock


@pytest.fixture
def server(clock: Clock) -> Iterator[ChatServer]:
    """A chat server that speaks the real protocol."""
    from chat_server import running

    with running(clock) as found:
        yield found
        assert found.problems == []


@pytest.fixture
def client_of(server: ChatServer, clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Makes clients of that server, with a cache of their own."""
    from chat_server import MODELS

    from pipeline.system import ChatClient
    from pipeline.system.chat import KEY_VARIABLE

    monkeypatch.delenv(KEY_VARIABLE, raising=False)

    def make(**options: Any) -> ChatClient:
        return ChatClient(
            options.pop("base_url", server.url),
            options.pop("model", MODELS[0]),
            **{"cache": tmp_path / "answers", "clock": clock, "sleep": clock.sleep, **options},
        )

    return make
