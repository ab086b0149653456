"""The protocol of the page: JSON texts over one socket, commands in, patches of the page out.

The browser sends a `Hello` first, then `Command`s and, where its address changes by hand, `Go`s. What comes back
are `Patch`es (elements by their id, as HTML), `Call`s of functions of the page, and the `Address` of what is shown.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, TypeAdapter, ValidationError

from pipeline.system.errors import InputError

LONGEST_ADDRESS = 4_000
LONGEST_COMMAND, LONGEST_DRAWING = 20_000, 500_000
"""Characters; a stroke of the pixel editor is a few tens of thousands."""
DRAWING = "px-"
"""Begins the commands of the pixel editor."""


@dataclass(frozen=True)
class Hello:
    """The first message: what the address says, who corrects labels in this browser, and what it likes.

    Attributes
    ----------
    address : str
        The query of the page's address, without "?".
    author : str
        The name that the browser has kept; "" for none.
    theme : str
        "dark" or "light" as the browser has kept it; "" for what the server was started with.
    """

    type: Literal["hello"]
    address: Annotated[str, Field(max_length=LONGEST_ADDRESS)] = ""
    author: Annotated[str, Field(max_length=LONGEST_ADDRESS)] = ""
    theme: Literal["", "dark", "light"] = ""


@dataclass(frozen=True)
class Command:
    """Something a person did: "name:argument", as an element's `do` says it."""

    type: Literal["command"]
    text: Annotated[str, Field(max_length=LONGEST_DRAWING)]


@dataclass(frozen=True)
class Go:
    """The address was changed by Back, Forward or by hand: look at what its query says."""

    type: Literal["go"]
    address: Annotated[str, Field(max_length=LONGEST_ADDRESS)]


Incoming: TypeAlias = "Hello | Command | Go"
_INCOMING: TypeAdapter[Incoming] = TypeAdapter(Annotated[Hello | Command | Go, Field(discriminator="type")])


@dataclass(frozen=True)
class Patch:
    """Elements to put in the place of those with the same ids.

    Attributes
    ----------
    parts : tuple of (str, str)
        (id, HTML).
    """

    parts: tuple[tuple[str, str], ...]
    type: Literal["patch"] = "patch"


@dataclass(frozen=True)
class Call:
    """A function of the page (`calls` of static/core.mjs) and its argument, which can be JSON."""

    name: str
    data: Any
    type: Literal["call"] = "call"


@dataclass(frozen=True)
class Address:
    """What the page's address and title say now.

    Attributes
    ----------
    query : str
        Without "?".
    title : str
    push : bool
        Whether Back leads to what was shown before.
    """

    query: str
    title: str
    push: bool
    type: Literal["address"] = "address"


@dataclass(frozen=True)
class Scene:
    """Whose scene the page's frame shows: its path."""

    path: str
    type: Literal["scene"] = "scene"


Outgoing: TypeAlias = "Patch | Call | Address | Scene"


def read(text: str | bytes) -> Incoming:
    """A message of the browser.

    Raises
    ------
    InputError
        For what is none.
    """
    try:
        message = _INCOMING.validate_json(text)
    except ValidationError as error:
        found = error.errors(include_url=False, include_context=False, include_input=False)[0]
        raise InputError("not a message of the page", got=f"{found['loc']}: {found['msg']}") from None
    if isinstance(message, Command) and len(message.text) > LONGEST_COMMAND and not message.text.startswith(DRAWING):
        raise InputError("not a message of the page", got=f"a command of {len(message.text)} characters")
    return message


def write(message: Outgoing) -> str:
    """A message to the browser."""
    return json.dumps(asdict(message), ensure_ascii=False, separators=(",", ":"))
