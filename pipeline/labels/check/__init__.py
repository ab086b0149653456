"""The linter of labels: rules on tables, objects, relations and expressions."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.labels.check.linter import check_labels
    from pipeline.labels.check.view import RULES, Finding, finding_record

__getattr__ = lazy_exports(__name__, __file__)
