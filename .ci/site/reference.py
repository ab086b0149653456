"""Pages of the reference, made from the code. Called by mkdocs (`hooks:` of mkdocs.yml)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import reference_commands
import reference_formats
import reference_keys
import reference_python
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {
    "reference/commands.md": reference_commands.page,
    "reference/python.md": reference_python.page,
    "reference/formats.md": reference_formats.page,
    "reference/keys.md": reference_keys.page,
}
STYLE = "reference.css"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and their style."""
    files.append(File.generated(config, STYLE, content=Path(__file__).with_name(STYLE).read_text(encoding="utf-8")))
    for name, page in PAGES.items():
        files.append(File.generated(config, name, content=page()))
    return files


def on_page_content(html: str, page: Page, files: Files, **_: Any) -> str:
    """Turn a notebook's links to documents to their pages: mkdocs does so for Markdown only."""
    if not page.file.src_uri.endswith(".ipynb"):
        return html

    def turned(found: re.Match[str]) -> str:
        file = files.get_file_from_path(found[1])
        if file is None:
            raise PluginError(f"{page.file.src_uri} links to {found[1]}, which is not there")
        return f'href="{file.url_relative_to(page.file)}{found[2] or ""}"'

    return re.sub(r'href="([^":#]+\.md)(#[^"]*)?"', turned, html)
