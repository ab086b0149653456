"""A report of labels: a folder with a page and its pictures."""

from pipeline.labels.report.folder import check_report_folder, write_report

__all__ = ["check_report_folder", "write_report"]
