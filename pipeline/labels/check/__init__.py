"""The linter of labels: rules on tables, objects, relations and expressions."""

from pipeline.labels.check.findings import RULES, Finding, Rule, finding_record
from pipeline.labels.check.linter import check_labels
from pipeline.labels.check.summary import RuleCount, Summary, summarise

__all__ = ["RULES", "Finding", "Rule", "RuleCount", "Summary", "check_labels", "finding_record", "summarise"]
