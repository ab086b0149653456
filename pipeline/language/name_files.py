"""JSON files of names that people write: synonyms, kinds and names often confused."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from pipeline.language.name_forms import normal_form


def _named(name: str) -> str:
    if not normal_form(name):
        raise ValueError("a name without letters")
    return name


Name = Annotated[str, AfterValidator(_named)]
Group = Annotated[list[Name], Field(min_length=2)]


class NameFile(BaseModel):
    """A JSON file of names; `docs/names.md` describes the keys."""

    model_config = ConfigDict(extra="forbid")

    groups: list[Group] = []
    near: list[Group] = []
    exceptions: list[Name] = []
    names: list[Name] = []
    kinds: dict[Name, list[Name]] = {}
    about: Any = None
    source: Any = None
    licence: Any = None
