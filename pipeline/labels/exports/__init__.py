"""Exports of labels to the formats of other tools; one module a format."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.labels.exports.base import ExportFormat
    from pipeline.labels.exports.exporting import FORMATS, export_labels

__getattr__ = lazy_exports(__name__, __file__)
