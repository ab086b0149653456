"""Faults done to real processes: killed, starved, disturbed; and whether each promise was kept.

python .ci/robust/faults.py --seconds 300 [--seed N] [--only kill-eval,page,...] [--json]

Exit status 1 where a promise was broken. What each kind promises stands in .github/SECURITY.md.
"""

# ruff: noqa: E402 (where modules are found is set first)

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / ".ci"), str(ROOT / ".ci" / "page")]

import disks
import disturbed
import journals
import kills
import pages
from promises import Tally, chosen, generator, options, rounds
from world import World

Scenario = Callable[..., None]
IDLE = "page-idle"
"""Lasts as long as the others."""
SCENARIOS: dict[str, Scenario] = {
    **kills.scenarios(),
    **disks.scenarios(),
    **disturbed.SCENARIOS,
    **journals.SCENARIOS,
    **pages.SCENARIOS,
    IDLE: lambda *_: None,
}


def main() -> int:
    os.chdir(ROOT)
    given = options(__doc__, SCENARIOS).parse_args()
    names, tally = chosen(SCENARIOS, given.only), Tally("faults", given.seed)
    with tempfile.TemporaryDirectory(prefix="faults-") as home:
        world = World(Path(home))

        def begin(name: str, number: int) -> None:
            again = f"python .ci/robust/faults.py --only {name} --seed {given.seed}"
            with tally.watching(name, round=number, again=again) as kind:
                SCENARIOS[name](world, generator(given.seed, name, number), kind)

        idle = pages.Idle() if IDLE in names else None
        try:
            rounds([name for name in names if name != IDLE], given, begin)
            if idle is not None:
                with tally.watching(IDLE) as kind:
                    idle.look(kind)
        finally:
            if idle is not None:
                idle.end()
    return tally.end(given.out, given.json)


if __name__ == "__main__":
    sys.exit(main())
