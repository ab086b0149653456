"""Exports of labels to the formats of other tools; one module a format."""

from pipeline.labels.exports.base import ExportFormat, ExportReport
from pipeline.labels.exports.exporting import FORMATS, export_labels

__all__ = ["FORMATS", "ExportFormat", "ExportReport", "export_labels"]
