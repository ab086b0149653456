"""Readers of RGB-D datasets: one file a format, found by looking at the folder."""

from __future__ import annotations

from pipeline.datasets.base import Dataset, DatasetFormat, resolve_frame
from pipeline.datasets.opening import open_dataset
from pipeline.datasets.settings import Settings, read_settings, write_settings
from pipeline.datasets.summary import SurveyCounts, summarise
from pipeline.datasets.survey import FrameReport, survey

__all__ = [
    "Dataset",
    "DatasetFormat",
    "FrameReport",
    "Settings",
    "SurveyCounts",
    "open_dataset",
    "read_settings",
    "resolve_frame",
    "summarise",
    "survey",
    "write_settings",
]
