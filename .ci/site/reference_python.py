"""Page of the public Python names: mkdocstrings renders each from its signature, types and docstring."""

from __future__ import annotations

import inspect

import pipeline
import spatialviz

INTRO = """# Python

What `import spatialviz` gives: each public name with its arguments, types, errors and an example that runs.
[From Python, and as JSON](../python.md) shows how they are used together. `import pipeline` has the same names without
the page. What stands in neither is private, and moves between releases.
"""
GROUPS = {
    "Ask and look": ("open", "ask", "show", "Opened", "Answer"),
    "Label and evaluate": ("label", "open_labels", "Labels", "evaluate", "open_run", "Run"),
    "Bring a pipeline": ("trace", "import_records"),
    "Frames": ("Frame", "Camera", "Annotation", "Box3D"),
    "Parts of your own": (
        *("Dataset", "DatasetFormat", "Detector", "Proposals", "Segmenter", "RelationScorer", "RelationScores"),
        *("ExportFormat", "Written", "PredictionFormat"),
    ),
    "Errors and version": ("InputError", "__version__"),
}


def defined(name: str) -> str:
    """Return where a public name is defined, as mkdocstrings asks for it; `open` and `ask` tell of their options."""
    found = getattr(pipeline if name in ("open", "ask") else spatialviz, name)
    return f"{found.__module__}.{found.__qualname__}"


def _section(name: str) -> str:
    if name == "__version__":
        return f"### `{name}`\n\nThe version as text: `{spatialviz.__version__}`.\n\n{_example(name)}"
    members = "\n      inherited_members: true" if inspect.isclass(getattr(spatialviz, name)) else ""
    return f'::: {defined(name)}\n    options:\n      heading: "{name}"\n      toc_label: "{name}"{members}\n'


def _example(name: str) -> str:
    return f"```pycon\n>>> import spatialviz\n>>> spatialviz.{name}\n'{spatialviz.__version__}'\n```\n"


def page() -> str:
    """Return the page's Markdown."""
    listed = [name for names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted(spatialviz.__all__), "a public name has no place on the page"
    parts = [INTRO]
    for group, names in GROUPS.items():
        parts += [f"## {group}\n", *map(_section, names)]
    return "\n".join(parts)
