"""The linter of labels: rules on tables, objects, relations and expressions."""

from pipeline.labels.check.linter import check_labels
from pipeline.labels.check.view import RULES, Finding, finding_record

__all__ = ["RULES", "Finding", "check_labels", "finding_record"]
