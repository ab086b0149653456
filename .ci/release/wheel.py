"""Check that a wheel holds what is under version control: `git ls-files pipeline spatialviz | wheel.py WHEEL`."""

import sys
from pathlib import Path
from zipfile import ZipFile

MOST = 12 * 10**6
OWN = ("pipeline/", "spatialviz/")
BUNDLED = "pipeline/assets/"  # from assets/, of which the card's pictures and the tests' files stay outside

wheel = Path(sys.argv[1])
names = {name for name in ZipFile(wheel).namelist() if not name.endswith("/")}
kept = set(sys.stdin.read().split())
code = {name for name in names if name.startswith(OWN) and not name.startswith(BUNDLED)}
faults = [f"not in the wheel: {name}" for name in sorted(kept - code)]
faults += [f"in the wheel, and not under version control: {name}" for name in sorted(code - kept)]
outside = {name for name in names - code if not name.startswith(BUNDLED) and ".dist-info/" not in name}
faults += [f"in the wheel, and no part of the program: {name}" for name in sorted(outside)]
size = wheel.stat().st_size
faults += [f"{size} bytes, more than {MOST}"] * (size > MOST)
sys.exit("\n".join(faults) or print(f"{wheel.name}: {size / 10**6:.1f} MB, {len(names)} files"))
