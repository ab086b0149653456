"""A report of labels: a folder with a page and its pictures."""

from pipeline.labels.report.folder import check_report_folder, write_report
from pipeline.labels.report.style import need_matplotlib

__all__ = ["check_report_folder", "need_matplotlib", "write_report"]
