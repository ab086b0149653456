"""Pages of the site that stand elsewhere in the project, and links out of `docs/`.

Called by mkdocs (`hooks:` of mkdocs.yml). GitHub shows the same Markdown, so links in the documents are those of the
checkout; here they are turned to the site's pages.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
# Documents outside `docs/`, each with its page.
ELSEWHERE = {
    "CHANGELOG.md": "changelog.md",
    ".github/SECURITY.md": "security.md",
    ".github/CONTRIBUTING.md": "contributing.md",
    "README.md": "index.md",
}
LANGUAGES = {".py": "python", ".sh": "sh"}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def examples_page() -> str:
    """Return the Markdown of all short files of `docs/examples`, each below its name."""
    parts = ["# Examples to copy\n\nShort files that run as they stand: save one, and run it.\n"]
    for file in sorted((ROOT / "docs" / "examples").iterdir()):
        if file.suffix in LANGUAGES:
            parts.append(f"## {file.name}\n\n```{LANGUAGES[file.suffix]}\n{file.read_text().rstrip()}\n```\n")
    return "\n".join(parts)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are written elsewhere or made of something, the program's icon and the colours."""
    made = {page: (ROOT / source).read_text() for source, page in ELSEWHERE.items() if page != "index.md"}
    made["examples.md"] = examples_page()
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    copied = {"pictures/icon.svg": "spatialviz/app/static/icon.svg", "site.css": ".ci/site/site.css"}
    for name, source in copied.items():
        files.append(File.generated(config, name, content=(ROOT / source).read_bytes()))
    return files


def source_of(page: str) -> Path:
    """Return the folder, from the root of the project, that links of a page start from."""
    written = {made: source for source, made in ELSEWHERE.items() if made != "index.md"}.get(page, f"docs/{page}")
    return Path(written).parent


def target_of(page: str, link: str) -> str | None:
    """Return where a link of a page leads in the site; None for what is not on the site."""
    path, _, anchor = link.partition("#")
    if "://" in link or link.startswith("mailto:") or not path:
        return link
    parts: list[str] = []
    for part in (source_of(page) / path).parts:
        if part == "..":
            parts = parts[:-1]
        elif part != ".":
            parts.append(part)
    whole = "/".join(parts)
    up = "../" * page.count("/")
    if whole in ELSEWHERE:
        found = ELSEWHERE[whole]
    elif whole == "docs/examples" or whole.startswith("docs/examples/"):
        found = "examples.md"
        anchor = whole.rpartition("/")[2].replace(".", "") if "." in whole else ""
    elif whole.startswith("docs/"):
        found = whole.removeprefix("docs/")
    else:
        return None
    return up + found + (f"#{anchor}" if anchor else "")


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Turn links to files of the project to the pages of the site; what is not on the site keeps its words alone."""

    def turned(found: re.Match[str]) -> str:
        target = target_of(page.file.src_uri, found[3])
        return f"{found[1]}[{found[2]}]({target})" if target is not None else found[2]

    return LINK.sub(turned, markdown)
