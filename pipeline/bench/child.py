"""Process of one part: measures the `pipeline` that it finds, and prints each figure as a line of JSON."""

from __future__ import annotations

import json
import os
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from pipeline.bench.clock import Setup
from pipeline.system.errors import first_line


def main(file: str, setup: str) -> None:
    """Run `measure` of a part's file; what it or a library prints goes to stderr."""
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    spec = spec_from_file_location("bench_part", Path(file))
    assert spec is not None
    assert spec.loader is not None
    part = module_from_spec(spec)
    sys.modules["bench_part"] = part
    try:
        spec.loader.exec_module(part)
        for name, value, floor in part.measure(Setup(**json.loads(setup))):
            why = {"why": value} if isinstance(value, str) else {}
            print(json.dumps({"name": name, "value": None if why else value, "floor": floor, **why}), file=out)
    except Exception as error:  # The reason stands in the table, whatever it is.
        print(json.dumps({"reason": f"{type(error).__name__}: {first_line(error)}"}), file=out)
