"""Exports of labels to the formats of other tools; one module a format."""

from pipeline.labels.exports.base import ExportFormat
from pipeline.labels.exports.exporting import FORMATS, export_labels

__all__ = ["FORMATS", "ExportFormat", "export_labels"]
