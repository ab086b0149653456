"""Hostile inputs of every reader: one clear line or an answer, no traceback, no hang, no write outside, little memory.

python .ci/robust/fuzz.py --seconds 300 [--seed N] [--only onnx,query,...] [--json]
python .ci/robust/fuzz.py --only onnx --seed N --number K      # that input again

Inputs that broke a promise are kept in --kept. Exit status 1 where there is one.
"""

# ruff: noqa: E402 (where modules are found is set first)

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [
    str(ROOT),
    str(ROOT / "tests"),
    str(ROOT / "tests" / "datasets"),
    str(ROOT / ".ci"),
    str(ROOT / ".ci" / "page"),
]
os.environ.setdefault("OMP_NUM_THREADS", "1")

import sockets_fuzz
from fuzz_kinds import kinds
from promises import Tally, chosen, generator, options, rounds
from workers import Worker, keep
from world import World

AT_ONCE = 8
"""Inputs of a kind before the next kind's turn."""
SERVER = ("http", "websocket")


def main() -> int:
    os.chdir(ROOT)
    parser = options(__doc__, ())
    parser.add_argument("--number", type=int, help="only this input, of the one kind that --only names")
    parser.add_argument(
        "--kept", type=Path, default=Path(tempfile.gettempdir()) / "fuzz-kept", help="where inputs are kept"
    )
    given = parser.parse_args()
    tally = Tally("fuzz", given.seed)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        home = Path(temporary)
        os.environ |= {
            "SPATIALVIZ_CACHE": str(home / "cache"),
            "XDG_DATA_HOME": str(home / "data"),
            "TMPDIR": temporary,
        }
        tempfile.tempdir = temporary
        world = World(home)
        every = kinds(world, home)
        names = chosen({**every, **dict.fromkeys(SERVER)}, given.only)
        allowed = (str(home), "/dev/null", "/dev/shm", "/proc/self", f"/proc/{os.getpid()}")
        worker = Worker(every, home, allowed)

        def one(name: str, number: int) -> None:
            with tally.watching(name) as counted:
                counted.times += 1
                verdict, folder = worker.judge(name, f"{given.seed} {name} {number}")
                counted.counts[verdict.result] += 1
                counted.most("MB more", verdict.grown_mb)
                counted.most("s", verdict.seconds)
                if verdict.broken:
                    place = keep(folder, name, verdict, given.kept, number)
                    again = f"python .ci/robust/fuzz.py --only {name} --seed {given.seed} --number {number}"
                    tally.fail(name, verdict.broken, again=again, kept=str(place), command=" ".join(verdict.words))
                shutil.rmtree(folder.parent, ignore_errors=True)

        server = sockets_fuzz.Fuzzed() if set(SERVER) & set(names) else None

        def begin(name: str, number: int) -> None:
            if name in SERVER and server is not None:
                with tally.watching(name, again=f"--only {name} --seed {given.seed}") as counted:
                    server.send(name, generator(given.seed, name, number), counted)
                return
            for k in range(AT_ONCE):
                one(name, number * AT_ONCE + k)

        try:
            if given.number is not None:
                one(names[0], given.number)
            else:
                rounds(names, given, begin)
        finally:
            worker.end()
            if server is not None:
                with tally.watching("server"):
                    server.end()
    return tally.end(given.out, given.json)


if __name__ == "__main__":
    sys.exit(main())
