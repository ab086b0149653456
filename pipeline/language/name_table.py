"""Class names: the table of synonyms, kinds, and names often confused."""

from __future__ import annotations

import json
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, TypeVar

import xxhash

from pipeline.language.name_forms import key_of, normal_form
from pipeline.system.errors import as_input_error
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked
from pipeline.system.safe_files import read_json

NAMES = Path(__file__).with_name("names")
"""The project's own table: every JSON file in here. `docs/names.md` says what its keys mean."""


Value = TypeVar("Value", bound=Hashable)


def _grouped(pairs: Iterable[tuple[str, Value]]) -> dict[str, frozenset[Value]]:
    found: dict[str, set[Value]] = {}
    for key, value in pairs:
        found.setdefault(key, set()).add(value)
    return {key: frozenset(values) for key, values in found.items()}


@dataclass(frozen=True, eq=False)
class Synonyms:
    """Synonyms, kinds, and exceptions of class names.

    >>> from pipeline.language import default_synonyms, match
    >>> table = default_synonyms().extended([["bin", "waste bucket"]])
    >>> match("waste bucket", ["trash can", "bin"], table)
    ('trash can', 'bin')
    """

    # Names, in normal form, that mean the same. A name may stand in several groups (`computer` with `laptop` and with
    # `desktop`), and meaning is not chained through it
    groups: tuple[frozenset[str], ...]
    # Names, in normal form, that their last word must not match: a `hot dog` is no `dog`
    exceptions: frozenset[str] = frozenset()
    # Of a general name, in normal form, names of its kinds: `cup` -> `mug`, `teacup`
    kinds: Mapping[str, frozenset[str]] = field(default_factory=dict)
    # Names of different things that people and detectors call by one another's: `desk` and `table`
    near: tuple[frozenset[str], ...] = ()
    # Further names of things, in normal form, of which the table only says that there are such
    plain: frozenset[str] = frozenset()

    @classmethod
    def load(cls, extra: str | Path | None = None) -> Synonyms:
        """Load the project's table, extended by a JSON file of the user.

        Parameters
        ----------
        extra : str or Path, optional
            `{"groups": [["bin", "my bin"], ...], "kinds": {"cup": ["my mug"]}, "near": [["desk", "table"]],
            "exceptions": ["hot dog", ...]}`, every key optional. A group of it that shares a name with one of ours adds
            its names to that group.

        Raises
        ------
        InputError
            The file is missing, is no JSON or has another shape.
        """
        if extra is None:
            return default_synonyms()
        from pipeline.language.name_files import NameFile

        path = Path(extra)
        what = "the synonym table is wrong at {}"
        read = checked(NameFile.model_validate, _json_of(path), what, path, keys=NameFile.model_fields)
        ours = default_synonyms().extended(read.groups, read.exceptions)
        kinds = dict(ours.kinds)
        for general, names in read.kinds.items():
            general = normal_form(general)
            kinds[general] = kinds.get(general, frozenset()) | frozenset(map(normal_form, names))
        near = (*ours.near, *(frozenset(map(normal_form, g)) for g in read.near))
        return cls(ours.groups, ours.exceptions, kinds, near, ours.plain | frozenset(map(normal_form, read.names)))

    def extended(self, groups: Iterable[Iterable[str]], exceptions: Iterable[str] = ()) -> Synonyms:
        """Copy with more groups and exceptions, added as `load` describes."""
        merged = list(self.groups)
        for names in groups:
            group = frozenset(normal_form(n) for n in names)
            keys = {key_of(n) for n in group}
            shares = [i for i, old in enumerate(merged) if not keys.isdisjoint(key_of(n) for n in old)]
            for i in shares:
                merged[i] = merged[i] | group
            if not shares:
                merged.append(group)
        more = self.exceptions | frozenset(normal_form(n) for n in exceptions)
        return Synonyms(tuple(merged), more, self.kinds, self.near, self.plain)

    def of(self, name: str) -> frozenset[str]:
        """All synonyms of a name, in normal form, itself included."""
        normal = normal_form(name)
        return frozenset({normal}).union(*(self.groups[i] for i in self._indices.get(key_of(normal), ())))

    def same(self, a: str, b: str) -> bool:
        """Test if two names in normal form are one spelling or share a group."""
        a, b = key_of(a), key_of(b)
        return a == b or not self._indices.get(a, frozenset()).isdisjoint(self._indices.get(b, frozenset()))

    def is_exception(self, name: str) -> bool:
        """Test if the last word of a name in normal form does not say what the thing is."""
        return key_of(name) in self._excepted

    def general(self, name: str) -> frozenset[str]:
        """Generalisations of a name, both in normal form, by the table."""
        return self._general.get(key_of(name), frozenset())

    def taken_for(self, name: str) -> frozenset[str]:
        """Names often confused with a name, both in normal form."""
        return self._taken.get(key_of(name), frozenset())

    @cached_property
    def _indices(self) -> dict[str, frozenset[int]]:
        return _grouped((key_of(name), number) for number, group in enumerate(self.groups) for name in group)

    @cached_property
    def _excepted(self) -> frozenset[str]:
        excepted = frozenset(map(key_of, self.exceptions))
        # What holds for the trash can holds for the garbage can.
        keys = (frozenset(map(key_of, group)) for group in self.groups)
        return excepted.union(*(group for group in keys if not excepted.isdisjoint(group)))

    @cached_property
    def _general(self) -> dict[str, frozenset[str]]:
        return _grouped((key_of(name), general) for general, names in self.kinds.items() for name in names)

    @cached_property
    def _taken(self) -> dict[str, frozenset[str]]:
        return _grouped((key_of(name), other) for group in self.near for name in group for other in group - {name})

    @cached_property
    def names(self) -> frozenset[str]:
        """Every name of the table, in normal form."""
        kinds = frozenset(self.kinds).union(*self.kinds.values())
        return kinds.union(self.plain, self.exceptions, *self.groups, *self.near)

    @cached_property
    def keys(self) -> frozenset[str]:
        """Names of the table without gaps."""
        return frozenset(map(key_of, self.names))

    @cached_property
    def words(self) -> frozenset[str]:
        """Single words of all names of the table."""
        return frozenset(word for name in self.names for word in name.split())

    def record(self) -> dict[str, Any]:
        """JSON of the table, in one order."""
        return {
            "groups": sorted(sorted(g) for g in self.groups),
            "exceptions": sorted(self.exceptions),
            "kinds": {general: sorted(names) for general, names in sorted(self.kinds.items())},
            "near": sorted(sorted(g) for g in self.near),
            "plain": sorted(self.plain),
        }

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the whole table."""
        return xxhash.xxh3_64_hexdigest(json.dumps(self.record()).encode())


@lru_cache(maxsize=1)
def default_synonyms() -> Synonyms:
    """The project's own table, read once."""
    # These files hold names in normal form, which a test of them sees to.
    files = [_json_of(path) for path in sorted(NAMES.glob("*.json"))]

    def all_of(key: str) -> list[Any]:
        return [entry for file in files for entry in file.get(key, ())]

    kinds = [(general, n) for file in files for general, names in file.get("kinds", {}).items() for n in names]
    groups, near = (tuple(map(frozenset, all_of(key))) for key in ("groups", "near"))
    return Synonyms(groups, frozenset(all_of("exceptions")), _grouped(kinds), near, frozenset(all_of("names")))


def _json_of(path: Path) -> Any:
    unreadable = "the synonym table cannot be read"
    with as_input_error(unreadable, OSError, ValueError, got=str, expected="a JSON file", path=path):
        return read_json(path)
