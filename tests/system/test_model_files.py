"""Model files by path or by their id on a hub: fetched once, checked, kept; and the table of public files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from model_hub import Hub, running_hub

from pipeline.answering import describe_file
from pipeline.answering.model_catalogue import depth_contracts
from pipeline.evaluation import EvalSpec, spec_record
from pipeline.evaluation.run_folder import _read_spec
from pipeline.labels import SourceSpec
from pipeline.proposals.contracts import DETECTORS
from pipeline.proposals.mismatch import SEGMENTERS
from pipeline.system import (
    HubId,
    InputError,
    KnownModel,
    MissingExtra,
    all_fetched,
    fetched,
    known_models,
    model_files,
    parse_hub_id,
    resolve_model,
)
from pipeline.system.model_files import KnownFile, model_folder, sha256_of

FIRST, SECOND = "a" * 40, "b" * 40
REPO = "someone/a-model"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    pytest.importorskip("huggingface_hub")
    import huggingface_hub.constants as constants

    with running_hub() as found:
        monkeypatch.setenv("HF_ENDPOINT", found.url)
        monkeypatch.setenv("NO_PROXY", "127.0.0.1")
        monkeypatch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 2)
        found.put(REPO, FIRST, onnx__model_dot_onnx=b"the model" * 99, tokenizer_dot_json=b"{}", README_dot_md=b"#")
        yield found


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("owner/repo", HubId("owner/repo")),
        ("owner/repo:onnx/model.onnx", HubId("owner/repo", "onnx/model.onnx")),
        ("owner/repo:m.onnx@0123abc", HubId("owner/repo", "m.onnx", "0123abc")),
        ("owner/my.repo-2@v1.0", HubId("owner/my.repo-2", None, "v1.0")),
        ("models/yolo.onnx", None),
        ("models/found.json", None),
        ("yolo.onnx", None),
        ("/a/b", None),
        ("a/b/c", None),
        ("owner/repo:../../etc/passwd", None),
        ("..:x", None),
        ("owner/repo:/etc/passwd", None),
        ("a b/c", None),
        ("", None),
        ("owner/repo:a\\b", None),
        ("https://x/y", None),
    ],
)
def test_what_is_an_id_and_what_a_path(text: str, expected: HubId | None) -> None:
    assert parse_hub_id(text) == expected
    assert parse_hub_id(Path(text)) == expected
    if expected is not None:
        assert parse_hub_id(str(expected)) == expected


def test_a_folder_that_is_there_is_no_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "owner" / "repo").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert parse_hub_id("owner/repo") is None
    assert resolve_model("owner/repo") == Path("owner/repo")


def test_a_model_is_fetched_once_with_what_belongs_to_it(hub: Hub) -> None:
    path = resolve_model(Path(f"{REPO}:onnx/model.onnx"))
    assert path == model_folder() / "someone--a-model" / FIRST / "onnx" / "model.onnx"
    assert path.read_bytes() == b"the model" * 99
    # The tokenizer stands above, as on the hub; what a model does not need is not fetched.
    assert (path.parent.parent / "tokenizer.json").is_file()
    assert not list(model_folder().rglob("README.md"))
    assert not path.is_symlink()
    asked = len(hub.requests)
    assert resolve_model(f"{REPO}:onnx/model.onnx") == path
    assert resolve_model(REPO) == path
    assert resolve_model(f"{REPO}:onnx/model.onnx@{FIRST}") == path
    assert len(hub.requests) == asked
    assert list(all_fetched()) == [(HubId(REPO, "onnx/model.onnx", FIRST), path)]


def test_a_branch_that_moves_on_does_not_change_the_model(hub: Hub) -> None:
    path = resolve_model(REPO)
    hub.put(REPO, SECOND, onnx__model_dot_onnx=b"another")
    assert resolve_model(REPO) == path
    newer = resolve_model(f"{REPO}@{SECOND}")
    assert newer.read_bytes() == b"another"
    assert path.read_bytes() == b"the model" * 99


def test_weights_of_their_own_come_along(hub: Hub) -> None:
    hub.put(REPO, FIRST, m_dot_onnx=b"graph", m_dot_onnx_data=b"weights", other_dot_onnx_data=b"not these")
    path = resolve_model(REPO)
    assert path.with_name("m.onnx_data").read_bytes() == b"weights"
    assert not path.with_name("other.onnx_data").exists()


def refused(text: str, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        resolve_model(text)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message
    assert fetched(HubId(REPO)) is None
    # What was checked may stay; the model is not among it.
    assert not list(all_fetched())


def test_a_wrong_hash_leaves_nothing(hub: Hub) -> None:
    hub.told["onnx/model.onnx"] = "0" * 64
    refused(REPO, "onnx/model.onnx of someone/a-model is not the file that is known", "0" * 64, "nothing was kept")
    assert not list(model_folder().rglob("model.onnx"))
    del hub.told["onnx/model.onnx"]
    assert resolve_model(REPO).is_file()


def test_our_own_hash_goes_before_the_hubs(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = KnownModel("--detector x", "x", REPO, FIRST, "", (KnownFile("onnx/model.onnx", "1" * 64),), "")
    monkeypatch.setattr(model_files, "known_models", lambda: (ours,))
    refused(f"{REPO}:onnx/model.onnx", "1" * 64)
    right = replace(ours, files=(KnownFile("onnx/model.onnx", sha256_of_bytes(b"the model" * 99)),))
    monkeypatch.setattr(model_files, "known_models", lambda: (right,))
    # The repository's id alone means the first file of our table, at the commit that its hash is of.
    assert resolve_model(REPO).parent.parent.name == FIRST


def sha256_of_bytes(content: bytes) -> str:
    import hashlib

    return hashlib.sha256(content).hexdigest()


def test_a_file_that_breaks_off_leaves_nothing(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    # The library waits between its attempts.
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    hub.cut.add("onnx/model.onnx")
    refused(REPO, "the model someone/a-model cannot be fetched")
    hub.cut.clear()
    assert resolve_model(REPO).read_bytes() == b"the model" * 99


def test_what_the_hub_lacks_is_told(hub: Hub) -> None:
    refused("nobody/nothing", "no such repository")
    refused(f"{REPO}@{SECOND}", "no such revision")
    refused(f"{REPO}:onnx/other.onnx", "no file 'onnx/other.onnx'", "expected onnx/model.onnx")
    hub.put(REPO, FIRST, a_dot_onnx=b"a", b_dot_onnx=b"b")
    refused(REPO, "holds 2 ONNX files", "a.onnx, b.onnx", "someone/a-model:FILE")
    hub.put(REPO, FIRST, README_dot_md=b"")
    refused(REPO, "holds no ONNX files")
    hub.gated.add("meta/secret")
    refused("meta/secret", "agreement")


def test_without_a_network_there_is_one_line(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    refused(REPO, "cannot be fetched", "is there a network?")


def test_without_the_library_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "huggingface_hub", None)
    with pytest.raises(MissingExtra, match=r"spatialviz\[hub\]"):
        resolve_model(REPO)


def test_manifests_keep_an_id_as_an_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    spec = SourceSpec("demo", {"model": f"{REPO}:m.onnx", "segmenter_model": [f"{REPO}:e.onnx", "d.onnx"]}).absolute()
    assert spec.options == {
        "model": f"{REPO}:m.onnx",
        "segmenter_model": [f"{REPO}:e.onnx", str(tmp_path / "d.onnx")],
    }
    for given, kept in (
        ("moge-2", "moge-2"),
        ("net.onnx", f"{tmp_path}/net.onnx"),
        ("moge-2=net.onnx", f"moge-2={tmp_path}/net.onnx"),
        (REPO, REPO),
    ):
        assert SourceSpec("demo", {"depth_model": given}).absolute().options == {"depth_model": kept}
    options = {"detector": "owlv2", "model": Path(f"{REPO}:m.onnx@v1"), "model_config": tmp_path / "c.toml"}
    record = spec_record(EvalSpec("demo", str(tmp_path / "labels"), options), tmp_path / "run")
    assert _read_spec(record, tmp_path / "run").options == options


def test_the_table_of_public_files_is_sound() -> None:
    options = {c.option for c in (*DETECTORS, *SEGMENTERS)} | {"--detector boxes"}
    options |= {c.option for c in depth_contracts()}
    assert {m.option for m in known_models()} == options
    for model in known_models():
        assert model.name
        assert model.licence
        assert (model.repo is None) == (model.revision is None)
        assert model.revision is None or re.fullmatch("[0-9a-f]{40}", model.revision)
        for file in model.files:
            assert file.sha256 is None or re.fullmatch("[0-9a-f]{64}", file.sha256)
            assert file.megabytes is None or 0 < file.megabytes < 5000
            assert file.file.startswith("https://") == (model.repo is None)
            if model.repo is not None:
                assert parse_hub_id(f"{model.repo}:{file.file}@{model.revision}") is not None
    hashes = [f.sha256 for m in known_models() for f in m.files if f.sha256]
    assert len(set(hashes)) == len(hashes)
    assert model_files.TABLE.is_file()


def test_the_hash_is_that_of_the_standard_library(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"abc")
    assert sha256_of(tmp_path / "x") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_an_address_on_the_hub_is_an_id_and_any_other_is_refused() -> None:
    address = "https://huggingface.co/o/r/resolve/main/onnx/model.onnx?download=true"
    other = "https://example.org/a.onnx"
    for made in (str, Path):
        assert parse_hub_id(made(address)) == HubId("o/r", "onnx/model.onnx", "main")
        with pytest.raises(InputError, match=r"not given by its address.*download it first"):
            resolve_model(made(other))
    assert "download it first" in str(describe_file(Path(other)).problem)


def test_an_id_is_described_where_it_was_fetched(hub: Hub) -> None:
    named = Path(f"{REPO}:onnx/model.onnx")
    assert "fetched" in str(describe_file(named).problem)
    path = resolve_model(named)
    assert describe_file(named).path == path
