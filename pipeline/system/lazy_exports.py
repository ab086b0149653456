"""Names handed on by a package, each loaded at its first use."""

from __future__ import annotations

TYPE_CHECKING = False
# Nothing but types: what imports this is to cost nothing.
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def lazy_exports(package: str, file: str) -> Callable[[str], Any]:
    """`__getattr__` of a package for the names imported in the `if TYPE_CHECKING:` block of its file.

    Type checkers read the block, so that names stand in one place. It is read when a name is first asked for: importing
    the package, or a module in it, costs nothing. The arguments are `__name__` and `__file__`.

    Examples
    --------
    >>> from pipeline.geometry import Box3D
    >>> Box3D.__module__
    'pipeline.geometry.boxes'
    """
    module_of: dict[str, str] = {}

    def get(name: str) -> Any:
        from importlib import import_module
        from sys import modules

        if not module_of:
            module_of.update(declared(file))
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(module_of[name]), name)
        setattr(modules[package], name, found)
        return found

    return get


def declared(file: str) -> dict[str, str]:
    """Modules by names, from a file's imports for type checkers."""
    import ast
    from pathlib import Path

    tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    blocks = [n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    imports = [n for block in blocks for n in block.body if isinstance(n, ast.ImportFrom) and n.module]
    return {alias.name: str(n.module) for n in imports for alias in n.names}
