"""Answers, runs and failures as IPython's display machinery shows them: pictures and tables, without a server."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import pytest
from IPython.core.interactiveshell import InteractiveShell

import spatialviz as sp
from pipeline.datasets.demo import demo_run

Shown = Callable[[object], str]


@pytest.fixture(scope="module")
def shown() -> Shown:
    """The HTML that a notebook gets of something; every kind of output has a text too."""

    def html(value: object) -> str:
        data, _ = InteractiveShell.instance().display_formatter.format(value)
        assert data["text/plain"] == repr(value)
        return data["text/html"]

    return html


@pytest.fixture(scope="module")
def run() -> sp.Run:
    return sp.open_run(demo_run())


def rows_of(html: str) -> int:
    return html.count("<tr>") - html.count("<thead>")


def test_a_run_shows_its_verdicts_what_each_module_costs_and_what_its_makers_share(shown: Shown, run: sp.Run) -> None:
    html = shown(run)
    assert rows_of(html) == sum(1 for n in run.verdicts.values() if n) + 5
    assert "simulated detector" in html
    share = run.verdicts["OPM-TARGET"] / run.records.num_rows
    assert f"{100 * share:.1f} %" in html
    assert all(s.sentence in html for s in run.shares)


def test_failures_show_the_first_rows_and_count_the_rest(shown: Shown, run: sp.Run) -> None:
    found = run.failures("verdict:OPM-CONF")
    html = shown(found)
    assert rows_of(html) == 12
    assert f"and {len(found) - 12} more expressions" in html
    assert rows_of(shown(found[:3])) == 3
    assert rows_of(shown(run.failures('"no such words"'))) == 0


def test_a_failure_shows_the_picture_with_what_is_true_and_what_each_factor_did(shown: Shown, run: sp.Run) -> None:
    failure = run.failures("verdict:OPM-CONF")[0]
    html = shown(failure)
    assert 'src="data:image/jpeg;base64,' in html
    judged = failure.answer.diagnosis
    assert judged is not None
    assert judged.contributions is not None
    assert all(f"{share:+.2f}" in html for share in judged.contributions.values())
    assert not re.search(r"<(script|style|link|iframe)", html)


def test_a_failure_whose_data_are_gone_shows_its_record_and_why(shown: Shown, run: sp.Run, tmp_path: Any) -> None:
    gone = sp.open_run(demo_run(), dataset=str(tmp_path / "moved"))
    html = shown(gone.failures("verdict:LIFT")[0])
    assert "not answered again" in html
    assert "LIFT" in html


class Tags(HTMLParser):
    """The tags and the text of a piece of HTML, as a browser would take them."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.names.add(tag)

    def handle_data(self, data: str) -> None:
        self.text += f"{data} "


def test_an_answer_shows_the_picture_the_ranking_and_the_verdict_and_all_names_are_text(shown: Shown) -> None:
    answer = sp.ask("demo", 0, "mug left of the laptop")
    html = shown(answer)
    tags = Tags(html)
    assert tags.names == {"div", "p", "b", "span", "img", "table", "thead", "tbody", "tr", "th", "td"}
    assert answer.sentence in tags.text
    assert "detector annotations · relations by rel32 · up declared" in tags.text
    assert "CORRECT" in tags.text
    assert 'src="data:image/jpeg;base64,' in html
    assert f"{answer.pairs[0].probability:.3f}" in tags.text
    assert rows_of(html) == len(answer.pairs)
    # Whatever a dataset calls its frames and its things is text.
    evil = "<script>alert('&\"')</script>"
    objects = tuple(replace(found, label=evil) for found in answer.objects)
    trace = answer.needed_trace()
    trace = replace(trace, objects=objects, frame=replace(trace.frame, id=evil))
    attacked = shown(replace(answer, trace=trace, unjudged=evil, diagnosis=None))
    assert Tags(attacked).names == tags.names
    assert Tags(attacked).text.count(evil) > 3


def test_an_answer_without_a_trace_shows_why(shown: Shown) -> None:
    assert "no relation &lt;in&gt; it" in shown(sp.Answer("mug beyond", problem="no relation <in> it"))
