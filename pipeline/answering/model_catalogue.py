"""Catalogue of usable networks: contracts of the adapters, public and installed files; and identification of a file."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from pipeline.datasets.depth.contract import OPTION as DEPTH_OPTION
from pipeline.datasets.depth.contract import known_contract, network_names, recognised
from pipeline.proposals.box_detector import find_box_model
from pipeline.proposals.class_names import metadata_names
from pipeline.proposals.contracts import DETECTORS, DetectorContract, TensorSpec, declared
from pipeline.proposals.detic import find_names
from pipeline.proposals.grounding_dino import TOKENIZERS
from pipeline.proposals.mismatch import BOXES, SEGMENTERS, FileKind, recognise
from pipeline.proposals.network import find_tokenizer
from pipeline.relations.model import installed_networks
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.model_files import (
    HubId,
    KnownModel,
    all_fetched,
    fetched,
    known_models,
    parse_hub_id,
    refuse_address,
)
from pipeline.system.onnx_session import open_session

BOXES_CONTRACT = DetectorContract(
    BOXES,
    "any detector of boxes with one picture as its input, described in a TOML file",
    (TensorSpec("one input", "float32", (1, 3, "H", "W")),),
    (),
)


def depth_contracts() -> tuple[DetectorContract, ...]:
    """Contracts of the depth networks, by their TOML files."""
    return tuple(_depth_contract(name) for name in network_names())


def _depth_contract(name: str) -> DetectorContract:
    given, output = (known := known_contract(name)).input, known.output
    named = ((output.depth, ("H", "W")), (output.points, ("H", "W", 3)), (output.mask, ("H", "W")))
    maps = tuple(TensorSpec(n, "float32", (1, *shape)) for n, shape in (*named, (output.sky, ("H", "W"))) if n)
    numbers = tuple(TensorSpec(n, "float32", (1,)) for n in (output.focal, next(iter(output.scale), None)) if n)
    picture = TensorSpec(given.name or "", "float32", (1, 3, *(given.size or ("H", "W"))))
    inputs = (picture, *(TensorSpec(n, "int64", ()) for n in given.constants))
    focal = "gives the focal length too" if known.gives_focal else "is told the focal length"
    return DetectorContract(f"{DEPTH_OPTION} {name}", f"depth estimated of colour; {focal}", inputs, (*maps, *numbers))


@dataclass(frozen=True)
class Adapter:
    """Option reading a network."""

    option: str  # "--detector grounding-dino"
    contracts: tuple[DetectorContract, ...]  # Any of them, or an encoder and a decoder of them
    known: tuple[KnownModel, ...]
    needs: str | None  # The extra that is missing here, if one is


@dataclass(frozen=True)
class FileReport:
    """Identification of a model file."""

    path: Path
    megabytes: float | None  # In 10**6 bytes
    inputs: tuple[TensorSpec, ...] = ()
    outputs: tuple[TensorSpec, ...] = ()
    kind: FileKind | None = None  # None where nothing here knows it
    missing: tuple[str, ...] = ()  # What must stand beside it and does not
    class_names: tuple[str, ...] = ()  # Those in its metadata, in the order of its outputs
    problem: str | None = None  # Why it cannot be opened


@dataclass(frozen=True)
class Inventory:
    """Inventory of this machine."""

    version: str  # Of ONNX Runtime
    providers: tuple[str, ...]  # What it was built with
    fetched: tuple[tuple[str, Path], ...]  # Models from the hub, by their ids
    networks: tuple[tuple[str, Path], ...]  # Relation networks that were installed, by name


def adapters() -> tuple[Adapter, ...]:
    """Options reading networks."""
    contracts = (*DETECTORS, BOXES_CONTRACT, *SEGMENTERS, *depth_contracts())
    options = dict.fromkeys(c.option for c in contracts)
    text = {c.option for c in contracts if any(s.name == "input_ids" for s in c.inputs)}
    lacks = "hub" if find_spec("tokenizers") is None else None
    return tuple(
        Adapter(
            option,
            tuple(c for c in contracts if c.option == option),
            tuple(m for m in known_models() if m.option == option),
            lacks if option in text else None,
        )
        for option in options
    )


def is_fetched(model: KnownModel) -> bool:
    """True for a public model fetched by its id."""
    return any(
        fetched(HubId(model.repo, f.file, model.revision)) is not None
        for f in model.files
        if model.repo is not None and f.file.endswith(".onnx")
    )


def take_inventory() -> Inventory:
    """Take the inventory of this machine."""
    import onnxruntime as ort

    return Inventory(
        ort.__version__,
        tuple(ort.get_available_providers()),
        tuple((str(hub_id), path) for hub_id, path in all_fetched()),
        tuple((n.stem, n) for n in installed_networks()),
    )


def describe_file(path: Path) -> FileReport:
    """Identify an ONNX file; an unreadable file is described by its problem.

    A file of the hub may be named by its id if fetched before: nothing is fetched here.
    """
    hub_id = parse_hub_id(path)
    try:
        if hub_id is None:
            refuse_address(path)
        elif (found := fetched(hub_id)) is not None:
            path = found
        else:
            raise InputError(
                "there is no such file, nor one of this id that was fetched",
                expected="a path; a file of the hub is fetched by the first --model or --segmenter-model that names it",
            )
    except InputError as error:
        return FileReport(path, None, problem=str(error))
    megabytes = path.stat().st_size / 1e6 if path.is_file() else None
    try:
        session = open_session(path)
    except InputError as error:
        return FileReport(path, megabytes, problem=str(error))
    depth = recognised(session)
    kind = recognise(session) if depth is None else FileKind(f"the depth model {depth}", (f"{DEPTH_OPTION} {depth}",))
    names = metadata_names(session) or ()
    return FileReport(
        path,
        megabytes,
        declared(session.get_inputs()),
        declared(session.get_outputs()),
        kind,
        () if kind is None else _missing(path, kind, names),
        names,
    )


def _missing(path: Path, kind: FileKind, names: tuple[str, ...]) -> tuple[str, ...]:
    wanted = []
    for option in kind.options:
        try:
            _need_companions(path, option, names)
        except InputError as error:
            wanted.append(str(error).removesuffix(f" [{path}]"))
    return tuple(dict.fromkeys(wanted))


def _need_companions(path: Path, option: str, names: tuple[str, ...]) -> None:
    """Find the companion files of an option; raises as the option itself would."""
    require(
        not (option == "--detector yolo-seg" and not names),
        "its metadata hold no class names: --model-config FILE gives them",
    )
    finders: dict[str, Callable[[], object]] = {
        "--detector grounding-dino": lambda: find_tokenizer(path, TOKENIZERS),
        "--detector owlv2": lambda: find_tokenizer(path),
        "--detector owlvit": lambda: find_tokenizer(path),
        "--detector detic": lambda: names or find_names(path),
        BOXES: lambda: find_box_model(path),
    }
    finders.get(option, lambda: None)()
