"""Nothing that strangers named reaches the terminal as a control code, and JSON still says exactly what was named."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from command_line import misused, spatialviz
from hypothesis import given
from hypothesis import strategies as st
from rich.text import Text

from pipeline.datasets.demo import demo_path, demo_run
from pipeline.system.errors import InputError
from spatialviz import printing
from spatialviz.error_lines import LONGEST_LINE, error_line
from spatialviz.options import print_json, warn
from spatialviz.plain_text import plain, plain_streams
from spatialviz.printing import print_rows, say
from spatialviz.terminal import console

CODES = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
NASTY = "a\x1b[8m\x1b]0;x\x07\x7f\x9b31m\u202eb\u2066\u2028\x85c\rd"
texts = st.text(st.one_of(st.characters(), st.sampled_from([*NASTY, "\n", '"', "\\"])), max_size=30)


@given(texts)
def test_whatever_is_printed_holds_no_code(text: str) -> None:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), plain_streams():
        say(text, (text, "bold"))
        print_rows(("name", text.replace("\n", "")), [(text, Text(text))])
        console().print(text, markup=False)
        print(text)
        warn(text)
        print(text, file=sys.stderr)
    assert not CODES.search(out.getvalue() + err.getvalue())


@given(texts, texts)
def test_a_line_without_colours_is_as_rich_prints_it(text: str, more: str) -> None:
    lines = []
    for colored in (False, True):
        out = io.StringIO()
        with redirect_stdout(out), pytest.MonkeyPatch.context() as patch:
            patch.setattr(printing, "colored", lambda colored=colored: colored)
            say(text, (more, "bold"), style="dim")
        lines.append(out.getvalue())
    assert lines[0] == lines[1]


cells = st.text(st.sampled_from("ab 1·é-.\t漢\n\u202e"), max_size=30)


@given(st.integers(1, 4), st.data())
def test_a_table_without_colours_is_as_rich_draws_it(columns: int, data: st.DataObject) -> None:
    row, short = (st.lists(cells, min_size=least, max_size=columns) for least in (columns, 0))
    heads, rows = data.draw(row), data.draw(st.lists(row | short, max_size=3))
    drawn = []
    for colored in (False, True):
        out = io.StringIO()
        with redirect_stdout(out), pytest.MonkeyPatch.context() as patch:
            patch.setattr(printing, "colored", lambda colored=colored: colored)
            print_rows([f">{heads[0]}", *heads[1:]], rows)
        drawn.append(out.getvalue())
    assert drawn[0] == drawn[1]


@given(texts.filter(lambda text: not re.search(r"[\ud800-\udfff]", text)))
def test_json_says_the_same(text: str) -> None:
    out = io.StringIO()
    with redirect_stdout(out), plain_streams():
        print_json({"name": text, text: [text]})
    assert json.loads(out.getvalue()) == {"name": text, text: [text]}
    assert not CODES.search(out.getvalue())


@given(texts)
def test_a_message_stays_one_line(text: str) -> None:
    err = io.StringIO()
    with redirect_stderr(err), plain_streams():
        warn(text)
    assert err.getvalue().count("\n") == 1


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels and a run whose every text ends in control codes, in folders that are named by them."""
    folder = tmp_path_factory.mktemp("hostile") / NASTY.replace("\x00", "")
    shutil.copytree(demo_run().parent / "labels", folder / "labels")
    shutil.copytree(demo_run(), folder / "run")
    for file, columns in (
        (folder / "labels" / "objects.parquet", ("label",)),
        (folder / "run" / "records.parquet", ("text", "target", "said")),
    ):
        table = pq.read_table(file)
        for name in columns:
            place, texts = table.schema.get_field_index(name), pc.binary_join_element_wise(table[name], NASTY, "")
            table = table.set_column(place, table.schema.field(name), texts)
        pq.write_table(table, file)
    return folder


def test_commands_on_hostile_names(hostile: Path) -> None:
    labels, run = hostile / "labels", hostile / "run"
    printed = [
        spatialviz(0, "show", labels, 0),
        spatialviz(0, "show", labels, 0, "--json"),
        spatialviz(0, "query", run, "SELECT text, target, said FROM records LIMIT 20"),
        spatialviz(0, "query", run, "SELECT text FROM records LIMIT 20", "--json"),
        spatialviz(0, "failures", run),
        spatialviz(2, "frames", hostile),
        spatialviz(2, "ask", "demo", NASTY, "mug"),
        spatialviz(2, "frames", hostile / "nowhere"),
        misused("frames", "demo", f"--{NASTY}"),
    ]
    for each in printed:
        assert not CODES.search(each.out + each.err), each
    assert NASTY in {row["text"][-len(NASTY) :] for row in printed[3].records}
    assert plain(NASTY) in printed[4].out


@pytest.mark.skipif(os.name != "posix", reason="a terminal of its own needs a pty")
def test_on_a_terminal_only_our_own_colours_are_codes(hostile: Path) -> None:
    import pty

    for words in (("failures", hostile / "run"), ("frames", demo_path()), ("frames", "--help"), ("frames", hostile)):
        ours, theirs = pty.openpty()
        running = subprocess.Popen(
            [sys.executable, "-m", "spatialviz", *map(str, words)],
            stdout=theirs,
            stderr=theirs,
            stdin=theirs,
            env=os.environ | {"TERM": "xterm-256color"},
        )
        os.close(theirs)
        seen = b""
        try:
            while block := os.read(ours, 1 << 16):
                seen += block
        except OSError:  # The other end is closed.
            pass
        running.wait()
        os.close(ours)
        text = seen.decode("utf-8", "replace").replace("\r\n", "\n")
        left = re.sub(r"\x1b\[[0-9;]*m|\x1b\[\?25[lh]|\x1b\[[0-9]*[AKJ]|\x1b\[2K|\r", "", text)
        assert not CODES.search(left), (words, left)
        assert "\\u001b[" not in text.replace("\\u001b[8m", ""), "our own colours are no escapes"
        assert "\x1b[8m" not in text


def test_a_line_is_never_as_long_as_a_name_may_be() -> None:
    line = error_line(InputError("no such frame", got="x" * 10**6, path=Path("/somewhere/labels")))
    assert len(line) < LONGEST_LINE + 10
    assert line.startswith("error: no such frame; got xxx")
    assert line.endswith("[/somewhere/labels]")
