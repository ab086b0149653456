"""Many pages at once: what is sent, kept and lost stays within bounds, also where others send garbage."""

import subprocess
import sys
from pathlib import Path

import pytest
from servers import free_port

SCRIPT = Path(__file__).parents[1] / "load_page.py"
FOUR = ("--minutes", "0.4", "--clients", "4", "--period", "2")


@pytest.mark.slow
@pytest.mark.parametrize("garbage", [0, 2])
def test_pages_are_answered(garbage: int) -> None:
    words = [*FOUR, "--garbage", str(garbage), "--port", str(free_port()), "--check"]
    done = subprocess.run([sys.executable, SCRIPT, *words], capture_output=True, check=False, text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stderr
