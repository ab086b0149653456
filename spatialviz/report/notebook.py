"""An answer and a run as HTML for a notebook: a headline, a picture with the roles, tables. Nothing is loaded.

The elements are built as a tree and written by the standard library, which escapes every text and attribute.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from xml.etree.ElementTree import Element, tostring

from pipeline.answering.json_records import probability
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.answer import Answer
from pipeline.evaluation.run_folder import Run
from spatialviz.report.picture import answer_picture, jpeg_url

SHOWN_PAIRS = 8
SHOWN_ROWS = 12
_QUIET = "color:gray"


def notebook_html(shown: Answer | Run) -> str:
    """What a notebook shows of an answer or a run."""
    return tostring(_answer(shown) if isinstance(shown, Answer) else _run(shown), encoding="unicode", method="html")


def element(tag: str, *children: Element | str | None, style: str = "", **attributes: str) -> Element:
    """An element with its children in order; text is text, whatever it holds."""
    found = Element(tag, {**attributes, **({"style": style} if style else {})})
    for child in children:
        if isinstance(child, Element):
            found.append(child)
        elif child is not None and len(found):
            found[-1].tail = (found[-1].tail or "") + child
        elif child is not None:
            found.text = (found.text or "") + child
    return found


def _answer(answer: Answer) -> Element:
    verdict = None if answer.verdict is None else element("b", f" {answer.verdict}")
    trace = answer.trace
    frame = None if trace is None else element("span", f" {trace.frame.id}", style=_QUIET)
    picture = None if trace is None else jpeg_url(answer_picture(trace))
    return element(
        "div",
        element("p", element("b", f"“{answer.text}”"), frame, verdict),
        element("p", answer.sentence),
        None if answer.why is None else element("p", answer.why, style=_QUIET),
        None if picture is None else element("img", src=picture, style="max-width:100%", alt=answer.sentence),
        None if trace is None or not answer.pairs else _pairs(trace.name, answer.pairs),
    )


def _pairs(name: Callable[[int], str], pairs: Sequence[ScoredPair]) -> Element:
    rows = [
        (
            str(rank),
            name(pair.target),
            " and ".join(name(k) for k in (pair.reference, pair.second_reference) if k is not None),
            *(f"{p:.2f}" for p in (pair.p_target, pair.p_reference, pair.p_relation)),
            probability(pair.product),
            f"{pair.probability:.3f}",
        )
        for rank, pair in enumerate(pairs[:SHOWN_PAIRS], start=1)
    ]
    head = ("#", "target", "reference", "P(target)", "P(reference)", "P(relation)", "product", "posterior")
    return element("div", _table(head, rows), _more(len(pairs) - SHOWN_PAIRS, "pairs"))


def _run(run: Run) -> Element:
    counts = run.verdicts
    total = sum(counts.values())
    verdicts = [(name, str(count), f"{100 * count / total:.1f} %") for name, count in counts.items()]
    return element(
        "div",
        element("p", element("b", run.name), f" {run.manifest.get('expressions')} expressions"),
        _table(("verdict", "expressions", "share"), verdicts) if verdicts else None,
        *(_figures(name, rows) for name, rows in run.tables.items() if name == "grounding"),
    )


def _figures(name: str, rows: Sequence[dict[str, str | float]]) -> Element:
    columns = list(dict.fromkeys(column for row in rows for column in row))
    shown = [[_cell(row.get(column, "")) for column in columns] for row in rows[:SHOWN_ROWS]]
    return element("div", element("p", name), _table(columns, shown), _more(len(rows) - SHOWN_ROWS, "rows"))


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.3f}".rstrip("0").rstrip(".")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Element:
    body = [element("tr", *(element("td", cell) for cell in row)) for row in rows]
    return element(
        "table", element("thead", element("tr", *(element("th", name) for name in head))), element("tbody", *body)
    )


def _more(count: int, what: str) -> Element | None:
    return element("p", f"and {count} more {what}", style=_QUIET) if count > 0 else None
