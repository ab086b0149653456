"""Check of a built site: every link, picture and heading that a page names is there.

    python .ci/site/links.py SITE

mkdocs checks what stands in Markdown; this sees what is generated, too. Addresses of other sites are not asked.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Names(HTMLParser):
    """The ids of a page, and what it links to or shows."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: set[str] = {""}
        self.links: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.ids |= {v for k in ("id", "name") if (v := given.get(k))}
        self.links |= {v for k in ("href", "src") if (v := given.get(k))}


def broken(site: Path) -> list[str]:
    """Return a line for each link within the site that leads nowhere."""
    pages = {p.resolve(): Names(p.read_text()) for p in site.rglob("*.html") if p.name != "404.html"}
    found = []
    for page, names in pages.items():
        for link in sorted(names.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            path = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            path = path / "index.html" if path.is_dir() else path
            there = path.is_file() and (path not in pages or unquote(parts.fragment) in pages[path].ids)
            if not there:
                found.append(f"{page.relative_to(site.resolve())}: {link}")
    return found


if __name__ == "__main__":
    lines = broken(Path(sys.argv[1]))
    print("\n".join(lines) or "every link of the site leads somewhere")
    raise SystemExit(bool(lines))
