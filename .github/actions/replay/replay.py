"""Runs kept cases again and says which module regressed; the steps of action.yml, which also run by themselves.

    python replay.py run CASES... --out FOLDER [--srm SRM] [--options="OPTIONS of `spatialviz replay`"]
    python replay.py comment FOLDER/comment.md

`run` writes comment.md, index.html and a page for each answer that is another now into the folder, and adds the comment
to the summary of the job. `comment` puts it below the pull request, or in the place of the one it wrote before.
"""

from __future__ import annotations

import argparse
import html
import json
import os
import re
import shlex
import subprocess
import sys
import urllib.error
import urllib.request
from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pipeline.diagnosis.verdict import MODULE_OF

ARTIFACT = os.environ.get("ARTIFACT", "spatialviz-replay")
MARK = f"<!-- {ARTIFACT} -->"
"""By this line a comment is found again; of several jobs each has its own."""
LONGEST = 65_536
"""Characters of a comment that GitHub takes."""
MOST_ROWS = 40
MOST_PAGES = 20
CORRECT = "CORRECT"
NOTHING = "no verdict"
NOTHING_CHANGED = "nothing changed"


def spatialviz(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "spatialviz", *arguments], capture_output=True, text=True)


def run(cases: list[str], out: Path, srm: str | None, options: list[str]) -> int:
    """Replay, write what came of it, and return the status of `spatialviz replay`."""
    scorer = [] if srm is None else ["--srm", srm]
    done = spatialviz("replay", *cases, "--json", *scorer, *options)
    *results, totals = [json.loads(line) for line in done.stdout.splitlines()] or [None]
    sys.stderr.write(done.stderr)
    out.mkdir(parents=True, exist_ok=True)
    changed = [Changed(result) for result in results if result["status"] in ("changed", "updated")]
    for number, one in enumerate(changed[:MOST_PAGES]):
        page = f"{number:02d}-{re.sub(r'[^A-Za-z0-9-]+', '-', Path(one.case).name)}.html"
        if spatialviz("report", one.case, "--out", str(out / page), "--overwrite", *scorer).returncode == 0:
            one.page = page
    damaged = [result for result in results if result["status"] == "damaged"]
    problem = (done.stderr.strip().splitlines() or ["it ended without a word"])[-1] if totals is None else None
    body = comment_of(changed, damaged, totals, problem)
    (out / "comment.md").write_text(body, encoding="utf-8")
    (out / "index.html").write_text(index_of(changed, damaged, problem), encoding="utf-8")
    add_to("GITHUB_STEP_SUMMARY", body)
    regressed = " ".join(module for module, _ in modules(changed))
    status = done.returncode if done.returncode in (0, 1) else 2
    add_to("GITHUB_OUTPUT", f"status={status}\nregressed={regressed}\n")
    print(body)
    return status


class Changed:
    """A case whose answer is another now."""

    def __init__(self, result: dict[str, Any]) -> None:
        self.case, self.name, self.changes = result["case"], result["name"], result["changes"]
        before, after = (result[when]["judgement"] or {} for when in ("before", "after"))
        self.before, self.after = (found.get("verdict", NOTHING) for found in (before, after))
        self.why = after.get("said") or result["after"].get("reason") or ""
        # The verdict blames what would mend this answer; what gives something else than before is what changed.
        self.module = result.get("moved") or MODULE_OF.get(self.after) or self.after
        self.page: str | None = None

    @property
    def moved(self) -> str:
        return f"{self.before} → {self.after}"

    @property
    def regressed(self) -> bool:
        return self.before == CORRECT != self.after


def modules(changed: list[Changed]) -> list[tuple[str, int]]:
    """The modules that made something wrong that was right before, those of most cases first."""
    return Counter(one.module for one in changed if one.regressed).most_common()


def comment_of(
    changed: list[Changed], damaged: list[dict[str, Any]], totals: dict[str, int] | None, problem: str | None
) -> str:
    """The comment, in Markdown."""
    if totals is None:
        return f"{MARK}\n### spatialviz replay: nothing was run\n\n{plain(problem or '')}\n"
    regressed = [one for one in changed if one.regressed]
    title = f"{len(changed)} of {totals['cases']} cases changed" if changed else NOTHING_CHANGED
    title += f", {len(damaged)} damaged" if damaged else ""
    lines = [MARK, f"### spatialviz replay: {title}", ""]
    if regressed:
        blamed = ", ".join(f"{module} ({count})" for module, count in modules(changed))
        lines += [f"**Regressed: {blamed}**", ""]
    if changed:
        lines += ["| module that moved first | verdict before → now | cases |", "|---|---|--:|"]
        counts = Counter((one.module, one.moved) for one in changed)
        lines += [f"| {module} | {moved} | {count} |" for (module, moved), count in counts.most_common()]
        lines += ["", "| case | module | verdict before → now | what changed | why |", "|---|---|---|---|---|"]
        # What was right comes first.
        for one in sorted(changed, key=lambda one: not one.regressed)[:MOST_ROWS]:
            other = "; ".join(change for change in one.changes if not change.startswith("verdict: "))
            cells = (f"{linked(one.case)} {plain(one.name)}", one.module, one.moved, plain(other), plain(one.why))
            lines.append(f"| {' | '.join(cells)} |")
        if len(changed) > MOST_ROWS:
            lines += ["", f"and {len(changed) - MOST_ROWS} more"]
    for result in damaged[:MOST_ROWS]:
        lines += ["", f"damaged: {linked(result['case'])}: {plain(result['problem'])}"]
    place = f"the artifact [{ARTIFACT}]({run_address()})" if "GITHUB_RUN_ID" in os.environ else "index.html"
    pages = f"The pages that show why are in {place}." if changed else ""
    return "\n".join([*lines, "", f"{totals['same']} unchanged. {pages}".strip(), ""])


