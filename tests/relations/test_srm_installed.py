"""Relation networks under names of their own."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipeline.relations import OnnxScorer, install_network, installed_networks, make_scorer, shipped_network
from pipeline.system import InputError


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SPATIALVIZ_NETWORKS", str(tmp_path / "networks"))
    return tmp_path / "networks"


def test_an_installed_network_is_found_by_its_name(folder: Path) -> None:
    assert installed_networks() == ()
    done = install_network(shipped_network(), "desk-2")
    assert installed_networks() == (done,)
    assert sorted(os.listdir(folder)) == ["desk-2.json", "desk-2.onnx"]
    mine, shipped = (make_scorer(name) for name in ("desk-2", "trained"))
    assert isinstance(mine, OnnxScorer)
    assert isinstance(shipped, OnnxScorer)
    assert mine.contract.vocabulary == shipped.contract.vocabulary
    assert Path(folder / "desk-2.onnx").read_bytes() == shipped_network().read_bytes()
    with pytest.raises(InputError, match="desk-2"):
        make_scorer("desk-3")


def test_a_name_is_not_taken_twice_unless_asked(folder: Path) -> None:
    install_network(shipped_network(), "mine")
    with pytest.raises(InputError, match="of this name"):
        install_network(shipped_network(), "mine")
    install_network(shipped_network(), "mine", overwrite=True)


@pytest.mark.parametrize("name", ["", "rule", "trained", "a/b", "../x", ".hidden", "x.onnx", "a" * 65, "ü"])
def test_names_that_are_none(name: str, folder: Path) -> None:
    with pytest.raises(InputError, match="no name for a network"):
        install_network(shipped_network(), name)
    assert not folder.exists()


def test_what_is_no_network_is_not_installed(folder: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"not a network")
    with pytest.raises(InputError):
        install_network(bad, "bad")
    with pytest.raises(InputError):
        install_network(tmp_path / "none.onnx", "none")
    assert not folder.exists() or not os.listdir(folder)
