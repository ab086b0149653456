"""pyarrow and its modules, each loaded when something of it is first used: what only hands tables on starts without."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any


class LazyModule:
    """A module that is imported when something of it is first used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        found = self.__dict__[attribute] = getattr(import_module(self._name), attribute)
        return found


if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.json as pj
    import pyarrow.parquet as pq
else:
    pa, pc, pj, pq = (LazyModule(f"pyarrow{part}") for part in ("", ".compute", ".json", ".parquet"))

__all__ = ["LazyModule", "pa", "pc", "pj", "pq"]
