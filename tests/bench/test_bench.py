"""Claims of speed are saved, compared and told as they were measured; a part that fails costs only itself."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.bench import BenchRun, SpeedClaim, run_bench
from pipeline.bench.claims import CLAIMS, declared, read_bench
from pipeline.bench.running import PARTS, TREE
from pipeline.bench.table import markdown, renewed, shown, table_head, table_rows
from pipeline.bench.worlds import crowded_frame, demo_frames, pictures
from pipeline.datasets import open_dataset
from pipeline.system import InputError

MACHINE = {
    **dict.fromkeys(("processor", "os", "python", "numpy", "cv2", "onnxruntime", "version", "commit"), "x"),
    "date": "2026-11-27",
    "cores": 2,
    "ram_gb": 8.0,
}
SOME = replace(CLAIMS[0], value=30.0, floor=15.0)


def part(folder: Path, text: str) -> Path:
    file = folder / "part.py"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("promise", "value", "floor", "kept"),
    [
        ("ratio <= 2.5", 30.0, 15.0, "yes"),
        ("ratio <= 2.5", 40.0, 15.0, "no"),
        ("ratio >= 60", 60.0, 1.0, "yes"),
        ("ratio <= 2.5", 40.0, None, "not measured"),
        ("value <= 20", 21.0, None, "no"),
        ("extra <= 150", 240.0, 100.0, "yes"),
        ("", 240.0, 100.0, ""),
        ("value <= 20", None, None, "not measured"),
    ],
)
def test_a_promise_is_of_the_ratio_the_value_or_what_it_adds(
    promise: str, value: float | None, floor: float | None, kept: str
) -> None:
    assert SpeedClaim("a.b", "what", "ms", "beside", promise, value, floor).kept == kept


def test_a_run_is_read_as_it_was_written(tmp_path: Path) -> None:
    run = BenchRun(MACHINE, (SOME, replace(CLAIMS[1], reason="why")), True, BenchRun(MACHINE, (SOME,)))
    run.write(tmp_path / "run.json")
    assert read_bench(tmp_path / "run.json") == run
    assert json.loads((tmp_path / "run.json").read_text())["claims"][0]["ratio"] == 2
    for text in ("{}", "[]", '{"machine": {}, "quick": true, "claims": [{"name": "a"}]}', "{"):
        (tmp_path / "no.json").write_text(text)
        with pytest.raises(InputError):
            read_bench(tmp_path / "no.json")


def test_claims_are_of_parts_that_there_are() -> None:
    assert len({c.name for c in CLAIMS}) == len(CLAIMS)
    assert {c.name.partition(".")[0] for c in CLAIMS} == {*PARTS, "page"}
    assert all(file.is_file() for file in PARTS.values())
    given = re.findall(r'yield "(\w+\.\w+)"', "".join(file.read_text() for file in PARTS.values()))
    assert set(given) <= {c.name for c in CLAIMS}
    assert [c.name for c in declared(("docs.doctor", "label.packed"))] == ["label.packed", "docs.doctor"]
    with pytest.raises(InputError, match=r"label\.packed"):
        declared(("nothing",))


def test_a_part_is_measured_by_itself_and_its_failure_is_told(tmp_path: Path) -> None:
    told: list[str] = []
    file = part(
        tmp_path,
        "import pipeline\nprint('noise')\n\ndef measure(setup):\n    print(pipeline.__file__)\n"
        "    yield 'page.cloud', 2.0, 4.0\n    yield 'page.label', 'for a reason', None\n    raise OSError('gone')\n",
    )
    run = run_bench(("page",), further={"page": file}, before=TREE, progress=told.append)
    for measured in (run, run.before):
        assert measured is not None
        found = {c.name: c for c in measured.claims}
        assert found["page.cloud"].ratio == 0.5
        assert found["page.cloud"].kept == "yes"
        assert found["page.label"].reason == "for a reason"
        assert found["page.frame"].reason == "OSError: gone"
    assert "page before" in told
    assert "page not measured: OSError: gone" in told


def test_a_tree_is_measured_with_its_own_modules(tmp_path: Path) -> None:
    other = tmp_path / "other"
    for name, text in (("pipeline", "SPEED = 3.0"), ("pipeline/system", ""), ("pipeline/bench", "SPEED = 4.0")):
        (other / name).mkdir(parents=True)
        (other / name / "__init__.py").write_text(text)
    for name in ("lazy_exports", "errors"):
        shutil.copy(TREE / "pipeline" / "system" / f"{name}.py", other / "pipeline" / "system")
    file = part(
        tmp_path,
        "import pipeline\n\ndef measure(setup):\n    yield 'page.cloud', getattr(pipeline, 'SPEED', 1.0), None\n",
    )
    run = run_bench(("page.cloud",), further={"page": file}, before=other)
    assert run.before is not None
    assert (run.claims[0].value, run.before.claims[0].value) == (1.0, 3.0)
    with pytest.raises(InputError, match="no checkout"):
        run_bench(("page.cloud",), before=tmp_path)


def test_what_is_measured_is_kept_when_the_user_stops(tmp_path: Path) -> None:
    def stop(step: str) -> None:
        if step.startswith("page.cloud"):
            raise KeyboardInterrupt

    file = part(
        tmp_path,
        "import time\n\ndef measure(setup):\n    yield 'page.cloud', 2.0, 4.0\n    time.sleep(600)\n",
    )
    run = run_bench(("page",), further={"page": file}, progress=stop)
    assert run.claim("page.cloud") is not None
    assert {c.name: c.value for c in run.claims}["page.cloud"] == 2.0
    assert {c.reason for c in run.claims if c.value is None} == {"stopped"}


def test_documents_take_their_figures_from_a_run() -> None:
    run = BenchRun(MACHINE, (SOME,), before=BenchRun(MACHINE, (replace(SOME, value=90.0),)))
    text = "It is 9<!-- bench: label.packed ratio --> times.\n<!-- bench: table -->\nold\n<!-- bench: end -->\n"
    new = renewed(text, run)
    assert new.startswith("It is 2<!-- bench: label.packed ratio --> times.")
    assert markdown(run) in new
    assert "old" not in new
    assert renewed(new, run) == new
    worked_out = "9<!-- bench: label.packed value / 3.6 + 1 * 100 -->, 9<!-- bench: label.packed ratio - 0.5 -->"
    assert re.sub(r"<.*?>", "", renewed(worked_out, run)) == "933, 1.5"
    with pytest.raises(InputError, match=r"label\.written"):
        renewed("9<!-- bench: label.written value -->", run)
    assert len(table_head(run)) == len(table_rows(run)[0])
    assert table_rows(run)[0][-2:] == ("90 ms", "6")
    assert shown(0.0123456) == "0.0123"


def test_worlds_have_what_they_are_asked_for(tmp_path: Path) -> None:
    many = open_dataset(str(demo_frames(tmp_path / "many", 3)))
    assert [len(many.load(f).annotations) for f in many.frame_ids] == [29, 29, 29]
    assert len(pictures(tmp_path / "many")) == 3 * 31
    written = open_dataset(str(demo_frames(tmp_path / "written", 1, written=True)))
    a, b = many.load(many.frame_ids[0]).annotations, written.load(written.frame_ids[0]).annotations
    assert all((x.mask == y.mask).all() for x, y in zip(a, b, strict=True))
    crowd = open_dataset(str(crowded_frame(tmp_path / "crowd", 300)))
    assert len(crowd.load(crowd.frame_ids[0]).annotations) == 300