def index_of(changed: list[Changed], damaged: list[dict[str, Any]], problem: str | None) -> str:
    """A page that leads to the others."""
    rows = [
        f"<tr><td>{html.escape(one.name)}<td>{one.module}<td>{html.escape(one.moved)}<td>"
        + (f'<a href="{quote(one.page)}">why</a>' if one.page else "")
        for one in changed
    ]
    rows += [f"<tr><td>{html.escape(r['case'])}<td>damaged<td colspan=2>{html.escape(r['problem'])}" for r in damaged]
    rows += [f"<tr><td>{html.escape(problem)}"] if problem else []
    table = "\n".join(rows) or "<tr><td>nothing has changed"
    style = ":root{color-scheme:light dark}body{font:15px system-ui;margin:2rem}td{padding:.3rem 1.2rem .3rem 0}"
    head = f"<!doctype html><meta charset=utf-8><title>spatialviz replay</title><style>{style}</style>"
    return f"{head}\n<table>\n{table}\n</table>\n"


def plain(text: str) -> str:
    """Text as it is, in a cell: no Markdown, no HTML, and nobody is notified. Names of cases are anybody's words."""
    text = re.sub(r"[\\`*_\[\]<>|#!&~$]", lambda found: f"&#{ord(found[0])};", " ".join(text.split()))
    return text.replace("@", "@\u200b")[:400]


def linked(case: str) -> str:
    """A case as a link to its folder at this commit, where it is in the repository."""
    root, folder = Path(os.environ.get("GITHUB_WORKSPACE", ".")).resolve(), Path(case).resolve()
    name = folder.relative_to(root).as_posix() if folder.is_relative_to(root) else folder.name
    sha = os.environ.get("GITHUB_SHA")
    if sha is None or not folder.is_relative_to(root):
        return plain(name)
    return f"[{plain(name)}]({repository()}/tree/{sha}/{quote(name)})"


def repository() -> str:
    return f"{os.environ.get('GITHUB_SERVER_URL', 'https://github.com')}/{os.environ.get('GITHUB_REPOSITORY', '')}"


def run_address() -> str:
    """Where the artifacts of this run are; the address of one is only known once it is there."""
    return f"{repository()}/actions/runs/{os.environ.get('GITHUB_RUN_ID', '')}#artifacts"


def add_to(variable: str, text: str) -> None:
    """Append to a file that GitHub named, where there is one."""
    if path := os.environ.get(variable):
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(text)


def comment(body: Path) -> None:
    """Comment on the pull request; a comment that cannot be written is a notice, not a failure."""
    event = json.loads(Path(os.environ.get("GITHUB_EVENT_PATH", os.devnull)).read_text(encoding="utf-8") or "{}")
    number = event.get("pull_request", {}).get("number")
    if number is None:
        print("no pull request: no comment")
        return
    text = body.read_text(encoding="utf-8").replace(run_address(), os.environ.get("ARTIFACT_URL") or run_address())
    mark, title = text.splitlines()[:2]
    text = text[:LONGEST]
    comments = f"/repos/{os.environ['GITHUB_REPOSITORY']}/issues/{number}/comments"
    try:
        page, own = 1, None
        while found := api("GET", f"{comments}?per_page=100&page={page}"):
            own = next((one["url"] for one in found if one["body"].startswith(mark)), own)
            page += 1
        if own is not None:
            api("PATCH", own, {"body": text})
        elif title != f"### spatialviz replay: {NOTHING_CHANGED}":
            api("POST", comments, {"body": text})
    except (urllib.error.URLError, TimeoutError) as error:
        print(f"::notice::no comment was written: {error}; the summary of the job says the same")


def api(method: str, address: str, content: dict[str, Any] | None = None) -> Any:
    """What GitHub's API answers."""
    address = address if "://" in address else os.environ.get("GITHUB_API_URL", "https://api.github.com") + address
    headers = {"Authorization": f"Bearer {os.environ.get('GITHUB_TOKEN', '')}", "Accept": "application/vnd.github+json"}
    data = None if content is None else json.dumps(content).encode()
    with urllib.request.urlopen(urllib.request.Request(address, data, headers, method=method), timeout=30) as answer:
        return json.load(answer)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    steps = parser.add_subparsers(dest="step", required=True)
    running = steps.add_parser("run")
    running.add_argument("cases", nargs="+")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--srm")
    running.add_argument("--options", default="")
    commenting = steps.add_parser("comment")
    commenting.add_argument("body", type=Path)
    asked = parser.parse_args()
    if asked.step == "comment":
        comment(asked.body)
    else:
        sys.exit(run(asked.cases, asked.out, asked.srm, shlex.split(asked.options)))
