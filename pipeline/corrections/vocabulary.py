"""The class names that a person may give to an object, and what they mean while they type one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

from pipeline.corrections.journal.journal import Journal
from pipeline.datasets import Dataset
from pipeline.labels.reading import Labels
from pipeline.language.naming import Synonyms, default_synonyms, normal_form
from pipeline.system.frozen import dataclass

MOST = 8
_NONE = 4


@dataclass(frozen=True)
class Completion:
    """Class name that was perhaps meant."""

    name: str  # as labels, dataset or synonyms write it
    via: str  # typed synonym, or ""
    count: int  # objects of the labels
    known: bool  # class of labels or dataset

    def record(self) -> dict[str, Any]:
        """JSON record."""
        return {"name": self.name, "via": self.via or None, "count": self.count, "known": self.known}


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """Class names of labels and dataset with their counts, and synonyms."""

    counts: Mapping[str, int]
    synonyms: Synonyms

    @classmethod
    def of(
        cls, labelled: Iterable[str], of_dataset: Iterable[str] = (), synonyms: Synonyms | None = None
    ) -> Vocabulary:
        """From the class of every labelled object, and the class names of the dataset."""
        return cls({**dict.fromkeys(of_dataset, 0), **Counter(labelled)}, synonyms or default_synonyms())

    def with_names(self, names: Iterable[str]) -> Vocabulary:
        """Add names, such as people's."""
        more = dict.fromkeys((n for n in names if n not in self.counts), 1)
        return Vocabulary({**self.counts, **more}, self.synonyms) if more else self

    def __contains__(self, name: str) -> bool:
        """True for an exact class name."""
        return name in self.counts

    @property
    def names(self) -> list[str]:
        """Names for completion, classes first."""
        return list(dict.fromkeys([*self.counts, *sorted(name for _, name, _ in self._spoken)]))

    @cached_property
    def _spoken(self) -> tuple[tuple[str, str, str], ...]:
        """Typed form, class name and alias of each name, in normal form."""
        found: dict[tuple[str, str], str] = {}
        for name in self.counts:
            own = normal_form(name)
            found[own, name] = ""
            for alias in self.synonyms.of(name) - {own}:
                found.setdefault((alias, name), alias)
        of_classes = {spoken for spoken, _ in found}
        for group in self.synonyms.groups:
            if of_classes.isdisjoint(group):
                found.update({(alias, alias): "" for alias in group})
        return tuple((spoken, name, via) for (spoken, name), via in found.items())


def vocabulary_of(labels: Labels, dataset: Dataset | None = None, journal: Journal | None = None) -> Vocabulary:
    """Class names of labels, dataset, and corrections."""
    words = Vocabulary.of(labels.objects.column("label").to_pylist(), () if dataset is None else dataset.class_names)
    events = () if journal is None else journal.events(kind="object")
    given = (
        e.after if e.ref.field == "label" else e.after.get("label")
        for e in events
        if e.ref.field == "label" or (e.ref.field == "exists" and e.after is not None)
    )
    return words.with_names(name for name in given if name)


def completions(typed: str, vocabulary: Vocabulary, most: int = MOST) -> tuple[Completion, ...]:
    """Class names for a typed beginning, best first.

    What begins with it comes before what has a word that does, and that before
    what only holds it. A class of the labels comes before another name of one
    (`trash can` for `trashcan`, `couch` for `sofa`), and that before a word of
    the table of synonyms that no class has. Frequent classes come first.

    `typed`: the beginning of a name; nothing means the most frequent classes.
    """
    # The end of what is typed is open: "book s" must not lose its last letter as a plural.
    wanted = " ".join(typed.lower().replace("_", " ").split())
    best: dict[str, tuple[tuple[int, ...], Completion]] = {}
    for spoken, name, via in vocabulary._spoken:
        how = min(_how(wanted, spoken), _how(normal_form(typed), spoken)) if wanted else 0
        known = name in vocabulary.counts
        if how == _NONE or (not wanted and (via or not known)):
            continue
        count = vocabulary.counts.get(name, 0)
        rank = (how, not known, bool(via), -count)
        if name not in best or rank < best[name][0]:
            best[name] = rank, Completion(name, via, count, known)
    ranked = sorted(best.values(), key=lambda entry: (entry[0], entry[1].name))
    return tuple(completion for _, completion in ranked[:most])


def by_digits(vocabulary: Vocabulary, here: Iterable[str], unnamed: str = "") -> list[str]:
    """Nine most frequent classes, of the labels, then of a frame."""
    often = (c.name for c in completions("", vocabulary, 18))
    names = dict.fromkeys((*often, *(name for name, _ in Counter(here).most_common())))
    return [name for name in names if name != unnamed][:9]


def _how(wanted: str, spoken: str) -> int:
    """Rank of a name for the typed text: 0 the same, 1 to 3 its beginning, a word's or within; _NONE for no match.

    `trash can` equals `trashcan`.
    """
    joined, short, words = spoken.replace(" ", ""), wanted.replace(" ", ""), spoken.split()
    of_word = any(" ".join(words[k:]).startswith(wanted) for k in range(1, len(words)))
    fits = (joined == short, joined.startswith(short), of_word, short in joined, True)
    return fits.index(True) if short else _NONE
