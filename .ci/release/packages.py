"""Packages that an install brings: size, licence, and who asked for them; run by the Python of that environment.

    python packages.py [REQUIREMENT]            # the table of docs/install.md; status 1 for what must not be released
    python packages.py "spatialviz[dev]" --lock # name==version of each, as a constraints file for pip

What must not be released: GPL or AGPL, a package of more than 20 MB without a reason, an install above the limit.
LGPL is allowed, and told: libraries under it are separate files that can be replaced.
"""

from __future__ import annotations

import argparse
import importlib.metadata as metadata
import platform
import re
import sys
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

MB = 10**6
MOST, LARGE = 850 * MB, 20 * MB
WHY = {
    "duckdb": "questions in SQL, counts over Parquet",
    "numpy": "every array",
    "onnxruntime": "runs every network: relations, boxes, detectors, depth",
    "opencv-python-headless": "decodes pictures, finds contours, warps, draws; without a window system",
    "pillow": "headers and EXIF of pictures, resizing exactly as the detectors were trained with; viser needs it too",
    "pyarrow": "labels, runs and tables are Parquet files",
    "scipy": "assignment, k-d trees, maximum flow, least squares, `.mat` files",
    "sympy": "older ONNX Runtimes, of Python 3.10 alone, need it",
    "spatialviz": "the program with its demo dataset, demo run, and two small networks",
    "zstandard": "viser compresses its messages with it",
}
LGPL_LIBRARIES = {"avcodec": "FFmpeg", "avformat": "FFmpeg", "quadmath": "libquadmath"}
GPL_LIBRARIES = {"postproc", "x264", "x265", "xvidcore", "readline", "fftw3"}


def tree(root: Requirement) -> dict[str, set[str]]:
    """Names of the packages that a requirement brings, each with those that ask for it."""
    asked: dict[str, set[str]] = {}
    seen: set[tuple[str, str]] = set()
    waiting = [(root, "")]
    while waiting:
        requirement, by = waiting.pop()
        name = canonicalize_name(requirement.name)
        asked.setdefault(name, set()).update({by} - {"", name})
        for extra in ("", *requirement.extras):
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            for text in metadata.requires(name) or ():
                needed = Requirement(text)
                if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                    waiting.append((needed, name))
    return asked


def size_of(distribution: metadata.Distribution) -> int:
    """Bytes of its files, compiled ones too."""
    paths = (Path(str(distribution.locate_file(file))) for file in distribution.files or ())
    return sum(path.stat().st_size for path in paths if path.is_file())


def licence_of(distribution: metadata.Distribution) -> str:
    """Licence as declared: the expression, the classifiers, or the first line of the text."""
    found = distribution.metadata
    classified = [
        c.split(" :: ")[-1] for c in found.get_all("Classifier") or () if c.startswith("License :: OSI Approved ::")
    ]
    text = (found.get("License") or "").strip().partition("\n")[0]
    return found.get("License-Expression") or " AND ".join(classified) or text or "not declared"


def is_gpl(licence: str) -> bool:
    """True unless one of the licences to choose from is neither GPL nor AGPL."""
    copyleft = re.compile(r"(?<!L)\bA?GPL|(?<!Lesser )\bGeneral Public License|Affero", re.IGNORECASE)
    return all(copyleft.search(choice) for choice in re.split(r"\bOR\b", licence))


def libraries_of(distribution: metadata.Distribution) -> set[str]:
    """Bare names of the shared libraries that its wheel carries along, such as "avcodec"."""
    names = (file.name for file in distribution.files or () if file.parent.name.endswith((".libs", ".dylibs")))
    return {found[1] for name in names if (found := re.match(r"(?:lib)?([a-zA-Z]+\d*?)(?:p-r\d+)?[-.]", name))}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("requirement", nargs="?", default="spatialviz", type=Requirement)
    parser.add_argument("--lock", action="store_true")
    options = parser.parse_args()
    asked = tree(options.requirement)
    found = {name: metadata.distribution(name) for name in asked}
    if options.lock:
        system = f"Python {platform.python_version()}, {sys.platform} {platform.machine()}"
        print(f"# Versions of {options.requirement}, {system}.")
        print(f'# Renewed by: python .ci/release/packages.py "{options.requirement}" --lock > FILE')
        # A local part names a build, such as that of torch without CUDA, which no index of packages has.
        lines = (f"{name}=={one.version.partition('+')[0]}" for name, one in found.items() if name != "spatialviz")
        print("\n".join(sorted(lines)))
        return 0
    sizes = {name: size_of(one) for name, one in found.items()}
    faults = []
    print("| package | MB | licence | asked for by | why, above 20 MB |\n|---|--:|---|---|---|")
    for name in sorted(found, key=lambda name: -sizes[name]):
        one, licence, carried = found[name], licence_of(found[name]), libraries_of(found[name])
        lesser = sorted({LGPL_LIBRARIES[library] for library in carried & LGPL_LIBRARIES.keys()})
        told = licence + (f"; carries {', '.join(lesser)} (LGPL)" if lesser else "")
        large = sizes[name] > LARGE
        row = (f"{name} {one.version}", f"{sizes[name] / MB:.1f}", told, ", ".join(sorted(asked[name])))
        print("| " + " | ".join((*row, WHY.get(name, "") if large else "")) + " |")
        faults += [f"{name} is under {licence}"] * is_gpl(licence)
        faults += [f"{name} carries {library}, under the GPL" for library in sorted(carried & GPL_LIBRARIES)]
        faults += [f"{name} takes {sizes[name] / MB:.0f} MB without a reason in {__file__}"] * (
            large and name not in WHY
        )
    total = sum(sizes.values())
    print(f"\n{total / MB:.0f} MB in {len(found)} packages, Python {platform.python_version()}")
    faults += [f"{total / MB:.0f} MB in all, more than {MOST // MB}"] * (total > MOST)
    for fault in faults:
        print(f"not to be released: {fault}", file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
