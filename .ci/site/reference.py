"""Pages of the reference, made from the code. Called by mkdocs (`hooks:` of mkdocs.yml)."""

from __future__ import annotations

from pathlib import Path

import reference_commands
import reference_formats
import reference_keys
import reference_python
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

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
