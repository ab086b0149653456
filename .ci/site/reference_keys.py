"""Page of the keys: what `spatialviz/app/keys.py` binds and lists."""

from __future__ import annotations

from markdown_tables import cell, table

from spatialviz.app.keys import KEYS, LABEL_KEYS, MOUSE, MOVE_KEYS, Rows

INTRO = """# Keys of the page

What each key does in the page of `spatialviz view`, by where it works. In the page `Ctrl+K`, `H` or `?` lists the
same, and searches it.
"""
PARTS = (
    (
        "Everywhere",
        "These keys work in the whole page, but for a field in which you type.",
        KEYS,
    ),
    (
        "While labels are shown",
        "`Shift+L` shows the labels to correct them. These keys then come first: where one stands above too, it means "
        "this here.",
        LABEL_KEYS,
    ),
    (
        "Datasets with moves",
        "In a dataset whose frames say where a step leads, as those of the Active Vision Dataset do, these keys walk.",
        {"Moves": MOVE_KEYS},
    ),
    ("Lists, scene and picture", "These work where the pointer or the focus is.", MOUSE),
)


def keyed(key: str) -> str:
    """Return a key, or several pressed at once, as keyboard keys."""
    return "+".join(f"<kbd>{part}</kbd>" for part in key.split("+"))


def _table(rows: Rows) -> str:
    return table(("key", "what it does"), ((keyed(key), cell(does)) for key, does, _ in rows))


def page() -> str:
    """Return the page's Markdown."""
    parts = [INTRO]
    for title, about, groups in PARTS:
        parts += [f"## {title}\n", f"{about}\n"]
        parts += [f"### {group}\n\n{_table(rows)}" for group, rows in groups.items()]
    return "\n".join(parts)
