"""Readers of RGB-D datasets: one file a format, found by looking at the folder."""

from __future__ import annotations

from pipeline.datasets.base import Dataset, DatasetFormat, resolve_frame
from pipeline.datasets.capabilities import MOVES, GivenExpression, given_expressions, has_moves, moves, splits
from pipeline.datasets.opening import open_dataset
from pipeline.datasets.settings import Settings, read_settings, write_settings
from pipeline.datasets.summary import SurveyCounts, summarise
from pipeline.datasets.survey import FrameReport, survey

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
    "summarise",
    "survey",
    "write_settings",
]
