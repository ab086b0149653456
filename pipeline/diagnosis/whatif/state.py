"""View state as a single string: paste it back for the same view.

"sv1:" and then URL-safe base64 of a zlib stream of canonical JSON (keys sorted,
no white space). zlib's own check sum finds damage; what the JSON may hold is
checked by a model, and how much of it there may be is bounded before it is read.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any

from pydantic import ConfigDict, Field

from pipeline.diagnosis.whatif.edits import Edits, edits_record, validated
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.frozen import dataclass

VERSION = 1
LONGEST_STRING = 2 * 2**20
"""Characters."""
LARGEST_CONTENT = 16 * 2**20
"""Bytes of JSON; a small string can be made to unpack to any amount."""

Text = Annotated[str, Field(max_length=4096)]
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
Vector = tuple[Number, Number, Number]
Toggle = bool | int | float | Text


@dataclass(frozen=True)
class CameraView:
    """Camera of the page, in the frame's camera frame, metres; `up` is a direction."""

    position: Vector  # Metres
    look_at: Vector  # Point that is looked at, metres
    up: Vector  # Direction


@dataclass(frozen=True)
class ViewState:
    """State of a view."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    dataset: Text  # Its name on the page
    frame: Text  # Frame id
    expression: Text = ""  # Question as it was typed
    # Keys of the selected objects (`pipeline.diagnosis.whatif.pair_tables`)
    selection: Annotated[tuple[Text, ...], Field(max_length=2000)] = ()
    pair: tuple[Text, Text] | None = None  # Keys of the pair that is shown; None for the winner
    camera: CameraView | None = None  # Where the scene is seen from
    # What is shown and how
    toggles: Annotated[Mapping[Text, Toggle], Field(max_length=200)] = field(default_factory=dict)
    edits: Edits = field(default_factory=Edits)  # Edits of a what-if
    run: Text | None = None  # Folder of the evaluation run that the expression is of
    expression_id: Text | None = None  # In that run
    colors: Text | None = None  # What the points are coloured by


def state_record(state: ViewState) -> dict[str, Any]:
    """JSON object of a view, without defaults."""
    camera = state.camera
    record: dict[str, Any] = {
        "dataset": state.dataset,
        "frame": state.frame,
        "expression": state.expression or None,
        "selection": list(state.selection),
        "pair": None if state.pair is None else list(state.pair),
        "camera": None
        if camera is None
        else {"position": list(camera.position), "look_at": list(camera.look_at), "up": list(camera.up)},
        "toggles": dict(state.toggles),
        "edits": edits_record(state.edits) if state.edits else None,
        "run": state.run,
        "expression_id": state.expression_id,
        "colors": state.colors,
    }
    return {name: value for name, value in record.items() if value is not None and value != {} and value != []}


def read_state(record: dict[str, Any] | str | bytes) -> ViewState:
    """View from a JSON object; InputError for anything else."""
    return validated(ViewState, record, "the state")


def encode(state: ViewState) -> str:
    """String of a view; equal views give equal strings.

    Raises
    ------
    InputError
        The view holds what no string can: a number that is not finite, or more than the size limit.

    >>> decode(encode(ViewState("demo", "0/0", "mug left of the laptop"))).expression
    'mug left of the laptop'
    """
    record = state_record(state)
    read_state(record)
    content = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")
    packed = base64.urlsafe_b64encode(zlib.compress(content, 9)).rstrip(b"=").decode("ascii")
    require(
        len(content) <= LARGEST_CONTENT and len(packed) <= LONGEST_STRING,
        "the view is too large for a string",
        cause="many repainted masks?",
    )
    return f"sv{VERSION}:{packed}"


def decode(text: str) -> ViewState:
    """View of a string; line breaks and blanks are ignored.

    Raises
    ------
    InputError
        It is no such string, one of a newer version, cut off, damaged, or too large.
    """
    require(len(text) <= LONGEST_STRING + 64, "the state string is too long", got=f"{len(text)} characters")
    text = re.sub(r"\s+", "", text)
    head = re.match(r"sv([0-9]{1,6}):", text)
    if head is None:
        raise InputError("this is no state string", got=repr(text[:24]), expected="sv1:...")
    if int(head[1]) != VERSION:
        cause = "it was made by a newer spatialviz" if int(head[1]) > VERSION else None
        raise InputError("the state string is of another version", got=f"sv{head[1]}", expected="sv1", cause=cause)
    body = text[head.end() :]
    damaged = "the state string is damaged"
    with as_input_error(damaged, ValueError, zlib.error, got=str, cause="was all of it copied?"):
        packed = base64.b64decode(body + "=" * (-len(body) % 4), altchars=b"-_", validate=True)
        unpacker = zlib.decompressobj()
        content = unpacker.decompress(packed, LARGEST_CONTENT + 1)
    require(
        len(content) <= LARGEST_CONTENT,
        "the state string unpacks to too much",
        expected=f"at most {LARGEST_CONTENT} bytes",
    )
    require(
        unpacker.eof and not unpacker.unused_data,
        damaged,
        cause="was all of it copied, and nothing more?",
    )
    return read_state(content)
