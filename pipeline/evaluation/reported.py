"""Figures that others published, as rows marked "reported": read from a file, so that anyone can add theirs."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.evaluation.grounding_tables import MEASURES
from pipeline.metrics.tables import Row
from pipeline.system.errors import InputError

FIGURES = Path(__file__).with_name("reported.json")


class Reported(BaseModel):
    """One published line: figures by the measure's name, as shares, and where they stand."""

    model_config = ConfigDict(extra="forbid")

    table: str
    name: str
    source: str = Field(min_length=1)
    figures: dict[str, float]


class Publications(BaseModel):
    """The file."""

    model_config = ConfigDict(extra="forbid")

    rows: list[Reported]


def read_reported(path: Path = FIGURES) -> tuple[Reported, ...]:
    """All published lines of a file.

    Raises
    ------
    InputError
        It is missing or of another shape.
    """
    try:
        return tuple(Publications.model_validate_json(path.read_bytes()).rows)
    except FileNotFoundError as error:
        raise InputError("there is no such file of published figures", path=path) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        raise InputError(f"published figures: {where}: {first['msg']}", path=path) from error


def reported_rows(table: str = "grounding", columns: tuple[str, ...] = MEASURES, path: Path = FIGURES) -> list[Row]:
    """The published lines of a table; a measure that was not published is left blank."""
    return [
        Row(f"{line.name}, {line.source}", tuple(line.figures.get(c) for c in columns), "reported")
        for line in read_reported(path)
        if line.table == table
    ]
