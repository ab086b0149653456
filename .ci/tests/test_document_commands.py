"""Commands of documents are found as a shell would read them, and blocks that are not run have a known reason."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "site"))

from command_blocks import Block, blocks_of, commands_of
from command_data import wrong_with


def block(language: str, text: str) -> Block:
    return Block(1, language, text, None)


def test_comments_continuations_and_heredocs() -> None:
    text = """\
spatialviz ask DATASET 0 "mug #2"   # exit status 1
spatialviz eval DATASET \\
  --out RUN   # a run
cat > x.toml << 'END'
a = 1  # stays
END
python -c 'print(1)' | head
"""
    asked, judged, written, piped = commands_of(block("sh", text))
    assert (asked.words, asked.status) == (["spatialviz", "ask", "DATASET", "0", "mug #2"], 1)
    assert (judged.words, judged.status, judged.line) == (["spatialviz", "eval", "DATASET", "--out", "RUN"], 0, 2)
    assert written.text.endswith("a = 1  # stays\nEND")
    assert written.words is piped.words is None


def test_what_a_console_prints_is_no_command() -> None:
    (only,) = commands_of(block("console", "$ spatialviz models\nsam  not there\n"))
    assert only.words == ["spatialviz", "models"]


def test_a_block_that_is_not_run_has_a_known_reason(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- not run: network -->\n```sh\npip install x\n```\n```toml\na = 1\n```\n", "utf-8")
    assert [(b.language, b.not_run) for b in blocks_of(page)] == [("sh", "network"), ("toml", None)]
    page.write_text("<!-- not run: no time -->\n```sh\npip install x\n```\n", "utf-8")
    with pytest.raises(ValueError, match="'no time' is no reason"):
        list(blocks_of(page))


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ('{"a": 1, "b": 2}', ""),
        ('{"a": 1, "...": 0}', ""),
        ('{"a": 1}', "other keys: b"),
        ('{"a": 1, "c": 2, "…": 0}', "other keys: c"),
        ('{"a": 1,}', "Expecting"),
    ],
)
def test_json_has_the_keys_that_are_printed(text: str, wrong: str) -> None:
    assert wrong in wrong_with(block("json", text), [{"a": 0, "b": 0}])
    assert bool(wrong) == bool(wrong_with(block("json", text), [{"a": 0, "b": 0}]))


def test_settings_are_read_by_their_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert wrong_with(block("toml", "depth_scale = 1000\n"), None) == ""
    assert "unknown setting 'depth_scales'" in wrong_with(block("toml", "depth_scales = 1000\n"), None)
