"""Contracts of depth networks in TOML: known networks, and recognition of a model file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from pipeline.geometry.picture_input import ContractTable, PictureInput, Side, read_description
from pipeline.system.errors import InputError, needed
from pipeline.system.frozen import dataclass
from pipeline.system.model_files import known_models, parse_hub_id, resolve_model
from pipeline.system.onnx_session import open_session, signature

OPTION = "--depth-model"
CONTRACTS = Path(__file__).with_name("contracts")
"""A TOML file for each network that is known; its name is the network's."""
RELATIVE = "its depth is relative: it has no metres, and nothing may be measured by it"
REFUSED = {
    "unidepth": "its weights are CC BY-NC 4.0, not for commercial use",
    "vggt": RELATIVE,
    "midas": RELATIVE,
    "dpt-large": RELATIVE,
    "dpt_large": RELATIVE,
    "da3mono": RELATIVE,
}
"""What is in the name of a network that is not used, and why."""


class DepthInput(PictureInput):
    """Input of the picture; a side fixed by neither model nor `size` follows the picture."""

    shortest: Side | None = None
    """The shorter side is made so long."""
    longest: Side | None = None
    """The longer side is made at most so long."""
    multiple: Annotated[int, Field(ge=1, le=256)] = 1
    """Sides are rounded to multiples of this."""
    constants: dict[str, float] = Field(default={})
    """More inputs, each one number; one that the model does not have is left out."""


class DepthOutput(ContractTable):
    """Outputs, and the way to metres: none, `canonical_focal`, `focal`, or `scale` with `points`."""

    depth: str | None = None
    """Depth along the camera's z axis."""
    points: str | None = None
    """Camera-frame points (H, W, 3), x right, y down, z forward, whose z lacks a shift that is found from them."""
    scale: tuple[str, ...] = ()
    """Metres of the points' unit; of several names the one that the model has."""
    canonical_focal: Annotated[float, Field(gt=0)] | None = None
    """The depth is that of a camera of this focal length, pixels of the input: metres are depth * focal length / it."""
    focal: str | None = None
    """The network's own focal length, pixels of the input's width, for which the depth is metres."""
    mask: str | None = None
    """Where there is depth: above a half."""
    sky: str | None = None
    """Where there is none: at least a half."""

    @model_validator(mode="after")
    def _of_one_form(self) -> DepthOutput:
        if (self.depth is None) == (self.points is None):
            raise ValueError("the output is either `depth` or `points`")
        if self.points is not None and not self.scale:
            raise ValueError("`points` need `scale`: without it they have no metres")
        if sum((self.points is not None, self.canonical_focal is not None, self.focal is not None)) > 1:
            raise ValueError("`points`, `canonical_focal` and `focal` are three ways to metres")
        return self


class DepthContract(ContractTable):
    """The whole of the file."""

    input: DepthInput = DepthInput()
    """How the picture is given to the network."""
    output: DepthOutput
    """What its outputs hold, and how they become metres."""
    recognised_by: tuple[str, ...] = ()
    """Outputs that tell a file of this network from all others; none where others have the same."""

    @property
    def gives_focal(self) -> bool:
        """Test whether the network estimates the focal length."""
        return self.output.points is not None or self.output.focal is not None


@dataclass(frozen=True)
class NamedContract:
    """A network by name: model file, contract, and the TOML file for errors."""

    name: str
    path: Path
    contract: DepthContract
    described: Path


def network_names() -> tuple[str, ...]:
    """Names of the known depth networks."""
    return tuple(sorted(path.stem for path in CONTRACTS.glob("*.toml")))


@lru_cache(maxsize=16)
def known_contract(name: str) -> DepthContract:
    """Contract of a known depth network."""
    return read_contract(CONTRACTS / f"{name}.toml")


def read_contract(path: Path) -> DepthContract:
    """Read a network's TOML file; InputError for an unknown, missing or wrong key."""
    return read_description(path, DepthContract, "depth model")


def find_network(given: str) -> NamedContract:
    """Find a depth network from NAME, NAME=FILE, FILE or a model hub id, fetched if needed."""
    asked = (given if parse_hub_id(given) else Path(given).name).lower()
    for part, why in REFUSED.items():
        if part in asked:
            raise InputError(f"the depth model {given} is not used: {why}", expected=_known())
    name, sign, file = given.partition("=")
    if name in network_names():
        path = resolve_model(file) if sign else _fetched(name)
        return NamedContract(name, path, known_contract(name), CONTRACTS / f"{name}.toml")
    if sign:
        raise InputError("there is no such depth model", got=repr(name), expected=_known())
    hub_id = parse_hub_id(given)
    if hub_id is None and not Path(given).exists() and Path(given).suffix == "":
        raise InputError("there is no such depth model", got=repr(given), expected=_known())
    path = resolve_model(given)
    own = path.with_suffix(".toml")
    if own.is_file():
        return NamedContract(path.stem, path, read_contract(own), own)
    repo = None if hub_id is None else hub_id.repo
    public = next((n for n in network_names() if repo is not None and _public(n).repo == repo), None)
    session = open_session(path)
    name = needed(
        public or recognised(session),
        "nothing says how this depth model's output becomes metres",
        got=signature(session)[:240],
        expected=f"{OPTION} NAME=FILE.onnx of {', '.join(network_names())}, or {path.stem}.toml beside it",
        cause=f"networks of relative depth have the same tensors; examples are in {CONTRACTS}",
        path=path,
    )
    return NamedContract(name, path, known_contract(name), CONTRACTS / f"{name}.toml")


def _known() -> str:
    return f"NAME, NAME=FILE.onnx or FILE.onnx with FILE.toml beside it; NAME is {', '.join(network_names())}"


def _public(name: str) -> Any:
    """The public file of a network."""
    return next(model for model in known_models() if model.option == f"{OPTION} {name}")


def _fetched(name: str) -> Path:
    public = _public(name)
    if public.repo is None:
        raise InputError(
            f"{name} is not on the model hub", expected=f"{OPTION} {name}=FILE.onnx", cause=public.files[0].file
        )
    return resolve_model(public.repo)


def recognised(session: Any) -> str | None:
    """Known network with outputs unlike any other network's."""
    outputs = {o.name for o in session.get_outputs()}
    found = (n for n in network_names() if (by := known_contract(n).recognised_by) and outputs.issuperset(by))
    return next(found, None)
