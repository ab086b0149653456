"""Readers of RGB-D datasets: one file a format, found by looking at the folder."""

from __future__ import annotations

from pipeline.datasets.base import (
    MOVES,
    Dataset,
    DatasetFormat,
    GivenExpression,
    given_expressions,
    has_moves,
    moves,
    resolve_frame,
    splits,
)
from pipeline.datasets.opening import open_dataset
from pipeline.datasets.settings import Settings, read_settings, write_settings
from pipeline.datasets.survey import FrameReport, SurveyCounts, survey

__all__ = [
    "MOVES",
    "Dataset",
    "DatasetFormat",
    "FrameReport",
    "GivenExpression",
    "Settings",
    "SurveyCounts",
    "given_expressions",
    "has_moves",
    "moves",
    "open_dataset",
    "read_settings",
    "resolve_frame",
    "splits",
    "survey",
    "write_settings",
]
