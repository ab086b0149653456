"""What the runners of faults and of fuzzing share: their options, what they counted, and the table of it."""

from __future__ import annotations

import argparse
import json
import random
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

SHOWN = 400
"""Characters of a failure in the table; the JSON has all of it."""


class Broken(Exception):
    """A promise that was not kept, in words."""


class NotRun(Exception):
    """Why a kind cannot be tried on this machine."""


def promise(kept: object, words: str, got: object = "") -> None:
    """Raise `Broken` unless a promise was kept."""
    if not kept:
        raise Broken(f"{words}; got {got}" if got != "" else words)


@dataclass
class Kind:
    """What was counted of one kind of fault or input."""

    times: int = 0
    seconds: float = 0.0
    counts: Counter[str] = field(default_factory=Counter)
    figures: dict[str, float] = field(default_factory=dict)
    """The largest seen of each."""
    failures: list[dict[str, Any]] = field(default_factory=list)
    not_run: str = ""

    def most(self, name: str, value: float) -> None:
        self.figures[name] = max(value, self.figures.get(name, value))


class Tally:
    """Counts of every kind, printed as a table and written as JSON."""

    def __init__(self, name: str, seed: int) -> None:
        self.name, self.seed = name, seed
        self.kinds: defaultdict[str, Kind] = defaultdict(Kind)
        self.started = time.monotonic()

    @property
    def broken(self) -> int:
        return sum(len(kind.failures) for kind in self.kinds.values())

    def fail(self, kind: str, words: str, **more: Any) -> None:
        """Note a broken promise, and say it at once."""
        self.kinds[kind].failures.append({"what": words, **more})
        print(f"BROKEN {kind}: {words[:SHOWN]}", *(f"\n  {k}: {v}" for k, v in more.items()), flush=True)

    @contextmanager
    def watching(self, kind: str, **more: Any) -> Iterator[Kind]:
        """Count the block as once more of a kind; what is broken in it is noted."""
        begun, counted = time.monotonic(), self.kinds[kind]
        try:
            yield counted
        except NotRun as why:
            counted.not_run = str(why)
        except Broken as error:
            self.fail(kind, str(error), **more)
        except Exception as error:  # A fault of the runner itself must not pass for a kept promise.
            self.fail(kind, f"the runner failed: {error!r}\n{traceback.format_exc()}", **more)
        finally:
            counted.seconds += time.monotonic() - begun

    def record(self) -> dict[str, Any]:
        return {
            "runner": self.name,
            "date": datetime.now(timezone.utc).strftime("%Y-%m-%d"),
            "seed": self.seed,
            "seconds": round(time.monotonic() - self.started),
            "times": sum(kind.times for kind in self.kinds.values()),
            "broken": self.broken,
            "kinds": {name: {**vars(kind), "seconds": round(kind.seconds, 1)} for name, kind in self.kinds.items()},
        }

    def table(self) -> str:
        lines = [f"{'kind':22} {'times':>7} {'broken':>6}  seen"]
        for name, kind in sorted(self.kinds.items()):
            seen = [f"{what} {count}" for what, count in sorted(kind.counts.items())]
            seen += [f"{what} {value:.4g}" for what, value in sorted(kind.figures.items())]
            seen += [f"not run: {kind.not_run}"] if kind.not_run else []
            lines.append(f"{name:22} {kind.times:7} {len(kind.failures):6}  {', '.join(seen)}")
        times = sum(kind.times for kind in self.kinds.values())
        lines.append(f"{'all':22} {times:7} {self.broken:6}  {time.monotonic() - self.started:.0f} s, seed {self.seed}")
        return "\n".join(lines)

    def end(self, out: Path | None, as_json: bool) -> int:
        """Print the table and write the JSON; the exit status."""
        text = json.dumps(self.record(), indent=1)
        if out is not None:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(text + "\n", "utf-8")
        print(text if as_json else self.table())
        return 1 if self.broken else 0


def options(about: str | None, kinds: Iterable[str]) -> argparse.ArgumentParser:
    """The options that both runners have."""
    names = sorted(kinds)
    parser = argparse.ArgumentParser(description=about, epilog="kinds: " + ", ".join(names))
    parser.add_argument("--seconds", type=float, default=300, help="begin nothing new after so long (300)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="kinds, or beginnings of their names, with commas")
    parser.add_argument("--json", action="store_true", help="print JSON in place of the table")
    parser.add_argument("--out", type=Path, help="also write the JSON there")
    return parser


def chosen(kinds: Mapping[str, Any], only: str) -> list[str]:
    """Names of the kinds that `--only` means."""
    words = [word.strip() for word in only.split(",") if word.strip()]
    wrong = [word for word in words if not any(name.startswith(word) for name in kinds)]
    if wrong:
        raise SystemExit(f"no such kind: {', '.join(wrong)}; kinds: {', '.join(kinds)}")
    return [name for name in kinds if not words or name.startswith(tuple(words))]


def rounds(names: list[str], given: argparse.Namespace, begin: Callable[[str, int], None]) -> None:
    """Begin each kind in turn until the time is over, those that `--only` names at least once.

    The seed shuffles them: where the time is too short for all, another seed begins with others.
    """
    until, number = time.monotonic() + given.seconds, 0
    names = random.Random(given.seed).sample(names, len(names))
    while True:
        for name in names:
            if (number or not given.only) and time.monotonic() >= until:
                return
            begin(name, number)
        number += 1
        if time.monotonic() >= until:
            return


def generator(seed: int, kind: str, number: int) -> random.Random:
    """The same draws for the same round of a kind."""
    return random.Random(f"{seed} {kind} {number}")
