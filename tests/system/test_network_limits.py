"""Strange networks: what their files declare is measured, where weights lie is checked, what never ends is ended."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.system import LIMITS_VARIABLE, InputError, model_hash, open_session, run_session
from pipeline.system.onnx_contents import declared_tensors, weight_files
from pipeline.system.onnx_session import stopped_after

onnx: Any = pytest.importorskip("onnx")
FLOAT, BOOL, INT64 = onnx.TensorProto.FLOAT, onnx.TensorProto.BOOL, onnx.TensorProto.INT64


def written(path: Path, nodes: list, constants: list) -> Path:
    """A network from `x` (1,) to `out` in a file."""
    x, out = (onnx.helper.make_tensor_value_info(name, FLOAT, [1]) for name in ("x", "out"))
    graph = onnx.helper.make_graph(nodes, "g", [x], [out], constants)
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def constant(name: str, value: object, kind: type = np.float32) -> Any:
    return onnx.numpy_helper.from_array(np.array(value, kind), name)


def added(path: Path, tensor: Any) -> Path:
    """A network that adds a tensor."""
    return written(path, [onnx.helper.make_node("Add", ["x", tensor.name], ["out"])], [tensor])


def elsewhere(location: str) -> Any:
    tensor = onnx.TensorProto(name="w", data_type=FLOAT, dims=[1], data_location=onnx.TensorProto.EXTERNAL)
    tensor.external_data.add(key="location", value=location)
    return tensor


def refused(path: Path, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        open_session(path)
    message = str(caught.value)
    assert "\n" not in message
    assert not [word for word in words if word not in message], message


@pytest.mark.parametrize("dims", [[1 << 20, 1 << 20], [1 << 62, 1 << 62], [3 * 10**9]])
def test_a_tensor_that_cannot_be_is_refused_by_what_is_declared(tmp_path: Path, dims: list[int]) -> None:
    claimed = onnx.TensorProto(name="w", data_type=FLOAT, dims=dims, raw_data=b"1234")
    refused(added(tmp_path / "a.onnx", claimed), "x".join(map(str, dims)), "--limits tensor=")
    inside = onnx.helper.make_node("Constant", [], ["w"], value=claimed)
    add = onnx.helper.make_node("Add", ["x", "w"], ["out"])
    refused(written(tmp_path / "b.onnx", [inside, add], []), "--limits tensor=")


def test_weights_lie_beside_the_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "net"
    folder.mkdir()
    (tmp_path / "secret").write_bytes(np.float32(7).tobytes())
    for location in ("../secret", "../../../../../../etc/passwd", "/etc/passwd"):
        refused(added(folder / "a.onnx", elsewhere(location)), "outside the network's folder", location)
    (folder / "w.bin").symlink_to(tmp_path / "secret")
    path = added(folder / "a.onnx", elsewhere("w.bin"))
    refused(path, "outside the network's folder", "--limits links=1")
    (folder / "w.bin").unlink()
    (folder / "w.bin").write_bytes(np.float32(7).tobytes())
    assert run_session(open_session(path), ["out"], {"x": np.ones(1)}, path)[0] == 8
    assert weight_files(path) == ["w.bin"]
    assert "+" in model_hash(path)
    monkeypatch.setenv(LIMITS_VARIABLE, "model=3")
    refused(path, "too large", "--limits model=")


def test_every_tensor_of_a_file_is_found(tmp_path: Path) -> None:
    branch = onnx.helper.make_graph(
        [onnx.helper.make_node("Identity", ["k"], ["y"])],
        "b",
        [],
        [onnx.helper.make_tensor_value_info("y", FLOAT, [3])],
        [constant("k", [1, 2, 3])],
    )
    nodes = [
        onnx.helper.make_node("If", ["yes"], ["z"], then_branch=branch, else_branch=branch),
        onnx.helper.make_node("Constant", [], ["c"], value=constant("c", np.zeros((4, 5)), np.float64)),
        onnx.helper.make_node("ReduceSum", ["z"], ["out"], keepdims=1),
    ]
    path = written(tmp_path / "a.onnx", nodes, [constant("yes", True, np.bool_)])
    assert sorted((t.dims, t.bytes) for t in declared_tensors(path)) == [((), 1), ((3,), 12), ((3,), 12), ((4, 5), 160)]
    data = path.read_bytes()
    for cut in range(0, len(data), 7):  # Whatever is cut off, nothing is raised.
        path.write_bytes(data[:cut])
        list(declared_tensors(path))
    rng = np.random.default_rng(0)
    path.write_bytes(rng.bytes(4000))
    list(declared_tensors(path))


def test_a_network_that_never_ends_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = [
        onnx.helper.make_tensor_value_info(n, k, s)
        for n, k, s in (("i", INT64, []), ("c", BOOL, []), ("v", FLOAT, [1]))
    ]
    results = [onnx.helper.make_tensor_value_info(n, k, s) for n, k, s in (("d", BOOL, []), ("w", FLOAT, [1]))]
    nodes = [onnx.helper.make_node("Identity", ["c"], ["d"]), onnx.helper.make_node("Add", ["v", "v"], ["w"])]
    loop = onnx.helper.make_node(
        "Loop", ["n", "yes", "x"], ["out"], body=onnx.helper.make_graph(nodes, "b", values, results)
    )
    constants = [constant("n", 1 << 62, np.int64), constant("yes", True, np.bool_)]
    path = written(tmp_path / "loop.onnx", [loop], constants)
    session = open_session(path)
    monkeypatch.setenv(LIMITS_VARIABLE, "seconds=1")
    began = time.monotonic()
    with pytest.raises(InputError, match=r"does not come to an end; got more than 1 seconds.*--limits seconds=10"):
        run_session(session, ["out"], {"x": np.ones(1)}, path)
    assert time.monotonic() - began < 10
    fine = added(tmp_path / "fine.onnx", constant("w", 1))
    assert run_session(open_session(fine), ["out"], {"x": np.ones(1)}, fine)[0] == 2


def test_what_networks_compute_has_a_limit_of_memory(tmp_path: Path) -> None:
    fill = onnx.helper.make_node("ConstantOfShape", ["n"], ["k"], value=constant("f", [1]))
    nodes = [
        fill,
        onnx.helper.make_node("ReduceSum", ["k"], ["s"], keepdims=0),
        onnx.helper.make_node("Add", ["x", "s"], ["out"]),
    ]
    path = written(tmp_path / "wide.onnx", nodes, [constant("n", [10**10], np.int64)])
    session = open_session(path)
    with pytest.raises(InputError, match=r"cannot be run.*--limits memory="):
        run_session(session, ["out"], {"x": np.ones(1)}, path)


def test_only_what_takes_too_long_is_stopped() -> None:
    stops: list[str] = []
    with (
        stopped_after(0.15, lambda: stops.append("slow")) as slow,
        stopped_after(60, lambda: stops.append("fast")) as fast,
    ):
        for _ in range(40):
            time.sleep(0.05)
            if stops:
                break
    assert slow.stopped
    assert not fast.stopped
    assert set(stops) == {"slow"}
