"""The table of .github/SECURITY.md, renewed from what the runners wrote; several files of one runner are added up.

python .ci/robust/faults.py --seconds 600 --out faults.json
python .ci/robust/fuzz.py --seconds 600 --out fuzz.json
python .ci/robust/table.py faults.json fuzz.json
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

DOCUMENT = Path(__file__).resolve().parents[2] / ".github" / "SECURITY.md"
BEGIN, END = "<!-- promises -->\n", "<!-- end -->\n"
FILES = (
    "dataset-",
    "picture-",
    "labels",
    "run",
    "case",
    "journal",
    "coco",
    "detections",
    "simulated",
    "predictions",
    "onnx",
)
ROWS: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
    ("A hostile file is refused in one line, or read: no crash, no hang, no write outside, little memory", "fuzz",
     (*FILES, "edits", "ply", "toml", "vec"), "dataset,picture,onnx"),
    ("So is a hostile text: a question, a query in SQL, a search, a view of the page, an agent's call", "fuzz",
     ("expression", "query", "search", "view", "whatif-edits", "mcp"), "expression,query,search,view,whatif,mcp"),
    ("Bytes that no browser sends do not end the page's server, or keep it from the next page", "fuzz",
     ("http", "websocket", "server"), "http,websocket"),
    ("A killed job leaves its whole result or none, and can be done again: label, check, eval, train, retrain, export, "
     "export-run, render, detect, map, save-case", "faults",
     tuple(f"kill-{n}" for n in ("label", "check", "eval", "train", "retrain", "export", "render", "detect", "map",
     "save")), "kill"),
    ("A killed correction, import or propagation is saved whole or not at all; what was acknowledged is there",
     "faults",
     ("kill-correct", "kill-import", "kill-propagate", "kill-journal"),
     "kill-correct,kill-import,kill-propagate,kill-journal"),
    ("What the page has called saved is there when its server is killed", "faults", ("page-kill",), "page-kill"),
    ("A damaged journal is refused, or every event is as it was saved", "faults", ("journal-damaged",),
     "journal-damaged"),
    ("Commands that correct the same labels at once lose nothing of each other", "faults", ("journal-together",),
     "journal-together"),
    ("A full disk is told in one line, leaves nothing half, and loses no correction", "faults", ("disk",), "disk"),
    ("A folder that cannot be written is read as any other", "faults", ("read-only",), "read-only"),
    ("A clock that jumps changes no result and no order of corrections", "faults", ("clock", "page-clock"),
     "clock,page-clock"),
    ("A dataset that changes under a command or a page ends in a line or a result that opens", "faults",
     ("changing", "page-changing"), "changing,page-changing"),
    ("Little memory and a reader that goes away are told in a line at most", "faults",
     ("little-memory", "closed-output"), "little-memory,closed-output"),
    ("The same command twice gives the same bytes", "faults", ("same-bytes",), "same-bytes"),
    ("Files of every earlier state open", "faults", ("old-files",), "old-files"),
    ("Foreign names, foreign pages, wrong tokens and paths that climb are refused", "faults", ("page-strangers",),
     "page-strangers"),
    ("Clients that never read, read slowly or send garbage keep nobody from an answer", "faults",
     ("page-unread", "page-garbage"), "page-unread,page-garbage"),
    ("Many clients at once lose no reply, and the server's memory is back within 20 % of its start", "faults",
     ("page-clients",), "page-clients"),
    ("A page that nobody touches is there ten minutes later, and its server has done next to nothing", "faults",
     ("page-idle",), "page-idle --seconds 600"),
)  # fmt: skip
"""Promise, runner, beginnings of the names of its kinds, and what `--only` takes."""


def row(promise: str, runner: str, kinds: tuple[str, ...], only: str, runs: Iterable[Mapping[str, Any]]) -> str:
    """A row of the table, of all runs of a runner."""
    found = [
        kind for run in runs if run["runner"] == runner for name, kind in run["kinds"].items() if name.startswith(kinds)
    ]
    figures: dict[str, float] = {}
    counts: dict[str, int] = {}
    for kind in found:
        for name, value in kind["figures"].items():
            figures[name] = max(value, figures.get(name, value))
        for name, count in kind["counts"].items():
            if name.startswith(("acknowledged", "refused", "read")):
                counts[name] = counts.get(name, 0) + count
    told = [f"{sum(kind['times'] for kind in found):,} times, {sum(len(kind['failures']) for kind in found)} broken"]
    told += [f"{name} {count:,}" for name, count in counts.items()]
    told += [f"{name} {value:.3g}" for name, value in figures.items()]
    return f"| {promise} | `{runner}.py --only {only}` | {'; '.join(told)} |"


def main(files: list[str]) -> int:
    runs = [json.loads(Path(file).read_text("utf-8")) for file in files]
    dates = sorted({run["date"] for run in runs})
    lines = [f"| promise | command | last figures, {' to '.join({dates[0]: 0, dates[-1]: 0})} |", "|---|---|---|"]
    text = DOCUMENT.read_text("utf-8")
    before, _, rest = text.partition(BEGIN)
    lines += [row(*one, runs) for one in ROWS]
    DOCUMENT.write_text(f"{before}{BEGIN}{chr(10).join(lines)}\n{END}{rest.partition(END)[2]}", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
